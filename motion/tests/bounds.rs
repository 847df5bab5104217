//! For any finite input, every primitive and law stays finite and within its limits. Invalid input is refused by
//! name and changes nothing.

use armarium_motion::{
    AdaptiveOscillator, Admittance, AdmittanceConfig, CoachConfig, CoachInput, CoachedMotion, DiscreteDmp,
    DiscreteDmpConfig, DiscretePeriodicConfig, DiscretePeriodicDmp, LearningControl, LearningControlConfig,
    MotionError, OscillatorConfig, OscillatorRule, PeriodicDmp, PeriodicDmpConfig, PhaseSample,
    PositionServo, ServoConfig, ServoObservation, SurfaceAdaptation, SurfaceConfig, Synchronisation,
    SynchronisationConfig, TimeSample,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};
use proptest::prelude::*;

/// Numbers of every magnitude and sign, including 0 and the largest.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        3 => -10.0..10.0_f64,
        2 => (-300.0..300.0_f64, prop::bool::ANY)
            .prop_map(|(e, minus)| if minus { -libm::pow(10.0_f64, e) } else { libm::pow(10.0_f64, e) }),
        1 => prop::sample::select(vec![0.0, -0.0, f64::MAX, f64::MIN, f64::MIN_POSITIVE]),
    ]
}

fn numbers(count: usize) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(any_number(), count)
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|v| v.is_finite())
}

