//! The file below the database. Each block of it has a checksum, so that a flipped bit is noticed when the block is read, and
//! a file that a killed process has left is opened without reading all of it.
//!
//! | block of 4096 bytes | content |
//! |---|---|
//! | 0 | [`MAGIC`]; the boot of the machine in which it was written (16 bytes); CRC-32 of the rest of its first 512 bytes; from byte 64 the database's own first block |
//! | 1 to 64 | the log of small commits (`log.rs`), which has checksums of its own |
//! | 65, 1090, 2115 ... | checksums of the next 1024 blocks: CRC-32 each, combined by xor with that of a block of zeros |
//! | all others | the blocks of the database, in order |
//!
//! A file of an earlier program begins with [`WITHOUT_LOG`] and has no blocks for a log.
//!
//! The database commits in two phases: it writes the pages, then the header that names them, each with a sync. As long as the
//! machine is not started anew, whatever a process has written is there, in order, however the process ends. So the first sync is
//! left out here, and the second one makes both durable. After another start of the machine, a file that was not closed is not
//! taken for one of two phases: then the database reads everything and falls back to the commit before, where the last one is
//! not complete. So it is when the header is not as it was written.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::Debug;
use std::fs::OpenOptions;
use std::io;
use std::ops::Bound;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::{MappedMutexGuard, Mutex, MutexGuard};
use redb::backends::FileBackend;
use redb::{BackendError, Builder, Database, DatabaseError, StorageBackend};

use super::log::{LOG_AT, LOG_BYTES};

/// How the file begins.
const MAGIC: &[u8; 16] = b"armarium memory2";
/// How files of earlier programs begin: one without a log, and one whose blocks have no checksums either.
const WITHOUT_LOG: &[u8; 16] = b"armarium memory\n";
const PLAIN: &[u8; 4] = b"redb";

const BLOCK: usize = 4096;
/// Blocks whose checksums are in one block.
const GROUP: u64 = 1024;
/// The part of block 0 that is used. A disk writes it whole or not at all.
const HEAD: usize = 512;
/// Places in it: the boot, the checksum and the first block of the database.
const BOOT_AT: usize = 16;
const SUM_AT: usize = 32;
const DATABASE_AT: usize = 64;
/// The byte of the database's header with its flags (`docs/design.md` of redb).
const FLAGS_AT: usize = DATABASE_AT + 9;
const PRIMARY: u8 = 1;
const IN_USE: u8 = 2;
const TWO_PHASES: u8 = 4;

/// One start of the machine.
pub(super) type Boot = [u8; 16];

/// Damage that a checksum shows.
#[derive(Debug, thiserror::Error)]
pub(super) enum Spoiled {
    #[error("block {0} is not as it was written")]
    Block(u64),
    #[error("it is cut short")]
    Cut,
}

impl From<Spoiled> for io::Error {
    fn from(spoiled: Spoiled) -> Self {
        Self::new(io::ErrorKind::InvalidData, spoiled)
    }
}

/// A database, and the file with its log, where it has one.
pub(super) type Opened = (Database, Option<Arc<dyn StorageBackend>>);

/// Opens the database in a file, or creates it. While `salvages` is set, blocks that are damaged are read nevertheless.
pub(super) fn open(
    path: &Path,
    builder: &Builder,
    salvages: &Arc<AtomicBool>,
) -> Result<Opened, DatabaseError> {
    let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
    let mut start = [0; PLAIN.len()];
    let is_plain = io::Read::read_exact(&mut &file, &mut start).is_ok() && start == *PLAIN;
    let backend = FileBackend::new(file)?;
    if is_plain {
        return Ok((builder.create_with_backend(backend)?, None));
    }
    open_checked(backend, builder, this_boot(), salvages)
}

/// As [`open`], on any medium.
pub(super) fn open_checked(
    medium: impl StorageBackend,
    builder: &Builder,
    boot: Option<Boot>,
    salvages: &Arc<AtomicBool>,
) -> Result<Opened, DatabaseError> {
    let medium = Arc::new(medium);
    let file = CheckedFile::new(Arc::clone(&medium), boot, Arc::clone(salvages));
    let database = builder.create_with_backend(file)?;
    let mut start = [0; MAGIC.len()];
    medium.read(0, &mut start)?;
    Ok((database, (start == *MAGIC).then_some(medium as Arc<dyn StorageBackend>)))
}

