//! Bodies stop before each other and before what is known to stand there.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::Rig;
use crate::bodies::{Bodies, least_distance};
use crate::planning::KnownBox;
use crate::{Kinematics, LeaseLimits, Load, LoadShape, Robot};

/// How near the hand comes to a board under it that it is driven to, m; with what it holds.
fn nearest_to_a_board(touches: &[String], load: Option<Load>) -> f64 {
    let mut rig = Rig::new();
    let tcp = rig.model.link("tcp_right").unwrap();
    let at = rig.joints.kinematics().pose(tcp).translation.vector;
    let board = KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::translation(at.x, at.y, at.z - 0.2),
        size: Vector3::new(0.3, 0.3, 0.02),
    };
    let mut loads = BTreeMap::new();
    if let Some(load) = load {
        rig.robot.set_load("right_hand", Some(load.clone())).unwrap();
        loads.insert("right_hand".to_owned(), load);
    }
    let boxes = [board];
    let bodies = Bodies::new(&rig.model).with(&rig.model, &loads, &boxes);
    rig.robot.set_surroundings(boxes.to_vec()).unwrap();
    let lease = rig.robot.lease_together(&["right_arm"], "test", LeaseLimits::default(), touches).unwrap();
    let mut ik =
        crate::DifferentialIk::new(&rig.model, tcp, rig.model.limb("right_arm"), crate::IkConfig::default());
    let down = crate::Twist { linear: Vector3::new(0.0, 0.0, -0.5), angular: Vector3::zeros() };
    let mut least = f64::INFINITY;
    for _ in 0..600 {
        let q = rig.joints.sample().position.clone();
        lease.command(ik.step(&q, &down, None).velocities).unwrap();
        rig.run(1, |_| Vector3::zeros());
        least = least.min(least_distance(&bodies, rig.joints.kinematics()));
    }
    least
}

#[test]
fn a_hand_and_what_it_holds_stop_before_a_known_table_unless_the_lease_names_it() {
    let shape = LoadShape {
        tcp_from_box: Isometry3::translation(0.08, 0.0, 0.0),
        size: Vector3::new(0.04, 0.1, 0.07),
    };
    let name = "sponge".to_owned();
    let load = Load { name, mass_kg: 0.0, center_in_tcp: Point3::origin(), shape: Some(shape) };
    for load in [None, Some(load)] {
        let kept = nearest_to_a_board(&[], load.clone());
        assert!(kept > 0.018 && kept < 0.03, "{kept} with {load:?}");
        let touching = nearest_to_a_board(&["board".into()], load);
        assert!(touching < 0.0, "{touching}");
    }
}

#[test]
fn surroundings_that_are_none_are_refused() {
    let rig = Rig::new();
    let board = KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::identity(),
        size: Vector3::new(0.3, 0.0, 0.02),
    };
    let flat = rig.robot.set_surroundings(vec![board.clone()]).unwrap_err().to_string();
    assert!(flat.contains("`board`"), "{flat}");
    let many = vec![KnownBox { size: Vector3::repeat(0.1), ..board }; 17];
    assert!(rig.robot.set_surroundings(many).is_err());
}

/// Drives both arms and the torso into three random postures in which bodies overlap, as fast as the joints may go. Returns the
/// least distance on the way, m, and how far the joints moved.
fn least_distance_while_driven(seed: u64, ms: u64) -> (f64, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rig = Rig::new();
    let bodies = Bodies::new(&rig.model);
    let limbs = ["left_arm", "right_arm", "torso"];
    let leases = limbs.map(|limb| rig.lease(limb));
    let (mut least, mut moved) = (f64::INFINITY, 0.0);
    for _ in 0..3 {
        let mut goal = rig.model.zero();
        let mut at_goal = Kinematics::new(&rig.model);
        while least_distance(&bodies, &at_goal) > 0.0 {
            goal = rig.model.joints().iter().map(|j| rng.random_range(j.lower..j.upper)).collect();
            at_goal.update(&goal);
        }
        for step in 0..ms {
            let before = rig.joints.sample().position.clone();
            for (lease, limb) in leases.iter().zip(limbs) {
                let towards = |&j: &usize| 5.0 * (goal[j] - before[j]).clamp(-1.0, 1.0);
                let speeds: Vec<f64> = rig.model.limb(limb).iter().map(towards).collect();
                lease.command(&speeds).unwrap();
            }
            rig.run(1, |_| Vector3::zeros());
            let now = &rig.joints.sample().position;
            moved += now.iter().zip(&before).map(|(a, b)| (a - b).abs()).sum::<f64>();
            if step % 4 == 0 {
                least = least.min(least_distance(&bodies, rig.joints.kinematics()));
            }
        }
    }
    (least, moved)
}

#[test]
fn arms_stop_before_each_other_before_the_head_and_before_the_trunk() {
    let mut near = 0;
    for seed in 0..30 {
        let (least, moved) = least_distance_while_driven(seed, 700);
        assert!(least > 0.018, "{seed}: {least}");
        assert!(moved > 0.5, "{seed}: {moved}");
        near += u32::from(least < 0.05);
    }
    assert!(near > 14, "only {near} drives came near");
}
