//! Tests the discrete-periodic primitive against its demonstration, closed forms and properties.

use super::*;
use crate::TimeSample;
use proptest::prelude::*;
use std::sync::LazyLock;

const OMEGA: f64 = 2.0 * TAU;
const C: [f64; 2] = [1.0, -0.5];
const A: [f64; 2] = [0.3, 0.2];
const B: [f64; 2] = [0.1, -0.08];

fn periodic(t: f64) -> TimeSample {
    let p = OMEGA * t;
    let of = |f: &dyn Fn(usize) -> f64| vec![f(0), f(1)];
    TimeSample {
        t,
        y: of(&|d| C[d] + A[d] * libm::sin(p) + B[d] * libm::cos(2.0 * p)),
        yd: of(&|d| OMEGA * (A[d] * libm::cos(p) - 2.0 * B[d] * libm::sin(2.0 * p))),
        ydd: of(&|d| OMEGA * OMEGA * (-A[d] * libm::sin(p) - 4.0 * B[d] * libm::cos(2.0 * p))),
    }
}

/// From rest in 0 to the periodic motion in 1 s, in the Hermite form of the fifth-order polynomial.
fn demonstration(t: f64) -> TimeSample {
    if t >= 1.0 {
        return TimeSample { t, ..periodic(t - 1.0) };
    }
    let end = periodic(0.0);
    let powers = |k: i32| [t.powi(k), f64::from(k) * t.powi(k - 1), f64::from(k * (k - 1)) * t.powi(k - 2)];
    let (p3, p4, p5) = (powers(3), powers(4), powers(5));
    let of = |i: usize| -> Vec<f64> {
        let value = |d: usize| {
            let (y, v, a) = (end.y[d], end.yd[d], end.ydd[d]);
            let c3 = 10.0 * y - 4.0 * v + 0.5 * a;
            let c4 = -15.0 * y + 7.0 * v - a;
            let c5 = 6.0 * y - 3.0 * v + 0.5 * a;
            c3 * p3[i] + c4 * p4[i] + c5 * p5[i]
        };
        vec![value(0), value(1)]
    };
    TimeSample { t, y: of(0), yd: of(1), ydd: of(2) }
}

fn learned(rule: CanonicalRule) -> DiscretePeriodicDmp {
    let canonical = CanonicalSystem { rule, ..CanonicalSystem::default() };
    let config = DiscretePeriodicConfig { canonical, ..DiscretePeriodicConfig::with_dofs(2) };
    let mut dmp = DiscretePeriodicDmp::new(config, OMEGA, 1.0).unwrap();
    let samples: Vec<TimeSample> = (0..=3000).map(|k| demonstration(0.001 * f64::from(k))).collect();
    dmp.learn(&samples).unwrap();
    dmp
}

/// Root mean square error over the range, worst degree of freedom, for a replay at `omega`.
fn replay(dmp: &mut DiscretePeriodicDmp, omega: f64, dt: f64) -> f64 {
    dmp.restart();
    let steps = (dmp.length(4.0, omega) / dt).round() as usize;
    let mut sums = [0.0; 2];
    for k in 1..=steps {
        let state = dmp.step(dt, omega).unwrap();
        let wanted = demonstration(k as f64 * dt * omega / OMEGA);
        for ((sum, y), wanted) in sums.iter_mut().zip(state.y).zip(&wanted.y) {
            *sum += (y - wanted).powi(2) / steps as f64;
        }
    }
    let range = [1.45, 0.75];
    (0..2).map(|d| sums[d].sqrt() / range[d]).fold(0.0, f64::max)
}

#[test]
fn it_repeats_the_demonstration_and_only_the_modified_phase_lets_it_scale() {
    let mut modified = learned(CanonicalRule::Modified);
    let mut original = learned(CanonicalRule::Original);
    for dmp in [&mut modified, &mut original] {
        let error = replay(dmp, OMEGA, 0.001);
        assert!(error < 1e-3, "{error}");
    }
    for omega in [0.5 * OMEGA, 0.8 * OMEGA, 2.0 * OMEGA] {
        let error = replay(&mut modified, omega, 0.001);
        assert!(error < 1e-3, "{omega}: {error}");
    }
    assert!(replay(&mut original, 0.5 * OMEGA, 0.001) > 0.15);
    assert!(replay(&mut original, 2.0 * OMEGA, 0.001) > 0.15);
}

#[test]
fn wide_steps_stay_on_the_path() {
    let mut dmp = learned(CanonicalRule::Modified);
    let error = replay(&mut dmp, OMEGA, 0.02);
    assert!(error < 0.05, "{error}");
    for _ in 0..1000 {
        let state = dmp.step(5.0, OMEGA).unwrap();
        assert!(state.y.iter().all(|y| y.abs() < 3.0) && (state.radius - 1.0).abs() < 1e-6);
    }
}