proptest! {
    #[test]
    fn a_periodic_primitive_stays_finite(inputs in prop::collection::vec(numbers(6), 1..25)) {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::default()).unwrap();
        for n in inputs {
            let _ = dmp.couple(&n[..1]);
            let _ = dmp.perturb(&n[1..2]);
            let _ = dmp.set_amplitude(n[2]);
            let _ = dmp.learn(n[3], n[4], n[5], &n[..1], &n[1..2], &n[2..3]);
            let _ = dmp.displace(n[0], n[3], &n[4..5]);
            let _ = dmp.reset(n[0], &n[1..2], &n[2..3], n[4]);
            let _ = dmp.step(n[5], n[4]);
            let s = dmp.state();
            prop_assert!(finite(s.y) && finite(dmp.weights()) && s.phase.is_finite(), "{dmp:?}");
        }
    }

    #[test]
    fn a_hand_that_is_led_stays_finite_and_within_its_speed(inputs in prop::collection::vec(numbers(10), 1..25)) {
        let config = AdmittanceConfig { shove: f64::MAX, ..AdmittanceConfig::default() };
        let mut law = Admittance::new(config.clone()).unwrap();
        for n in inputs {
            let wrench = Vector6::from_column_slice(&n[..6]);
            let _ = law.hold_to(&wrench);
            let Ok(step) = law.step(n[9], &wrench, &Vector3::new(n[6], n[7], n[8])) else { continue };
            prop_assert!(finite(step.twist.as_slice()) && finite(law.zero().as_slice()), "{law:?}");
            prop_assert!(step.twist.fixed_rows::<3>(0).norm() <= config.max_linear * (1.0 + 1e-9));
            prop_assert!((0.0..=config.most_damping).contains(&step.damping));
        }
    }

    #[test]
    fn a_discrete_primitive_stays_finite(inputs in prop::collection::vec(numbers(6), 1..25)) {
        let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::default()).unwrap();
        for n in inputs {
            let _ = dmp.couple(&n[..1]);
            let _ = dmp.perturb(&n[1..2]);
            let _ = dmp.set_goal(&n[2..3]);
            let _ = dmp.set_amplitude(n[3]);
            let _ = dmp.learn(n[3], n[4], n[5], &n[..1], &n[1..2], &n[2..3]);
            let _ = dmp.step(n[5], n[4]);
            prop_assert!(finite(dmp.state().y) && finite(dmp.weights()), "{dmp:?}");
        }
    }

    #[test]
    fn a_discrete_periodic_primitive_and_its_learning_stay_finite(
        inputs in prop::collection::vec(numbers(4), 2..20)
    ) {
        let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::default(), 6.0, 1.0).unwrap();
        let mut control = LearningControl::new(LearningControlConfig::default(), 1, 100).unwrap();
        for n in &inputs {
            let _ = control.step(&mut dmp, n[0], &n[1..2]);
            let _ = dmp.set_centre(&n[2..3]);
            let _ = dmp.step(n[3], n[0]);
            prop_assert!(finite(dmp.state().y), "{dmp:?}");
        }
        let _ = control.finish(&mut dmp);
        prop_assert!(finite(dmp.control_weights()));
    }

    #[test]
    fn an_oscillator_and_who_follows_it_stay_finite(
        inputs in prop::collection::vec(numbers(2), 1..40), rule in 0..3_usize, estimate in prop::bool::ANY
    ) {
        let rule = [
            OscillatorRule::Scaled,
            OscillatorRule::Paper { coupling: 15.0, learning: 2.0 },
            OscillatorRule::Bare { coupling: 11.5, learning: 1.5 },
        ][rule];
        let config = OscillatorConfig { rule, estimate, ..OscillatorConfig::default() };
        let mut oscillator = AdaptiveOscillator::new(config.clone()).unwrap();
        let primitive = PeriodicDmp::new(PeriodicDmpConfig::default()).unwrap();
        let mut both = Synchronisation::new(SynchronisationConfig::default(), config, primitive).unwrap();
        for n in inputs {
            let _ = oscillator.update(n[0], &n[1..]);
            let _ = both.step(n[0], &n[1..]);
            let [mut y, mut dy, mut ddy] = [[0.0]; 3];
            oscillator.signal(oscillator.phase(), &mut y, &mut dy, &mut ddy).unwrap();
            prop_assert!(finite(&[oscillator.phase(), oscillator.omega(), y[0], dy[0], ddy[0]]), "{oscillator:?}");
            prop_assert!(finite(both.primitive().state().y));
        }
    }

    #[test]
    fn a_coach_moves_no_farther_than_he_may(
        inputs in prop::collection::vec((numbers(5), 0..4_usize), 1..40)
    ) {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
        let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
        for (k, (n, kind)) in inputs.into_iter().enumerate() {
            let v = Vector3::new(n[0], n[1], n[2]);
            let input = match kind {
                0 => CoachInput::Push { force: v },
                1 => CoachInput::Attract { hand: v },
                2 => CoachInput::Repel { hand: v },
                _ => CoachInput::Shift { direction: v },
            };
            let _ = coach.step(&mut dmp, n[3], n[4], input);
            let _ = dmp.step(n[3], n[4]);
            prop_assert!(finite(dmp.weights()) && finite(dmp.state().y));
            // The whole path takes longer than all else here.
            if k % 4 > 0 {
                continue;
            }
            let path = dmp.steady_path(32).unwrap();
            prop_assert!(path.y.iter().flatten().all(|y| y.abs() < 40.0 * 0.2), "{:?}", path.y);
        }
    }

    #[test]
    fn force_adaptation_keeps_its_limits(inputs in prop::collection::vec(numbers(4), 1..60)) {
        let config = SurfaceConfig::default();
        let (most, fastest) = (2.0 * config.max_offset, config.max_speed);
        let mut adaptation = SurfaceAdaptation::new(config).unwrap();
        let mut last = 0.0;
        for (k, n) in inputs.iter().enumerate() {
            adaptation.set_feedback(k % 7 != 6);
            if let Ok(c) = adaptation.step(n[0], n[1], n[2], n[3]) {
                prop_assert!(c.velocity.abs() <= 1.000_001 * fastest && c.offset.abs() <= 1.000_001 * most);
                prop_assert!((c.offset - last).abs() <= fastest * n[0] * 1.000_001 + 1e-15);
                last = c.offset;
            }
        }
    }

    #[test]
    fn a_servo_keeps_its_limits(inputs in prop::collection::vec(numbers(7), 1..20)) {
        let config = ServoConfig { timeout: f64::MAX, ..ServoConfig::default() };
        let (linear, angular) = (config.max_linear, config.max_angular);
        let mut servo = PositionServo::new(config).unwrap();
        for n in inputs {
            let hand = Isometry3::from_parts(
                Vector3::new(n[1], n[2], n[3]).into(),
                UnitQuaternion::from_scaled_axis(Vector3::new(n[4], n[5], n[6])),
            );
            let seen = ServoObservation { hand, target: Isometry3::identity() };
            if let Ok(c) = servo.step(n[0], Some(&seen)) {
                prop_assert!(finite(c.linear.as_slice()) && c.linear.norm() <= linear * (1.0 + 1e-9), "{c:?}");
                prop_assert!(finite(c.angular.as_slice()) && c.angular.norm() <= angular * (1.0 + 1e-9));
            }
        }
    }
}

/// Checks that `act` is refused with `error` and leaves `state` unchanged.
fn refused<S: std::fmt::Debug, T: std::fmt::Debug + PartialEq>(
    state: &mut S,
    error: &MotionError,
    act: impl FnOnce(&mut S) -> Result<T, MotionError>,
) {
    let before = format!("{state:?}");
    assert_eq!(act(state).as_ref(), Err(error));
    assert_eq!(format!("{state:?}"), before);
}

const NONE: MotionError = MotionError::TooFew { what: "samples", needed: 2, got: 0 };
const ONE: MotionError = MotionError::TooFew { what: "samples", needed: 2, got: 1 };

fn infinite(what: &'static str) -> MotionError {
    MotionError::NotFinite { what }
}

fn size(what: &'static str, expected: usize, got: usize) -> MotionError {
    MotionError::Size { what, expected, got }
}

fn not_positive(value: f64) -> MotionError {
    MotionError::OutOfRange { what: "dt", value, low: f64::MIN_POSITIVE, high: f64::MAX }
}

