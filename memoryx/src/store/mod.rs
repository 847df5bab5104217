//! Long-term memory: what an agent keeps on disk, in one redb file that survives a crash at any moment.
//!
//! Everything for which [`LongTermMemory::persist`] has returned is synced to disk. A call that has not returned is
//! stored completely or not at all. This module does not decide what is worth storing (see [`crate::Consolidator`])
//! and does not cache snapshots. All functions block on the disk.
//!
//! # The file, format 3
//!
//! A redb database of file format 3, in a file whose blocks have checksums (`checked.rs`). Snapshots are stored in chunks, in the order of arrival; an index finds them by
//! entity and version. So storing a group costs little more than writing its bytes, and reading everything means
//! reading the chunks.
//!
//! | table | key | value |
//! |---|---|---|
//! | `meta` | name (text) | `u64`: `format` (3), `log` (the round of the log), `next_entity`, `next_chunk`, `snapshots`, `bytes` (of chunks and blobs) |
//! | `entities` | segment `00` provider `00` entity `00` | its number (`u64`), and whether later versions never speak of earlier times |
//! | `index` | entity's number, version | chunk (`u64`), offset and length in it (`u32` each), referenced_ns (`u64`) |
//! | `chunks` | number, counted up | records, one after the other, up to 64 kB; a longer record has a chunk of its own |
//! | `blobs` | SHA-256 of the content | the content: byte values of 16 kB or more |
//! | `blob_uses` | SHA-256 of the content | how many records name it (`u64`) |
//! | `ages` | when the newest record of a chunk arrived, ns, and the chunk's number; 0 where that is not known yet, or retention is to come to it next | nothing: the chunks that retention is not done with |
//! | `kept` | number of a chunk of which retention has forgotten something, or to which it has moved what stays, because it is the newest of its entity | how many of its bytes are still in the index (`u64`) |
//! | `removed` | entity's number | its key, if it was ever removed |
//! | `given` | entity's number; the largest `u64` for all entities that are not stored | no later version than this was given to it; at least the newest stored one where there is no row |
//! | `named` | name (text) | a named snapshot of working memory: the time it was taken, then entity numbers and versions (`u64` each) |
//!
//! A record: its length (`u32`), CRC-32 (IEEE, `u32`) of the rest, the entity's number, the version, referenced_ns,
//! sent_ns, arrived_ns (`u64` each), the number of instances, and for each the confidence (`f64`), the attributes and
//! the covariances. All numbers are little-endian, counts and lengths LEB128; a value is a byte for its kind, then
//! its content (`record.rs` has the list). Names hold no control characters, so a zero byte ends them unambiguously.
//! One transaction changes all tables, so they are always consistent. A file of format 2, which lacks these four tables, gets
//! them when it is opened. Commits of a few snapshots go into a log first, from which the tables take many together (`log.rs`).
//!
//! # Assumptions about the medium
//! A sync that has returned has written its data. A write that was not synced may be there, missing, or there in
//! part. Who has the file open has it alone (it is locked); others wait a moment. redb selects the newest complete
//! transaction by its own checksums.
//!
//! # Several processes
//! [`LongTermMemory::open`] keeps the file for as long as it lives. [`LongTermMemory::open_shared`] opens it for each use only,
//! so that several processes read and write one file. A snapshot of an entity that another process has written meanwhile is
//! stored as the entity's next version: nothing is lost, and what was written last is the newest. Versions that are not stored are
//! not counted there.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use redb::{Database, ReadableTableMetadata, TableDefinition};

use crate::entity::{EntityId, Snapshot};
use crate::query::{Pattern, Query};

mod backup;
mod checked;
mod coding;
mod compact;
mod consolidate;
mod error;
mod exchange;
mod facts;
mod loading;
mod log;
mod named;
mod opening;
mod read;
mod record;
mod retain;
mod verify;
mod write;

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod keep_tests;
#[cfg(test)]
mod query_tests;
#[cfg(test)]
pub(crate) mod tests;

pub use coding::Coding;
pub use consolidate::{Consolidator, Policies, Policy};
pub use error::StoreError;
pub use loading::Loading;
pub use named::{EntityChange, NamedSnapshot};
pub use retain::{Dropped, Retention};
pub use verify::Verification;

use facts::EntityCache;
use log::{Log, Stored};
use parking_lot::{Mutex, RwLock};
use write::Totals;

/// The format that this program writes and reads.
const FORMAT: u64 = 3;
/// The earlier format, which lacks the tables `ages`, `kept`, `removed` and `given`.
const EARLIER_FORMAT: u64 = 2;
/// redb's cache, bytes. A process has two of them while it compacts the file.
const CACHE_BYTES: usize = 10 << 20;
const META: TableDefinition<'_, &str, u64> = TableDefinition::new("meta");
const ENTITIES: TableDefinition<'_, &[u8], (u64, bool)> = TableDefinition::new("entities");
const INDEX: TableDefinition<'_, (u64, u64), RecordPlace> = TableDefinition::new("index");
const CHUNKS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("chunks");
const BLOBS: TableDefinition<'_, &[u8], &[u8]> = TableDefinition::new("blobs");
const BLOB_USES: TableDefinition<'_, &[u8], u64> = TableDefinition::new("blob_uses");
const AGES: TableDefinition<'_, (u64, u64), ()> = TableDefinition::new("ages");
const KEPT: TableDefinition<'_, u64, u64> = TableDefinition::new("kept");
const REMOVED: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("removed");
const GIVEN: TableDefinition<'_, u64, u64> = TableDefinition::new("given");
const NAMED: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("named");

