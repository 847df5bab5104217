//! `MoveJoints`: position control of the arm and what helps it to a named posture or to joint angles, around what is known to
//! be in the way.

use armarium_robot::Limb;
use armarium_runtime::skill::{Failure, NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{ArmLeases, Senses, chosen, moves_the_arm};
use crate::around::{Around, follow};
use crate::equipment::{self, Equipment};

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "MoveJoints",
        "Moves the arm and what helps it together to a posture, each joint in a straight line, or around what is known to be in the way.",
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
    let leases = ArmLeases::take(&equipment, &context, arm, (&arm.helped_by, &[])).await?;
    let goal = goal(&equipment, &context, arm)?;
    let model = equipment.robot.model();
    let mut senses = Senses::new(&*equipment.robot, &context);
    let now = senses.newest().position.clone();
    let around = Around::of(&equipment, arm, &leases, &now, None).await?;
    let path = around.way_to_joints(now, goal).await?;
    follow(&mut senses, model, &leases, &path, (tolerance, timeout)).await?;
    Ok(Outcome::success())
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
