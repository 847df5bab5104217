//! Long-term memory: what an agent keeps on disk, in one redb file that survives a crash at any moment.
//!
//! Everything for which [`LongTermMemory::persist`] has returned is synced to disk. A call that has not returned is
//! stored completely or not at all. This module does not decide what is worth storing (see [`crate::Consolidator`])
//! and does not cache snapshots. All functions block on the disk.
//!
//! # The file, format 2
//!
//! A redb file of file format 3. Snapshots are stored in chunks, in the order of arrival; an index finds them by
//! entity and version. So storing a group costs little more than writing its bytes, and reading everything means
//! reading the chunks.
//!
//! | table | key | value |
//! |---|---|---|
//! | `meta` | name (text) | `u64`: `format` (2), `next_entity`, `next_chunk`, `snapshots`, `bytes` (of chunks and blobs) |
//! | `entities` | segment `00` provider `00` entity `00` | its number (`u64`), and whether later versions never speak of earlier times |
//! | `index` | entity's number, version | chunk (`u64`), offset and length in it (`u32` each), referenced_ns (`u64`) |
//! | `chunks` | number, counted up | records, one after the other, up to 64 kB; a longer record has a chunk of its own |
//! | `blobs` | SHA-256 of the content | the content: byte values of 16 kB or more |
//! | `blob_uses` | SHA-256 of the content | how many records name it (`u64`) |
//! | `named` | name (text) | a named snapshot of working memory: the time it was taken, then entity numbers and versions (`u64` each) |
//!
//! A record: its length (`u32`), CRC-32 (IEEE, `u32`) of the rest, the entity's number, the version, referenced_ns,
//! sent_ns, arrived_ns (`u64` each), the number of instances, and for each the confidence (`f64`), the attributes and
//! the covariances. All numbers are little-endian, counts and lengths LEB128; a value is a byte for its kind, then
//! its content (`record.rs` has the list). Names hold no control characters, so a zero byte ends them unambiguously.
//! One transaction changes all tables, so they are always consistent.
//!
//! # Assumptions about the medium
//! A sync that has returned has written its data. A write that was not synced may be there, missing, or there in
//! part. No other process writes to the file (it is locked). redb selects the newest complete transaction by its own
//! checksums.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use redb::{Database, ReadableDatabase, ReadableTableMetadata, TableDefinition};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Pattern, Query};
use crate::working::{Backing, Kept, WorkingMemory};

mod coding;
mod consolidate;
mod error;
mod exchange;
mod named;
mod opening;
mod read;
mod record;
mod retain;
mod verify;
mod write;

#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod keep_tests;
#[cfg(test)]
mod query_tests;
#[cfg(test)]
mod tests;

pub use coding::Coding;
pub use consolidate::{Consolidator, Numbering, Policies, Policy, Step};
pub use error::StoreError;
pub use named::Named;
pub use retain::{Dropped, Retention};
pub use verify::Verification;

use parking_lot::{Mutex, RwLock};
use write::{Memo, Totals};

/// The format that this program writes and reads.
const FORMAT: u64 = 2;
/// Snapshots that are loaded together, and about how many bytes of them.
const PIECE: usize = 8192;
const PIECE_BYTES: u64 = 16 << 20;
/// redb's cache, bytes.
const CACHE: usize = 32 << 20;
const META: TableDefinition<'_, &str, u64> = TableDefinition::new("meta");
const ENTITIES: TableDefinition<'_, &[u8], (u64, bool)> = TableDefinition::new("entities");
const INDEX: TableDefinition<'_, (u64, u64), Row> = TableDefinition::new("index");
const CHUNKS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("chunks");
const BLOBS: TableDefinition<'_, &[u8], &[u8]> = TableDefinition::new("blobs");
const BLOB_USES: TableDefinition<'_, &[u8], u64> = TableDefinition::new("blob_uses");
const NAMED: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("named");

/// Where a record is: chunk, offset, length, and its referenced time, ns.
type Row = (u64, u32, u32, u64);

/// The size of a long-term memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreStats {
    /// Entities.
    pub entities: u64,
    /// Snapshots.
    pub snapshots: u64,
    /// Bytes of records and blobs, without the free space between them.
    pub bytes: u64,
    /// Length of the file, bytes; 0 where there is no file.
    pub file_bytes: u64,
}

type Opener = Box<dyn Fn() -> Result<Database, redb::DatabaseError> + Send + Sync>;

