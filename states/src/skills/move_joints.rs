//! `MoveJoints`: position control of the arm and what helps it to a named posture or to joint angles.

use std::sync::Arc;

use armarium_robot::Limb;
use armarium_runtime::skill::{Failure, NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{ArmLeases, Senses, chosen, moves_the_arm};
use crate::equipment::{self, Equipment};

/// The share of each joint's speed limit that is used.
const SPEED_SHARE: f64 = 0.8;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
    let manifest = SkillManifest::new(
        "MoveJoints",
        "Moves the arm and what helps it together to a posture, each joint in a straight line.",
    )
    .optional("posture", Type::String, "", "A named posture of the robot, for instance `home`.")
    .names(NameKind::Posture)
    .optional(
        "joints",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "Joint angles of the arm, rad, instead of a posture.",
    )
    .optional("tolerance", Type::quantity(Unit::RAD), 0.01, "When each joint counts as reached.")
    .optional("timeout", Type::Duration, 15.0, "Longest time it may take.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let tolerance = context.number("tolerance")?;
    let timeout = context.number("timeout")?;
    let arm = chosen(&equipment, &context)?;
    let leases = ArmLeases::take(&equipment, &context, arm)?;
    let goal = goal(&equipment, &context, arm)?;
    let model = equipment.robot.model();
    let joints = &leases.joints;
    let speed = |joint: usize| model.joints()[joint].velocity * SPEED_SHARE;
    let acceleration = |joint: usize| model.joints()[joint].acceleration * 0.3;

    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut elapsed = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        // All joints arrive together: the slowest one determines the speed, including braking.
        let error = |joint: usize| goal[joint] - sample.position[joint];
        let moved = || joints.iter().copied();
        let worst = moved().map(|j| error(j).abs()).fold(0.0, f64::max);
        if worst < tolerance {
            return Ok(Outcome::success());
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the posture was not reached within {timeout:.0} s: a joint is still {worst:.3} rad away"
            )));
        }
        let time_left = moved().map(|j| error(j).abs() / speed(j)).fold(0.0, f64::max);
        let braking = moved()
            .map(|j| error(j).abs() / (2.0 * acceleration(j) * error(j).abs()).sqrt().max(1e-6))
            .fold(0.0, f64::max);
        let time_left = time_left.max(braking).max(0.08);
        let velocity: Vec<f64> = moved().map(|j| error(j) / time_left).collect();
        leases.command(&velocity)?;
    }
}

/// The goal position of every joint of the robot; joints that are not named keep their position.
fn goal(equipment: &Equipment, context: &SkillContext, arm: &Limb) -> Result<Vec<f64>, Failure> {
    let model = equipment.robot.model();
    let mut goal = equipment.robot.sensed().borrow().position.clone();
    let name = context.text("posture")?;
    if !name.is_empty() {
        let posture = model.posture(name, &arm.name).ok_or_else(|| {
            let known = model.postures().keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            Failure::new(format!("the robot has no posture `{name}`; it has {known}"))
        })?;
        for joint in model.reaching_joints(&arm.name) {
            goal[joint] = posture[joint];
        }
        return Ok(goal);
    }
    let angles = context.value("joints")?.as_list().unwrap_or_default();
    let joints = &arm.joints;
    if angles.len() != joints.len() {
        return Err(Failure::new(format!(
            "give a `posture`, or `joints` with {} angles; it has {}",
            joints.len(),
            angles.len()
        )));
    }
    for (&joint, angle) in joints.iter().zip(angles) {
        goal[joint] = angle
            .as_f64()
            .filter(|a| a.is_finite())
            .ok_or_else(|| Failure::new("`joints` holds something that is no number"))?;
    }
    Ok(goal)
}
