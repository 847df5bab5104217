//! Long-term memory on failing media: a crash at every write, a full disk, kill -9.

use std::io;
use std::io::BufRead;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;

use parking_lot::Mutex;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use redb::StorageBackend;

use super::checked;
use super::damage_tests::file_with;
use super::tests::{all, removed, snapshot, store};
use super::*;
use crate::working::Backing;
use crate::working::WorkingMemory;

/// A medium that loses power: each unsynced write may be there, missing, or there in part.
#[derive(Clone, Debug, Default)]
struct Medium(Arc<Mutex<Disk>>);

#[derive(Debug, Default)]
struct Disk {
    /// What a reader sees now.
    seen: Vec<u8>,
    /// What certainly survives.
    synced: Vec<u8>,
    /// Writes since the last sync.
    loose: Vec<(u64, Vec<u8>)>,
    /// Syncs, and bytes written, so far; and the most bytes between two syncs.
    syncs: u64,
    written: u64,
    largest: u64,
    /// Number of changes that still succeed.
    left: Option<u64>,
    /// Whether the changes after that report a full disk.
    full: bool,
    /// How often the power was off.
    boot: u8,
    /// How often all of it was read when it was opened.
    repairs: u64,
}

impl Disk {
    fn change(&mut self) -> io::Result<()> {
        match &mut self.left {
            Some(0) if self.full => Err(io::ErrorKind::StorageFull.into()),
            Some(0) => Err(io::Error::other("the power is off")),
            Some(left) => {
                *left -= 1;
                Ok(())
            }
            None => Ok(()),
        }
    }
}

impl Medium {
    fn store(&self) -> Result<LongTermMemory, StoreError> {
        let medium = self.clone();
        let opener: Opener = Box::new(move |salvages| {
            let boot = [medium.0.lock().boot; 16];
            let repaired = medium.clone();
            let mut builder = redb::Builder::new();
            builder.set_repair_callback(move |_| repaired.0.lock().repairs += 1);
            checked::open_checked(medium.clone(), &builder, Some(boot), salvages)
        });
        LongTermMemory::open_with("medium".into(), None, opener, false)
    }

    fn fail_after(&self, changes: Option<u64>, full: bool) {
        let mut disk = self.0.lock();
        (disk.left, disk.full) = (changes, full);
    }

    /// Restores power: each unsynced write is there, there in part, or missing.
    fn recover(&self, random: &mut ChaCha8Rng) {
        let mut disk = self.0.lock();
        let mut bytes = std::mem::take(&mut disk.synced);
        for (offset, data) in std::mem::take(&mut disk.loose) {
            let written = match random.random_range(0..3) {
                0 => 0,
                1 => random.random_range(0..=data.len()),
                _ => data.len(),
            };
            let (start, end) = (offset as usize, offset as usize + written);
            if bytes.len() < end {
                bytes.resize(end, 0);
            }
            bytes[start..end].copy_from_slice(&data[..written]);
        }
        *disk = Disk { seen: bytes.clone(), synced: bytes, boot: disk.boot + 1, ..Disk::default() };
    }
}

impl StorageBackend for Medium {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.lock().seen.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let disk = self.0.lock();
        let from = offset as usize;
        let bytes = disk.seen.get(from..from + out.len()).ok_or(io::ErrorKind::UnexpectedEof)?;
        out.copy_from_slice(bytes);
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let mut disk = self.0.lock();
        disk.change()?;
        disk.seen.resize(len as usize, 0);
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        let mut disk = self.0.lock();
        disk.change()?;
        disk.syncs += 1;
        disk.synced = disk.seen.clone();
        let loose = std::mem::take(&mut disk.loose);
        disk.largest = disk.largest.max(loose.iter().map(|(_, bytes)| bytes.len() as u64).sum());
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        let mut disk = self.0.lock();
        disk.change()?;
        let from = offset as usize;
        disk.seen.get_mut(from..from + data.len()).ok_or(io::ErrorKind::UnexpectedEof)?.copy_from_slice(data);
        disk.written += data.len() as u64;
        disk.loose.push((offset, data.to_vec()));
        Ok(())
    }
}

