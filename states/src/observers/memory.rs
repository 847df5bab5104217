//! What charts observe of memory: the matches of a pattern as channels, from a subscription.
//!
//! Poses and points come in the root frame where it is known how theirs stands to it. Only what charts observe is read, and of a
//! pattern at most [`MAX_MATCHES`] matches are held: of more, those with the lowest confidence are left out.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{EntityId, MemoryError, Pattern, Query, Snapshot, pages};
use armarium_runtime::channels::{Channels, ObserveError, ObserveMemory};
use armarium_runtime::observed::{MAX_MATCHES, MemoryPattern, ObservedPattern, match_of};
use armarium_values::{Frame, FrameChange, Value};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::task::JoinSet;

use super::surroundings::{AGENTS, stand};
use crate::equipment::Equipment;

/// Snapshots per query.
const PAGE_SIZE: usize = 1024;
/// Most changes that are taken together.
const MAX_BATCH: usize = 4096;
/// The time of what always holds, ns.
const NOW: u64 = 0;

/// The memory of this equipment, for charts that observe it.
pub fn memory(equipment: &Equipment) -> Arc<dyn ObserveMemory> {
    Arc::new(OwnMemory(equipment.clone()))
}

struct OwnMemory(Equipment);

impl ObserveMemory for OwnMemory {
    fn observe(
        &self,
        patterns: Vec<ObservedPattern>,
        channels: Channels,
    ) -> BoxFuture<'static, Result<JoinSet<()>, ObserveError>> {
        let equipment = self.0.clone();
        async move {
            let failed = |error: MemoryError| ObserveError { reason: error.to_string() };
            for agent in equipment.memory.segment(AGENTS).await.map_err(failed)? {
                stand(&equipment, &agent);
            }
            let mut tasks = JoinSet::new();
            for observed in patterns {
                // What changes while the memory is read comes after it.
                let changes = equipment.memory.subscribe();
                let mut matches = Matches::of(observed, &equipment);
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
    equipment: Equipment,
    held: BTreeMap<EntityId, Arc<Snapshot>>,
    /// Whether more match than are held.
    left_out: bool,
}

impl Matches {
    fn of(observed: ObservedPattern, equipment: &Equipment) -> Self {
        let pattern = pattern(&observed.pattern);
        Self { observed, pattern, equipment: equipment.clone(), held: BTreeMap::new(), left_out: false }
    }

    /// Reads all matches anew.
    async fn read(&mut self) -> Result<(), MemoryError> {
        (self.held, self.left_out) = (BTreeMap::new(), false);
        let mut found = pages(Query::latest(self.pattern.clone()), PAGE_SIZE);
        while let Some(page) = found.next(&*self.equipment.memory).await? {
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
    async fn follow(mut self, mut changes: broadcast::Receiver<Arc<Snapshot>>, channels: Channels) {
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
                            snapshot.id.segment() == AGENTS && snapshot.id.entity() == self.equipment.agent;
                        if own_pose {
                            stand(&self.equipment, &snapshot);
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
        let now_ns = self.equipment.robot.sensed().borrow().stamp_ns;
        let value = |snapshot: &&Snapshot| {
            let age = Duration::from_nanos(now_ns.saturating_sub(snapshot.referenced_ns));
            (self.value(snapshot), age)
        };
        let best = ordered.first().filter(|_| self.observed.best).map(value);
        channels.publish_matches(&self.observed, best, || ordered.iter().map(value).collect());
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
        let Some(from) = frame_of(value).filter(|frame| **frame != root) else { return value.clone() };
        match self.equipment.transforms.read().transform(&root, from, NOW) {
            Ok(to_from_from) => {
                FrameChange { from, to: &root, to_from_from: &to_from_from }.value(name, value)
            }
            Err(_) => value.clone(),
        }
    }
}

fn pattern(of: &MemoryPattern) -> Pattern {
    let part = |part: &str| (part != "*").then(|| part.to_owned());
    Pattern { segment: part(&of.segment), provider: part(&of.provider), entity: part(&of.entity) }
}

/// The order of matches: the highest confidence first, of equals what was referenced last.
fn rank(a: &Snapshot, b: &Snapshot) -> Ordering {
    let confidence = |of: &Snapshot| of.instance().map_or(0.0, |instance| instance.confidence);
    let by_confidence = confidence(b).total_cmp(&confidence(a));
    by_confidence.then(b.referenced_ns.cmp(&a.referenced_ns)).then_with(|| a.id.cmp(&b.id))
}

/// The frame of a value, or of the first part of it that has one.
fn frame_of(value: &Value) -> Option<&Frame> {
    match value {
        Value::Vector(vector) => Some(&vector.frame),
        Value::Pose(pose) => Some(&pose.frame),
        Value::Wrench(wrench) => Some(&wrench.frame),
        Value::List(items) => items.iter().find_map(frame_of),
        Value::Map(fields) => fields.values().find_map(frame_of),
        _ => None,
    }
}
