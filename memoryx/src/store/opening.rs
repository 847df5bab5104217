//! Opening the file, sharing it among readers and writers, and the meaning of its errors. After an error, a usable
//! database comes back only by opening the file again.

use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use redb::{Database, ReadableDatabase};

use super::checked::{Opened, Spoiled};
use super::error::Fault;
use super::log::Log;
use super::write::{Totals, Writer};
use super::{EARLIER_FORMAT, FORMAT, LongTermMemory, META, OpenFile, SHARED_WAIT, StoreError, WAIT};

/// Between two tries to open a file that another process has open.
const PAUSE: Duration = Duration::from_millis(5);

impl LongTermMemory {
    /// Uses the database; opens it again first if it has failed.
    pub(super) fn with<T>(&self, act: impl FnOnce(&OpenFile) -> Result<T, Fault>) -> Result<T, StoreError> {
        let open = self.database.read().clone();
        let open = open.map_or_else(|| self.reopen(), Ok)?;
        let result = self.contained(|| act(&open));
        self.closed(Some(open));
        use StoreError::{Damaged, Failed, Full, Reopened};
        if let Err(Full { .. } | Failed { .. } | Damaged { .. } | Reopened { .. }) = result {
            // The next use opens the file again.
            self.close();
        }
        self.release();
        result
    }

    /// Reads a damaged file as far as that is possible: blocks are read whether they are as they were written or not. Nobody
    /// writes meanwhile.
    pub(super) fn salvage<T>(&self, act: impl FnOnce() -> Result<T, StoreError>) -> Result<T, StoreError> {
        let _unwritten = self.memo.lock();
        self.close();
        self.salvages.store(true, Ordering::Release);
        let salvaged = act();
        self.close();
        self.salvages.store(false, Ordering::Release);
        salvaged
    }

    /// Closes a shared file that nobody in this process uses any more.
    pub(super) fn release(&self) {
        if !self.shared {
            return;
        }
        let mut open = self.database.write();
        // Whoever still uses it closes it later.
        if open.as_ref().is_some_and(|open| Arc::strong_count(open) == 1) {
            self.closed(open.take());
        }
    }

    /// Closes the file as soon as nobody uses it. This writes too, and so it can fail; acknowledged data do not depend on it.
    pub(super) fn close(&self) {
        let mut open = self.database.write();
        self.closed(open.take());
    }

    pub(super) fn closed(&self, closing: Option<Arc<OpenFile>>) {
        let closed = self.contained(|| {
            drop(closing);
            Ok(())
        });
        if let Err(error) = closed {
            tracing::warn!(%error, "long-term memory was not closed cleanly");
        }
    }

    pub(super) fn reopen(&self) -> Result<Arc<OpenFile>, StoreError> {
        let mut open = self.database.write();
        if let Some(open) = &*open {
            return Ok(Arc::clone(open));
        }
        let database = self.contained(|| {
            let (database, log) = self.opened().map_err(|e| self.opening(e))?;
            self.check_format(&database)?;
            let round = Totals::read(&database.begin_read()?.open_table(META)?)?.round;
            let log =
                log.map(|log| Log::read(log, round, self.salvages.load(Ordering::Acquire))).transpose()?;
            let is_logged = AtomicBool::new(log.as_ref().is_some_and(|log| !log.stored.is_empty()));
            Ok(Arc::new(OpenFile { database, log: Mutex::new(log), is_logged }))
        })?;
        *open = Some(Arc::clone(&database));
        Ok(database)
    }

    /// Opens the file; waits for another process that has it open.
    #[expect(
        clippy::disallowed_methods,
        reason = "another process holds the file: virtual time does not pass for it"
    )]
    fn opened(&self) -> Result<Opened, redb::DatabaseError> {
        let mut left = if self.shared { SHARED_WAIT } else { WAIT };
        loop {
            match (self.opener)(&self.salvages) {
                Err(redb::DatabaseError::DatabaseAlreadyOpen) if !left.is_zero() => {
                    std::thread::sleep(PAUSE);
                    left = left.saturating_sub(PAUSE);
                }
                opened => return opened,
            }
        }
    }

    /// Sets up a new file, and adds what a file of the earlier format lacks.
    fn check_format(&self, database: &Database) -> Result<(), Fault> {
        let path = self.name.clone();
        let read = database.begin_read()?;
        match read.open_table(META) {
            Ok(meta) => match meta.get("format")?.map_or(0, |v| v.value()) {
                FORMAT => return Ok(()),
                EARLIER_FORMAT => {}
                found => return Err(StoreError::Format { path, found, supported: FORMAT }.into()),
            },
            Err(redb::TableError::TableDoesNotExist(_)) => {
                if read.list_tables()?.next().is_some() {
                    let what = "it is a database of something else".into();
                    return Err(StoreError::NotAStore { path, what }.into());
                }
            }
            Err(error) => return Err(error.into()),
        }
        drop(read);
        let write = database.begin_write()?;
        Writer::set_up(&write)?;
        Ok(write.commit()?)
    }

    /// Turns panics into errors: redb panics on some damaged files.
    pub(super) fn contained<T>(&self, act: impl FnOnce() -> Result<T, Fault>) -> Result<T, StoreError> {
        let result = catch_unwind(AssertUnwindSafe(act)).unwrap_or_else(|panic| {
            let what = panic.downcast_ref::<String>().map(String::as_str);
            let what = what.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
            Err(Fault::Damaged(format!("its pages contradict each other ({what})")))
        });
        result.map_err(|fault| self.fault(fault))
    }

    pub(super) fn damaged(&self, what: String) -> StoreError {
        StoreError::Damaged { path: self.name.clone(), what }
    }

    pub(super) fn failed(&self, what: &str) -> StoreError {
        StoreError::Failed { path: self.name.clone(), what: what.into() }
    }

    /// The user's error for a redb error at opening.
    fn opening(&self, error: redb::DatabaseError) -> StoreError {
        let not_a_store = |what| StoreError::NotAStore { path: self.name.clone(), what };
        match error.into() {
            redb::Error::UpgradeRequired(format) => {
                not_a_store(format!("it is of redb's old file format {format}"))
            }
            redb::Error::Io(e) if e.kind() == ErrorKind::InvalidData && !is_spoiled(&e) => {
                not_a_store(e.to_string())
            }
            redb::Error::Io(e) if e.kind() == ErrorKind::UnexpectedEof => {
                self.damaged("it is cut short".into())
            }
            error => self.fault(Fault::Redb(error)),
        }
    }

    /// The user's error for a fault during use.
    fn fault(&self, fault: Fault) -> StoreError {
        let path = self.name.clone();
        match fault {
            Fault::Other(error) => error,
            Fault::Damaged(what) | Fault::Redb(redb::Error::Corrupted(what)) => self.damaged(what),
            Fault::Redb(redb::Error::Io(e)) if e.kind() == ErrorKind::StorageFull => {
                StoreError::Full { path }
            }
            Fault::Redb(redb::Error::Io(e)) if is_spoiled(&e) => self.damaged(e.to_string()),
            Fault::Redb(redb::Error::DatabaseAlreadyOpen) => StoreError::Locked { path },
            Fault::Redb(redb::Error::PreviousIo) => StoreError::Reopened { path },
            Fault::Redb(error) => StoreError::Failed { path, what: error.to_string() },
        }
    }
}

/// Whether a checksum has shown damage.
fn is_spoiled(error: &std::io::Error) -> bool {
    error.get_ref().is_some_and(|inner| inner.is::<Spoiled>())
}
