//! `MoveTcp`: position control of the arm's TCP along a straight line, or around what is known to be in its way.

use armarium_motion::StraightLine;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::around::{Around, follow, stops_short};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, pose_value};
use crate::motions::failed;

/// How near each joint comes to the end of a way around before the TCP goes straight to its target, rad.
const NEAR_THE_GOAL: f64 = 0.02;

/// How long after the end of its line the TCP may still be on its way before the arm takes another posture, s.
pub(crate) const LATE: f64 = 1.0;
/// A force that the guard does not let a hand come to, N.
pub(crate) const NO_LIMIT: f64 = 1e3;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest =
        SkillManifest::new("MoveTcp", "Moves the arm's TCP to a pose on a straight line, turning evenly, or around what is known to be in the way.")
            .input("target", Type::Pose, "Pose of the TCP in the root frame.")
            .optional("speed", Type::quantity(Unit::M_S), 0.15, "Speed on the line.");
    let manifest = tolerances(manifest, 0.005, 0.05)
        .optional("timeout", Type::Duration, 15.0, "Longest time it may take.")
        .output("tcp", Type::Pose, "Where the TCP is at the end.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

/// Adds the inputs that say when a pose counts as reached: the defaults are `position` m and `orientation` rad.
pub(crate) fn tolerances(manifest: SkillManifest, position: f64, orientation: f64) -> SkillManifest {
    let [m, rad] = [Unit::M, Unit::RAD].map(Type::quantity);
    manifest.optional("position_tolerance", m, position, "When the position counts as reached.").optional(
        "orientation_tolerance",
        rad,
        orientation,
        "When the orientation counts as reached.",
    )
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let target = context.pose("target")?;
    let reached = PoseTolerance {
        position: context.number("position_tolerance")?,
        angle: context.number("orientation_tolerance")?,
        timeout: context.number("timeout")?,
        force: NO_LIMIT,
    };
    let speed = context.number("speed")?;
    let mut arm = LeasedArm::take(&equipment, &context, &[target]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (model, now) = (equipment.robot.model(), senses.newest().position.clone());
    let around = Around::of(&equipment, &arm.limb, &arm.leases, &now, Some(&target)).await?;
    if let Some(path) = around.way_to_pose(now, target, speed).await? {
        follow(&mut senses, model, &arm.leases, &path, (NEAR_THE_GOAL, reached.timeout)).await?;
    }
    move_to(&mut arm, &mut senses, target, speed, &reached).await
}

/// When a pose counts as reached.
pub(crate) struct PoseTolerance {
    /// Largest distance, m.
    pub(crate) position: f64,
    /// Largest angle, rad.
    pub(crate) angle: f64,
    /// Timeout, s.
    pub(crate) timeout: f64,
    /// More force than this on the hand, beyond that at the start, ends the way, N.
    pub(crate) force: f64,
}

/// Moves the TCP to `target` (root frame) on a straight line at `speed`, m/s. The outcome contains the final pose.
pub(crate) async fn move_to(
    arm: &mut LeasedArm,
    senses: &mut Senses,
    target: Isometry3<f64>,
    speed: f64,
    reached: &PoseTolerance,
) -> SkillResult {
    let mut line = StraightLine::new(arm.tcp(&senses.newest()), target, speed).map_err(failed)?;
    let feels = reached.force < NO_LIMIT;
    let free = if feels { arm.force(&senses.newest())? } else { Vector3::zeros() };
    let (mut elapsed, mut pulled, mut turns) = (0.0, false, false);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let force = if feels { (arm.force(&sample)? - free).norm() } else { 0.0 };
        if force > reached.force {
            arm.stand()?;
            return Err(Failure::new(format!(
                "the hand met something on its way: it felt {force:.0} N, and {:.0} N are allowed",
                reached.force
            )));
        }
        let point = line.step(dt).map_err(failed)?;
        if turns {
            turns = !arm.take_posture(&sample)?;
        } else {
            arm.track(&sample, &point.pose, point.linear, point.angular)?;
        }
        let tcp = arm.tcp(&sample);
        let distance = (target.translation.vector - tcp.translation.vector).norm();
        let angle = target.rotation.angle_to(&tcp.rotation);
        let there = distance < reached.position && angle < reached.angle;
        // It must end at rest, so that the next skill starts with a still hand.
        if !turns && line.rested(0.15) && there {
            return Ok(Outcome::success().with("tcp", pose_value(&tcp)));
        }
        turns &= !there;
        if line.rested(LATE) && !pulled {
            turns = arm.needs_another_posture(&sample, &target, distance);
            pulled = true;
        }
        if elapsed > reached.timeout {
            let why = stops_short(arm, &sample).await?;
            return Err(Failure::new(format!(
                "the TCP was not at its target within {:.0} s: it is {:.0} mm and {angle:.2} rad away{why}",
                reached.timeout,
                distance * 1e3,
            )));
        }
    }
}