/// Stores versions one after the other until the medium fails. Returns the last acknowledged version.
fn keep_until_failure(medium: &Medium, from: u64, to: u64) -> u64 {
    let Ok(store) = medium.store() else { return from - 1 };
    for version in from..=to {
        if store.persist(&[snapshot("S/p/e", version, version, version as i64)]).is_err() {
            return version - 1;
        }
        // Reading takes what is in the log into the tables.
        if version % 3 == 0 && store.stats().is_err() {
            return version;
        }
    }
    to
}

fn check_kept(medium: &Medium, acknowledged: u64) {
    let store = medium.store().unwrap();
    let kept = all(&store);
    let versions: Vec<u64> = kept.iter().map(|s| s.version).collect();
    // The version that was being stored may be there; then it is complete.
    assert!(versions.len() as u64 >= acknowledged && versions.len() as u64 <= acknowledged + 1);
    assert_eq!(versions, (1..=versions.len() as u64).collect::<Vec<_>>());
    let verified = store.verify().unwrap();
    assert!(verified.is_intact(), "{verified:?}");
}

#[test]
fn a_crash_at_any_write_loses_nothing_acknowledged() {
    // Until the test runs through without a crash.
    for changes in 0.. {
        let mut random = ChaCha8Rng::seed_from_u64(changes);
        let medium = Medium::default();
        let acknowledged = keep_until_failure(&medium, 1, 4);
        assert_eq!(acknowledged, 4);
        medium.fail_after(Some(changes), false);
        let acknowledged = keep_until_failure(&medium, 5, 14);
        medium.recover(&mut random);
        check_kept(&medium, acknowledged);
        assert!(
            acknowledged == 14 || changes < 5 || medium.0.lock().repairs > 0,
            "what was not synced may be missing"
        );
        if acknowledged == 14 {
            assert!(changes > 50, "ten commits are more than {changes} writes");
            break;
        }
    }
}

/// A process that is killed leaves all that it has written, in order, also what was not synced.
#[test]
fn a_kill_at_any_write_loses_nothing_acknowledged_and_the_file_opens_at_once() {
    for changes in 0.. {
        let medium = Medium::default();
        medium.store().unwrap().persist(&[snapshot("Many/p/e", 1, 1, 1)]).unwrap();
        medium.fail_after(Some(changes), false);
        // The store fails when it is closed, too.
        let acknowledged = keep_until_failure(&medium, 1, 5);
        medium.fail_after(None, false);
        let store = medium.store().unwrap();
        assert_eq!(medium.0.lock().repairs, 0, "nothing is read after {changes} writes");
        let kept = store.query(&Query::history(Pattern::segment("S"))).unwrap().len() as u64;
        assert!(kept == acknowledged || kept == acknowledged + 1, "{kept} after {acknowledged}");
        assert!(store.verify().unwrap().is_intact());
        if acknowledged == 5 {
            assert!(changes > 20, "five commits are more than {changes} writes");
            break;
        }
    }
}

#[test]
fn each_group_is_synced_once() {
    let medium = Medium::default();
    let store = medium.store().unwrap();
    for group in 0..5 {
        let before = medium.0.lock().syncs;
        let snapshots: Vec<_> = (1..100).map(|v| snapshot("S/p/e", group * 100 + v, v, 0)).collect();
        store.persist(&snapshots).unwrap();
        assert_eq!(medium.0.lock().syncs - before, 1);
        assert!(medium.0.lock().loose.is_empty(), "nothing is written after the sync");
    }
}

/// Small commits are one write each, which goes into the tables later.
#[test]
fn a_small_commit_writes_little_more_than_its_bytes() {
    let medium = Medium::default();
    let store = medium.store().unwrap();
    store.persist(&[snapshot("S/p/e", 1, 1, 1)]).unwrap();
    let before = medium.0.lock().written;
    for version in 2..=101 {
        store.persist(&[snapshot("S/p/e", version, version, 1)]).unwrap();
    }
    let written = medium.0.lock().written - before;
    assert!(written < 100 * 256, "{written} bytes for a hundred commits");
    assert_eq!(store.query(&Query::history(Pattern::any())).unwrap().len(), 101);
    assert!(store.verify().unwrap().is_intact());
}