/// How long an opening waits for another process that has the file, where processes share it, and where they do not.
const SHARED_WAIT: Duration = Duration::from_secs(5);
const WAIT: Duration = Duration::from_millis(200);

/// Where a record is: chunk, offset, length, and its referenced time, ns.
type RecordPlace = (u64, u32, u32, u64);

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

/// Opens the database; while the flag is set, damaged blocks are read nevertheless.
type Opener = Box<dyn Fn(&Arc<AtomicBool>) -> Result<checked::Opened, redb::DatabaseError> + Send + Sync>;

/// The file while it is open.
struct OpenFile {
    database: Database,
    /// Locked by the writer. `None` where an earlier program has made the file.
    log: Mutex<Option<Log>>,
    /// Whether something is in the log, for readers, who do not wait for the writer's lock.
    is_logged: AtomicBool,
}

/// The long-term memory of an agent.
pub struct LongTermMemory {
    path: Option<PathBuf>,
    name: String,
    opener: Opener,
    /// `None` after a failure: the next use opens the file again, which restores the last commit.
    database: RwLock<Option<Arc<OpenFile>>>,
    /// Cached facts about entities; locked by the writer.
    memo: Mutex<EntityCache>,
    /// Whether the file is open only while it is used.
    shared: bool,
    /// Held by what changes more than a commit: retention, compaction, named snapshots.
    upkeep: Mutex<()>,
    /// What is stored while the file is copied; locked by the writer.
    journal: Mutex<Option<Stored>>,
    /// Whether damaged blocks are read nevertheless.
    salvages: Arc<AtomicBool>,
}

impl LongTermMemory {
    /// Opens the file, or creates it and its folder. A new file is created under a temporary name and renamed when complete,
    /// so that a crash leaves no incomplete file at `path`.
    ///
    /// # Errors
    /// [`StoreError::Locked`] when it is open elsewhere; [`StoreError::NotAStore`], [`StoreError::Format`] and
    /// [`StoreError::Damaged`] for a file that cannot be used, which is not changed; [`StoreError::Failed`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_as(path, false)
    }

    /// As [`open`](Self::open), for a file that other processes use at the same time: it is open only while it is read or
    /// written. Each use waits a few seconds at most for the others.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_shared(path: &Path) -> Result<Self, StoreError> {
        Self::open_as(path, true)
    }

    fn open_as(path: &Path, shared: bool) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let failed = |e: std::io::Error| StoreError::Failed { path: name.clone(), what: e.to_string() };
        if std::fs::metadata(path).is_ok_and(|m| m.len() == 0) {
            let what = "it is empty: remove it, and a new one is made in its place".into();
            return Err(StoreError::NotAStore { path: name, what });
        }
        if std::fs::metadata(path).is_err() {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            if !folder.is_dir() {
                let folder = folder.display();
                let what = format!("there is no folder `{folder}`: make it, or choose a file in another one");
                return Err(StoreError::Failed { path: name, what });
            }
            let beside = beside(path);
            drop(Self::open_file(name.clone(), beside.clone(), false)?);
            let placed = match std::fs::hard_link(&beside, path) {
                // A file system without hard links.
                Err(e) if e.kind() != std::io::ErrorKind::AlreadyExists => std::fs::rename(&beside, path),
                // It is there, or another process has made one meanwhile.
                _ => std::fs::remove_file(&beside),
            };
            placed.map_err(failed)?;
            std::fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
        }
        Self::open_file(name, path.into(), shared)
    }

    fn open_file(name: String, file: PathBuf, shared: bool) -> Result<Self, StoreError> {
        let opened = file.clone();
        let opener = Box::new(move |salvages: &Arc<AtomicBool>| {
            checked::open(&opened, redb::Builder::new().set_cache_size(CACHE_BYTES), salvages)
        });
        Self::open_with(name, Some(file), opener, shared)
    }

    fn open_with(
        name: String,
        path: Option<PathBuf>,
        opener: Opener,
        shared: bool,
    ) -> Result<Self, StoreError> {
        let store = Self {
            path,
            name,
            opener,
            database: RwLock::new(None),
            memo: Mutex::default(),
            shared,
            upkeep: Mutex::default(),
            journal: Mutex::default(),
            salvages: Arc::default(),
        };
        match store.reopen() {
            // Whoever reads what is damaged learns that; the rest can be exported.
            Err(StoreError::Damaged { .. }) if store.salvage(|| store.reopen().map(drop)).is_ok() => {}
            opened => drop(opened?),
        }
        store.release();
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

    /// Its size.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn stats(&self) -> Result<StoreStats, StoreError> {
        let file_bytes = self.path.as_ref().and_then(|p| std::fs::metadata(p).ok()).map_or(0, |m| m.len());
        self.read_tables(|transaction| {
            let Totals { snapshots, bytes, .. } = Totals::read(&transaction.open_table(META)?)?;
            let entities = transaction.open_table(ENTITIES)?.len()?;
            Ok(StoreStats { entities, snapshots, bytes, file_bytes })
        })
    }
}

/// A path beside a file that no other opening uses.
fn beside(path: &Path) -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{}-{}.new", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed)));
    PathBuf::from(name)
}

impl Drop for LongTermMemory {
    fn drop(&mut self) {
        // After an end in good order, the log is empty. After any other one, the next opening reads it.
        let is_open = self.database.read().is_some();
        if is_open && let Err(error) = self.read_tables(|_| Ok(())) {
            tracing::warn!(%error, "what is in its log stays there");
        }
        self.close();
    }
}

impl fmt::Debug for LongTermMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LongTermMemory").field("name", &self.name).finish_non_exhaustive()
    }
}