/// The present start of the machine. `None` where the system does not tell.
fn this_boot() -> Option<Boot> {
    let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    let number = u128::from_str_radix(&text.trim().replace('-', ""), 16).ok()?;
    Some(number.to_be_bytes())
}

/// A file with a checksum for each block.
#[derive(Debug)]
struct CheckedFile<F> {
    file: Arc<F>,
    boot: Option<Boot>,
    salvages: Arc<AtomicBool>,
    /// Read at the first use: then the database has locked the file.
    state: Mutex<Option<FileState>>,
    /// The checksum of a block of zeros.
    zero: u32,
}

#[derive(Debug)]
struct FileState {
    head: Box<[u8; HEAD]>,
    layout: Layout,
    /// The flags at the last sync, and whether the header was written since.
    synced_flags: u8,
    is_head_written: bool,
    /// Checksums by group, of the groups that were used.
    groups: BTreeMap<u64, Sums>,
}

/// The checksums of a group of blocks, and which of them the file does not have yet.
#[derive(Debug)]
struct Sums {
    sums: Vec<u32>,
    changed: Option<(usize, usize)>,
}

impl Sums {
    fn set(&mut self, at: usize, sum: u32) {
        if let Some(place) = self.sums.get_mut(at).filter(|place| **place != sum) {
            *place = sum;
            let (from, to) = self.changed.unwrap_or((at, at));
            self.changed = Some((from.min(at), to.max(at)));
        }
    }
}

/// Where things are in a file.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Blocks before the first group: the head, and those of the log.
    before: u64,
}

impl Layout {
    fn of(head: &[u8; HEAD]) -> Self {
        let log = if head.starts_with(MAGIC) { LOG_BYTES / BLOCK as u64 } else { 0 };
        Self { before: 1 + log }
    }

    /// How long the file is for so many bytes of the database, and the reverse.
    fn outer_len(self, inner: u64) -> u64 {
        let blocks = (inner / BLOCK as u64).saturating_sub(1);
        if inner == 0 { 0 } else { (self.before + blocks + blocks.div_ceil(GROUP)) * BLOCK as u64 }
    }

    fn inner_len(self, outer: u64) -> u64 {
        let blocks = (outer / BLOCK as u64).saturating_sub(self.before);
        let (full, rest) = (blocks / (GROUP + 1), blocks % (GROUP + 1));
        if outer == 0 { 0 } else { (1 + full * GROUP + rest.saturating_sub(1)) * BLOCK as u64 }
    }

    /// Where the checksums of a group are.
    fn sums_at(self, group: u64) -> u64 {
        (self.before + group * (GROUP + 1)) * BLOCK as u64
    }

    /// The runs of whole blocks from `offset`, which is behind block 0.
    fn runs(self, offset: u64, len: usize) -> io::Result<Vec<BlockRun>> {
        let block = BLOCK as u64;
        if offset < block || !offset.is_multiple_of(block) || !len.is_multiple_of(BLOCK) {
            let what = "the database does not use whole blocks";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        let (mut next, mut done, mut runs) = (offset / block - 1, 0, Vec::new());
        while done < len {
            let (group, first) = (next / GROUP, next % GROUP);
            let count = (GROUP - first).min((len - done) as u64 / block);
            let bytes = done..done + count as usize * BLOCK;
            let at = self.sums_at(group) + (1 + first) * block;
            done = bytes.end;
            runs.push(BlockRun { group, first: first as usize, at, bytes });
            next += count;
        }
        Ok(runs)
    }
}

/// A part of the database's blocks that lies in one group.
struct BlockRun {
    group: u64,
    /// The first of its blocks, counted in the group.
    first: usize,
    /// Where it begins in the file.
    at: u64,
    /// Its part of the bytes that are read or written.
    bytes: std::ops::Range<usize>,
}

impl<F: StorageBackend> CheckedFile<F> {
    fn new(file: Arc<F>, boot: Option<Boot>, salvages: Arc<AtomicBool>) -> Self {
        Self { file, boot, salvages, state: Mutex::new(None), zero: crc32fast::hash(&[0; BLOCK]) }
    }

