//! Queries to long-term memory, and to both memories together, compared with a working memory that forgets nothing.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::{Frame, Value, Vector};
use proptest::prelude::*;

use super::tests::{store, versions};
use super::*;
use crate::entity::Commit;
use crate::error::MemoryError;
use crate::memory::pages;
use crate::place::SpatialRegion;
use crate::query::{Cursor, Times};
use crate::working::WorkingMemory;
use crate::working::{Archive, Backing, MemoryLimits};

/// A history with times out of order and removals, by entity.
fn histories() -> impl Strategy<Value = Vec<(u8, u64, bool)>> {
    proptest::collection::vec((0u8..3, 0u64..12, proptest::bool::weighted(0.8)), 0..30)
}

fn queries() -> impl Strategy<Value = Query> {
    let times = prop_oneof![
        Just(Times::Latest),
        Just(Times::All),
        (0u64..12, 0u64..12).prop_map(|(a, b)| Times::Between(a, b)),
        (0u64..13).prop_map(Times::At),
        (0u64..13).prop_map(Times::Before),
        (0u64..9, 0u64..9).prop_map(|(a, b)| Times::Versions(a, b)),
        (-5i64..5, -5i64..5).prop_map(|(a, b)| Times::Index(a, b)),
    ];
    let pattern = prop_oneof![
        Just(Pattern::any()),
        Just(Pattern::segment("S")),
        Just(Pattern::segment("S").of_provider("p").named("e1")),
        Just(Pattern { entity: Some("e2".into()), ..Pattern::any() }),
        Just(Pattern::segment("T")),
    ];
    let filter = proptest::option::of(prop_oneof![
        Just("version % 2 == 0"),
        Just("referenced_s > 5e-9 || entity == 'e1'")
    ]);
    let cursor = (0..4, 0u64..9)
        .prop_map(|(name, version)| Cursor { id: format!("S/p/e{name}").parse().unwrap(), version });
    let bounds = (proptest::option::of(0usize..6), proptest::option::of(0u64..900), proptest::bool::ANY);
    let world = || Frame("world".into());
    let region = proptest::option::of(prop_oneof![
        (0usize..6).prop_map(move |count| SpatialRegion::Nearest {
            frame: world(),
            to: [5.0, 1.0, 0.0],
            count
        }),
        (0.0..9.0).prop_map(move |radius| SpatialRegion::Within {
            frame: world(),
            of: [4.0, 0.0, 0.0],
            radius
        }),
    ]);
    let part = (proptest::option::of(cursor), bounds, proptest::option::of(3u64..9), region);
    (pattern, times, proptest::option::of(prop_oneof![0usize..4, Just(usize::MAX)]), filter, part).prop_map(
        |(pattern, times, limit, filter, (after, (most, most_bytes, removed), arrived_since, region))| {
            Query {
                pattern,
                times,
                arrived_since,
                filter: filter.map(Into::into),
                region,
                limit,
                after,
                most,
                most_bytes,
                removed,
                long_term: false,
            }
        },
    )
}

/// An update of an entity: it was somewhere, or was removed.
fn update((name, time, there): (u8, u64, bool)) -> Commit {
    let id: EntityId = format!("S/p/e{name}").parse().unwrap();
    if !there {
        return Commit::removal(id, time);
    }
    let components = [time as f64, f64::from(name), 0.0];
    let position = Value::Vector(Vector { frame: Frame("world".into()), components });
    Commit::new(id, time, BTreeMap::from([("position".to_owned(), position)]))
}

/// A memory that queries its store in small parts.
struct InParts {
    store: Arc<LongTermMemory>,
    most: usize,
}

impl Backing for InParts {
    fn holds_any(&self, _: &[Arc<Snapshot>]) -> Result<bool, MemoryError> {
        Ok(false)
    }

    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        self.store.last_version(id)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.store.take(snapshots)
    }

    fn archive(&self) -> Option<&dyn Archive> {
        Some(self)
    }
}

impl Archive for InParts {
    fn recall(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        assert!(query.most.is_some_and(|most| most <= self.most) && query.most_bytes.is_some(), "{query:?}");
        self.store.recall(query)
    }

    fn versions(
        &self,
        query: &Query,
        backwards: bool,
        act: &mut dyn FnMut(u64) -> bool,
    ) -> Result<(), MemoryError> {
        self.store.versions(query, backwards, act)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// A working memory that forgets nothing is the oracle for queries on disk.
    #[test]
    fn queries_mean_the_same_on_disk(history in histories(), queries in proptest::collection::vec(queries(), 8)) {
        let (_folder, _, store) = store();
        let (_other_folder, _, other) = super::tests::store();
        let clock = || {
            let ticks = std::sync::atomic::AtomicU64::new(0);
            Arc::new(move || ticks.fetch_add(1, std::sync::atomic::Ordering::Relaxed)) as crate::working::Clock
        };
        let memory = WorkingMemory::new(clock()).with_backing(Arc::<LongTermMemory>::clone(&store));
        let forgetful = WorkingMemory::new(clock()).with_limits(MemoryLimits { history: 1, ..MemoryLimits::default() });
        let forgetful = forgetful.with_backing(Arc::new(InParts { store: other, most: 3 })).in_parts_of(3);
        for update in history.into_iter().map(update) {
            memory.commit_now(vec![update.clone()]).unwrap();
            forgetful.commit_now(vec![update]).unwrap();
        }
        for query in queries {
            let expected = memory.query_now(&query).unwrap();
            prop_assert_eq!(versions(&store.query(&query).unwrap()), versions(&expected), "{:?}", query);
            let both = forgetful.query_now(&query.clone().with_long_term()).unwrap();
            prop_assert_eq!(versions(&both), versions(&expected), "recalled: {:?}", query);
        }
        prop_assert!(store.verify().unwrap().is_intact());
    }

    /// Reading in pieces of any size gives the same as one read.
    #[test]
    fn pieces_make_up_the_whole(history in histories(), query in queries(), size in 1usize..5, bytes in 0u64..900) {
        let (_folder, _, store) = store();
        let memory = WorkingMemory::new(Arc::new(|| 0)).with_limits(MemoryLimits { history: 2, ..MemoryLimits::default() });
        let memory = memory.with_backing(store).in_parts_of(2);
        for update in history.into_iter().map(update) {
            memory.commit_now(vec![update]).unwrap();
        }
        prop_assume!(!query.is_nearest());
        let whole = Query { most: None, most_bytes: None, ..query }.with_long_term();
        let mut pieces = pages(Query { most_bytes: Some(bytes), ..whole.clone() }, size);
        let mut found = Vec::new();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        while let Some(piece) = runtime.block_on(pieces.next(&memory)).unwrap() {
            prop_assert!(piece.len() <= size);
            found.extend(piece);
        }
        prop_assert_eq!(versions(&found), versions(&memory.query_now(&whole).unwrap()), "{:?}", whole);
    }
}
