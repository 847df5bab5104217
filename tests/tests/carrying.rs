//! What a hand carries moves with it in memory, and so does what stands on it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use armarium_host::bench::Bench;
use armarium_memoryx::{Commit, EntityId, Pattern, Query, Snapshot};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_simulator::World;
use armarium_states::Equipment;
use armarium_values::{Frame, Pose, Reference, Value};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Plays skills one after the other: what the hand is said to hold is carried through the room, and let go.
struct Carries(Equipment);

/// What memory knows of a thing.
async fn known(equipment: &Equipment, entity: &str) -> Arc<Snapshot> {
    equipment.memory.latest(&id(equipment, entity)).await.unwrap()
}

fn id(equipment: &Equipment, entity: &str) -> EntityId {
    EntityId::new("ObjectInstances", &equipment.agent, entity).unwrap()
}

fn place(snapshot: &Snapshot) -> Isometry3<f64> {
    match snapshot.attribute("pose") {
        Some(Value::Pose(pose)) => pose.isometry(),
        other => panic!("{other:?}"),
    }
}

impl Carries {
    async fn carry(self, context: SkillContext) -> SkillResult {
        let Self(equipment) = self;
        let skill = |name: &str| {
            let all = armarium_states::skills(&equipment);
            all.into_iter().find(|skill| skill.manifest().name == name).unwrap()
        };
        let play = |name: &str, inputs: &[(&str, Value)]| {
            let skill = skill(name);
            let mut context = context.clone();
            let usual = skill.manifest().inputs.into_iter();
            context.inputs = usual.filter_map(|input| Some((input.name, input.default?))).collect();
            context.inputs.extend(inputs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
            skill.run(context)
        };
        let model = Arc::clone(equipment.robot.model());
        let arm = model.arms().next().unwrap();
        let tcp = |equipment: &Equipment| {
            model.link_pose(&equipment.robot.sensed().borrow().position, arm.tcp.unwrap())
        };
        let memory = &equipment.memory;
        // To where the arm can move to all sides.
        play("MoveJoints", &[("posture", Value::from("wipe"))]).await?;

        // A brick at the TCP, as prior knowledge knows it, turned a little; and another one upon it, whose class has the same size.
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3);
        let below = Isometry3::from_parts(tcp(&equipment).translation, turned);
        let classes = memory.query(&Query::latest(Pattern::segment("ObjectClasses"))).await.unwrap();
        let class = classes.iter().find(|class| class.id.entity() == "sponge").unwrap();
        let height = class.attribute("size").unwrap().as_vector3().unwrap()[2];
        let above = below * Translation3::new(0.01, 0.0, height);
        for (entity, at) in
            [("tray", &below), ("cup", &above), ("far", &(below * Translation3::new(0.5, 0.0, 0.0)))]
        {
            let pose = Value::Pose(Pose::new(Frame::root(), at));
            let attributes =
                BTreeMap::from([("class".to_owned(), Value::from("sponge")), ("pose".to_owned(), pose)]);
            memory.commit(vec![Commit::new(id(&equipment, entity), 1, attributes)]).await.unwrap();
        }
        let pose = |at: &Isometry3<f64>| Value::Pose(Pose::new(Frame::root(), at));
        let tray =
            Value::Reference(Reference { kind: "Object".into(), id: id(&equipment, "tray").to_string() });
        let held = [("object", tray), ("pose", pose(&below)), ("tcp_at_grasp", pose(&tcp(&equipment)))];
        play("AttachObject", &held).await?;
        let in_hand = tcp(&equipment).inverse() * below;
        let offset = Value::List([0.0, 0.05, 0.1].map(Value::Float).to_vec());
        play("MoveTcpBy", &[("offset", offset)]).await?;
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;

        let (is, should) = (place(&*known(&equipment, "tray").await), tcp(&equipment) * in_hand);
        assert!((is.translation.vector - should.translation.vector).norm() < 0.002, "{is} {should}");
        assert!(is.rotation.angle_to(&should.rotation) < 0.02, "{is} {should}");
        assert!((is.translation.vector - below.translation.vector).norm() > 0.08, "it has moved");
        let upon = place(&*known(&equipment, "cup").await);
        let as_before = is * below.inverse() * above;
        assert!((upon.translation.vector - as_before.translation.vector).norm() < 1e-6, "{upon} {as_before}");
        let far = known(&equipment, "far").await;
        assert_eq!((far.version, far.attribute("attached_to")), (1, None));

        play("OpenHand", &[]).await?;
        let left = known(&equipment, "tray").await;
        for thing in [&left, &known(&equipment, "cup").await] {
            assert_eq!((thing.attribute("attached_to"), thing.attribute("offset")), (None, None));
        }
        let relations = memory.query(&Query::latest(Pattern::segment("ObjectRelations"))).await.unwrap();
        assert!(relations.is_empty(), "nothing is in the hand: {relations:?}");
        let lies = place(&left);
        let offset = Value::List([0.0, -0.05, 0.05].map(Value::Float).to_vec());
        play("MoveTcpBy", &[("offset", offset)]).await?;
        assert_eq!(place(&*known(&equipment, "tray").await), lies, "the hand has gone without it");
        Ok(Outcome::success())
    }
}

impl Skill for Carries {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Carries", "Carries a thing with another one upon it.")
    }
    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let carries = Self(self.0.clone());
        async move { carries.carry(context).await.map_err(|failure: Failure| failure) }.boxed()
    }
}

#[test]
fn memory_carries_along_what_the_hand_carries_and_what_stands_on_it() {
    // Each reading of the joints would put the hand up to 2 mm elsewhere.
    let exact = "world: exact\nphysics: ideal\nrobot: {noise: {joint: 0}}\n";
    let world = World::parse(Path::new("exact.world.yaml"), exact).unwrap();
    let ended = Bench::new(|equipment: &Equipment| Arc::new(Carries(equipment.clone())) as Arc<dyn Skill>)
        .world(world)
        .run()
        .unwrap();
    assert_eq!(ended.outcome, "success", "{:?}", ended.reason);
}
