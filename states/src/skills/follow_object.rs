//! `FollowObject`: holds the hand over a thing and goes where it goes, until both have rested for a while.
//!
//! Where the thing is, memory says: it sees nothing itself. Whoever turns the eyes looks at the thing as long as this skill needs it.

use armarium_memoryx::EntityId;
use armarium_motion::{PositionServo, ServoConfig, ServoObservation, ServoStatus};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use nalgebra::{Isometry3, Translation3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::around::stops_short;
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp, towards_wrist};
use crate::inputs::{Inputs, pose_value};
use crate::motions::failed;
use crate::skills::move_tcp::{LATE, tolerances};

/// How often memory is asked, s.
const ASKED: f64 = 0.02;
/// How long memory may know nothing of it, s.
const LOST: f64 = 3.0;
/// So exactly the thing's place is to be known, m; one that is further from where it stood has moved.
const WITHIN: f64 = 0.01;
/// A hand that is slower than this, m/s, stands.
const STANDS: f64 = 0.01;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "FollowObject",
        "Holds the hand over a thing, wherever memory says that it is, until both have rested.",
    )
    .input("object", Type::object(), "The thing in memory.")
    .optional(
        "height",
        Type::quantity(Unit::M),
        0.12,
        "Height of what the hand would hold over the thing's middle.",
    )
    .optional(
        "back",
        Type::quantity(Unit::M),
        0.0,
        "How far it stays back, from the fingers towards the wrist, so that it does not hide the thing.",
    )
    .optional(
        "grasp_pose",
        Type::Any,
        Value::Null,
        "Pose of the TCP that grasps the thing; without it, the hand keeps its orientation.",
    )
    .optional(
        "object_pose",
        Type::Any,
        Value::Null,
        "Pose of the thing for which `grasp_pose` is; without it, where it is when this begins.",
    )
    .optional(
        "for",
        Type::Duration,
        0.5,
        "How long the hand is to have rested there, and the thing under it.",
    )
    .optional("speed", Type::quantity(Unit::M_S), 0.15, "Largest speed.");
    let manifest = tolerances(manifest, 0.005, 0.06)
        .optional("timeout", Type::Duration, 20.0, "Longest time it may take.")
        .output(
            "grasp_pose",
            Type::Pose,
            "Pose of the TCP that grasps the thing where it is believed to be at the end.",
        )
        .output("pre_pose", Type::Pose, "Pose of the TCP right over it.")
        .attends("object", WITHIN, 1.0)
        .mark(Mark::at_success("pre_pose_left"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let id = context.entity("object")?;
    let begin = match context.value("object_pose")? {
        Value::Null => place(&equipment, &id).await?,
        _ => context.pose("object_pose")?.translation.vector,
    };
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut arm = LeasedArm::take(&equipment, &context, &[]).await?;
    let grasp = match context.value("grasp_pose")? {
        Value::Null => {
            let palm = arm.tcp(&senses.newest()).rotation;
            let held = palm * held_in_tcp(hand(equipment.robot.model(), &arm.limb)?).coords;
            Isometry3::from_parts((begin - held).into(), palm)
        }
        _ => context.pose("grasp_pose")?,
    };
    let above = Translation3::new(0.0, 0.0, context.number("height")?);
    let back = towards_wrist(equipment.robot.model(), &arm.limb, &grasp.rotation) * context.number("back")?;
    let rests = context.number("for")?;
    let (position, angle) = (context.number("position_tolerance")?, context.number("orientation_tolerance")?);
    let mut law = PositionServo::new(ServoConfig {
        position_tolerance: position,
        rotation_tolerance: angle,
        timeout: context.number("timeout")?,
        max_linear: context.number("speed")?,
        // When the hand has rested is judged here; the thing may go away from it.
        hold_frames: u32::MAX,
        divergence: 1e9,
        lost_after: LOST,
        ..ServoConfig::default()
    })
    .map_err(failed)?;
    // Where the thing stands, and for how long it and the hand have rested, s.
    let (mut stands, mut rested) = (begin, 0.0);
    let (mut there, mut reached_for) = (grasp, None);
    // For how long the hand has stood beside its place, s, and whether it takes another posture for that.
    let (mut short, mut turns) = (0.0, false);
    let (mut waited, mut linear, mut angular) = (ASKED, Vector3::zeros(), Vector3::zeros());
    loop {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        if waited >= ASKED {
            // A thing of which memory knows nothing for a moment may be found again.
            let known = place(&equipment, &id).await.ok();
            there = known.map_or(there, |place| Translation3::from(place - begin) * grasp);
            let hand = arm.tcp(&sample);
            let target = Translation3::from(back) * above * there;
            let wanted = target.translation.vector;
            if reached_for.is_none_or(|before: Vector3<f64>| (wanted - before).norm() > WITHIN) {
                arm.pull_towards_pose(&sample, &target);
                reached_for = Some(wanted);
            }
            let observation = known.map(|_| ServoObservation { hand, target });
            let command = law.step(waited, observation.as_ref()).map_err(failed)?;
            let near = command.distance <= position && command.angle <= angle;
            let is_short = !near && arm.tcp_velocity(&sample).norm() < STANDS;
            short = if is_short { short + waited } else { 0.0 };
            turns &= !near;
            if short > LATE {
                (short, turns) = (0.0, arm.needs_another_posture(&sample, &target, command.distance));
            }
            rested += waited;
            if !known.is_some_and(|place| near && (place - stands).norm() < WITHIN) {
                (stands, rested) = (known.unwrap_or(stands), 0.0);
            }
            if rested >= rests {
                let done = Outcome::success().with("grasp_pose", pose_value(&there));
                return Ok(done.with("pre_pose", pose_value(&(above * there))));
            }
            match command.status {
                ServoStatus::Running | ServoStatus::Converged => {}
                _ if known.is_none() => {
                    return Err(Failure::new(format!("memory has not known for some time where `{id}` is")));
                }
                _ => {
                    let why = stops_short(&arm, &sample).await?;
                    return Err(Failure::new(format!(
                        "the hand did not come to rest over `{id}`: it is {:.0} mm and {:.2} rad off; the thing has to \
                         stand still for that{why}",
                        command.distance * 1e3,
                        command.angle
                    )));
                }
            }
            (waited, linear, angular) = (0.0, command.linear, command.angular);
        }
        if turns {
            turns = !arm.take_posture(&sample)?;
        } else {
            arm.twist(&sample, linear, angular)?;
        }
    }
}

/// Where memory believes a thing to be, root frame, m.
async fn place(equipment: &Equipment, id: &EntityId) -> Result<Vector3<f64>, Failure> {
    Ok(equipment.remembered().find(id).await?.1.translation.vector)
}
