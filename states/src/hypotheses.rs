//! What may be things of their own, in memory: read from and written to the core segment `ObjectHypotheses`.

use armarium_memoryx::{Commit, EntityId, Instance, Snapshot, modify};
use armarium_runtime::skill::Failure;
use armarium_values::{Observation, Value};
use armarium_visionx::segmentation::{Appearance, Hypothesis};
use nalgebra::Isometry3;

use crate::equipment::Equipment;
use crate::motions::failed;

/// The core segment.
const HYPOTHESES: &str = "ObjectHypotheses";

/// The provider of the classes that were learned.
pub(crate) const LEARNED: &str = "learned";

/// A hypothesis, with its address and what else memory says of it.
pub(crate) struct RememberedHypothesis {
    pub(crate) id: EntityId,
    pub(crate) hypothesis: Hypothesis,
    /// The pose of the middle of its box, root frame, and the edges of that, m.
    pub(crate) pose: Isometry3<f64>,
    pub(crate) size: [f64; 3],
    /// The learned class of which it is taken to be.
    pub(crate) class: Option<String>,
    /// When it was seen, ns.
    pub(crate) seen_ns: u64,
}

impl RememberedHypothesis {
    /// The height of the table under it, root frame, m.
    pub(crate) fn table(&self) -> f64 {
        self.pose.translation.z - self.size[2] / 2.0
    }
}

/// What this agent holds for things of their own.
pub(crate) async fn hypotheses(equipment: &Equipment) -> Result<Vec<RememberedHypothesis>, Failure> {
    let known = equipment.memory.segment(HYPOTHESES).await.map_err(failed)?;
    let own = known.iter().filter(|known| known.id.provider() == equipment.agent);
    Ok(own.filter_map(|known| read(equipment, known)).collect())
}

fn read(equipment: &Equipment, known: &Snapshot) -> Option<RememberedHypothesis> {
    let Value::Bytes(points) = known.attribute("points")? else { return None };
    let mut hypothesis = Hypothesis::unpacked(known.id.entity(), points);
    hypothesis.confirmed = matches!(known.attribute("confirmed")?, Value::Bool(true));
    hypothesis.pushes = known.attribute("pushes")?.as_f64()? as u32;
    let (pose, size) = (equipment.remembered().root_pose(known)?, known.attribute("size")?.as_vector3()?);
    let class = known.attribute("class").and_then(Value::as_str).map(str::to_owned);
    let (id, seen_ns) = (known.id.clone(), known.referenced_ns);
    Some(RememberedHypothesis { id, hypothesis, pose, size, class, seen_ns })
}

/// The largest number at the end of a name, as in `thing_3`; 0 where there is none.
pub(crate) fn newest<'n>(names: impl Iterator<Item = &'n str>) -> usize {
    names.filter_map(|name| name.rsplit('_').next()?.parse().ok()).max().unwrap_or(0)
}

/// Writes what was told apart in a picture, in place of what was known before.
pub(crate) async fn write(
    equipment: &Equipment,
    before: &[RememberedHypothesis],
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

/// Writes of which learned class a hypothesis is.
pub(crate) async fn name_class(
    equipment: &Equipment,
    known: &RememberedHypothesis,
    class: &str,
) -> Result<(), Failure> {
    let named = |now: Option<&Snapshot>| {
        let mut attributes = now?.instance()?.attributes.to_map();
        attributes.insert("class".into(), Value::from(class));
        Some(attributes)
    };
    modify(&*equipment.memory, &known.id, known.seen_ns, named).await.map_err(failed)?;
    Ok(())
}

/// The learned classes, and by what each is known again.
pub(crate) async fn learned(equipment: &Equipment) -> Result<Vec<(String, Appearance)>, Failure> {
    let classes = equipment.memory.segment("ObjectClasses").await.map_err(failed)?;
    let learned = classes.iter().filter(|class| class.id.provider() == LEARNED);
    let appearance = |class: &Snapshot| {
        let numbers = class.attribute("appearance")?.as_list()?.iter().filter_map(Value::as_f64);
        Appearance::from_numbers(&numbers.collect::<Vec<_>>())
    };
    Ok(learned.filter_map(|class| Some((class.id.entity().to_owned(), appearance(class)?))).collect())
}
