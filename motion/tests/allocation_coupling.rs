//! Steps of coached point-to-point movements and of servos do not allocate.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use armarium_motion::{
    CoachArm, DiscreteDmp, DiscreteDmpConfig, ObstacleAvoidance, PositionServo, PotentialField, ServoConfig,
    ServoObservation, joint_coupling, nearer_hand,
};
use nalgebra::{Isometry3, Vector3};

fn allocations(mut step: impl FnMut()) -> u64 {
    step();
    allocation_counter::measure(|| (0..2000).for_each(|_| step())).count_total
}

#[test]
fn a_coached_step_does_not_allocate() {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(7)).unwrap();
    dmp.set_goal(&[0.5; 7]).unwrap();
    let field = PotentialField::default();
    let avoid = ObstacleAvoidance::default();
    let columns = [0, 1, 2, 3, 4, 5, 6].map(|i| Vector3::new(f64::from(i), 1.0, f64::from(i * i)));
    let arm = CoachArm { wrist: Vector3::new(0.1, 0.2, 0.3), elbow: Vector3::new(0.1, 0.5, 0.3) };
    let n = allocations(|| {
        let (x, v) = (Vector3::new(0.1, 0.1, 0.2), Vector3::new(0.2, 0.3, 0.1));
        let command = nearer_hand(&arm, &arm, &x, 0.1).unwrap();
        let strength = field.strength(command.o.as_slice(), x.as_slice(), v.as_slice());
        let mut coupling = [0.0; 7];
        joint_coupling(&columns, &(strength * command.d), 0.01, &mut coupling).unwrap();
        dmp.couple(&coupling).unwrap();
        joint_coupling(&columns, &avoid.coupling(&command.o, &x, &v), 0.01, &mut coupling).unwrap();
        dmp.perturb(&coupling).unwrap();
        dmp.learn(0.5, 2.0, 0.001, &[0.1; 7], &[0.0; 7], &[0.0; 7]).unwrap();
        dmp.step(0.001, 2.0).unwrap();
    });
    assert_eq!(n, 0);
}

#[test]
fn a_servo_step_does_not_allocate() {
    let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
    let seen =
        ServoObservation { hand: Isometry3::translation(0.1, 0.0, 0.2), target: Isometry3::identity() };
    let n = allocations(|| {
        servo.step(0.001, Some(&seen)).unwrap();
    });
    assert_eq!(n, 0);
}
