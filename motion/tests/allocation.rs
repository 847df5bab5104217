//! No control step allocates: checked by a counting allocator.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use armarium_motion::{
    AdaptiveOscillator, Admittance, AdmittanceConfig, CoachArm, CoachConfig, CoachInput, CoachedMotion,
    DiscreteDmp, DiscreteDmpConfig, DiscreteOrientationDmp, DiscretePeriodicConfig, DiscretePeriodicDmp,
    FeedbackError, FrictionConfig, FrictionModel, LearningControl, LearningControlConfig, MotionEdit,
    ObstacleAvoidance, OscillatorConfig, PeriodicDmp, PeriodicDmpConfig, PeriodicOrientationDmp,
    PositionServo, PotentialField, ServoConfig, ServoObservation, SurfaceAdaptation, SurfaceConfig,
    Synchronisation, SynchronisationConfig, Touchdown, TouchdownConfig, joint_coupling, nearer_hand,
};
use nalgebra::{Isometry3, Vector3, Vector6};

fn allocations(mut step: impl FnMut()) -> u64 {
    step();
    allocations_from_start(step)
}

fn allocations_from_start(mut step: impl FnMut()) -> u64 {
    allocation_counter::measure(|| (0..4000).for_each(|_| step())).count_total
}

#[test]
fn steps_do_not_allocate() {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(7)).unwrap();
    let n = allocations(|| {
        dmp.couple(&[0.01; 7]).unwrap();
        dmp.perturb(&[0.01; 7]).unwrap();
        dmp.learn(1.0, 3.0, 0.001, &[0.1; 7], &[0.0; 7], &[0.0; 7]).unwrap();
        dmp.step(0.001, 3.0).unwrap();
    });
    assert_eq!(n, 0, "primitive");

    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
    let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
    let mut k = 0;
    let n = allocations(|| {
        let hand = Vector3::new(0.1, 0.0, 0.0);
        let input = match k % 5 {
            0 => CoachInput::None,
            1 => CoachInput::Push { force: Vector3::new(10.0, 0.0, 0.0) },
            2 => CoachInput::Attract { hand },
            3 => CoachInput::Repel { hand },
            _ => CoachInput::Shift { direction: hand },
        };
        k += 1;
        coach.step(&mut dmp, 0.001, 3.0, input).unwrap();
        dmp.step(0.001, 3.0).unwrap();
    });
    assert_eq!(n, 0, "coach");

    let mut turning = PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).unwrap();
    let mut reaching = DiscreteOrientationDmp::new(DiscreteDmpConfig::default()).unwrap();
    let n = allocations(|| {
        turning.step(0.001, 3.0).unwrap();
        reaching.step(0.001, 2.0).unwrap();
    });
    assert_eq!(n, 0, "orientations");

    let (mut edit, before) = (MotionEdit::none(&dmp), dmp.clone());
    let n = allocations(|| {
        dmp.displace(0.3, 0.001, &[0.01; 3]).unwrap();
        edit.add_difference(before.weights(), before.centre(), &dmp).unwrap();
        edit.apply(&mut dmp).unwrap();
        edit.clear();
        dmp.set_weights(before.weights()).unwrap();
    });
    assert_eq!(n, 0, "edits");

    let mut surface = SurfaceAdaptation::new(SurfaceConfig::default()).unwrap();
    let mut phase = 0.0;
    let n = allocations(|| {
        phase += 0.1;
        surface.step(0.005, phase, 20.0, 7.0).unwrap();
    });
    assert_eq!(n, 0, "surface");

    let mut friction = FrictionModel::new(FrictionConfig::default()).unwrap();
    let mut touchdown = Touchdown::new(TouchdownConfig::default()).unwrap();
    let n = allocations(|| {
        friction.step(0.001, 8.0, [0.1, 0.0], [3.0, 0.0]).unwrap();
        touchdown.step(0.001, 2.0).unwrap();
    });
    assert_eq!(n, 0, "friction and touchdown");

    let mut led = Admittance::new(AdmittanceConfig::default()).unwrap();
    let n = allocations(|| {
        led.step(0.001, &Vector6::repeat(5.0), &Vector3::zeros()).unwrap();
        led.hold_to(&Vector6::repeat(0.01)).unwrap();
    });
    assert_eq!(n, 0, "guiding");
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

#[test]
fn steps_that_follow_a_signal_do_not_allocate_even_when_the_oscillator_starts() {
    let mut oscillator = AdaptiveOscillator::new(OscillatorConfig::with_dims(2)).unwrap();
    let mut phase = 0.0_f64;
    let n = allocations_from_start(|| {
        phase += 0.02;
        oscillator.update(0.004, &[libm::sin(phase), 0.3 * libm::cos(2.0 * phase)]).unwrap();
    });
    assert_eq!((n, oscillator.starts()), (0, 1), "oscillator");

    let primitive = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(7)).unwrap();
    let config = SynchronisationConfig::default();
    let mut system = Synchronisation::new(config, OscillatorConfig::default(), primitive).unwrap();
    let n = allocations_from_start(|| {
        phase += 0.02;
        system.step(0.004, &[libm::sin(phase)]).unwrap();
    });
    assert_eq!((n, system.oscillator().starts()), (0, 1), "synchronisation");

    let config = DiscretePeriodicConfig::with_dofs(4);
    let mut dmp = DiscretePeriodicDmp::new(config, 6.0, 1.0).unwrap();
    let mut control = LearningControl::new(LearningControlConfig::default(), 4, 4000).unwrap();
    let columns = [0, 1, 2, 3].map(|i| Vector6::ith(i, 1.0));
    let (wrench, twist) = (Vector6::repeat(0.1), Vector6::repeat(0.01));
    let n = allocations_from_start(|| {
        let mut error = [0.0; 4];
        FeedbackError::default().in_joint_space(&columns, &wrench, &twist, &mut error).unwrap();
        control.step(&mut dmp, 6.0, &error).unwrap();
        dmp.step(0.001, 6.0).unwrap();
    });
    assert_eq!(n, 0, "learning control");
}