/// A bit that is flipped in the log, which is read after a kill. The copy of an open file stands for the file of a killed process.
#[test]
fn damage_in_the_log_is_noticed() {
    let (folder, path, store) = store();
    let killed = folder.path().join("killed.redb");
    store.persist(&[snapshot("S/p/e", 1, 1, 1)]).unwrap();
    for version in 2..=6 {
        store.persist(&[snapshot("S/p/e", version, version, 1)]).unwrap();
    }
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&killed, &bytes).unwrap();
    assert_eq!(LongTermMemory::open(&killed).unwrap().stats().unwrap().snapshots, 6);
    // The entries are of one length, each at the next multiple of 64.
    let length = u32::from_le_bytes(*bytes[4096..].first_chunk().unwrap()) as usize;
    let entry = |number: usize| 4096 + number * length.next_multiple_of(64);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for place in (0..5).flat_map(|number| entry(number)..entry(number) + length) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << random.random_range(0..8);
        std::fs::write(&killed, &flipped).unwrap();
        let store = LongTermMemory::open(&killed).unwrap();
        let mut lines = Vec::new();
        if place >= entry(4) {
            // The last one cannot be told from one that was not acknowledged; a log line says that it is not whole.
            assert_eq!(store.stats().unwrap().snapshots, 5);
            let (log, round) = (&flipped[4096..], bytes[entry(4) + 8..].first_chunk().unwrap());
            assert!(log::is_cut(log, entry(4) - 4096, u64::from_le_bytes(*round)), "byte {place}");
            continue;
        }
        let error = store.stats().unwrap_err();
        assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
        assert!(store.persist(&[snapshot("S/p/e", 7, 7, 1)]).is_err());
        assert!(store.export(&Pattern::any(), &mut lines).is_err());
        let whole = 1 + (0..5).take_while(|number| entry(*number) + length <= place).count();
        assert_eq!(lines.iter().filter(|byte| **byte == b'\n').count(), whole);
    }
}

/// What is committed after a compaction is read after a kill, too.
#[test]
fn the_log_goes_on_after_compaction() {
    let (folder, path, store) = store();
    let killed = folder.path().join("killed.redb");
    for version in 1..=9 {
        store.persist(&[snapshot("S/p/e", version, version, 1)]).unwrap();
        if version % 3 == 0 {
            assert!(store.compact().unwrap());
        }
        store.persist(&[snapshot("S/p/f", version, version, 1)]).unwrap();
        std::fs::copy(&path, &killed).unwrap();
        let killed = LongTermMemory::open(&killed).unwrap();
        assert_eq!(all(&killed), all(&store));
        assert_eq!(killed.stats().unwrap().snapshots, 2 * version);
    }
}

#[test]
fn a_crash_while_the_file_is_made_leaves_one_that_can_be_made() {
    for changes in 0.. {
        let mut random = ChaCha8Rng::seed_from_u64(changes);
        let medium = Medium::default();
        medium.fail_after(Some(changes), false);
        let acknowledged = keep_until_failure(&medium, 1, 3);
        medium.recover(&mut random);
        match medium.store() {
            Ok(_) => check_kept(&medium, acknowledged),
            // The incomplete file is beside its final path, and is created again.
            Err(error) => {
                assert_eq!(acknowledged, 0, "{error}");
                assert!(
                    matches!(error, StoreError::NotAStore { .. } | StoreError::Damaged { .. }),
                    "{error}"
                );
            }
        }
        if acknowledged == 3 {
            assert!(changes > 20, "a file and three commits are more than {changes} writes");
            break;
        }
    }
}

#[test]
fn a_full_disk_is_an_error_and_no_damage() {
    for changes in 0..20 {
        let medium = Medium::default();
        let store = medium.store().unwrap();
        store.persist(&[snapshot("S/p/e", 1, 1, 1)]).unwrap();
        medium.fail_after(Some(changes), true);
        let mut acknowledged = 1;
        let error = loop {
            match store.persist(&[snapshot("S/p/e", acknowledged + 1, 1, 1)]) {
                Ok(_) => acknowledged += 1,
                Err(error) => break error,
            }
        };
        assert_eq!(error, StoreError::Full { path: "medium".into() });
        assert!(store.persist(&[snapshot("S/p/f", 1, 1, 1)]).is_err());
        medium.fail_after(None, false);
        store.persist(&[snapshot("S/p/f", 1, 1, 1)]).unwrap();
        let kept = store.query(&Query::history(Pattern::segment("S").named("e"))).unwrap();
        assert!(kept.len() as u64 == acknowledged || kept.len() as u64 == acknowledged + 1);
        assert!(store.verify().unwrap().is_intact());
    }
}

