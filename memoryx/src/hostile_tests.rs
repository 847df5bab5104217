//! A writer that sends nonsense, too much data or data from the future gets an error, and all others are served.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use armarium_bus::keys;
use armarium_bus::session::Reply;
use armarium_values::Value;

use crate::remote::tests::pair_with;
use crate::wire::{self, CommitRequest};
use crate::*;

fn update(name: &str, time: u64) -> Commit {
    Commit::new(EntityId::new("Things", "p", name).unwrap(), time, [("value", Value::Int(1))])
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nonsense_is_refused_in_words_and_others_are_served() {
    let limits =
        MemoryLimits { entities: 3, bytes: 100_000, ahead_ns: Some(1000), ..MemoryLimits::default() };
    let pair = pair_with(limits, Some(Arc::new(|| 500))).await;
    let (memory, remote, near) = (&pair.memory, &pair.remote, &pair.near);
    let key = keys::memory_commit("alice").unwrap();
    let commit = |v: u32| format!("application/cbor;memoryx/commit;v{v}");
    let deep = vec![0x81; 100_000];
    let good = wire::seal(&CommitRequest { updates: vec![update("a", 1)], sent_ns: 1 }).unwrap().1;
    for (encoding, payload, words) in [
        (commit(9), good.clone(), "is version 9 of `memoryx/commit`"),
        ("text/plain".to_owned(), good.clone(), "does not name a schema"),
        ("application/cbor;robot/state;v1".to_owned(), good, "is a `robot/state`"),
        (commit(1), b"\xff\xff".to_vec(), "starts no item"),
        (commit(1), Vec::new(), "ends too early"),
        (commit(1), deep, "nested deeper"),
        ("application/cbor;memoryx/query;v1".to_owned(), b"\x01".to_vec(), "does not fit"),
        ("application/cbor;memoryx/maintain;v1".to_owned(), b"\x66verify".to_vec(), "--store"),
    ] {
        let answer = near.query_one(&key, "", Some((&encoding, payload))).await.unwrap();
        let Reply::Refusal { encoding, payload } = answer else { panic!("{words}: was taken") };
        let error = wire::open::<MemoryError>(&encoding, &payload).unwrap().to_string();
        assert!(error.contains(words), "{error} does not say: {words}");
    }
    assert!(memory.is_empty());
    assert_eq!(remote.commit(vec![update("a", 1)]).await, Ok(vec![1]));
    let ahead = remote.commit(vec![update("a", 9_000_000_000)]).await;
    assert!(matches!(ahead, Err(MemoryError::Future { ahead_s: 8, .. })), "{ahead:?}");
    let many = (0..1000).map(|i| update(&format!("many{i}"), 1)).collect();
    assert!(matches!(remote.commit(many).await, Err(MemoryError::Full { entities: 3, .. })));
    let large = Commit::new(update("a", 1).id, 1, [("data", Value::Bytes(vec![0; 200_000]))]);
    assert!(matches!(remote.commit(vec![large]).await, Err(MemoryError::TooLarge { most: 100_000, .. })));
    assert_eq!(memory.len(), 1);
    assert_eq!(remote.commit(vec![update("a", 2)]).await, Ok(vec![2]));
}

#[test]
fn nobody_takes_the_room_of_others() {
    let limits =
        MemoryLimits { history: 2, entities: 100, bytes: 40_000, shares: 4, ..MemoryLimits::default() };
    let memory = WorkingMemory::new(Arc::new(|| 0)).with_limits(limits);
    let of = |provider: &str, name: &str, bytes: usize| {
        let data = Value::Bytes(vec![0; bytes]);
        Commit::new(EntityId::new("Things", provider, name).unwrap(), 0, [("data", data)])
    };
    // A provider segment and the segments named after it with a dot have one owner.
    let many = |provider: &str, count: usize| {
        (0..count).map(|i| of(provider, &format!("e{i}"), 0)).collect::<Vec<_>>()
    };
    assert!(memory.commit_now([many("mallory", 20), many("mallory.b", 5)].concat()).is_ok());
    let more = memory.commit_now(vec![of("mallory.c", "e", 0)]);
    assert!(matches!(more, Err(MemoryError::Full { entities: 25, .. })), "{more:?}");
    let at_once = memory.commit_now(many("other", 26));
    assert!(matches!(at_once, Err(MemoryError::Full { entities: 25, .. })), "all or none: {at_once:?}");
    assert_eq!(memory.len(), 25);
    assert!(memory.commit_now(many("carol", 25)).is_ok(), "there is room for others");

    // Bytes: an update that frees as much as it adds is always accepted.
    for _ in 0..5 {
        memory.commit_now(vec![of("dave", "image", 4000)]).unwrap();
    }
    let second = memory.commit_now(vec![of("dave", "other", 4000)]);
    assert!(matches!(second, Err(MemoryError::TooLarge { most: 10_000, .. })), "{second:?}");
    let large = memory.commit_now(vec![of("dave", "image", 9000)]);
    assert!(matches!(large, Err(MemoryError::TooLarge { most: 10_000, .. })), "{large:?}");
    let gone = Commit::removal(of("dave", "image", 0).id, 0);
    assert_eq!(memory.commit_now(vec![gone]), Ok(vec![6]), "that it is gone is always taken");
    assert!(memory.commit_now(vec![of("erin", "image", 4000)]).is_ok());
}

/// Counts how often it is asked to store something, and waits each time until its disk is free.
#[derive(Default)]
struct Counting {
    takes: AtomicUsize,
    disk_is_busy: AtomicBool,
}

impl Backing for Counting {
    fn last_version(&self, _: &EntityId) -> Result<u64, MemoryError> {
        Ok(0)
    }

    fn holds_any(&self, _: &[Arc<Snapshot>]) -> Result<bool, MemoryError> {
        Ok(false)
    }

    fn take(&self, _: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.takes.fetch_add(1, Ordering::Relaxed);
        while self.disk_is_busy.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        Ok(())
    }

    fn archive(&self) -> Option<&dyn Archive> {
        Some(self)
    }
}

impl Archive for Counting {
    fn recall(&self, _: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.take(&[])?;
        Ok(Vec::new())
    }

    fn versions(&self, _: &Query, _: bool, _: &mut dyn FnMut(u64) -> bool) -> Result<(), MemoryError> {
        Ok(())
    }
}

/// The only worker of the runtime does other things while a commit and a query wait for the disk.
#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn no_worker_waits_for_the_disk() {
    let backing = Arc::new(Counting::default());
    let memory = Arc::new(WorkingMemory::new(Arc::new(|| 0)).with_backing(Arc::<Counting>::clone(&backing)));
    backing.disk_is_busy.store(true, Ordering::Release);
    let (writing, reading) = (Arc::clone(&memory), Arc::clone(&memory));
    let writer = tokio::spawn(async move { writing.commit(vec![update("a", 1)]).await });
    let reader =
        tokio::spawn(async move { reading.query(&Query::latest(Pattern::any()).with_long_term()).await });
    let waiting = Arc::clone(&backing);
    let other = tokio::spawn(async move {
        while waiting.takes.load(Ordering::Relaxed) < 2 {
            tokio::task::yield_now().await;
        }
        waiting.disk_is_busy.store(false, Ordering::Release);
    });
    other.await.unwrap();
    assert_eq!(writer.await.unwrap(), Ok(vec![1]));
    assert!(reader.await.unwrap().is_ok());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn commits_that_wait_together_are_kept_together() {
    let backing = Arc::new(Counting::default());
    let memory = WorkingMemory::new(Arc::new(|| 0)).with_backing(Arc::<Counting>::clone(&backing));
    backing.disk_is_busy.store(true, Ordering::Release);
    let before = memory.enqueue(vec![update("z", 1)], 0);
    while backing.takes.load(Ordering::Relaxed) == 0 {
        tokio::task::yield_now().await;
    }
    let answers = [
        memory.enqueue(vec![update("a", 1), update("b", 1)], 0),
        memory.enqueue(vec![update("c", 1), update("a", 2).expecting(7)], 0),
        memory.enqueue(vec![update("a", 3).expecting(1)], 0),
    ];
    assert!(memory.is_empty(), "nothing is visible before it is stored");
    backing.disk_is_busy.store(false, Ordering::Release);
    assert_eq!(before.await, Ok(vec![1]));
    let [first, second, third] = answers;
    assert_eq!(first.await, Ok(vec![1, 1]));
    assert!(matches!(second.await, Err(MemoryError::Conflict { expected: 7, actual: 1, .. })));
    assert_eq!(third.await, Ok(vec![2]), "what was refused has left nothing behind");
    assert_eq!((backing.takes.load(Ordering::Relaxed), memory.len()), (2, 3));

    let versions: Vec<u64> = std::thread::scope(|scope| {
        let write = |_| {
            scope.spawn(|| {
                (0..50).flat_map(|i| memory.commit_now(vec![update("d", i)]).unwrap()).collect::<Vec<_>>()
            })
        };
        let writers: Vec<_> = (0..4).map(write).collect();
        writers.into_iter().flat_map(|writer| writer.join().unwrap()).collect()
    });
    let mut sorted = versions;
    sorted.sort_unstable();
    assert_eq!(sorted, (1..=200).collect::<Vec<_>>(), "each version is given once");
}
