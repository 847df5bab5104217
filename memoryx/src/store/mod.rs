//! Long-term memory: what an agent keeps on disk, in one redb file that survives a crash at any moment.
//!
//! What [`LongTermMemory::persist`] has returned for is on the disk, synced; what it has not returned for is there
//! whole or not at all. It does not decide what is worth keeping (see [`crate::Consolidator`]) and keeps no copy in
//! working memory. All functions block for the disk.
//!
//! # The file, format 1
//!
//! A redb file of file format 3 with four tables. Numbers in keys are big-endian, so that the order of bytes is the
//! order of numbers; names hold no control characters, so that a zero byte ends them without doubt.
//!
//! | table | key | value |
//! |---|---|---|
//! | `meta` | `format` (text) | 1 (`u64`) |
//! | `snapshots` | segment `00` provider `00` entity `00` version (8 bytes) | CRC-32 (IEEE, 4 bytes little-endian) of key and record, then the record |
//! | `times` | segment `00` provider `00` entity `00` referenced_ns (8 bytes) version (8 bytes) | nothing |
//! | `latest` | segment `00` provider `00` entity `00` | newest version (`u64`) |
//!
//! A record is the CBOR map `{referenced_ns, sent_ns, arrived_ns, instances}`, `instances` as on the wire. `times` and
//! `latest` follow from `snapshots`; one transaction changes all three, so they never disagree.
//!
//! # What is relied on
//! A sync that returns has written; a write that is not synced may be there in part, or not; nobody else writes
//! into the file (it is locked). redb makes the newest complete transaction the valid one by its own checksums.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use redb::{Database, ReadableDatabase, ReadableTable, ReadableTableMetadata, TableDefinition};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Pattern, Query};
use crate::working::{Backing, WorkingMemory};

mod consolidate;
mod read;
mod record;
mod verify;

#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod tests;

pub use consolidate::{Consolidator, Numbering, Policies, Policy, Step};
pub use verify::Verification;

/// The format that this program writes and reads.
const FORMAT: u64 = 1;
/// redb's cache, bytes.
const CACHE: usize = 32 << 20;
const META: TableDefinition<'_, &str, u64> = TableDefinition::new("meta");
const SNAPSHOTS: TableDefinition<'_, &[u8], &[u8]> = TableDefinition::new("snapshots");
const TIMES: TableDefinition<'_, &[u8], ()> = TableDefinition::new("times");
const LATEST: TableDefinition<'_, &[u8], u64> = TableDefinition::new("latest");

/// Why long-term memory refuses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// Another process, or this one, has the file open.
    #[error("long-term memory `{path}` is in use by another process")]
    Locked {
        /// The file.
        path: String,
    },
    /// The file is not a long-term memory, or its beginning is destroyed.
    #[error("`{path}` is no long-term memory: {what}")]
    NotAStore {
        /// The file.
        path: String,
        /// What is said of it.
        what: String,
    },
    /// The file is of another format.
    #[error("`{path}` is of format {found}; this program reads and writes format {supported}")]
    Format {
        /// The file.
        path: String,
        /// Its format.
        found: u64,
        /// The format of this program.
        supported: u64,
    },
    /// The disk is full.
    #[error("the disk under long-term memory `{path}` is full; nothing of the last commit was kept")]
    Full {
        /// The file.
        path: String,
    },
    /// Something on the disk is not what was written.
    #[error("long-term memory `{path}` is damaged: {what}")]
    Damaged {
        /// The file.
        path: String,
        /// What is damaged.
        what: String,
    },
    /// The operating system refuses.
    #[error("long-term memory `{path}` cannot be used: {what}")]
    Failed {
        /// The file.
        path: String,
        /// What it says.
        what: String,
    },
    /// Another snapshot has the version already.
    #[error("long-term memory has another version {version} of `{id}` already")]
    Version {
        /// The entity.
        id: String,
        /// The version.
        version: u64,
    },
    /// A snapshot that cannot be encoded.
    #[error("`{id}` cannot be kept: {what}")]
    Encode {
        /// The entity.
        id: String,
        /// Why.
        what: String,
    },
}

impl From<StoreError> for MemoryError {
    fn from(error: StoreError) -> Self {
        Self::Store { what: error.to_string() }
    }
}

/// How much a long-term memory holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreStats {
    /// Entities.
    pub entities: u64,
    /// Snapshots.
    pub snapshots: u64,
    /// Length of the file, bytes; 0 where there is no file.
    pub file_bytes: u64,
}

type Opener = Box<dyn Fn() -> Result<Database, redb::DatabaseError> + Send + Sync>;

/// The long-term memory of an agent.
pub struct LongTermMemory {
    path: Option<PathBuf>,
    name: String,
    opener: Opener,
    /// None after a failure: the next use opens the file again, which brings it back to its last commit.
    database: RwLock<Option<Database>>,
}

