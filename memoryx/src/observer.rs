//! The working memory observer: turns conditions on a memory into events, which the program forwards to charts and
//! other receivers.
//!
//! An observer follows a memory through a [`Follower`], so that it sees every change once and in order, even after a
//! lag. It only skips versions that the memory no longer has; [`Observer::missed`] counts them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use armarium_values::Frame;

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::filter::Filter;
use crate::follow::{Change, Follower};
use crate::memory::Memory;
use crate::place::{distance, place_of};
use crate::query::Pattern;

/// When an observed entity causes an event.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// It is new, or exists again after a removal.
    Created,
    /// It has a new snapshot, the first one included.
    Updated,
    /// It was removed.
    Removed,
    /// It has moved since the last such event, or since its first position.
    Moved {
        /// The least distance, m.
        by: f64,
    },
    /// A CEL expression over its snapshot (see [`Filter`]) becomes true.
    Holds {
        /// The expression.
        expression: String,
    },
}

/// An event of an observer.
#[derive(Clone, Debug, PartialEq)]
pub struct MemoryEvent {
    /// The name of the condition.
    pub name: String,
    /// The snapshot that fulfilled it.
    pub snapshot: Arc<Snapshot>,
}

/// Turns changes of a memory into events.
pub struct Observer {
    follower: Follower,
    conditions: Vec<WatchedCondition>,
    /// Whether each entity exists now.
    there: BTreeMap<EntityId, bool>,
    ready: VecDeque<MemoryEvent>,
    missed: u64,
}

struct WatchedCondition {
    name: String,
    pattern: Pattern,
    condition: Condition,
    filter: Option<Filter>,
    /// The position of each entity at its last event.
    places: BTreeMap<EntityId, FramedPosition>,
    /// The entities for which the expression holds.
    held: BTreeSet<EntityId>,
}

#[derive(Clone, Debug, PartialEq)]
struct FramedPosition {
    frame: Frame,
    position: [f64; 3],
}

impl Observer {
    /// Observes a memory from now on; its present content causes no events.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn new(memory: Arc<dyn Memory>) -> Result<Self, MemoryError> {
        let (follower, heads) = Follower::from_now(memory, Pattern::any()).await?;
        let there = heads.into_iter().map(|head| (head.id, !head.removed)).collect();
        Ok(Self { follower, conditions: Vec::new(), there, ready: VecDeque::new(), missed: 0 })
    }

    /// Adds a condition on the entities of `pattern`; its events have this name.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when its expression or distance is invalid.
    pub fn when(mut self, name: &str, pattern: Pattern, condition: Condition) -> Result<Self, MemoryError> {
        let filter = match &condition {
            Condition::Holds { expression } => Some(Filter::compile(expression)?),
            Condition::Moved { by } if !by.is_finite() || *by < 0.0 => {
                return Err(MemoryError::Query { what: format!("nothing can move further than {by} m") });
            }
            _ => None,
        };
        let (places, held) = (BTreeMap::new(), BTreeSet::new());
        self.conditions.push(WatchedCondition {
            name: name.into(),
            pattern,
            condition,
            filter,
            places,
            held,
        });
        Ok(self)
    }

    /// The next event; `None` when the memory has closed. Cancel-safe: dropping the future loses nothing.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn next(&mut self) -> Result<Option<MemoryEvent>, MemoryError> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Ok(Some(event));
            }
            match self.follower.next().await? {
                Some(Change::New(snapshot)) => self.see(&snapshot),
                Some(Change::Missed { from, to, .. }) => self.missed += to - from + 1,
                None => return Ok(None),
            }
        }
    }

    /// Passes each event to `act`, until the memory closes.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn run(mut self, mut act: impl FnMut(MemoryEvent) + Send) -> Result<(), MemoryError> {
        while let Some(event) = self.next().await? {
            act(event);
        }
        Ok(())
    }

    /// How many snapshots the memory had forgotten before the observer read them.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    fn see(&mut self, snapshot: &Arc<Snapshot>) {
        let is_there = !snapshot.is_removed();
        let was_there = self.there.insert(snapshot.id.clone(), is_there).unwrap_or(false);
        for watched in &mut self.conditions {
            if watched.pattern.matches(&snapshot.id) && watched.fires(snapshot, was_there) {
                let event = MemoryEvent { name: watched.name.clone(), snapshot: Arc::clone(snapshot) };
                self.ready.push_back(event);
            }
        }
    }
}