    fn sum(&self, block: &[u8]) -> u32 {
        crc32fast::hash(block) ^ self.zero
    }

    /// The state, which is read first if that was not done yet.
    fn state(&self) -> io::Result<MappedMutexGuard<'_, FileState>> {
        let mut state = self.state.lock();
        if state.is_none() {
            *state = Some(self.first_state()?);
        }
        Ok(MutexGuard::map(state, |state| state.as_mut().expect("it was read")))
    }

    fn first_state(&self) -> io::Result<FileState> {
        let mut head = Box::new([0; HEAD]);
        let len = self.file.len()?;
        let mut is_doubtful = false;
        if len == 0 {
            head[..MAGIC.len()].copy_from_slice(MAGIC);
        } else {
            let used = head.len().min(usize::try_from(len).unwrap_or(HEAD));
            self.file.read(0, &mut head[..used])?;
            if !head.starts_with(MAGIC) && !head.starts_with(WITHOUT_LOG) {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "it does not begin like one"));
            }
            if !len.is_multiple_of(BLOCK as u64) {
                return Err(Spoiled::Cut.into());
            }
            let is_whole = head[SUM_AT..SUM_AT + 4] == head_sum(&head);
            let is_in_use = head[FLAGS_AT] & IN_USE != 0;
            is_doubtful =
                !is_whole || is_in_use && self.boot.is_none_or(|boot| head[BOOT_AT..SUM_AT] != boot);
        }
        if is_doubtful {
            head[FLAGS_AT] = head[FLAGS_AT] & !TWO_PHASES | IN_USE;
        }
        let (layout, synced_flags) = (Layout::of(&head), head[FLAGS_AT]);
        let mut state =
            FileState { head, layout, synced_flags, is_head_written: false, groups: BTreeMap::new() };
        if is_doubtful {
            self.sum_all(&mut state)?;
        }
        Ok(state)
    }

    /// Takes the checksums of what is there, which the database compares with its own.
    fn sum_all(&self, state: &mut FileState) -> io::Result<()> {
        let blocks = state.layout.inner_len(self.file.len()?) / BLOCK as u64 - 1;
        for group in 0..blocks.div_ceil(GROUP) {
            let count = (blocks - group * GROUP).min(GROUP) as usize;
            let mut bytes = vec![0; count * BLOCK];
            self.file.read(state.layout.sums_at(group) + BLOCK as u64, &mut bytes)?;
            let mut sums = vec![0; GROUP as usize];
            sums.iter_mut().zip(bytes.chunks(BLOCK)).for_each(|(sum, block)| *sum = self.sum(block));
            state.groups.insert(group, Sums { sums, changed: Some((0, GROUP as usize - 1)) });
        }
        Ok(())
    }

    fn sums<'s>(&self, state: &'s mut FileState, group: u64) -> io::Result<&'s mut Sums> {
        Ok(match state.groups.entry(group) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => {
                let mut bytes = [0; BLOCK];
                self.file.read(state.layout.sums_at(group), &mut bytes)?;
                let number = |bytes: &[u8]| bytes.first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
                unknown.insert(Sums { sums: bytes.chunks(4).map(number).collect(), changed: None })
            }
        })
    }

    /// Writes the checksums that have changed.
    fn write_sums(&self, state: &mut FileState) -> io::Result<()> {
        for (group, sums) in &mut state.groups {
            let Some((from, to)) = sums.changed else { continue };
            let changed = sums.sums.get(from..=to).unwrap_or_default();
            let bytes: Vec<u8> = changed.iter().flat_map(|sum| sum.to_le_bytes()).collect();
            self.file.write(state.layout.sums_at(*group) + 4 * from as u64, &bytes)?;
            sums.changed = None;
        }
        Ok(())
    }
}

fn head_sum(head: &[u8; HEAD]) -> [u8; 4] {
    let mut sum = crc32fast::Hasher::new();
    sum.update(&head[..SUM_AT]);
    sum.update(&head[SUM_AT + 4..]);
    sum.finalize().to_le_bytes()
}