#[test]
fn without_weights_it_is_the_critically_damped_oscillator() {
    let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::default(), 2.0, 1.0).unwrap();
    dmp.set_centre(&[1.0]).unwrap();
    for k in 1..=100 {
        let y = dmp.step(0.005, 2.0).unwrap().y[0];
        let a = 24.0 * 0.01 * f64::from(k);
        assert!((y - (1.0 - (1.0 + a) * libm::exp(-a))).abs() < 1e-12);
    }
}

#[test]
fn a_constant_control_shifts_the_rest_by_its_share_and_scales_with_the_frequency() {
    // At rest in (12): Omega z = -u, and (1) leaves y = g + u / (Omega beta_z).
    let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::default(), 2.0, 1.0).unwrap();
    dmp.set_control_weights(&[0.6; 50]).unwrap();
    for omega in [2.0, 5.0] {
        dmp.restart();
        for _ in 0..4000 {
            dmp.step(0.01, omega).unwrap();
        }
        let state = dmp.state();
        assert!((state.y[0] - 0.6 / (2.0 * 12.0)).abs() < 1e-9, "{}", state.y[0]);
        assert!(state.yd[0].abs() < 1e-9);
    }
    let mut given = [0.0];
    dmp.control(5.0, &mut given).unwrap();
    assert!((given[0] - 1.5).abs() < 1e-12);
}

#[test]
fn a_correction_holds_for_one_step() {
    let mut dmp = learned(CanonicalRule::Modified);
    let mut plain = dmp.clone();
    dmp.correct(&[1.0, -2.0]).unwrap();
    let (a, b) = (dmp.step(1e-4, OMEGA).unwrap().y.to_vec(), plain.step(1e-4, OMEGA).unwrap().y.to_vec());
    assert!((a[0] - b[0] - 1e-4).abs() < 2e-6 && (a[1] - b[1] + 2e-4).abs() < 4e-6);
    for _ in 0..4000 {
        dmp.step(1e-3, OMEGA).unwrap();
        plain.step(1e-3, OMEGA).unwrap();
    }
    assert!((dmp.state().y[0] - plain.state().y[0]).abs() < 1e-9);
}

#[test]
fn position_and_velocity_belong_together_across_the_transition() {
    let mut dmp = learned(CanonicalRule::Modified);
    let dt = 1e-4;
    let (mut y, mut v) = (dmp.state().y[0], dmp.state().yd[0]);
    for _ in 0..12_000 {
        let state = dmp.step(dt, OMEGA).unwrap();
        assert!(((state.y[0] - y) / dt - 0.5 * (state.yd[0] + v)).abs() < 1e-3);
        (y, v) = (state.y[0], state.yd[0]);
    }
    assert!(dmp.state().phase > 0.0);
}

#[test]
fn it_is_saved_and_read_back() {
    let mut dmp = learned(CanonicalRule::Modified);
    dmp.set_control_weights(&[0.1; 100]).unwrap();
    dmp.restart();
    let text = serde_json::to_string(&dmp).unwrap();
    let mut read: DiscretePeriodicDmp = serde_json::from_str(&text).unwrap();
    // The text format may change the last digit.
    for _ in 0..200 {
        let (a, b) = (read.step(0.01, 3.0).unwrap(), dmp.step(0.01, 3.0).unwrap());
        assert!((a.y[0] - b.y[0]).abs() < 1e-9 && (a.yd[1] - b.yd[1]).abs() < 1e-9);
    }
    let broken = text.replace("\"omega\":", "\"omega\":-");
    assert!(serde_json::from_str::<DiscretePeriodicDmp>(&broken).is_err());
}

