//! Opening the file, sharing it among readers and writers, and the meaning of its errors. After an error, a usable
//! database comes back only by opening the file again.

use std::panic::{AssertUnwindSafe, catch_unwind};

use redb::{Database, ReadableDatabase};

use super::{BLOB_USES, BLOBS, CHUNKS, ENTITIES, FORMAT, INDEX, LongTermMemory, META, NAMED, StoreError};

impl LongTermMemory {
    /// Uses the database with shared access; opens it again first if it has failed.
    pub(super) fn with<T>(
        &self,
        act: impl FnOnce(&Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let open = self.database.read();
        let open = if open.is_some() {
            open
        } else {
            drop(open);
            self.reopen()?;
            self.database.read()
        };
        let Some(database) = open.as_ref() else {
            return Err(self.failed("it has just failed in another place"));
        };
        let result = self.contained(|| act(database));
        drop(open);
        self.close_after(&result);
        result
    }

    /// Uses the database with exclusive access.
    pub(super) fn with_alone<T>(
        &self,
        act: impl FnOnce(&mut Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.reopen()?;
        let mut open = self.database.write();
        let Some(database) = open.as_mut() else {
            return Err(self.failed("it has just failed in another place"));
        };
        let result = self.contained(|| act(database));
        drop(open);
        self.close_after(&result);
        result
    }

    /// Drops the database after a failure, so that the next use opens the file again.
    fn close_after<T>(&self, result: &Result<T, StoreError>) {
        if let Err(StoreError::Full { .. } | StoreError::Failed { .. } | StoreError::Damaged { .. }) = result
        {
            self.close();
        }
    }

    /// Closes the file. This writes too, and so it can fail; acknowledged data do not depend on it.
    pub(super) fn close(&self) {
        let mut open = self.database.write();
        let closing = open.take();
        let closed = self.contained(|| {
            drop(closing);
            Ok(())
        });
        if let Err(error) = closed {
            tracing::warn!(%error, "long-term memory was not closed cleanly");
        }
    }

    pub(super) fn reopen(&self) -> Result<(), StoreError> {
        let mut open = self.database.write();
        if open.is_none() {
            *open = Some(self.contained(|| {
                let database = (self.opener)().map_err(|e| self.opening(e))?;
                self.check_format(&database)?;
                Ok(database)
            })?);
        }
        Ok(())
    }

    fn check_format(&self, database: &Database) -> Result<(), StoreError> {
        let fault = |e: redb::Error| self.fault(e);
        {
            let read = database.begin_read().map_err(|e| fault(e.into()))?;
            match read.open_table(META) {
                Ok(meta) => {
                    let found = meta.get("format").map_err(|e| fault(e.into()))?.map_or(0, |v| v.value());
                    let path = self.name.clone();
                    return match found {
                        FORMAT => Ok(()),
                        found => Err(StoreError::Format { path, found, supported: FORMAT }),
                    };
                }
                Err(redb::TableError::TableDoesNotExist(_)) => {}
                Err(error) => return Err(fault(error.into())),
            }
            if read.list_tables().map_err(|e| fault(e.into()))?.next().is_some() {
                let what = "it is a database of something else".into();
                return Err(StoreError::NotAStore { path: self.name.clone(), what });
            }
        }
        let write = database.begin_write().map_err(|e| fault(e.into()))?;
        write
            .open_table(META)
            .map_err(|e| fault(e.into()))?
            .insert("format", FORMAT)
            .map_err(|e| fault(e.into()))?;
        let make = || -> Result<(), redb::Error> {
            write.open_table(ENTITIES)?;
            write.open_table(INDEX)?;
            write.open_table(CHUNKS)?;
            write.open_table(BLOBS)?;
            write.open_table(BLOB_USES)?;
            write.open_table(NAMED)?;
            Ok(())
        };
        make().map_err(fault)?;
        write.commit().map_err(|e| fault(e.into()))
    }

    /// Turns panics into errors: redb panics on some damaged files.
    fn contained<T>(&self, act: impl FnOnce() -> Result<T, StoreError>) -> Result<T, StoreError> {
        catch_unwind(AssertUnwindSafe(act)).unwrap_or_else(|panic| {
            let what = panic.downcast_ref::<String>().map(String::as_str);
            let what = what.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
            Err(self.damaged(format!("its pages contradict each other ({what})")))
        })
    }

    pub(super) fn damaged(&self, what: String) -> StoreError {
        StoreError::Damaged { path: self.name.clone(), what }
    }

    pub(super) fn failed(&self, what: &str) -> StoreError {
        StoreError::Failed { path: self.name.clone(), what: what.into() }
    }

    /// The user's error for a redb error at opening.
    fn opening(&self, error: redb::DatabaseError) -> StoreError {
        let path = self.name.clone();
        match error {
            redb::DatabaseError::DatabaseAlreadyOpen => StoreError::Locked { path },
            redb::DatabaseError::UpgradeRequired(format) => {
                StoreError::NotAStore { path, what: format!("it is of redb's old file format {format}") }
            }
            redb::DatabaseError::Storage(redb::StorageError::Io(e))
                if e.kind() == std::io::ErrorKind::InvalidData =>
            {
                StoreError::NotAStore { path, what: e.to_string() }
            }
            redb::DatabaseError::Storage(redb::StorageError::Io(e))
                if e.kind() == std::io::ErrorKind::UnexpectedEof =>
            {
                self.damaged("it is cut short".into())
            }
            error => self.fault(error),
        }
    }

    /// The user's error for a redb error during use.
    pub(super) fn fault(&self, error: impl Into<redb::Error>) -> StoreError {
        let path = self.name.clone();
        match error.into() {
            redb::Error::Io(e) if e.kind() == std::io::ErrorKind::StorageFull => StoreError::Full { path },
            redb::Error::Corrupted(what) => StoreError::Damaged { path, what },
            redb::Error::DatabaseAlreadyOpen => StoreError::Locked { path },
            error => StoreError::Failed { path, what: error.to_string() },
        }
    }
}
