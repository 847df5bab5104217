//! An arm goes around what memory knows to be in its way, and says so where there is no way.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_host::bench::{Bench, Benched};
use armarium_memoryx::{Commit, EntityId};
use armarium_robot::planning::{KnownBox, PlanError, Planner};
use armarium_robot::{LinkId, Model};
use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_states::Equipment;
use armarium_values::{Pose, Value};
use armarium_visionx::BulkEstimate;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use parking_lot::Mutex;

/// A skill in whose memory there are the table and a board, as a bulk that was seen, and what its TCP came nearest to that board, m.
struct Watched {
    skill: Arc<dyn Skill>,
    equipment: Equipment,
    board: KnownBox,
    nearest: Arc<Mutex<f64>>,
}

impl Skill for Watched {
    fn manifest(&self) -> SkillManifest {
        self.skill.manifest()
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let known = [&self.board, &table()].map(|known| {
            let pose = Value::Pose(Pose::new("root".into(), &known.root_from_box));
            let size: [f64; 3] = known.size.into();
            let class = if known.name == self.board.name { BulkEstimate::CLASS } else { "table" };
            let attributes = [
                ("pose".to_owned(), pose),
                ("size".to_owned(), Value::from(size)),
                ("class".to_owned(), Value::from(class)),
            ];
            let id = EntityId::new("EnvironmentModels", "test", &known.name).unwrap();
            Commit::new(id, 0, BTreeMap::from(attributes))
        });
        let (equipment, board) = (self.equipment.clone(), self.board.clone());
        let (nearest, acting) = (Arc::clone(&self.nearest), self.skill.run(context));
        async move {
            equipment.memory.commit(known.to_vec()).await.unwrap();
            let model = Arc::clone(equipment.robot.model());
            let tcp = model.arms().next().unwrap().tcp.unwrap();
            let mut sensed = equipment.robot.sensed();
            let watch = async move {
                while sensed.changed().await.is_ok() {
                    let at = model.link_pose(&sensed.borrow_and_update().position, tcp).translation.vector;
                    let mut nearest = nearest.lock();
                    *nearest = nearest.min(distance(&board, &at.into()));
                }
                std::future::pending::<()>().await;
            };
            tokio::select! {
                biased;
                ended = acting => ended,
                () = watch => unreachable!("it waits"),
            }
        }
        .boxed()
    }
}

/// The table of the default world, a little lower: over it, the hand that is ready keeps the distance that bodies keep.
fn table() -> KnownBox {
    let table = armarium_simulator::World::default().table;
    let [x, y] = table.center;
    KnownBox {
        name: "table".into(),
        root_from_box: Isometry3::translation(x, y, table.height - 0.04),
        size: Vector3::new(table.size[0], table.size[1], 0.04),
    }
}

fn distance(board: &KnownBox, point: &Point3<f64>) -> f64 {
    let inside = board.root_from_box.inverse() * point;
    (inside.coords.abs() - board.size / 2.0).sup(&Vector3::zeros()).norm()
}

/// A board that stands across the way of the hand from its start to where it is ready, `tall` m and `wide` m.
fn board(model: &Arc<Model>, tall: f64, wide: f64) -> KnownBox {
    let arm = model.arms().next().unwrap();
    let at = |q: &[f64]| model.link_pose(q, arm.tcp.unwrap()).translation.vector;
    let (from, to) = (at(model.start()), at(model.ready(&arm.name)));
    let way = to - from;
    KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::from_parts(
            (0.5 * (from + to)).into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(way.y, way.x)),
        ),
        size: Vector3::new(0.02, wide, tall),
    }
}

/// Runs a skill with a board in memory. Also returns what the TCP came nearest to it, m.
fn run(name: &'static str, board: KnownBox, inputs: &[(&str, Value)]) -> (Benched, f64) {
    let nearest = Arc::new(Mutex::new(f64::INFINITY));
    let seen = Arc::clone(&nearest);
    let make = move |equipment: &Equipment| {
        let skills = armarium_states::skills(equipment);
        let skill = skills.into_iter().find(|skill| skill.manifest().name == name).unwrap();
        let (equipment, board, nearest) = (equipment.clone(), board.clone(), Arc::clone(&seen));
        Arc::new(Watched { skill, equipment, board, nearest }) as Arc<dyn Skill>
    };
    let bench = inputs.iter().fold(Bench::new(make), |bench, (name, value)| bench.input(name, value.clone()));
    let ended = bench.run().unwrap();
    let nearest = *nearest.lock();
    (ended, nearest)
}