#[test]
fn derivatives_of_a_cubic_are_met() {
    let of = |t: f64| 1.0 + t - 2.0 * t * t + 0.5 * t * t * t;
    let positions: Vec<Vec<f64>> = (0..20).map(|k| vec![of(0.1 * f64::from(k))]).collect();
    for (k, s) in differentiate(0.1, &positions).unwrap().iter().enumerate() {
        let t = 0.1 * k as f64;
        assert!((s.ydd[0] - (3.0 * t - 4.0)).abs() < 1e-9);
        // The second-order error: a sixth (a third at the ends) of dt^2 times the third derivative.
        assert!((s.yd[0] - (1.0 - 4.0 * t + 1.5 * t * t)).abs() < 1.01e-2);
    }
    for (dt, positions) in [(0.0, positions.clone()), (f64::NAN, positions.clone()), (0.1, Vec::new())] {
        assert!(differentiate(dt, &positions).is_err());
    }
    assert!(differentiate(0.1, &[vec![0.0], vec![0.0], vec![0.0, 1.0], vec![0.0]]).is_err());
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut dmp = learned(CanonicalRule::Modified);
    for _ in 0..10 {
        dmp.step(0.01, OMEGA).unwrap();
    }
    dmp.correct(&[0.1, 0.2]).unwrap();
    let before = dmp.clone();
    for (dt, omega) in
        [(0.0, 1.0), (-0.1, 1.0), (f64::NAN, 1.0), (0.01, f64::NAN), (0.01, -1.0), (f64::INFINITY, 1.0)]
    {
        assert!(dmp.step(dt, omega).is_err());
    }
    assert!(dmp.set_weights(&[0.0]).is_err());
    assert!(dmp.set_control_weights(&[f64::NAN; 100]).is_err());
    assert!(dmp.set_centre(&[0.0]).is_err());
    assert!(dmp.correct(&[0.0]).is_err());
    assert!(dmp.control(1.0, &mut [0.0]).is_err());
    let one = demonstration(0.0);
    assert_eq!(dmp.learn(&[]), Err(MotionError::TooFew { what: "samples", needed: 2, got: 0 }));
    assert_eq!(
        dmp.learn(std::slice::from_ref(&one)),
        Err(MotionError::TooFew { what: "samples", needed: 2, got: 1 })
    );
    assert!(dmp.learn(&[one.clone(), one.clone()]).is_err());
    let short: Vec<TimeSample> = (0..50).map(|k| demonstration(0.01 * f64::from(k))).collect();
    assert!(matches!(
        dmp.learn(&short),
        Err(MotionError::TooFew { what: "samples of the periodic part", .. })
    ));
    let mut bad = short;
    bad.extend((100..200).map(|k| demonstration(0.01 * f64::from(k))));
    bad[3].yd[1] = f64::NAN;
    assert!(dmp.learn(&bad).is_err());
    bad[3].yd.pop();
    assert!(matches!(dmp.learn(&bad), Err(MotionError::Size { what: "yd", expected: 2, got: 1 })));
    assert_eq!(dmp, before);
    let config = DiscretePeriodicConfig::default();
    for (omega, duration) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, -1.0), (1.0, f64::INFINITY)] {
        assert!(DiscretePeriodicDmp::new(config.clone(), omega, duration).is_err());
    }
    let inverted = CanonicalSystem { mu2: 1.1, ..CanonicalSystem::default() };
    assert!(
        DiscretePeriodicDmp::new(DiscretePeriodicConfig { canonical: inverted, ..config.clone() }, 1.0, 1.0)
            .is_err()
    );
    assert!(
        DiscretePeriodicDmp::new(DiscretePeriodicConfig { periodic_kernels: 1, ..config }, 1.0, 1.0).is_err()
    );
}

#[test]
fn amplitudes_scale() {
    let mut one = learned(CanonicalRule::Modified);
    for scale in [0.1, 4.0] {
        let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::with_dofs(2), OMEGA, 1.0).unwrap();
        let scaled = |k: i32| {
            let s = demonstration(0.001 * f64::from(k));
            let by = |v: Vec<f64>| v.iter().map(|v| v * scale).collect();
            TimeSample { t: s.t, y: by(s.y), yd: by(s.yd), ydd: by(s.ydd) }
        };
        dmp.learn(&(0..=3000).map(scaled).collect::<Vec<_>>()).unwrap();
        one.restart();
        for _ in 0..300 {
            let a = dmp.step(0.005, OMEGA).unwrap().y[0];
            let b = one.step(0.005, OMEGA).unwrap().y[0];
            assert!((a - scale * b).abs() < 1e-6 * scale);
        }
    }
}

/// The canonical systems with both rules, learned once.
fn both() -> [DiscretePeriodicDmp; 2] {
    static LEARNED: LazyLock<[DiscretePeriodicDmp; 2]> =
        LazyLock::new(|| [CanonicalRule::Modified, CanonicalRule::Original].map(learned));
    LEARNED.clone()
}

proptest! {
    #[test]
    fn any_finite_input_stays_finite(
        inputs in prop::collection::vec((-1e30..1e30_f64, 1e-9..1e6_f64, 0.0..1e6_f64), 1..20)
    ) {
        for mut dmp in both() {
            for (u, dt, omega) in &inputs {
                let _ = dmp.correct(&[*u, 0.0]);
                let _ = dmp.step(*dt, *omega);
                prop_assert!(dmp.state().y.iter().chain(dmp.state().yd).all(|y| y.is_finite()));
            }
        }
    }
}
