//! `AttachObject`: records in memory that the hand holds an object. From then on the object moves with the hand,
//! for this agent and for all agents that follow its memory.
//!
//! The object's pose in the hand is computed from the poses of object and hand when the hand closed. `VerifyGrasp`
//! checks whether it is held at all.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::updater::MotionModel;
use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Frame, Type, Value, Vector};

use crate::arm::{chosen, moves_the_hand, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::hand;
use crate::inputs::{Inputs, pose_value, reference};
use crate::motions::failed;
use crate::prior::class_name;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
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
    let class = class_name(&snapshot)?;
    // The pose in memory may by now be that of the object in the hand, so the inputs are used.
    let tcp_from_object = context.pose("tcp_at_grasp")?.inverse() * context.pose("pose")?;

    let sensed = equipment.robot.sensed().borrow();
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let now = model.link_pose(&sensed.position, tcp_of(arm)?) * tcp_from_object;
    // The agent's name as prefix distinguishes the hands of several agents.
    let name = &hand(model, arm)?.name;
    let hand = format!("{}/{name}", equipment.agent);
    let held = MotionModel::Hand { name: hand.clone(), offset: tcp_from_object.translation.vector.into() };
    let mut attributes = BTreeMap::from([
        ("class".to_owned(), Value::from(class)),
        ("pose".to_owned(), pose_value(&now)),
        ("position".to_owned(), Value::Vector(Vector::new(Frame::root(), &now.translation.vector))),
    ]);
    attributes.extend(held.attributes());
    let confidence = snapshot.instance().map_or(1.0, |instance| instance.confidence);

    let id = EntityId::new("ObjectInstances", &equipment.agent, before.entity()).map_err(failed)?;
    let name = format!("{}-in-{name}", before.entity());
    let relation = EntityId::new("ObjectRelations", &equipment.agent, &name).map_err(failed)?;
    let related = BTreeMap::from([
        ("subject".to_owned(), Value::from(id.as_str())),
        ("relation".to_owned(), Value::from("in")),
        ("object".to_owned(), Value::from(hand)),
    ]);
    let commits = vec![
        Commit::new(id.clone(), sensed.stamp_ns, attributes).with_confidence(confidence),
        Commit::new(relation, sensed.stamp_ns, related),
    ];
    equipment.memory.commit(commits).await.map_err(failed)?;
    Ok(Outcome::success().with("object", reference("Object", &id)))
}
