//! `LocateObject`: finds an object of prior knowledge in the stereo images by its colour and size, and the table on which it
//! stands, where the images have depth.

use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_runtime::skill::{Failure, NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Frame, Observation, Type, Vector};
use armarium_visionx::{ObjectLocalizer, ObjectStep};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::inputs::{pose_value, reference, seen_at, seen_pose};
use crate::motions::failed;
use crate::prior::object_class;
use crate::surface::ContactPlane;

/// Number of good detections that are averaged.
const DETECTIONS: usize = 5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "LocateObject",
        "Finds an object of prior knowledge in the stereo images and puts it into memory, with the table on which it stands.",
    )
    .input("object", Type::String, "Object class in prior knowledge.")
    .names(NameKind::ObjectClass)
    .optional("timeout", Type::Duration, 5.0, "How long to look for it.")
    .output("object", Type::object(), "The object in memory.")
    .output("pose", Type::Pose, "Its pose in the root frame.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let name = context.text("object")?;
    let timeout = context.number("timeout")?;
    let class = object_class(&*equipment.memory, name).await?;
    let calibration = equipment.images.calibration();
    let localizer = ObjectLocalizer::new(calibration, class.size, class.color);
    let mut sight = equipment.look(ObjectStep::new(localizer, name).with_table(calibration.camera));
    let mut senses = Senses::new(&*equipment.robot, &context);
    let updater = Updater::new(Arc::clone(&equipment.memory), &equipment.agent).map_err(failed)?;
    let (mut sights, mut table, mut search) = (Vec::new(), None, None);
    let (mut waited, mut looked) = (0.0, 0);
    while sights.len() < DETECTIONS {
        let (_, dt) = senses.next().await?;
        waited += dt;
        if waited > timeout {
            return Err(Failure::new(format!(
                "the object `{name}` was not seen in {looked} frames within {timeout:.0} s; is it on the table, in view, \
                 and of the colour ({}, {}, {}) that prior knowledge says?",
                class.color[0], class.color[1], class.color[2]
            )));
        }
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        looked += 1;
        table = table.or_else(|| frame.of_class("table").cloned());
        sights.extend(frame.of_class(name).cloned());
        search.clone_from(&frame.search);
        if frame.of_class(name).is_none() {
            // It is not where it may have been before.
            let (_, missed) = equipment.remembered().placed(Vec::new(), search.clone());
            updater.update_from(&[], missed.as_ref()).await.map_err(failed)?;
        }
    }
    drop(sight);
    // What the model of the environment knows of the table is surer than one look at it.
    let first = sights.first().and_then(seen_at);
    let modelled = match first {
        Some(first) => ContactPlane::modelled_under(equipment.remembered(), &first).await?,
        None => None,
    };
    let table = table.filter(|_| modelled.is_none());
    let surface = modelled.or_else(|| table.as_ref().and_then(seen_pose).map(ContactPlane::of));
    let tilt = surface.map(|surface| surface.rotation());
    let seen = median(sights, &tilt.unwrap_or_else(UnitQuaternion::identity));
    let seen: Vec<Observation> = table.into_iter().chain(seen).collect();
    let (seen, search) = equipment.remembered().placed(seen, search);
    let written = updater.update_from(&seen, search.as_ref()).await.map_err(failed)?;
    let id = written.into_iter().map(|(id, _)| id).next_back();
    let id = id.ok_or_else(|| Failure::new("nothing was written to memory"))?;
    let (_, pose) = equipment.remembered().find(&id).await?;
    Ok(Outcome::success().with("object", reference("Object", &id)).with("pose", pose_value(&pose)))
}

/// One observation of the median of each coordinate, upright on a surface of this tilt, at the time of the last one. The yaw is
/// taken relative to the first detection, as a box looks the same after half a turn.
fn median(sights: Vec<Observation>, tilt: &UnitQuaternion<f64>) -> Option<Observation> {
    let poses: Vec<Isometry3<f64>> = sights.iter().filter_map(seen_pose).collect();
    let middle = |value: &dyn Fn(&Isometry3<f64>) -> f64| {
        let mut values: Vec<f64> = poses.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let yaw = |pose: &Isometry3<f64>| {
        let turned = tilt.inverse() * pose.rotation * Vector3::x();
        libm::atan2(turned.y, turned.x)
    };
    let first = yaw(poses.first()?);
    let turn = |pose: &Isometry3<f64>| {
        let d = yaw(pose) - first;
        d - (d / std::f64::consts::PI).round() * std::f64::consts::PI
    };
    let at = |axis: usize| middle(&|pose| pose.translation.vector[axis]);
    let upright = tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), first + middle(&turn)?);
    let center = Vector3::new(at(0)?, at(1)?, at(2)?);
    let pose = Isometry3::from_parts(center.into(), upright);
    let mut seen = sights.into_iter().next_back()?.with("pose", pose_value(&pose));
    if let Some(place) = &mut seen.place {
        place.position = Vector::new(Frame::root(), &center);
    }
    Some(seen)
}