#[test]
fn joints_and_tcp_go_around_a_known_board() {
    let model = Model::shipped("armar3").unwrap();
    let arm = model.arms().next().unwrap();
    let board = board(&model, 0.12, 0.5);
    let straight = [model.start().to_vec(), model.ready(&arm.name).to_vec()];
    let mut planner = Planner::new(&model, std::slice::from_ref(&board));
    assert!(matches!(planner.check(&straight), Err(PlanError::WayBlocked(_))), "the board is in the way");

    let (ended, nearest) = run("MoveJoints", board.clone(), &[("posture", Value::from("wipe"))]);
    assert_eq!(ended.outcome, "success", "{:?}", ended.reason);
    assert!(nearest > 0.02, "{nearest}");
    let there = model.link_pose(model.ready(&arm.name), arm.tcp.unwrap());
    let target = Value::Pose(Pose::new("root".into(), &there));
    let (ended, nearest) = run("MoveTcp", board, &[("target", target)]);
    assert_eq!(ended.outcome, "success", "{:?}", ended.reason);
    assert!(nearest > 0.02, "{nearest}");
    let reached = ended.outputs["tcp"].clone();
    let Value::Pose(reached) = reached else { panic!("{reached:?}") };
    assert!((reached.isometry().translation.vector - there.translation.vector).norm() < 0.006);
}

#[test]
fn a_way_that_is_shut_is_said_before_anything_moves() {
    let model = Model::shipped("armar3").unwrap();
    let arm = model.arms().next().unwrap();
    let mut shut = board(&model, 4.0, 4.0);
    let (ended, _) = run("MoveJoints", shut.clone(), &[("posture", Value::from("wipe"))]);
    let reason = ended.reason.unwrap();
    assert!(reason.contains("`board`"), "{reason}");
    let there = model.link_pose(model.ready(&arm.name), arm.tcp.unwrap());
    shut = KnownBox { root_from_box: there, size: Vector3::repeat(0.1), ..shut };
    let (ended, _) = run("MoveJoints", shut, &[("posture", Value::from("wipe"))]);
    let reason = ended.reason.unwrap();
    assert!(reason.contains("the goal is not free") && reason.contains("`board`"), "{reason}");
    let moved = ended.robot.sensed().borrow().position.clone();
    let most = moved.iter().zip(model.start()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(most < 0.01, "{most}");
}

#[test]
fn a_posture_before_which_the_guard_would_stop_is_refused_at_once() {
    let model = Model::shipped("armar3").unwrap();
    let arm = model.arms().next().unwrap();
    let ready = model.ready(&arm.name);
    let under = |depth: f64| KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::translation(0.0, 0.0, -depth) * lying(&model, ready, arm.tcp.unwrap()),
        size: Vector3::new(0.3, 0.3, 0.02),
    };
    let nearest = |board: KnownBox| Planner::new(&model, &[board]).nearest(ready).map(|near| near.distance_m);
    let depth = (1..300).map(|mm| 1e-3 * f64::from(mm)).find(|&depth| nearest(under(depth)) > Some(0.01));
    let (ended, _) = run("MoveJoints", under(depth.unwrap()), &[("posture", Value::from("wipe"))]);
    let reason = ended.reason.unwrap_or_default();
    assert!(reason.contains("the goal is not free") && reason.contains("`board`"), "{reason}");
    // With enough room it goes there.
    let (ended, _) = run("MoveJoints", under(depth.unwrap() + 0.02), &[("posture", Value::from("wipe"))]);
    assert_eq!(ended.outcome, "success", "{:?}", ended.reason);
}

#[test]
fn a_hand_that_the_guard_stops_says_before_what() {
    let model = Model::shipped("armar3").unwrap();
    let under = lying(&model, model.start(), model.arms().next().unwrap().tcp.unwrap());
    // Between the hand and where it is to go, and at neither.
    let board = KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::translation(0.0, 0.0, -0.25) * under,
        size: Vector3::new(0.6, 0.6, 0.02),
    };
    let offset = Value::from([0.0, 0.0, -0.6]);
    let (ended, _) = run("MoveTcpBy", board, &[("offset", offset)]);
    let reason = ended.reason.unwrap_or_default();
    assert!(reason.contains("`board`, and may come no nearer"), "{reason}");
}

/// A level frame at a TCP.
fn lying(model: &Arc<Model>, q: &[f64], tcp: LinkId) -> Isometry3<f64> {
    Isometry3::from(model.link_pose(q, tcp).translation)
}