/// The error for signals, whose samples may not be too far apart either.
fn no_sample_time(value: f64) -> MotionError {
    MotionError::OutOfRange { what: "dt", value, low: f64::MIN_POSITIVE, high: 1e6 }
}

#[test]
fn a_periodic_primitive_says_what_was_wrong() {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::default()).unwrap();
    let sample = |y: Vec<f64>| PhaseSample { phase: 0.0, y, dy: vec![0.0], ddy: vec![0.0] };
    refused(&mut dmp, &NONE, |d| d.learn_batch(&[]));
    refused(&mut dmp, &ONE, |d| d.learn_batch(&[sample(vec![1.0])]));
    refused(&mut dmp, &infinite("y"), |d| d.learn_batch(&[sample(vec![1.0]), sample(vec![f64::NAN])]));
    refused(&mut dmp, &size("y", 1, 2), |d| d.learn_batch(&[sample(vec![1.0]), sample(vec![1.0, 2.0])]));
    for dt in [0.0, -0.5] {
        refused(&mut dmp, &not_positive(dt), |d| d.step(dt, 3.0).map(|_| ()));
        refused(&mut dmp, &not_positive(dt), |d| d.learn(0.0, 3.0, dt, &[0.0], &[0.0], &[0.0]));
    }
    refused(&mut dmp, &infinite("dt"), |d| d.step(f64::INFINITY, 3.0).map(|_| ()));
    refused(&mut dmp, &infinite("ydd"), |d| d.learn(0.0, 3.0, 0.01, &[0.0], &[0.0], &[f64::NAN]));
    refused(&mut dmp, &size("coupling", 1, 2), |d| d.couple(&[0.0; 2]));
    refused(&mut dmp, &infinite("perturbation"), |d| d.perturb(&[f64::INFINITY]));
}

#[test]
fn a_discrete_primitive_says_what_was_wrong() {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::default()).unwrap();
    let sample = |t: f64, y: Vec<f64>| TimeSample { t, y, yd: vec![0.0], ydd: vec![0.0] };
    refused(&mut dmp, &NONE, |d| d.learn_batch(&[]));
    refused(&mut dmp, &ONE, |d| d.learn_batch(&[sample(0.0, vec![1.0])]));
    let bad = [sample(0.0, vec![1.0]), sample(1.0, vec![f64::NAN])];
    refused(&mut dmp, &infinite("y"), |d| d.learn_batch(&bad));
    let uneven = [sample(0.0, vec![1.0]), sample(1.0, vec![1.0, 2.0])];
    refused(&mut dmp, &size("y", 1, 2), |d| d.learn_batch(&uneven));
    for dt in [0.0, -0.5] {
        refused(&mut dmp, &not_positive(dt), |d| d.step(dt, 1.0).map(|_| ()));
    }
    refused(&mut dmp, &infinite("dt"), |d| d.step(f64::NAN, 1.0).map(|_| ()));
    refused(&mut dmp, &infinite("coupling"), |d| d.couple(&[f64::NAN]));
    refused(&mut dmp, &size("goal", 1, 0), |d| d.set_goal(&[]));
}

#[test]
fn laws_of_control_say_what_was_wrong() {
    let mut oscillator = AdaptiveOscillator::new(OscillatorConfig::default()).unwrap();
    oscillator.update(0.01, &[1.0]).unwrap();
    let mut surface = SurfaceAdaptation::new(SurfaceConfig::default()).unwrap();
    let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
    for dt in [0.0, -0.5] {
        refused(&mut oscillator, &no_sample_time(dt), |o| o.update(dt, &[0.0]));
        refused(&mut surface, &not_positive(dt), |s| s.step(dt, 0.0, 3.0, 1.0));
        refused(&mut servo, &not_positive(dt), |s| s.step(dt, None));
    }
    refused(&mut oscillator, &infinite("signal"), |o| o.update(0.01, &[f64::NAN]));
    refused(&mut oscillator, &size("signal", 1, 2), |o| o.update(0.01, &[0.0; 2]));
    refused(&mut oscillator, &infinite("dt"), |o| o.update(f64::INFINITY, &[0.0]));
    refused(&mut surface, &infinite("force"), |s| s.step(0.01, 0.0, 3.0, f64::NAN));
    refused(&mut surface, &infinite("phase"), |s| s.step(0.01, f64::INFINITY, 3.0, 1.0));
    let backwards = MotionError::OutOfRange { what: "omega", value: -3.0, low: 0.0, high: 1e4 };
    refused(&mut surface, &backwards, |s| s.step(0.01, 0.0, -3.0, 1.0));
    let hand = Isometry3::translation(f64::NAN, 0.0, 0.0);
    let seen = ServoObservation { hand, target: Isometry3::identity() };
    refused(&mut servo, &infinite("pose"), |s| s.step(0.01, Some(&seen)));
}
