//! What charts observe of memory: the matches of a pattern as channels, from a subscription.
//!
//! Poses and points come in the root frame where it is known how theirs stands to it. Only what charts observe is read, and of a
//! pattern at most [`MAX_MATCHES`] matches are held: of more, those with the lowest confidence are left out.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{Changes, Clock, EntityId, Memory, MemoryError, Pattern, Query, Snapshot, pages};
use armarium_runtime::channels::{Channels, ObserveError, ObserveMemory};
use armarium_runtime::observed::{MAX_MATCHES, ObservedPattern, match_of};
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, FrameChange, Value};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use parking_lot::RwLock;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::task::JoinSet;

use super::surroundings::{AGENTS, stand};
use crate::equipment::Equipment;
use crate::inputs::pattern_of;

/// Snapshots per query.
const PAGE_SIZE: usize = 1024;
/// Most changes that are taken together.
const MAX_BATCH: usize = 4096;
/// The time of what always holds, ns.
const NOW: u64 = 0;

/// The memory of this equipment, for charts that observe it.
pub fn memory(equipment: &Equipment) -> Arc<dyn ObserveMemory> {
    let sensed = equipment.robot.sensed();
    Arc::new(OwnMemory {
        memory: Arc::clone(&equipment.memory),
        transforms: Arc::clone(&equipment.transforms),
        agent: equipment.agent.clone(),
        clock: Arc::new(move || sensed.borrow().stamp_ns),
    })
}

/// An agent's memory with the frames of its robot.
#[derive(Clone)]
struct OwnMemory {
    memory: Arc<dyn Memory>,
    transforms: Arc<RwLock<Transforms>>,
    agent: String,
    /// The robot's time, in which memory says when things were seen.
    clock: Clock,
}

impl ObserveMemory for OwnMemory {
    fn observe(
        &self,
        patterns: Vec<ObservedPattern>,
        channels: Channels,
    ) -> BoxFuture<'static, Result<JoinSet<()>, ObserveError>> {
        let own = self.clone();
        async move {
            let failed = |error: MemoryError| ObserveError { reason: error.to_string() };
            for agent in own.memory.segment(AGENTS).await.map_err(failed)? {
                stand((&own.transforms, &own.agent), &agent);
            }
            let mut tasks = JoinSet::new();
            for observed in patterns {
                // What changes while the memory is read comes after it.
                let changes = own.memory.subscribe(&Pattern::any()).await.map_err(failed)?;
                let mut matches = Matches::of(observed, &own);
                matches.read().await.map_err(failed)?;
                matches.publish(&channels);
                tasks.spawn(matches.follow(changes, channels.clone()));
            }
            Ok(tasks)
        }
        .boxed()
    }
}

/// What memory holds of a pattern.
struct Matches {
    observed: ObservedPattern,
    pattern: Pattern,
    own: OwnMemory,
    held: BTreeMap<EntityId, Arc<Snapshot>>,
    /// Whether more match than are held.
    left_out: bool,
}

impl Matches {
    fn of(observed: ObservedPattern, own: &OwnMemory) -> Self {
        let pattern = pattern_of(&observed.pattern);
        Self { observed, pattern, own: own.clone(), held: BTreeMap::new(), left_out: false }
    }

    /// Reads all matches anew.
    async fn read(&mut self) -> Result<(), MemoryError> {
        (self.held, self.left_out) = (BTreeMap::new(), false);
        let mut found = pages(Query::latest(self.pattern.clone()), PAGE_SIZE);
        while let Some(page) = found.next(&*self.own.memory).await? {
            for snapshot in page {
                self.take(snapshot);
            }
        }
        if self.left_out {
            let pattern = &self.observed.pattern;
            tracing::warn!(
                "more than {MAX_MATCHES} entities match `{pattern}`, which a chart observes: those with the lowest confidence are left out"
            );
        }
        Ok(())
    }

