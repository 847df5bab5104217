//! `PlanPut`: chooses how a hand puts what it holds on a thing: the yaw, near to the one that it has, for which the arm has the most margin
//! to its joint limits.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Point3, Translation3};

use crate::arm::{chosen, free_joints, names_the_arm, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, tcp_at, towards_wrist};
use crate::inputs::{Inputs, pose_value};
use crate::reach::Reach;
use crate::surface::ContactPlane;

/// The step between the yaws that are tried, rad, and how many there are on each side of the hand's own.
const STEP: f64 = 0.2;
const STEPS: i32 = 6;
/// Additional margin, rad, that one radian of turning must bring.
const TURN_COST: f64 = 0.2;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "PlanPut",
        "Chooses the pose of the hand for putting what it holds on a thing, by the arm's margin.",
    )
    .input("object", Type::object(), "The thing in memory on which it is put.")
    .optional(
        "above",
        Type::quantity(Unit::M),
        0.05,
        "Height of what the hand holds over the thing's middle when it is put down.",
    )
    .optional("height", Type::quantity(Unit::M), 0.12, "Height of the pre-pose over that.")
    .optional(
        "back",
        Type::quantity(Unit::M),
        0.0,
        "How far back from there the hand waits before, as `FollowObject` takes it.",
    )
    .output("put_pose", Type::Pose, "Pose of the TCP that has what it holds over the thing.")
    .output("object_pose", Type::Pose, "Where memory believes the thing to be.");
    equipment::skill(equipment, names_the_arm(manifest), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let id = context.entity("object")?;
    let thing = equipment.remembered().find(&id).await?.1;
    let center = Point3::from(thing.translation.vector);
    let surface = ContactPlane::under(equipment.remembered(), &center).await?;
    let (up, rotation) = (surface.normal(), surface.rotation());
    let over = center + up.scale(context.number("above")?);
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let (hand, tcp) = (hand(model, arm)?, tcp_of(arm)?);
    let mut random = equipment.random();
    let now = equipment.robot.sensed().borrow().position.clone();
    let joints = free_joints(&equipment, &context, arm);
    let level = rotation.inverse() * model.link_pose(&now, tcp).rotation * hand.palm_down(0.0).inverse();
    let yaw = level.euler_angles().2;
    let mut reach = Reach::new(model, &joints, tcp, &now);
    let turns = (-STEPS..=STEPS).map(|step| STEP * f64::from(step));
    let (height, back) = (context.number("height")?, context.number("back")?);
    let poses = turns.filter_map(|turn| {
        let put = tcp_at(hand, &over, &rotation, yaw + turn);
        let pre = Translation3::from(up.scale(height)) * put;
        let waits = Translation3::from(towards_wrist(model, arm, &put.rotation) * back) * pre;
        let margin = reach.margin(&[put, pre, waits], &mut random).ok()?;
        Some((margin - TURN_COST * turn.abs(), put))
    });
    let Some((_, put)) = poses.max_by(|a, b| a.0.total_cmp(&b.0)) else {
        let [x, y, z] = over.coords.into();
        return Err(Failure::new(format!(
            "the arm cannot put anything on `{id}`: x {x:.2}, y {y:.2}, z {z:.2} m is out of its reach from above"
        )));
    };
    Ok(Outcome::success().with("put_pose", pose_value(&put)).with("object_pose", pose_value(&thing)))
}