/// The long-term memory of an agent.
pub struct LongTermMemory {
    path: Option<PathBuf>,
    name: String,
    opener: Opener,
    /// `None` after a failure: the next use opens the file again, which restores the last commit.
    database: RwLock<Option<Database>>,
    /// Cached facts about entities; locked by the writer.
    memo: Mutex<Memo>,
}

impl LongTermMemory {
    /// Opens the file, or creates it. A new file is created under a temporary name and renamed when complete, so that
    /// a crash leaves no incomplete file at `path`.
    ///
    /// # Errors
    /// [`StoreError::Locked`] when it is open elsewhere; [`StoreError::NotAStore`], [`StoreError::Format`] and
    /// [`StoreError::Damaged`] for a file that cannot be used, which is not changed; [`StoreError::Failed`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let failed = |e: std::io::Error| StoreError::Failed { path: name.clone(), what: e.to_string() };
        if std::fs::metadata(path).is_ok_and(|m| m.len() == 0) {
            let what = "it is empty: remove it, and a new one is made in its place".into();
            return Err(StoreError::NotAStore { path: name, what });
        }
        if std::fs::metadata(path).is_err() {
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
        let store = Self { path, name, opener, database: RwLock::new(None), memo: Mutex::default() };
        store.reopen()?;
        Ok(store)
    }

    /// The newest version of an entity, removals included; `None` when nothing is stored.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn newest(&self, id: &EntityId) -> Result<Option<Arc<Snapshot>>, StoreError> {
        let query = Query::history(Pattern::entity(id)).limit(1);
        Ok(self.query(&query)?.pop())
    }

    /// Loads the newest snapshots of matching entities into working memory, with their versions. Returns how many of
    /// them that memory did not have. Snapshots that it refuses, because they are invalid or it is full, stay in the
    /// file only, with a log line.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be read.
    pub fn load_into(&self, memory: &WorkingMemory, pattern: Pattern) -> Result<usize, MemoryError> {
        let (mut restored, mut refused) = (0, None);
        let mut query = Query { most: Some(PIECE), most_bytes: Some(PIECE_BYTES), ..Query::latest(pattern) };
        loop {
            let found = self.query(&query)?;
            let Some(last) = found.last().map(|s| Cursor { id: s.id.clone(), version: s.version }) else {
                break;
            };
            let is_cut = query.is_filled_by(&found);
            let (count, error) = memory.restore(found);
            restored += count;
            refused = refused.or(error);
            if !is_cut {
                break;
            }
            query.after = Some(last);
        }
        if let Some(error) = refused {
            tracing::warn!(%error, store = self.name, "some of what was kept is not in working memory");
        }
        Ok(restored)
    }

    /// Its size.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn stats(&self) -> Result<StoreStats, StoreError> {
        let file_bytes = self.path.as_ref().and_then(|p| std::fs::metadata(p).ok()).map_or(0, |m| m.len());
        self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            let meta = transaction.open_table(META).map_err(|e| self.fault(e))?;
            let totals = Totals::read(&meta).map_err(|e| self.fault(e))?;
            let entities = transaction.open_table(ENTITIES).map_err(|e| self.fault(e))?;
            Ok(StoreStats {
                entities: entities.len().map_err(|e| self.fault(e))?,
                snapshots: totals.snapshots,
                bytes: totals.bytes,
                file_bytes,
            })
        })
    }

    /// Joins small chunks and returns free space to the file system. Returns whether the file has changed. Waits
    /// until it has the database for itself.
    ///
    /// # Errors
    /// When the disk fails; nothing is lost then.
    pub fn compact(&self) -> Result<bool, StoreError> {
        let joined = self.join_chunks()?;
        let freed = self.with_alone(|database| database.compact().map_err(|e| self.fault(e)))?;
        Ok(joined || freed)
    }
}

impl Backing for LongTermMemory {
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        Ok(self.newest_version(id)?)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.persist(snapshots)?;
        Ok(())
    }

    fn kept(&self) -> Option<&dyn Kept> {
        Some(self)
    }
}

impl Kept for LongTermMemory {
    fn recall(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        Ok(self.query(query)?)
    }

    fn versions(
        &self,
        query: &Query,
        backwards: bool,
        act: &mut dyn FnMut(u64) -> bool,
    ) -> Result<(), MemoryError> {
        Ok(self.versions_of(query, backwards, act)?)
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
