//! What the wrench sensors feel, and how arms give way.

use nalgebra::{Point3, Vector3};

use super::{LEFT, RIGHT, Rig};
use crate::{Fault, LeaseLimits, Load, Robot, load_mass};

#[test]
fn the_wrist_reads_a_push_and_no_motion_of_its_own() {
    let mut rig = Rig::new();
    assert!(rig.wrist().force.norm() < 0.02, "{:?}", rig.wrist());
    let push = Vector3::new(3.0, -4.0, 5.0);
    rig.run(100, |_| push);
    let wrist = rig.wrist();
    assert!((wrist.force - push).norm() < 0.02 && wrist.torque.norm() < 0.02, "{wrist:?}");
    rig.run(100, |_| Vector3::zeros());
    let lease = rig.lease("right_arm");
    let mut most = 0.0_f64;
    for k in 0..600_u32 {
        let speed = if (k / 100) % 2 == 0 { 1.0 } else { -1.0 };
        lease.command(&[speed, 0.5 * speed, -speed, speed, 0.0, 0.0, 0.0]).unwrap();
        rig.run(1, |_| Vector3::zeros());
        most = most.max(rig.wrist().force.norm());
    }
    // The hand of 1 kg accelerates at up to 8 m/s².
    assert!(most < 0.5, "its own motion reads as {most} N");
}

#[test]
fn what_the_hand_lifts_is_weighed_and_compensated() {
    let mut rig = Rig::new();
    let before = rig.wrist();
    let weight = Vector3::new(0.0, 0.0, -0.15 * 9.81);
    rig.run(100, |_| weight);
    assert!((load_mass(&before, &rig.wrist()) - 0.15).abs() < 0.002);
    let load = Load { name: "sponge".into(), mass_kg: 0.15, center_in_tcp: Point3::origin(), shape: None };
    rig.robot.set_load("right_hand", Some(load)).unwrap();
    rig.run(100, |_| weight);
    assert!(rig.wrist().force.norm() < 0.02, "{:?}", rig.wrist());
}

#[test]
fn the_raw_wrist_of_a_hanging_hand_reads_its_weight_downwards() {
    let rig = Rig::new();
    let sensor = rig.model.link("wrist_sensor_right").unwrap();
    let force = rig.joints.kinematics().pose(sensor) * rig.joints.sample().wrenches[rig.sensor(RIGHT)].force;
    assert!((force - Vector3::new(0.0, 0.0, -9.81)).norm() < 0.01, "{force:?}");
}

#[test]
fn a_strong_push_is_given_way_to_until_it_is_under_the_limit() {
    let mut rig = Rig::new();
    let arm = rig.lease("right_arm");
    let hand = rig.lease("right_hand");
    // A person of 500 N/m, whose hand is 0.16 m behind the robot's: 80 N.
    let tcp = rig.model.link("tcp_right").unwrap();
    let start = rig.joints.kinematics().pose(tcp).translation.vector;
    let spring = move |at: Point3<f64>| Vector3::new(500.0 * (start.x - 0.16 - at.x).min(0.0), 0.0, 0.0);
    rig.run(2000, spring);
    let Some(Fault::Force { force_n, limit_n, .. }) = arm.fault() else { panic!("{:?}", arm.fault()) };
    assert!(limit_n == 40.0 && force_n > 60.0 && force_n < 90.0, "{force_n}");
    assert_eq!(hand.fault(), None);
    let force = rig.wrist().force.norm();
    assert!(force < 40.0 && force > 10.0, "{force} N remain");
    assert!(rig.fastest() < 0.01, "it stands, at {}", rig.fastest());
    let end = rig.joints.kinematics().pose(tcp).translation.vector;
    assert!((end - start).x < -0.08 && (end - start).yz().norm() < 0.02, "{:?}", end - start);
}

#[test]
fn a_lease_may_say_a_larger_limit_up_to_the_most_of_the_robot() {
    for (said, push, limit) in
        [(None, 55.0, Some(40.0)), (Some(60.0), 55.0, None), (Some(200.0), 85.0, Some(70.0))]
    {
        let mut rig = Rig::new();
        let lease =
            rig.robot.lease("right_arm", "test", LeaseLimits { force_n: said, ..LeaseLimits::default() });
        let lease = lease.unwrap();
        rig.run(50, |_| Vector3::x() * -push);
        let found = match lease.fault() {
            Some(Fault::Force { limit_n, .. }) => Some(limit_n),
            _ => None,
        };
        assert_eq!(found, limit, "{said:?}");
    }
}

#[test]
fn pressing_on_a_stiff_table_ends_under_the_limit_of_the_lease() {
    for stiffness in [2000.0, 10_000.0] {
        let mut rig = Rig::new();
        let limits = LeaseLimits { force_n: Some(20.0), ..LeaseLimits::default() };
        let lease = rig.robot.lease("right_arm", "test", limits).unwrap();
        let tcp = rig.model.link("tcp_right").unwrap();
        let table = rig.joints.kinematics().pose(tcp).translation.z - 0.03;
        let spring = move |at: Point3<f64>| Vector3::new(0.0, 0.0, stiffness * (table - at.z).max(0.0));
        let mut ik = crate::DifferentialIk::new(
            &rig.model,
            tcp,
            rig.model.limb("right_arm"),
            crate::IkConfig::default(),
        );
        let down = crate::Twist { linear: Vector3::new(0.0, 0.0, -0.1), angular: Vector3::zeros() };
        for _ in 0..2000 {
            let q = rig.joints.sample().position.clone();
            let _ = lease.command(ik.step(&q, &down, None).velocities);
            rig.run(1, spring);
        }
        assert!(matches!(lease.fault(), Some(Fault::Force { limit_n: 20.0, .. })), "{:?}", lease.fault());
        let force = rig.wrist().force.norm();
        assert!(force < 20.0, "{force} N remain at {stiffness} N/m");
        assert!(rig.fastest() < 0.01, "it stands at {stiffness} N/m, at {}", rig.fastest());
    }
}