    /// Publishes each change, until the memory closes.
    async fn follow(mut self, mut changes: Changes, channels: Channels) {
        loop {
            let mut change = changes.recv().await.map_err(|error| match error {
                RecvError::Lagged(missed) => TryRecvError::Lagged(missed),
                RecvError::Closed => TryRecvError::Closed,
            });
            let (mut changed, mut again) = (false, false);
            for _ in 0..MAX_BATCH {
                match change {
                    Ok(snapshot) => {
                        let own_pose =
                            snapshot.id.segment() == AGENTS && snapshot.id.entity() == self.own.agent;
                        if own_pose {
                            stand((&self.own.transforms, &self.own.agent), &snapshot);
                        }
                        let matches = self.pattern.matches(&snapshot.id);
                        changed |= own_pose || matches;
                        again |= matches && self.take(snapshot);
                    }
                    Err(TryRecvError::Lagged(_)) => again = true,
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Closed) => return,
                }
                change = changes.try_recv();
            }
            if again && let Err(error) = self.read().await {
                tracing::warn!(
                    "a chart's observation of `{}` is not up to date: {error}",
                    self.observed.pattern
                );
            }
            if changed || again {
                self.publish(&channels);
            }
        }
    }

    /// Takes the newest snapshot of an entity. Returns whether one that was left out may be among the best now.
    fn take(&mut self, snapshot: Arc<Snapshot>) -> bool {
        let before = self.held.get(&snapshot.id);
        if before.is_some_and(|before| {
            (before.version, before.arrived_ns) >= (snapshot.version, snapshot.arrived_ns)
        }) {
            return false;
        }
        let fell = before.is_some_and(|before| snapshot.is_removed() || rank(before, &snapshot).is_lt());
        if snapshot.is_removed() {
            self.held.remove(&snapshot.id);
        } else {
            self.held.insert(snapshot.id.clone(), snapshot);
        }
        let left_out = self.left_out;
        if self.held.len() > MAX_MATCHES
            && let Some(last) = self.held.values().max_by(|a, b| rank(a, b)).map(|last| last.id.clone())
        {
            self.held.remove(&last);
            self.left_out = true;
        }
        fell && left_out
    }

    fn publish(&self, channels: &Channels) {
        let mut ordered: Vec<&Snapshot> = self.held.values().map(|snapshot| &**snapshot).collect();
        ordered.sort_by(|a, b| rank(a, b));
        let now_ns = (self.own.clock)();
        let age = |snapshot: &Snapshot| Duration::from_nanos(now_ns.saturating_sub(snapshot.referenced_ns));
        let best = ordered.first().filter(|_| self.observed.best).map(|best| (self.value(best), age(best)));
        channels
            .publish_matches(&self.observed, best, || ordered.iter().map(|one| self.value(one)).collect());
    }

    fn value(&self, snapshot: &Snapshot) -> Value {
        let Some(instance) = snapshot.instance() else { return Value::Null };
        let attributes = instance.attributes.iter();
        let attributes =
            attributes.map(|(name, value)| (name.to_owned(), self.in_root(name, value))).collect();
        match_of(attributes, instance.confidence, snapshot.id.as_str())
    }

    /// An attribute in the root frame, if it is known where its own frame stands there.
    fn in_root(&self, name: &str, value: &Value) -> Value {
        let root = Frame::root();
        let Some(from) = value.frame().filter(|frame| **frame != root) else { return value.clone() };
        match self.own.transforms.read().transform(&root, from, NOW) {
            Ok(to_from_from) => {
                FrameChange { from, to: &root, to_from_from: &to_from_from }.value(name, value)
            }
            Err(_) => value.clone(),
        }
    }
}

/// The order of matches: the highest confidence first, of equals what was referenced last.
fn rank(a: &Snapshot, b: &Snapshot) -> Ordering {
    let confidence = |of: &Snapshot| of.instance().map_or(0.0, |instance| instance.confidence);
    let by_confidence = confidence(b).total_cmp(&confidence(a));
    by_confidence.then(b.referenced_ns.cmp(&a.referenced_ns)).then_with(|| a.id.cmp(&b.id))
}

#[cfg(test)]
mod tests {
    use armarium_knowledge::{WORLD, agent_pose_update};
    use armarium_memoryx::{Commit, MemoryLimits, WorkingMemory};
    use armarium_values::Pose;
    use nalgebra::Isometry3;

    use super::*;

    /// A memory at 10 s, and channels on which it is observed.
    fn observed(limits: MemoryLimits) -> (Arc<WorkingMemory>, Channels) {
        let memory =
            Arc::new(armarium_knowledge::working_memory(Arc::new(|| 10_000_000_000)).with_limits(limits));
        let own = OwnMemory {
            memory: Arc::<WorkingMemory>::clone(&memory),
            transforms: Arc::default(),
            agent: "bob".into(),
            clock: Arc::new(|| 10_000_000_000),
        };
        (memory, Channels::new().with_memory(Arc::new(own)))
    }

    fn cups() -> [ObservedPattern; 1] {
        [ObservedPattern { pattern: CUPS.parse().unwrap(), best: true, all: true }]
    }

    fn id(name: &str) -> EntityId {
        EntityId::new("ObjectInstances", "bob", name).unwrap()
    }

    /// A cup that was seen at `seen_s`.
    fn cup(name: &str, confidence: f64, seen_s: u64) -> Commit {
        let pose = Pose::new(Frame(WORLD.to_owned()), &Isometry3::translation(1.0, 2.0, 3.0));
        let attributes = [("class", Value::from("cup")), ("pose", Value::Pose(pose))];
        Commit::new(id(name), seen_s * 1_000_000_000, attributes).with_confidence(confidence)
    }

    fn removal(name: &str) -> Commit {
        Commit::removal(id(name), 9_000_000_000)
    }

    const CUPS: &str = "ObjectInstances/*/cup*";

    /// All matches, the best first.
    fn all(channels: &Channels) -> Vec<Value> {
        let all = channels.newest("all ObjectInstances/*/cup*").expect("they are observed");
        all.value.as_list().expect("a list").to_vec()
    }