/// A write or a sync that fails once, wherever it is: memory and disk agree, and the next commit works without a restart.
#[test]
fn after_a_failure_at_any_write_memory_and_disk_agree() {
    for (changes, full) in (0..).flat_map(|changes| [(changes, false), (changes, true)]) {
        let medium = Medium::default();
        let store = Arc::new(medium.store().unwrap());
        let backing: Arc<dyn Backing> = Arc::<LongTermMemory>::clone(&store);
        let memory = WorkingMemory::new(Arc::new(|| 0)).with_backing(backing);
        let commit = |value: u64| {
            let id = if value.is_multiple_of(3) { "S/p/a" } else { "S/p/b" };
            memory.commit_now(vec![crate::Commit::new(id.parse().unwrap(), value, [])])
        };
        commit(0).unwrap();
        medium.fail_after(Some(changes), full);
        let mut acknowledged = Vec::new();
        let mut failures = 0;
        for value in 1..12 {
            match commit(value) {
                Ok(versions) => {
                    acknowledged.push((value, versions[0]));
                    if value % 3 == 0 && store.stats().is_err() {
                        failures += 1;
                        medium.fail_after(None, false);
                    }
                }
                Err(_) => {
                    failures += 1;
                    medium.fail_after(None, false);
                }
            }
        }
        medium.fail_after(None, false);
        commit(12).unwrap();
        let query = Query::history(Pattern::any());
        let held = memory.query_now(&query).unwrap();
        assert_eq!(held, store.query(&query).unwrap(), "after {changes} changes");
        let has = |(value, version)| held.iter().any(|s| (s.referenced_ns, s.version) == (value, version));
        assert!(failures <= 1 && acknowledged.into_iter().all(has));
        assert!(store.verify().unwrap().is_intact());
        if failures == 0 {
            assert!(changes > 50, "ten commits are more than {changes} writes");
            break;
        }
    }
}

/// An age limit that drops a hundredth of the store each time writes little more than that, and nothing when nothing is old. No
/// write to disk is so large that a commit waits long for it.
#[test]
fn retention_writes_in_proportion_to_what_it_drops() {
    let medium = Medium::default();
    let store = medium.store().unwrap();
    let id = |n: u64| format!("S/p/e{n:03}");
    let written = || medium.0.lock().written;
    // A minute: 100 of 500 entities get 5 snapshots of 500 B each.
    let minute = |minute: u64| {
        for round in 0..5 {
            let entities = (0..100).map(|n| (minute * 100 + n) % 500);
            let version = minute / 5 * 5 + round + 1;
            let group: Vec<_> = entities.map(|n| padded(&id(n), version, minute)).collect();
            store.persist(&group).unwrap();
        }
    };
    (0..100).for_each(minute);
    let idle: Vec<_> = (0..2000).map(|n| padded(&format!("S/idle/e{n}"), 1, 0)).collect();
    store.persist(&idle).unwrap();
    let retain = |now: u64| store.retain(Retention { age_ns: Some(99), bytes: None }, now).unwrap();
    retain(101);
    for now in 100..115 {
        minute(now);
        let before = written();
        medium.0.lock().largest = 0;
        let dropped = retain(now + 2);
        let largest = medium.0.lock().largest;
        assert!(largest < 1_000_000, "{largest} bytes go to disk at once");
        assert!(dropped.snapshots >= 400 && dropped.bytes > 100_000, "{dropped:?}");
        let (wrote, dropped) = (written() - before, dropped.bytes);
        assert!(wrote < 3 * dropped, "{wrote} bytes written to drop {dropped}");
        let before = written();
        assert_eq!(retain(now + 2), Dropped::default());
        assert_eq!(written(), before, "an idle store writes nothing");
    }
    assert_eq!(store.stats().unwrap().entities, 2500);
    assert!(store.verify().unwrap().is_intact());
    let mut lines = Vec::new();
    assert_eq!(store.export(&Pattern::any(), &mut lines), Ok(store.stats().unwrap().snapshots));
}

/// A snapshot of 500 B that arrived at a time.
fn padded(id: &str, version: u64, arrived_ns: u64) -> Arc<Snapshot> {
    let instances = vec![crate::Instance::new([("data", armarium_values::Value::Bytes(vec![7; 500]))])];
    Arc::new(Snapshot { arrived_ns, instances, ..(*snapshot(id, version, version, 0)).clone() })
}

