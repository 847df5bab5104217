//! `ModelEnvironment`: keeps in memory where tables, shelves, walls, the floor and other solid things are, as depth shows them.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_memoryx::{Pattern, Query, Snapshot};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Observation, Type, Value};
use armarium_visionx::{BulkEstimate, EnvironmentModel, EnvironmentStep, ImageError, SurfaceEstimate};
use nalgebra::{Matrix3, Vector3};

use crate::equipment::{self, Equipment};
use crate::inputs::seen_pose;
use crate::motions::failed;
use crate::own_hand::own_body;
use crate::places::{PLACES, is_bulk};

/// Changes that are worth writing to memory: of a pose, m and rad, of an edge, m, and of a probability.
const WORTH: (f64, f64, f64, f64) = (0.003, 0.003, 0.04, 0.1);

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ModelEnvironment",
        "Keeps in memory where tables, shelves, walls, the floor and other solid things are, as depth shows them, until it is cancelled.",
    )
    .optional("for", Type::Duration, 0.0, "How long; 0: until it is cancelled.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let longest = context.number("for")?;
    let model = work(&equipment);
    let ended = context.cancel.run_until_cancelled(async {
        match longest > 0.0 {
            true => {
                let ended = tokio::time::timeout(std::time::Duration::from_secs_f64(longest), model).await;
                ended.unwrap_or(Ok(Outcome::success()))
            }
            false => model.await,
        }
    });
    ended.await.unwrap_or_else(|| Ok(Outcome::success()))
}

async fn work(equipment: &Equipment) -> SkillResult {
    let first = equipment.images.next().await.map_err(failed)?;
    if first.depth.is_none() {
        return Err(Failure::new("the cameras give no depth, by which surfaces are found"));
    }
    let camera = equipment.images.calibration().camera;
    let own = Pattern::segment(PLACES).of_provider(&equipment.agent);
    let known = equipment.memory.query(&Query::latest(own)).await.map_err(failed)?;
    let surfaces = known.iter().filter_map(|known| surface(equipment, known)).collect();
    let bulks = known.iter().filter_map(|known| bulk(equipment, known)).collect();
    let model = EnvironmentModel::new(camera).remembering(surfaces, bulks);
    let updater = Updater::new(Arc::clone(&equipment.memory), &equipment.agent).map_err(failed)?;
    let mut sight = equipment.look(EnvironmentStep::new(model, camera).without(own_body(equipment)));
    let mut written: BTreeMap<String, Observation> = BTreeMap::new();
    loop {
        let sighting = match sight.next().await {
            Ok(sighting) => sighting,
            Err(error @ ImageError::Gone { .. }) => return Err(failed(error)),
            Err(_) => continue,
        };
        let name = |seen: &Observation| seen.entity.clone().unwrap_or_default();
        let worth = |seen: &&Observation| written.get(&name(seen)).is_none_or(|before| differ(before, seen));
        let news: Vec<Observation> = sighting.observations.iter().filter(worth).cloned().collect();
        if news.is_empty() {
            continue;
        }
        written.extend(news.iter().map(|seen| (name(seen), seen.clone())));
        // What is gone is told for a while only.
        written.retain(|name, _| sighting.observations.iter().any(|seen| seen.entity.as_ref() == Some(name)));
        let (news, _) = equipment.remembered().placed(news, None);
        updater.update(&news).await.map_err(failed)?;
    }
}

fn differ(before: &Observation, now: &Observation) -> bool {
    let (Some(was), Some(is)) = (seen_pose(before), seen_pose(now)) else { return true };
    let moved = was.inverse() * is;
    let size =
        |seen: &Observation| seen.attributes.get("size").and_then(Value::as_vector3).unwrap_or_default();
    let (a, b) = (size(before), size(now));
    moved.translation.vector.norm() > WORTH.0
        || moved.rotation.angle() > WORTH.1
        || a.iter().zip(b).any(|(a, b)| (a - b).abs() > WORTH.2)
        || (before.confidence - now.confidence).abs() > WORTH.3
}

/// A surface that this agent knows from before, root frame.
fn surface(equipment: &Equipment, known: &Snapshot) -> Option<SurfaceEstimate> {
    let numbers = known.attribute("plane_covariance")?.as_list()?;
    let numbers: Vec<f64> = numbers.iter().filter_map(Value::as_f64).collect();
    let [x, y, _] = known.attribute("size")?.as_vector3()?;
    Some(SurfaceEstimate {
        name: known.id.entity().to_owned(),
        class: SurfaceEstimate::class_of(known.attribute("class")?.as_str()?)?,
        root_from_surface: equipment.remembered().root_pose(known)?,
        size: [x, y],
        covariance: (numbers.len() == 9).then(|| Matrix3::from_row_slice(&numbers))?,
        probability: known.instance()?.confidence,
    })
}

/// A bulk that it knows from before.
fn bulk(equipment: &Equipment, known: &Snapshot) -> Option<BulkEstimate> {
    is_bulk(known).then_some(())?;
    let size = Vector3::from(known.attribute("size")?.as_vector3()?);
    Some(BulkEstimate {
        name: known.id.entity().to_owned(),
        root_from_box: equipment.remembered().root_pose(known)?,
        size,
        covariance: Matrix3::zeros(),
        probability: known.instance()?.confidence,
    })
}