    /// The name in the id of a match.
    fn name(id: &Value) -> Option<String> {
        Some(id.as_str()?.rsplit('/').next()?.to_owned())
    }

    /// The name of the best match, its age in s, and how many match.
    async fn seen(channels: &Channels) -> (Option<String>, Option<u64>, usize) {
        // The tasks take what has changed.
        tokio::time::sleep(Duration::from_millis(1)).await;
        let best = channels.field(CUPS, &["id".to_owned()]);
        let age = channels.age(CUPS).map(|age| age.as_secs());
        (best.as_ref().and_then(name), age, all(channels).len())
    }

    fn is(name: &str, age: u64, count: usize) -> (Option<String>, Option<u64>, usize) {
        (Some(name.to_owned()), Some(age), count)
    }

    #[tokio::test(start_paused = true)]
    async fn the_best_match_is_there_with_its_age_until_it_is_removed() {
        let (memory, channels) = observed(MemoryLimits::default());
        memory.commit_now(vec![cup("cup1", 0.5, 4), cup("mug", 1.0, 4)]).unwrap();
        let tasks = channels.observe(&cups()).await.unwrap();
        assert_eq!(seen(&channels).await, is("cup1", 6, 1));
        memory.commit_now(vec![cup("cup2", 0.7, 7), cup("cup3", 0.7, 8)]).unwrap();
        assert_eq!(seen(&channels).await, is("cup3", 2, 3), "of equals, the one that was seen last");
        memory.commit_now(vec![removal("cup3"), cup("cup2", 0.2, 9)]).unwrap();
        assert_eq!(seen(&channels).await, is("cup1", 6, 2));
        memory.commit_now(vec![removal("cup1"), removal("cup2")]).unwrap();
        let absent = (None, Some(6), 0);
        assert_eq!(seen(&channels).await, absent, "what is removed is absent again, and its age goes on");
        memory.commit_now(vec![cup("cup1", 0.5, 10)]).unwrap();
        assert_eq!(seen(&channels).await, is("cup1", 0, 1));
        drop(tasks);
        memory.commit_now(vec![removal("cup1")]).unwrap();
        assert_eq!(seen(&channels).await, is("cup1", 0, 1), "nothing is read for who observes nothing");
    }

    #[tokio::test(start_paused = true)]
    async fn of_very_many_matches_those_of_lowest_confidence_are_left_out_until_there_is_room() {
        let (memory, channels) = observed(MemoryLimits::default());
        let _tasks = channels.observe(&cups()).await.unwrap();
        let many = |from: u32, to: u32| (from..to).map(|n| cup(&format!("cup{n}"), f64::from(n) / 1000.0, 1));
        memory.commit_now(many(0, 150).collect()).unwrap();
        assert_eq!(seen(&channels).await, is("cup149", 9, MAX_MATCHES));
        let last = |channels: &Channels| all(channels).last().and_then(|cup| name(cup.get("id")?));
        assert_eq!(last(&channels).as_deref(), Some("cup50"));
        memory.commit_now(vec![removal("cup149"), cup("cup148", 0.0, 2)]).unwrap();
        assert_eq!(seen(&channels).await, is("cup147", 9, MAX_MATCHES));
        assert_eq!(last(&channels).as_deref(), Some("cup48"), "they are read again");
        memory.commit_now((0..145).map(|n| removal(&format!("cup{n}"))).collect()).unwrap();
        assert_eq!(seen(&channels).await, is("cup147", 9, 4));
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_missed_in_a_flood_is_read_again() {
        let (memory, channels) = observed(MemoryLimits { backlog: 2, ..MemoryLimits::default() });
        let _tasks = channels.observe(&cups()).await.unwrap();
        for n in 0..20 {
            memory.commit_now(vec![cup(&format!("cup{n}"), 0.5, 1)]).unwrap();
        }
        memory.commit_now(vec![cup("cup7", 0.9, 3), removal("cup8")]).unwrap();
        assert_eq!(seen(&channels).await, is("cup7", 7, 19));
    }

    #[tokio::test(start_paused = true)]
    async fn places_come_in_the_root_frame_where_it_is_known_where_the_robot_stands() {
        let (memory, channels) = observed(MemoryLimits::default());
        memory.commit_now(vec![cup("cup1", 0.5, 4)]).unwrap();
        let _tasks = channels.observe(&cups()).await.unwrap();
        let at = |channels: &Channels| match channels.field(CUPS, &["position".to_owned()]) {
            Some(Value::Vector(vector)) => (vector.frame.0, vector.components),
            other => panic!("{other:?}"),
        };
        assert_eq!(at(&channels), (WORLD.into(), [1.0, 2.0, 3.0]));
        let stands = Isometry3::translation(1.0, 0.0, 0.0);
        memory.commit_now(vec![agent_pose_update("bob", &stands).unwrap()]).unwrap();
        seen(&channels).await;
        assert_eq!(at(&channels), ("root".into(), [0.0, 2.0, 3.0]));
    }
}
