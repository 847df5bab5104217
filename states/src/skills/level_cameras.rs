//! `LevelCameras`: finds how cameras and neck are tilted, by the floor that they see on all sides.
//!
//! In one picture a floor that seems to be tilted tells nothing of whether the cameras are mounted so, or the neck leans. But the cameras'
//! tilt turns with the head, and the neck's does not: `CameraMounting` tells them apart. What is seen where the arm works stays there, as the
//! hand has shown where that is (`CalibrateHandEye`); or else, with `height`, the floor also says how high the cameras are.

use std::collections::BTreeSet;

use armarium_motion::CameraMounting;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use armarium_visionx::FloorStep;
use nalgebra::{Isometry3, Point3, UnitQuaternion, UnitVector3, Vector3};

use super::look_around::{look_at_each, views};
use super::look_at::point;
use crate::arm::{Senses, names_the_arm};
use crate::equipment::{self, Equipment};
use crate::hand_eye::Mounting;
use crate::head::{Head, moves_the_head};
use crate::inputs::{Inputs, seen_pose};
use crate::motions::failed;

/// A head that turns has seen the floor in at least so many directions.
const DIRECTIONS: usize = 3;
/// The visible part of the floor is at least so wide, m.
const WIDE: f64 = 0.6;
/// A picture that is off by more than so many times the median of all is not of the floor.
const FAR_OFF: f64 = 2.5;
/// Cameras that are turned by more than this between two pictures still move, rad.
const STEADY: f64 = 0.006;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "LevelCameras",
        "Turns the head from side to side and corrects where the cameras look, so that the floor is level on all sides.",
    )
    .optional(
        "point",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "The place in view that stays where it is seen: x, y, z in the root frame, m; empty: where the arm works.",
    )
    .optional("offset", Type::list(Type::FLOAT), vec![0.0, 0.0, 0.0], "How far beside that point, as for `LookAt`.")
    .optional(
        "height",
        Type::Bool,
        false,
        "Whether the floor also says how high the cameras are: then all heights are right, and not as the arm's joints say where it works.",
    )
    .optional("side", Type::quantity(Unit::RAD), 0.9, "How far to each side of straight ahead it looks.")
    .optional("down", Type::quantity(Unit::RAD), 0.7, "How far below the horizon it looks at most; the neck may reach less.")
    .optional("dwell", Type::Duration, 0.6, "How long it rests on each view.")
    .output("turned", Type::quantity(Unit::RAD), "By how much the cameras' mounting is corrected.")
    .output("leans", Type::quantity(Unit::RAD), "By how much the neck leans otherwise than was known.")
    .output("directions", Type::Int, "In how many directions the floor was seen.");
    equipment::skill(equipment, moves_the_head(names_the_arm(manifest), equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let kept = point(&equipment, &context)?;
    let known = Mounting::load(&*equipment.memory, &equipment.agent).await?;
    let mut head = Head::take(&equipment, &context)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut sight = equipment.look(FloorStep::new(equipment.images.calibration().camera));
    // From where the hand was seen.
    let model = equipment.robot.model();
    let camera = model.camera().ok_or_else(|| Failure::new("the robot has no cameras"))?;
    let from = known.corrected(&model.link_pose(&senses.newest().position, camera.left));
    let mut floors: Vec<Floor> = Vec::new();
    let (mut seen_in, mut before) = (BTreeSet::new(), Isometry3::identity());
    let all = views(context.number("side")?.abs(), context.number("down")?);
    let looked = look_at_each(&mut head, &mut senses, &all, context.number("dwell")?, |view| {
        let Some(sighting) = sight.newest().map_err(failed)? else { return Ok(()) };
        let eyes = sighting.root_from_left;
        let steady = std::mem::replace(&mut before, eyes).rotation.angle_to(&eyes.rotation) < STEADY;
        let Some(floor) = sighting.of_class("floor").filter(|_| steady) else { return Ok(()) };
        let size = floor.attributes.get("size").and_then(Value::as_vector3).unwrap_or_default();
        let Some(shown) = seen_pose(floor).filter(|_| size[1] > WIDE) else { return Ok(()) };
        floors.push(Floor { eyes, believed: equipment.link_at(camera.left, sighting.stamp_ns)?, shown });
        seen_in.insert(view);
        Ok(())
    });
    looked.await?;
    let directions = seen_in.len();
    if directions < if head.turns() { DIRECTIONS } else { 1 } {
        return Err(Failure::new(format!(
            "the floor was seen in {directions} of {} directions, too few to correct anything: do the cameras give depth up to 3 m, and is \
             the floor within 0.15 m of the root frame's z = 0?",
            all.len()
        )));
    }
    let floors = without_outliers(floors)?;
    let mounting = fit(&floors)?;
    let turn = mounting.believed_from_camera().rotation;
    let upright =
        UnitQuaternion::rotation_between_axis(&mounting.surface_up(), &Vector3::z_axis()).unwrap_or_default();
    let mut found = known.turned(&turn, &upright, &from, &kept);
    if context.flag("height")? {
        let height = |floor: &Floor| {
            let in_left = floor.eyes.inverse() * Point3::from(floor.shown.translation.vector);
            (found.corrected(&floor.believed) * in_left).z
        };
        let sum: f64 = floors.iter().map(height).sum();
        found.upright.translation.z -= sum / floors.len() as f64;
    }
    found.store(&*equipment.memory, &equipment.agent, senses.newest().stamp_ns).await?;
    let outcome = Outcome::success().with("turned", turn.angle()).with("leans", upright.angle());
    Ok(outcome.with("directions", directions as i64))
}

/// The floor in one picture.
struct Floor {
    /// The left camera's pose by all that was known, and by the joints alone.
    eyes: Isometry3<f64>,
    believed: Isometry3<f64>,
    /// The pose of its visible part; z is up.
    shown: Isometry3<f64>,
}

impl Floor {
    fn up(&self) -> UnitVector3<f64> {
        self.shown.rotation * Vector3::z_axis()
    }
}

/// The pictures without those that are far off the others: in some a part of something else passes for the floor.
fn without_outliers(mut floors: Vec<Floor>) -> Result<Vec<Floor>, Failure> {
    let first = fit(&floors)?;
    let off = |floor: &Floor| (first.from_shown(&floor.eyes) * floor.up()).angle(&first.surface_up());
    let mut offs: Vec<f64> = floors.iter().map(off).collect();
    offs.sort_by(f64::total_cmp);
    let usual = offs.get(offs.len() / 2).copied().unwrap_or_default();
    floors.retain(|floor| off(floor) <= FAR_OFF * usual);
    Ok(floors)
}

/// How cameras and neck are tilted by these pictures.
fn fit(floors: &[Floor]) -> Result<CameraMounting, Failure> {
    let mut mounting = CameraMounting::default();
    floors.iter().try_for_each(|floor| mounting.see_surface(&floor.eyes, &floor.up())).map_err(failed)?;
    Ok(mounting)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_only_passes_for_the_floor_says_neither_how_cameras_are_tilted_nor_how_high_they_are() {
        let eyes = Isometry3::translation(0.0, 0.0, 1.6);
        let shown = |tilt: f64, height: f64| {
            let shown = Isometry3::new(Vector3::new(0.0, 2.0, height), Vector3::x() * tilt);
            Floor { eyes, believed: eyes, shown }
        };
        let noise = [1.0, -2.0, 1.5, -1.0, 2.0, -1.5].map(|k| shown(0.001 * k, 0.0));
        let chest = [shown(0.09, 0.06), shown(0.091, 0.058)];
        let floors = without_outliers(noise.into_iter().chain(chest).collect()).unwrap();
        let heights: Vec<f64> = floors.iter().map(|floor| floor.shown.translation.z).collect();
        assert!(heights.len() >= 4 && heights.iter().all(|height| *height == 0.0), "{heights:?}");
    }
}