impl WatchedCondition {
    fn fires(&mut self, snapshot: &Snapshot, was_there: bool) -> bool {
        let is_there = !snapshot.is_removed();
        match &self.condition {
            Condition::Holds { .. } => {
                let holds = is_there && self.filter.as_ref().is_some_and(|filter| filter.fits(snapshot));
                if holds {
                    self.held.insert(snapshot.id.clone())
                } else {
                    self.held.remove(&snapshot.id);
                    false
                }
            }
            Condition::Created => is_there && !was_there,
            Condition::Updated => is_there,
            Condition::Removed => !is_there && was_there,
            Condition::Moved { by } => {
                let Some(now) = place(snapshot) else {
                    // Removed, or without a position: the next position is the new start.
                    self.places.remove(&snapshot.id);
                    return false;
                };
                match self.places.get(&snapshot.id) {
                    Some(before) if before.frame == now.frame => {
                        let moved = distance(&before.position, &now.position) > *by;
                        if moved {
                            self.places.insert(snapshot.id.clone(), now);
                        }
                        moved
                    }
                    // Positions in two frames cannot be compared here.
                    _ => {
                        self.places.insert(snapshot.id.clone(), now);
                        false
                    }
                }
            }
        }
    }
}

fn place(snapshot: &Snapshot) -> Option<FramedPosition> {
    place_of(snapshot).map(|(frame, position)| FramedPosition { frame: frame.clone(), position })
}

#[cfg(test)]
mod tests {
    use armarium_values::{Value, Vector};

    use super::*;
    use crate::entity::Commit;
    use crate::working::{MemoryLimits, WorkingMemory};

    fn at(name: &str, frame: &str, x: f64) -> Commit {
        let vector = Value::Vector(Vector { frame: Frame::from(frame), components: [x, 0.0, 0.0] });
        let id = EntityId::new("Things", "p", name).unwrap();
        Commit::new(id, 0, BTreeMap::from([("position".to_owned(), vector)]))
    }

    async fn events(observer: &mut Observer) -> Vec<String> {
        let mut events = Vec::new();
        while let Ok(event) = tokio::time::timeout(std::time::Duration::ZERO, observer.next()).await {
            let event = event.unwrap().unwrap();
            events.push(format!("{} {} {}", event.name, event.snapshot.id.entity(), event.snapshot.version));
        }
        events
    }

    #[tokio::test(start_paused = true)]
    async fn conditions_become_events_in_order() {
        let memory = Arc::new(WorkingMemory::new(Arc::new(|| 0)));
        memory.commit_now(vec![at("old", "root", 0.0)]).unwrap();
        let things = || Pattern::segment("Things");
        let mut observer = Observer::new(Arc::<WorkingMemory>::clone(&memory))
            .await
            .unwrap()
            .when("new", things(), Condition::Created)
            .unwrap()
            .when("gone", things(), Condition::Removed)
            .unwrap()
            .when("changed", things().named("old"), Condition::Updated)
            .unwrap()
            .when("moved", things(), Condition::Moved { by: 0.1 })
            .unwrap()
            .when("far", things(), Condition::Holds { expression: "position.x > 0.1".into() })
            .unwrap();
        let gone = |name: &str| Commit::removal(EntityId::new("Things", "p", name).unwrap(), 0);
        memory
            .commit_now(vec![
                at("cup", "root", 0.0),
                at("cup", "root", 0.06),
                at("cup", "root", 0.09),
                at("cup", "root", 0.11),
                at("cup", "root", 0.15),
                at("cup", "camera", 9.0),
                at("old", "root", 0.0),
                gone("cup"),
                at("cup", "camera", 0.0),
            ])
            .unwrap();
        let expected = ["new cup 1", "moved cup 4", "far cup 4", "changed old 2", "gone cup 7", "new cup 8"];
        assert_eq!(events(&mut observer).await, expected);
    }

    #[tokio::test(start_paused = true)]
    async fn a_lagging_observer_reads_again_and_counts_what_is_lost() {
        let limits = MemoryLimits { history: 3, backlog: 2, ..MemoryLimits::default() };
        let memory = Arc::new(WorkingMemory::new(Arc::new(|| 0)).with_limits(limits));
        let observer = Observer::new(Arc::<WorkingMemory>::clone(&memory)).await.unwrap();
        assert!(matches!(
            Observer::new(Arc::<WorkingMemory>::clone(&memory)).await.unwrap().when(
                "bad",
                Pattern::any(),
                Condition::Holds { expression: "1 +".into() }
            ),
            Err(MemoryError::Query { .. })
        ));
        let mut observer = observer.when("changed", Pattern::any(), Condition::Updated).unwrap();
        for i in 0..10 {
            memory.commit_now(vec![at("cup", "root", f64::from(i))]).unwrap();
        }
        assert_eq!(events(&mut observer).await, ["changed cup 8", "changed cup 9", "changed cup 10"]);
        assert_eq!(observer.missed(), 7);
    }
}