#[test]
fn a_frozen_wrench_faults_the_arm_but_not_the_head() {
    let mut rig = Rig::new();
    let (arm, head) = (rig.lease("right_arm"), rig.lease("head"));
    rig.frozen = true;
    rig.run(99, |_| Vector3::zeros());
    assert_eq!(arm.fault(), None);
    rig.run(5, |_| Vector3::zeros());
    assert!(matches!(arm.fault(), Some(Fault::FrozenWrench { frozen_ms: 100, .. })), "{:?}", arm.fault());
    assert_eq!(head.fault(), None);
    drop(arm);
    rig.frozen = false;
    rig.run(2, |_| Vector3::zeros());
    let arm = rig.lease("right_arm");
    rig.run(10, |_| Vector3::zeros());
    assert_eq!(arm.fault(), None);
}

#[test]
fn each_arm_has_a_sensor_of_its_own() {
    let mut rig = Rig::new();
    let push = Vector3::new(0.0, 5.0, -3.0);
    (0..100).for_each(|_| rig.step(&[(LEFT, push)]));
    assert!((rig.felt(LEFT).force - push).norm() < 0.02, "{:?}", rig.felt(LEFT));
    assert!(rig.felt(RIGHT).force.norm() < 0.02, "{:?}", rig.felt(RIGHT));
    // A tare and a load concern one of them.
    rig.robot.tare(LEFT).unwrap();
    (0..100).for_each(|_| rig.step(&[(LEFT, push), (RIGHT, push)]));
    assert!(rig.felt(LEFT).force.norm() < 0.02 && (rig.felt(RIGHT).force - push).norm() < 0.02);
    let load = Load { name: "cup".into(), mass_kg: 0.3, center_in_tcp: Point3::origin(), shape: None };
    rig.robot.set_load("left_hand", Some(load.clone())).unwrap();
    rig.run(100, |_| Vector3::zeros());
    let weighed = Vector3::z() * 0.3 * 9.81 - push;
    assert!((rig.felt(LEFT).force - weighed).norm() < 0.02, "{:?}", rig.felt(LEFT));
    assert!(rig.felt(RIGHT).force.norm() < 0.02);
    // So does too strong a force.
    let (right, left) = (rig.lease("right_arm"), rig.lease("left_arm"));
    (0..200).for_each(|_| rig.step(&[(LEFT, Vector3::x() * -60.0)]));
    let said = left.fault().map(|fault| fault.to_string()).unwrap_or_default();
    assert!(said.contains("`left_wrist`") && right.fault().is_none(), "{said}");
    let unknown = rig.robot.tare("nose").unwrap_err().to_string();
    assert_eq!(unknown, "the robot has no wrench sensor `nose`; it has right_wrist, left_wrist");
    assert!(rig.robot.set_load("nose", None).is_err());
    let heavy = Load { mass_kg: f64::NAN, ..load };
    assert!(rig.robot.set_load("left_hand", Some(heavy)).unwrap_err().to_string().contains("not physical"));
}

/// Where a TCP is, and how far it went in 300 ms of a push on the right hand.
fn gone(rig: &mut Rig, push: Vector3<f64>) -> [Vector3<f64>; 2] {
    let tcps = ["tcp_right", "tcp_left"].map(|tcp| rig.model.link(tcp).unwrap());
    let at = |rig: &Rig| tcps.map(|tcp| rig.joints.kinematics().pose(tcp).translation.vector);
    let before = at(rig);
    (0..300).for_each(|_| rig.step(&[(RIGHT, push)]));
    let after = at(rig);
    [after[0] - before[0], after[1] - before[1]]
}

#[test]
fn arms_that_hold_one_load_give_way_and_stop_together() {
    let push = Vector3::new(0.0, 60.0, 0.0);
    let hold = |rig: &Rig, names: [&str; 2]| {
        for (hand, name) in ["right_hand", "left_hand"].into_iter().zip(names) {
            let load = Load { name: name.into(), mass_kg: 0.0, center_in_tcp: Point3::origin(), shape: None };
            rig.robot.set_load(hand, Some(load)).unwrap();
        }
        rig.lease("left_arm")
    };
    let mut rig = Rig::new();
    let left = hold(&rig, ["tray", "cup"]);
    let [right_went, left_went] = gone(&mut rig, push);
    assert!(right_went.y > 0.02 && left_went.norm() < 1e-3, "{right_went} {left_went}");
    assert_eq!(left.fault(), None, "two things");

    let mut rig = Rig::new();
    // Hanging straight down, the left arm could not follow: its elbow is bent first.
    let (elbow, ..) = rig.limit_and("elbow_l");
    let lease = rig.lease("left_arm");
    let place = rig.model.limb("left_arm").iter().position(|&j| j == elbow).unwrap();
    let mut bend = [0.0; 7];
    bend[place] = -0.8;
    rig.command(&lease, &bend, 1000);
    drop(lease);
    rig.run(300, |_| Vector3::zeros());
    let left = hold(&rig, ["tray", "tray"]);
    let right = rig.lease("right_arm");
    let [right_went, left_went] = gone(&mut rig, push);
    assert!(right_went.y > 0.02, "{right_went}");
    assert!((left_went - right_went).norm() < 0.25 * right_went.norm(), "{right_went} {left_went}");
    assert!(matches!(left.fault(), Some(Fault::Force { .. })), "{:?}", left.fault());
    assert!(matches!(right.fault(), Some(Fault::Force { .. })), "{:?}", right.fault());
}