/// The bytes of the head for a part of the database's first block.
fn in_head(offset: u64, len: usize) -> io::Result<std::ops::Range<usize>> {
    let from = DATABASE_AT + offset as usize;
    if from + len > HEAD {
        let what = "the database's header is longer than it was";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    }
    Ok(from..from + len)
}

/// Functions on locks, which are those of the file below.
macro_rules! locks_of_the_file {
    ($($name:ident: $answer:ty,)*) => {$(
        fn $name(&self, start: Bound<u64>, end: Bound<u64>) -> Result<$answer, BackendError> {
            self.file.$name(start, end)
        }
    )*};
}

impl<F: StorageBackend> StorageBackend for CheckedFile<F> {
    fn len(&self) -> io::Result<u64> {
        let len = self.file.len()?;
        Ok(self.state()?.layout.inner_len(len))
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        if offset < BLOCK as u64 {
            let range = in_head(offset, out.len())?;
            out.copy_from_slice(&self.state()?.head[range]);
            return Ok(());
        }
        let layout = self.state()?.layout;
        for run in layout.runs(offset, out.len())? {
            let bytes = &mut out[run.bytes];
            self.file.read(run.at, bytes)?;
            if self.salvages.load(Ordering::Acquire) {
                continue;
            }
            let found: Vec<u32> = bytes.chunks(BLOCK).map(|block| self.sum(block)).collect();
            let mut state = self.state()?;
            let expected = self.sums(&mut state, run.group)?.sums.iter().skip(run.first);
            if let Some(at) = found.iter().zip(expected).position(|(found, expected)| found != expected) {
                return Err(Spoiled::Block(run.at / BLOCK as u64 + at as u64).into());
            }
        }
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let mut state = self.state()?;
        let before = state.layout.inner_len(self.file.len()?);
        // What is cut off is zero when it comes back.
        for block in len / BLOCK as u64..before / BLOCK as u64 {
            let Some(block) = block.checked_sub(1) else { continue };
            self.sums(&mut state, block / GROUP)?.set((block % GROUP) as usize, 0);
        }
        let groups = (len / BLOCK as u64).saturating_sub(1).div_ceil(GROUP);
        state.groups.retain(|group, _| *group < groups);
        self.file.set_len(state.layout.outer_len(len))?;
        if before == 0 && len > 0 {
            // Blocks that have been written once are synced without a change of the file's map.
            self.file.write(LOG_AT, &vec![0; LOG_BYTES as usize])?;
        }
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        let mut state = self.state()?;
        self.write_sums(&mut state)?;
        let (flags, synced) = (state.head[FLAGS_AT], state.synced_flags);
        let is_first_phase = state.is_head_written
            && flags & synced & IN_USE != 0
            && flags & PRIMARY == synced & PRIMARY
            && self.boot.is_some();
        if is_first_phase {
            return Ok(());
        }
        drop(state);
        self.file.sync_data()?;
        let mut state = self.state()?;
        (state.synced_flags, state.is_head_written) = (flags, false);
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        if offset < BLOCK as u64 {
            let range = in_head(offset, data.len())?;
            let mut state = self.state()?;
            state.head[range].copy_from_slice(data);
            state.head[BOOT_AT..SUM_AT].copy_from_slice(&self.boot.unwrap_or_default());
            let sum = head_sum(&state.head);
            state.head[SUM_AT..SUM_AT + 4].copy_from_slice(&sum);
            state.is_head_written = true;
            return self.file.write(0, &state.head[..]);
        }
        let layout = self.state()?.layout;
        for run in layout.runs(offset, data.len())? {
            let bytes = &data[run.bytes];
            self.file.write(run.at, bytes)?;
            let found: Vec<u32> = bytes.chunks(BLOCK).map(|block| self.sum(block)).collect();
            let mut state = self.state()?;
            let sums = self.sums(&mut state, run.group)?;
            found.into_iter().zip(run.first..).for_each(|(sum, at)| sums.set(at, sum));
        }
        Ok(())
    }

    fn close(&self) -> io::Result<()> {
        let written = self.state().and_then(|mut state| self.write_sums(&mut state));
        self.file.close().and(written)
    }

    locks_of_the_file! {
        try_lock_range: bool,
        try_lock_shared_range: bool,
        lock_range: (),
        lock_shared_range: (),
        unlock_range: (),
        query_lock_range: bool,
    }
}
