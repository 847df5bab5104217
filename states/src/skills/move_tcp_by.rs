//! `MoveTcpBy`: moves the arm's TCP by an offset, without rotation.

use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{LeasedArm, Senses, chosen, moves_the_arm, tcp_of};
use crate::equipment::{self, Equipment};
use crate::inputs::Inputs;
use crate::skills::move_tcp::{NO_LIMIT, PoseTolerance, move_to};

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "MoveTcpBy",
        "Moves the arm's TCP by an offset on a straight line, without turning it.",
    )
    .input("offset", Type::list(Type::FLOAT), "x, y, z in the frame, m.")
    .optional(
        "frame",
        Type::one_of(["root", "hand"]),
        "root",
        "The frame of the offset: the robot's root, or the TCP as it is at the start.",
    )
    .optional("speed", Type::quantity(Unit::M_S), 0.1, "Speed on the line.")
    .optional("position_tolerance", Type::quantity(Unit::M), 0.01, "When the position counts as reached.")
    .optional("timeout", Type::Duration, 10.0, "Longest time it may take.")
    .optional(
        "force",
        Type::quantity(Unit::N),
        NO_LIMIT,
        "More force than this on the hand, beyond that at the start, ends the way.",
    )
    .output("tcp", Type::Pose, "Where the TCP is at the end.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let offset = context.vector("offset")?;
    let reached = PoseTolerance {
        position: context.number("position_tolerance")?,
        angle: 0.1,
        timeout: context.number("timeout")?,
        force: context.number("force")?,
    };
    let speed = context.number("speed")?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let tcp = tcp_of(chosen(&equipment, &context)?)?;
    let mut target = equipment.robot.model().link_pose(&senses.newest().position, tcp);
    let in_hand = context.text("frame")? == "hand";
    target.translation.vector += if in_hand { target.rotation * offset } else { offset };
    let mut arm = LeasedArm::take(&equipment, &context, &[target]).await?;
    move_to(&mut arm, &mut senses, target, speed, &reached).await
}