/// What the file may have in the next test.
const MEGABYTES: u64 = 16;

/// Names that come and go for 15 minutes, 10 000 a minute: the file stays within its limit. What cannot be kept within it is said. (The
/// benchmark has a day of them.)
#[test]
fn names_that_come_and_go_leave_nothing() {
    let (_folder, _, store) = store();
    let retention = Retention { age_ns: Some(1000), bytes: Some(MEGABYTES * 1_000_000) };
    let mut most = StoreStats { entities: 0, snapshots: 0, bytes: 0, file_bytes: 0 };
    for minute in 0..15 {
        for part in 0..10 {
            let names = (0..1000).map(|n| format!("S/p/e{minute}-{part}-{n}"));
            let born = names.clone().map(|name| snapshot(&name, 1, minute, 1));
            let gone = names.map(|name| removed(&name, 2, minute));
            store.persist(&born.chain(gone).collect::<Vec<_>>()).unwrap();
        }
        let dropped = store.keep_within(retention, minute + 2).unwrap();
        assert_eq!(dropped.over, 0, "after {minute} minutes");
        let stats = store.stats().unwrap();
        most = if stats.file_bytes > most.file_bytes { stats } else { most };
    }
    assert!(most.entities < 120_000 && most.file_bytes <= MEGABYTES * 1_000_000, "{most:?}");
    assert!(store.verify().unwrap().is_intact());
    let dropped = store.retain(Retention { age_ns: Some(0), bytes: Some(0) }, u64::MAX).unwrap();
    assert_eq!((dropped.over, store.stats().unwrap().entities), (0, 0), "{dropped:?}");
    store.persist(&[snapshot("S/p/stays", 1, 1, 1)]).unwrap();
    let dropped = store.retain(Retention { age_ns: None, bytes: Some(0) }, u64::MAX).unwrap();
    assert!(dropped.over > 0 && store.newest(&"S/p/stays".parse().unwrap()).unwrap().is_some());
}

#[test]
fn a_file_of_the_earlier_format_is_opened() {
    let (_folder, path) = file_with(3);
    let (old, _) = checked::open(&path, &redb::Builder::new(), &Arc::default()).unwrap();
    let write = old.begin_write().unwrap();
    write.delete_table(GIVEN).unwrap();
    write.delete_table(AGES).unwrap();
    write.delete_table(KEPT).unwrap();
    write.delete_table(REMOVED).unwrap();
    write.open_table(META).unwrap().insert("format", EARLIER_FORMAT).unwrap();
    write.commit().unwrap();
    drop(old);
    let store = LongTermMemory::open(&path).unwrap();
    assert_eq!(store.last_version(&"S/p/e".parse().unwrap()), Ok(3));
    assert!(store.verify().unwrap().is_intact());
}

/// The variable that turns [`the_process_that_is_killed`] into the child process.
const CHILD: &str = "ARMARIUM_TEST_STORE";

/// Stores versions and prints the acknowledged ones, when the next test starts it.
#[test]
fn the_process_that_is_killed() {
    let Ok(path) = std::env::var(CHILD) else { return };
    let store = LongTermMemory::open(Path::new(&path)).unwrap();
    let id: EntityId = "S/p/e".parse().unwrap();
    let mut version = store.last_version(&id).unwrap();
    loop {
        version += 1;
        store.persist(&[snapshot("S/p/e", version, version, version as i64)]).unwrap();
        println!("acknowledged {version}");
    }
}

#[test]
fn a_killed_process_loses_nothing_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("killed.redb");
    let mut random = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..100 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "store::fault_tests::the_process_that_is_killed", "--nocapture"])
            .env(CHILD, &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = io::BufReader::new(child.stdout.take().unwrap()).lines();
        let count = random.random_range(1..30);
        let mut last = 0;
        let acknowledged = lines.map_while(Result::ok);
        for line in acknowledged.filter_map(|l| l.rsplit_once("acknowledged ")?.1.parse().ok()).take(count) {
            last = line;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let store = LongTermMemory::open(&path).unwrap();
        let newest = store.last_version(&"S/p/e".parse().unwrap()).unwrap();
        assert!(last > 0 && newest >= last);
        assert_eq!(store.stats().unwrap().snapshots, newest, "none of them is missing");
        assert!(store.verify().unwrap().is_intact());
    }
}