impl LongTermMemory {
    /// Opens the file, or makes it. A new file is made beside its place and moved there when it is whole, so that a
    /// crash leaves none or all of it.
    ///
    /// # Errors
    /// [`StoreError::Locked`] when it is open elsewhere; [`StoreError::NotAStore`], [`StoreError::Format`] and
    /// [`StoreError::Damaged`] for a file that cannot be used, which is left as it is; [`StoreError::Failed`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let failed = |e: std::io::Error| StoreError::Failed { path: name.clone(), what: e.to_string() };
        if std::fs::metadata(path).map_or(true, |m| m.len() == 0) {
            let mut beside = path.as_os_str().to_owned();
            beside.push(".new");
            let beside = PathBuf::from(beside);
            match std::fs::remove_file(&beside) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(failed(e)),
                _ => {}
            }
            drop(Self::open_file(name.clone(), beside.clone())?);
            std::fs::rename(&beside, path).map_err(failed)?;
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            std::fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
        }
        Self::open_file(name, path.into())
    }

    fn open_file(name: String, file: PathBuf) -> Result<Self, StoreError> {
        let opened = file.clone();
        let opener = Box::new(move || redb::Builder::new().set_cache_size(CACHE).create(&opened));
        Self::open_with(name, Some(file), opener)
    }

    fn open_with(name: String, path: Option<PathBuf>, opener: Opener) -> Result<Self, StoreError> {
        let store = Self { path, name, opener, database: RwLock::new(None) };
        store.reopen()?;
        Ok(store)
    }

    /// Keeps snapshots, all or none; on the disk when this returns. Snapshots that are there already stay as they
    /// are. Returns how many are new.
    ///
    /// # Errors
    /// [`StoreError::Version`] when another snapshot has that version; [`StoreError::Full`] and others when the disk
    /// fails.
    pub fn persist(&self, snapshots: &[Arc<Snapshot>]) -> Result<usize, StoreError> {
        let records = snapshots.iter().map(|s| record::encode(s)).collect::<Result<Vec<_>, _>>()?;
        if records.is_empty() {
            return Ok(0);
        }
        self.with(|database| {
            let transaction = database.begin_write().map_err(|e| self.fault(e))?;
            let mut new = 0;
            {
                let mut table = transaction.open_table(SNAPSHOTS).map_err(|e| self.fault(e))?;
                let mut times = transaction.open_table(TIMES).map_err(|e| self.fault(e))?;
                let mut latest = transaction.open_table(LATEST).map_err(|e| self.fault(e))?;
                for (snapshot, record) in snapshots.iter().zip(&records) {
                    let key = record::key(&snapshot.id, snapshot.version);
                    let held =
                        table.get(key.as_slice()).map_err(|e| self.fault(e))?.map(|v| v.value() == record);
                    match held {
                        Some(true) => continue,
                        Some(false) => {
                            let (id, version) = (snapshot.id.to_string(), snapshot.version);
                            return Err(StoreError::Version { id, version });
                        }
                        None => {}
                    }
                    table.insert(key.as_slice(), record.as_slice()).map_err(|e| self.fault(e))?;
                    let time = record::time_key(&snapshot.id, snapshot.referenced_ns, snapshot.version);
                    times.insert(time.as_slice(), ()).map_err(|e| self.fault(e))?;
                    let entity = record::entity_key(&snapshot.id);
                    let newest = latest.get(entity.as_slice()).map_err(|e| self.fault(e))?.map(|v| v.value());
                    if newest.is_none_or(|n| n < snapshot.version) {
                        latest.insert(entity.as_slice(), snapshot.version).map_err(|e| self.fault(e))?;
                    }
                    new += 1;
                }
            }
            if new > 0 {
                transaction.commit().map_err(|e| self.fault(e))?;
            }
            Ok(new)
        })
    }

    /// The newest version of an entity, also when it says that the entity is gone; `None` when nothing was kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn newest(&self, id: &EntityId) -> Result<Option<Arc<Snapshot>>, StoreError> {
        let query = Query::history(Pattern::entity(id)).limit(1);
        Ok(self.query(&query)?.pop())
    }

    /// Puts the newest snapshots of what a pattern fits back into working memory, with their versions. Returns how
    /// many that memory did not have.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be read; otherwise as [`WorkingMemory::restore`].
    pub fn load_into(&self, memory: &WorkingMemory, pattern: Pattern) -> Result<usize, MemoryError> {
        memory.restore(self.query(&Query::latest(pattern))?)
    }

    /// How much it holds.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn stats(&self) -> Result<StoreStats, StoreError> {
        let file_bytes = self.path.as_ref().and_then(|p| std::fs::metadata(p).ok()).map_or(0, |m| m.len());
        self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            let snapshots = transaction.open_table(SNAPSHOTS).map_err(|e| self.fault(e))?;
            let latest = transaction.open_table(LATEST).map_err(|e| self.fault(e))?;
            Ok(StoreStats {
                entities: latest.len().map_err(|e| self.fault(e))?,
                snapshots: snapshots.len().map_err(|e| self.fault(e))?,
                file_bytes,
            })
        })
    }

    /// Gives free space back to the file system. Returns whether there was any. Waits until nobody else uses it.
    ///
    /// # Errors
    /// When the disk fails; nothing is lost then.
    pub fn compact(&self) -> Result<bool, StoreError> {
        self.with_alone(|database| database.compact().map_err(|e| self.fault(e)))
    }

    /// Uses the database together with others; opens it again first if it has failed.
    fn with<T>(&self, act: impl FnOnce(&Database) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let open = self.database.read().unwrap_or_else(PoisonError::into_inner);
        let open = if open.is_some() {
            open
        } else {
            drop(open);
            self.reopen()?;
            self.database.read().unwrap_or_else(PoisonError::into_inner)
        };
        let Some(database) = open.as_ref() else {
            return Err(self.failed("it has just failed in another place"));
        };
        let result = self.contained(|| act(database));
        drop(open);
        self.close_after(&result);
        result
    }

    /// Uses the database while nobody else does.
    fn with_alone<T>(
        &self,
        act: impl FnOnce(&mut Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.reopen()?;
        let mut open = self.database.write().unwrap_or_else(PoisonError::into_inner);
        let Some(database) = open.as_mut() else {
            return Err(self.failed("it has just failed in another place"));
        };
        let result = self.contained(|| act(database));
        drop(open);
        self.close_after(&result);
        result
    }

    /// After a failure only opening the file again brings a database back that can be used.
    fn close_after<T>(&self, result: &Result<T, StoreError>) {
        if let Err(StoreError::Full { .. } | StoreError::Failed { .. } | StoreError::Damaged { .. }) = result
        {
            self.close();
        }
    }

    /// Closing writes too, and so it can fail; what was acknowledged does not depend on it.
    fn close(&self) {
        let mut open = self.database.write().unwrap_or_else(PoisonError::into_inner);
        let closing = open.take();
        let closed = self.contained(|| {
            drop(closing);
            Ok(())
        });
        if let Err(error) = closed {
            tracing::warn!(%error, "long-term memory was not closed cleanly");
        }
    }

    fn reopen(&self) -> Result<(), StoreError> {
        let mut open = self.database.write().unwrap_or_else(PoisonError::into_inner);
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
        write.open_table(SNAPSHOTS).map_err(|e| fault(e.into()))?;
        write.open_table(TIMES).map_err(|e| fault(e.into()))?;
        write.open_table(LATEST).map_err(|e| fault(e.into()))?;
        write.commit().map_err(|e| fault(e.into()))
    }

    /// redb answers some damages of a file with a panic: here it is an error like others.
    fn contained<T>(&self, act: impl FnOnce() -> Result<T, StoreError>) -> Result<T, StoreError> {
        catch_unwind(AssertUnwindSafe(act)).unwrap_or_else(|panic| {
            let what = panic.downcast_ref::<String>().map(String::as_str);
            let what = what.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
            Err(self.damaged(format!("its pages contradict each other ({what})")))
        })
    }

    fn damaged(&self, what: String) -> StoreError {
        StoreError::Damaged { path: self.name.clone(), what }
    }

    fn failed(&self, what: &str) -> StoreError {
        StoreError::Failed { path: self.name.clone(), what: what.into() }
    }

    /// What an error at opening means to the user.
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
            error => self.fault(error),
        }
    }

    /// What an error in use means to the user.
    fn fault(&self, error: impl Into<redb::Error>) -> StoreError {
        let path = self.name.clone();
        match error.into() {
            redb::Error::Io(e) if e.kind() == std::io::ErrorKind::StorageFull => StoreError::Full { path },
            redb::Error::Corrupted(what) => StoreError::Damaged { path, what },
            redb::Error::DatabaseAlreadyOpen => StoreError::Locked { path },
            error => StoreError::Failed { path, what: error.to_string() },
        }
    }
}

impl Backing for LongTermMemory {
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        let key = record::entity_key(id);
        let version = self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            let latest = transaction.open_table(LATEST).map_err(|e| self.fault(e))?;
            Ok(latest.get(key.as_slice()).map_err(|e| self.fault(e))?.map_or(0, |v| v.value()))
        })?;
        Ok(version)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.persist(snapshots)?;
        Ok(())
    }
}

impl Drop for LongTermMemory {
    fn drop(&mut self) {
        self.close();
    }
}

impl fmt::Debug for LongTermMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LongTermMemory").field("name", &self.name).finish_non_exhaustive()
    }
}
