//! Finds, reads and writes motions in working memory. A running motion is in `running_motion/`.

use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, Memory, Snapshot};
use armarium_motion::{Motion, Movement};
use armarium_runtime::skill::Failure;
use armarium_values::Value;

/// The core segment that holds motions.
const SEGMENT: &str = "Motions";

/// A motion in memory: periodic, or a movement to a goal.
pub(crate) enum StoredMotion {
    Motion(Box<Motion>),
    Movement(Box<Movement>),
}

/// Reads the motion of a snapshot, which has to be periodic.
pub(crate) fn motion_of(snapshot: &Snapshot) -> Result<Motion, Failure> {
    match kept_in(snapshot)? {
        StoredMotion::Motion(motion) => Ok(*motion),
        StoredMotion::Movement(_) => Err(Failure::new(format!(
            "the motion `{}` goes to a goal, and a periodic one is needed here; `PlayMotion` plays both",
            snapshot.id
        ))),
    }
}

/// Reads the motion of a snapshot.
pub(crate) fn kept_in(snapshot: &Snapshot) -> Result<StoredMotion, Failure> {
    let json = |name: &str| snapshot.attribute(name).map(Value::to_json);
    let kept = match (json("movement"), json("motion")) {
        (Some(movement), _) => serde_json::from_value(movement).map(StoredMotion::Movement),
        (None, Some(motion)) => serde_json::from_value(motion).map(StoredMotion::Motion),
        (None, None) => return Err(Failure::new(format!("the entity `{}` holds no motion", snapshot.id))),
    };
    kept.map_err(|e| Failure::new(format!("the motion `{}` in memory cannot be used: {e}", snapshot.id)))
}

/// The newest version of a motion.
pub(crate) async fn load(memory: &dyn Memory, id: &EntityId) -> Result<(Motion, u64), Failure> {
    let snapshot = memory.latest(id).await.map_err(failed)?;
    Ok((motion_of(&snapshot)?, snapshot.version))
}

/// The newest motion of that name, from any agent.
pub(crate) async fn find(memory: &dyn Memory, name: &str) -> Result<Arc<Snapshot>, Failure> {
    let known = memory.segment(SEGMENT).await.map_err(failed)?;
    newest(&known, name).cloned().ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|s| s.id.entity()).collect();
        let known = if names.is_empty() { "no motion".to_owned() } else { names.join(", ") };
        Failure::new(format!("memory has no motion `{name}`; it has {known}"))
    })
}

fn newest<'k>(known: &'k [Arc<Snapshot>], name: &str) -> Option<&'k Arc<Snapshot>> {
    known.iter().filter(|s| s.id.entity() == name).max_by_key(|s| s.arrived_ns)
}

/// The address of an agent's motion.
pub(crate) fn address(agent: &str, name: &str) -> Result<EntityId, Failure> {
    EntityId::new(SEGMENT, agent, name).map_err(failed)
}

/// Writes what was learned as the newest version of its entity.
pub(crate) async fn keep(
    memory: &dyn Memory,
    id: &EntityId,
    learned: &StoredMotion,
    stamp_ns: u64,
) -> Result<(), Failure> {
    let movement = match learned {
        StoredMotion::Motion(motion) => return store(memory, id, motion, stamp_ns).await,
        StoredMotion::Movement(movement) => movement,
    };
    let attributes = [
        ("name", Value::from(movement.name())),
        ("kind", Value::from("discrete DMP")),
        ("duration", Value::Float(movement.duration_s())),
        ("learned_from", Value::from(movement.learned_from())),
        ("movement", written(id, serde_json::to_value(movement))?),
    ];
    memory.commit(vec![Commit::new(id.clone(), stamp_ns, attributes)]).await.map(drop).map_err(failed)
}

/// What one hand learned to move with the other, for a task that is told in one line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LearnedTogether {
    /// What the hands do, and in which space it was learned.
    pub(crate) task: String,
    /// From how many epochs it was learned.
    pub(crate) epochs: u32,
    /// The weights of the control signal (13) of the hand's motion.
    pub(crate) control_weights: Vec<f64>,
}

impl LearnedTogether {
    const KIND: &'static str = "control signal of a discrete-periodic DMP";

    /// What was kept under a name, by any agent; `None` if nothing was.
    pub(crate) async fn recall(memory: &dyn Memory, name: &str) -> Result<Option<Self>, Failure> {
        let known = memory.segment(SEGMENT).await.map_err(failed)?;
        newest(&known, name).map(|snapshot| Self::of(snapshot)).transpose()
    }

    fn of(snapshot: &Snapshot) -> Result<Self, Failure> {
        let read = || {
            let weights = snapshot.attribute("control_weights")?.as_list()?;
            Some(Self {
                task: snapshot.attribute("task")?.as_str()?.to_owned(),
                epochs: u32::try_from(snapshot.attribute("epochs")?.as_int()?).ok()?,
                control_weights: weights.iter().map(Value::as_f64).collect::<Option<_>>()?,
            })
        };
        let other = || {
            Failure::new(format!(
                "`{}` in memory is not what a hand learned to move with another; keep this under another name",
                snapshot.id
            ))
        };
        read().ok_or_else(other)
    }

    /// Writes it as the newest version of its entity.
    pub(crate) async fn keep(self, memory: &dyn Memory, id: &EntityId, stamp_ns: u64) -> Result<(), Failure> {
        let weights = self.control_weights.into_iter().map(Value::Float).collect();
        let attributes = [
            ("name", Value::from(id.entity())),
            ("kind", Value::from(Self::KIND)),
            ("task", Value::from(self.task)),
            ("epochs", Value::Int(i64::from(self.epochs))),
            ("control_weights", Value::List(weights)),
        ];
        memory.commit(vec![Commit::new(id.clone(), stamp_ns, attributes)]).await.map(drop).map_err(failed)
    }
}

fn written(id: &EntityId, json: serde_json::Result<serde_json::Value>) -> Result<Value, Failure> {
    let unwritable = |error| Failure::new(format!("the motion `{id}` cannot be written to memory: {error}"));
    json.map(|json| Value::from_json(&json)).map_err(unwritable)
}

/// Writes a motion as the newest version of its entity.
pub(crate) async fn store(
    memory: &dyn Memory,
    id: &EntityId,
    motion: &Motion,
    stamp_ns: u64,
) -> Result<(), Failure> {
    memory.commit(vec![commit(id, motion, stamp_ns, None)?]).await.map(drop).map_err(failed)
}

/// The commit of a motion, refused unless `expected_version` is the newest.
pub(crate) fn commit(
    id: &EntityId,
    motion: &Motion,
    stamp_ns: u64,
    expected_version: Option<u64>,
) -> Result<Commit, Failure> {
    let attributes = [
        ("name", Value::from(motion.name())),
        ("kind", Value::from("periodic DMP")),
        ("frequency", Value::Float(motion.frequency_hz())),
        ("learned_from", Value::from(motion.learned_from())),
        ("motion", written(id, serde_json::to_value(motion))?),
    ];
    let commit = Commit::new(id.clone(), stamp_ns, attributes);
    Ok(Commit { expected_version, ..commit })
}

/// Converts an error of another room to a skill's failure.
pub(crate) fn failed(error: impl std::fmt::Display) -> Failure {
    Failure::new(error.to_string())
}
