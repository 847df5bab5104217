//! `LocateObject`: finds an object of prior knowledge in the stereo images by its colour and size, and the table on which it
//! stands, where the images have depth.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::skill::{Failure, NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use armarium_visionx::{BoxModel, ColorModel, ObjectEstimate, ObjectLocalizer};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::frames::Frames;
use crate::inputs::{pose_value, reference};
use crate::motions::failed;
use crate::prior::object_class;
use crate::surface::Surface;

/// Number of good detections that are averaged.
const DETECTIONS: usize = 5;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
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
    let model = BoxModel { size: Vector3::from(class.size), color: ColorModel::from_rgb(class.color) };
    let mut localizer = ObjectLocalizer::new(equipment.images.calibration(), model);
    let mut frames = Frames::of(&equipment.images);
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut sights: Vec<ObjectEstimate> = Vec::new();
    let mut tilt = UnitQuaternion::identity();
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
        let Some(frame) = frames.new_frame()? else { continue };
        looked += 1;
        if sights.is_empty()
            && let Some(first) = localizer.localize(&frame)
        {
            let middle = Point3::from(first.root_from_object.translation.vector);
            let memory = (equipment.remembered(), equipment.agent.as_str());
            let camera = equipment.images.calibration().camera;
            if let Some(table) = Surface::see(memory, camera, &frame, (&middle, class.size[2])).await? {
                tilt = table.rotation();
                localizer = localizer.standing_on(tilt);
            }
        }
        sights.extend(localizer.localize(&frame));
    }
    let pose = median(&sights, &tilt);
    let stamp_ns = senses.newest().stamp_ns;
    let id = EntityId::new("ObjectInstances", &equipment.agent, name).map_err(failed)?;
    let placed = equipment.remembered().placed(&pose);
    let attributes = BTreeMap::from([("class".to_owned(), Value::from(name)), ("pose".to_owned(), placed)]);
    let confidence = sights[0].visible.clamp(0.0, 1.0);
    let commit = Commit::new(id.clone(), stamp_ns, attributes).with_confidence(confidence);
    equipment.memory.commit(vec![commit]).await.map_err(failed)?;
    Ok(Outcome::success().with("object", reference("Object", &id)).with("pose", pose_value(&pose)))
}

/// The median of each coordinate, upright on a surface of this tilt. The yaw is taken relative to the first detection, as a box looks the same after
/// half a turn.
fn median(sights: &[ObjectEstimate], tilt: &UnitQuaternion<f64>) -> Isometry3<f64> {
    let middle = |value: &dyn Fn(&ObjectEstimate) -> f64| {
        let mut values: Vec<f64> = sights.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let first = sights[0].yaw;
    let turn = |yaw: f64| {
        let d = yaw - first;
        d - (d / std::f64::consts::PI).round() * std::f64::consts::PI
    };
    let yaw = first + middle(&|s| turn(s.yaw));
    let at = |axis: usize| middle(&|s| s.root_from_object.translation.vector[axis]);
    let upright = tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Vector3::new(at(0), at(1), at(2)).into(), upright)
}
