//! `AttachObject`: records in memory that the hand holds an object. From then on the object moves with the hand,
//! for this agent and for all agents that follow its memory.
//!
//! The object's pose in the hand is computed from the poses of object and hand when the hand closed. `VerifyGrasp`
//! checks whether it is held at all.

use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;

use crate::arm::{chosen, moves_the_hand, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::hand;
use crate::held;
use crate::inputs::{Inputs, reference};
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "AttachObject",
        "Says in memory that the hand holds an object, which moves with it from now on.",
    )
    .input("object", Type::object(), "The object in memory.")
    .input("pose", Type::Pose, "Its pose when the hand closed, root frame.")
    .input("tcp_at_grasp", Type::Pose, "Pose of the TCP when the hand closed.")
    .output("object", Type::object(), "The object in memory, in the hand.");
    equipment::skill(equipment, moves_the_hand(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let before = context.entity("object")?;
    let snapshot = equipment.memory.latest(&before).await.map_err(failed)?;
    // The pose in memory may by now be that of the object in the hand, so the inputs are used.
    let tcp_from_object = context.pose("tcp_at_grasp")?.inverse() * context.pose("pose")?;
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let sensed = equipment.robot.sensed().borrow();
    let now = model.link_pose(&sensed.position, tcp_of(arm)?) * tcp_from_object;
    let hand = &hand(model, arm)?.name;
    let id = held::take(&equipment, (hand, &snapshot), &now, &tcp_from_object).await?;
    Ok(Outcome::success().with("object", reference("Object", &id)))
}
