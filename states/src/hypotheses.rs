//! What may be things of their own, in memory: read from and written to the core segment `ObjectHypotheses`.

use armarium_memoryx::{Commit, EntityId, Instance, Snapshot};
use armarium_runtime::skill::Failure;
use armarium_values::{Observation, Value};
use armarium_visionx::segmentation::Hypothesis;

use crate::equipment::Equipment;
use crate::motions::failed;

/// The core segment.
const HYPOTHESES: &str = "ObjectHypotheses";

/// A hypothesis, with its address and what else memory says of it.
pub(crate) struct KnownHypothesis {
    pub(crate) id: EntityId,
    pub(crate) hypothesis: Hypothesis,
    /// The height of the table under it, root frame, m.
    pub(crate) table: f64,
}

/// What this agent holds for things of their own.
pub(crate) async fn hypotheses(equipment: &Equipment) -> Result<Vec<KnownHypothesis>, Failure> {
    let known = equipment.memory.segment(HYPOTHESES).await.map_err(failed)?;
    let own = known.iter().filter(|known| known.id.provider() == equipment.agent);
    Ok(own.filter_map(|known| read(equipment, known)).collect())
}

fn read(equipment: &Equipment, known: &Snapshot) -> Option<KnownHypothesis> {
    let Value::Bytes(points) = known.attribute("points")? else { return None };
    let mut hypothesis = Hypothesis::unpacked(known.id.entity(), points);
    hypothesis.confirmed = matches!(known.attribute("confirmed")?, Value::Bool(true));
    hypothesis.pushes = known.attribute("pushes")?.as_f64()? as u32;
    let [.., height] = known.attribute("size")?.as_vector3()?;
    let table = equipment.remembered().root_pose(known)?.translation.z - height / 2.0;
    Some(KnownHypothesis { id: known.id.clone(), hypothesis, table })
}

/// The largest number that a hypothesis of this agent has had in its name.
pub(crate) fn newest(known: &[KnownHypothesis]) -> usize {
    let number = |known: &KnownHypothesis| known.hypothesis.name.rsplit('_').next()?.parse().ok();
    known.iter().filter_map(number).max().unwrap_or(0)
}

/// Writes what was told apart in a picture, in place of what was known before.
pub(crate) async fn write(
    equipment: &Equipment,
    before: &[KnownHypothesis],
    seen: &[Observation],
    stamp_ns: u64,
) -> Result<(), Failure> {
    let mut commits = Vec::new();
    for seen in seen {
        let name = seen.entity.as_deref().unwrap_or(&seen.class);
        let id = EntityId::new(HYPOTHESES, &equipment.agent, name).map_err(failed)?;
        let instances = vec![Instance::new(seen.attributes.clone())];
        commits.push(Commit { id, referenced_ns: stamp_ns, instances, expected_version: None });
    }
    let dropped = before.iter().filter(|known| !commits.iter().any(|commit| commit.id == known.id));
    let removals: Vec<Commit> = dropped.map(|known| Commit::removal(known.id.clone(), stamp_ns)).collect();
    commits.extend(removals);
    equipment.memory.commit(commits).await.map_err(failed)?;
    Ok(())
}
