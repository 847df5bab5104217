//! Learning, integration, modulation and refused input.

use super::*;
use crate::PhaseSample;
use proptest::prelude::*;

/// y = 0.2 + sin p + 0.3 cos 2p and its derivatives with respect to the phase.
fn wave(p: f64) -> [f64; 3] {
    let (s, c) = libm::sincos(p);
    let (s2, c2) = libm::sincos(2.0 * p);
    [0.2 + s + 0.3 * c2, c - 0.6 * s2, -s - 1.2 * c2]
}

fn learned() -> PeriodicDmp {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::default()).unwrap();
    let samples: Vec<PhaseSample> = (0..200)
        .map(|k| {
            let phase = TAU * f64::from(k) / 200.0;
            let [y, dy, ddy] = wave(phase);
            PhaseSample { phase, y: vec![y], dy: vec![dy], ddy: vec![ddy] }
        })
        .collect();
    dmp.learn_batch(&samples).unwrap();
    dmp
}

#[test]
fn batch_learning_meets_the_wave() {
    let dmp = learned();
    assert!((dmp.centre()[0] - 0.2).abs() < 1e-12);
    let path = dmp.steady_path(100).unwrap();
    let error = (0..100).map(|s| (path.y[s][0] - wave(path.phase(s))[0]).abs()).fold(0.0, f64::max);
    // The part that 25 kernels cannot express, for an amplitude of 1.3.
    assert!(error < 5e-4, "{error}");
}

#[test]
fn online_learning_meets_the_wave_at_any_sample_time() {
    for dt in [0.001, 0.01, 0.02] {
        for omega in [2.0, 6.0] {
            let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::default()).unwrap();
            dmp.set_centre(&[0.2]).unwrap();
            let mut phase = 0.0;
            for _ in 0..(60.0 / dt) as usize {
                let [y, dy, ddy] = wave(phase);
                dmp.learn(phase, omega, dt, &[y], &[dy * omega], &[ddy * omega * omega]).unwrap();
                phase += omega * dt;
            }
            let path = dmp.steady_path(100).unwrap();
            let error =
                (0..100).map(|s| (path.y[s][0] - wave(path.phase(s))[0]).powi(2)).sum::<f64>().sqrt() / 10.0;
            // The local regression smooths: a few percent of the second harmonic are lost.
            assert!(error < 0.04, "{dt} {omega}: {error}");
            dmp.sharpen();
            let path = dmp.steady_path(100).unwrap();
            let error = (0..100).map(|s| (path.y[s][0] - wave(path.phase(s))[0]).abs()).fold(0.0, f64::max);
            assert!(error < 0.003, "sharpened, {dt} {omega}: {error}");
        }
    }
}

#[test]
fn gain_reaches_its_fixed_point_and_its_cap() {
    let mut dmp = learned();
    let mut phase = 0.0;
    for _ in 0..60_000 {
        dmp.learn(phase, 3.0, 0.005, &[0.0], &[0.0], &[0.0]).unwrap();
        phase += 0.015;
    }
    let mean = dmp.learner.gain.iter().sum::<f64>() / 25.0;
    let mut settled = dmp.clone();
    settled.settle_gain(0.005).unwrap();
    assert!((settled.learner.gain[0] / mean - 1.0).abs() < 0.01, "{} {mean}", settled.learner.gain[0]);
    for _ in 0..200_000 {
        dmp.learn(0.0, 3.0, 0.01, &[0.0], &[0.0], &[0.0]).unwrap();
    }
    assert_eq!(dmp.learner.gain[12], 1.0);
}

#[test]
fn euler_and_exact_agree_for_small_steps() {
    let mut exact = learned();
    let mut euler =
        PeriodicDmp::new(PeriodicDmpConfig { integrator: Integrator::Euler, ..PeriodicDmpConfig::default() })
            .unwrap();
    euler.set_weights(exact.weights()).unwrap();
    euler.set_centre(exact.centre()).unwrap();
    exact.start_on_path(0.0, 3.0).unwrap();
    euler.start_on_path(0.0, 3.0).unwrap();
    for _ in 0..20_000 {
        let a = exact.step(1e-4, 3.0).unwrap().y[0];
        let b = euler.step(1e-4, 3.0).unwrap().y[0];
        assert!((a - b).abs() < 2e-3);
    }
    assert!(euler.step(0.16, 3.0).is_ok(), "alpha_z omega dt under 4 decays");
    assert!(matches!(euler.step(0.17, 3.0), Err(MotionError::OutOfRange { .. })));
}

#[test]
fn velocity_and_acceleration_are_the_derivatives() {
    let mut dmp = learned();
    dmp.start_on_path(0.0, 2.0).unwrap();
    let dt = 1e-4;
    let mut last = dmp.state().y[0];
    let mut last_v: Option<f64> = None;
    for _ in 0..5000 {
        let s = dmp.step(dt, 2.0).unwrap();
        let (y, v, a) = (s.y[0], s.yd[0], s.ydd[0]);
        assert!(((y - last) / dt - v).abs() < 1e-3);
        if let Some(old) = last_v {
            assert!(((v - old) / dt - a).abs() < 1e-2_f64.max(2e-3 * a.abs()), "{} {a}", (v - old) / dt);
        }
        (last, last_v) = (y, Some(v));
    }
}

#[test]
fn a_perturbation_passes_and_a_coupling_stays() {
    let mut dmp = learned();
    let before = dmp.steady_path(50).unwrap();
    dmp.start_on_path(0.0, 3.0).unwrap();
    for k in 0..6000 {
        if k < 1000 {
            dmp.perturb(&[4.0]).unwrap();
        }
        dmp.step(0.001, 3.0).unwrap();
    }
    assert_eq!(dmp.steady_path(50).unwrap(), before);
    dmp.settle_gain(0.001).unwrap();
    for _ in 0..4000 {
        dmp.couple(&[4.0]).unwrap();
        dmp.step(0.001, 3.0).unwrap();
    }
    let after = dmp.steady_path(50).unwrap();
    let shift = after.mean()[0] - before.mean()[0];
    // (1 - lambda) / 10 ms for 4 s, over alpha beta.
    assert!((shift / (4.0 * 0.05 * 4.0 / 16.0) - 1.0).abs() < 0.1, "{shift}");
}

#[test]
fn amplitude_and_frequency_scale_the_path() {
    let mut dmp = learned();
    let one = dmp.steady_path(60).unwrap();
    dmp.set_amplitude(0.5).unwrap();
    let half = dmp.steady_path(60).unwrap();
    for s in 0..60 {
        assert!((half.y[s][0] - 0.2 - 0.5 * (one.y[s][0] - 0.2)).abs() < 1e-12);
    }
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut dmp = learned();
    dmp.start_on_path(1.0, 3.0).unwrap();
    dmp.couple(&[1.0]).unwrap();
    let before = dmp.clone();
    for (dt, omega) in
        [(0.0, 1.0), (-0.1, 1.0), (f64::NAN, 1.0), (0.01, f64::INFINITY), (0.01, -1.0), (f64::INFINITY, 1.0)]
    {
        assert!(dmp.step(dt, omega).is_err());
    }
    assert!(dmp.set_weights(&[0.0]).is_err());
    assert!(dmp.set_weights(&[f64::NAN; 25]).is_err());
    assert!(dmp.set_centre(&[0.0, 1.0]).is_err());
    assert!(dmp.couple(&[f64::NAN]).is_err());
    assert!(dmp.perturb(&[]).is_err());
    assert!(dmp.learn(0.0, 0.0, 0.01, &[0.0], &[0.0], &[0.0]).is_err());
    assert!(dmp.learn(0.0, 1.0, 0.01, &[0.0], &[0.0, 0.0], &[0.0]).is_err());
    assert!(dmp.learn_batch(&[]).is_err());
    assert_eq!(dmp, before);
    for config in [
        PeriodicDmpConfig { dofs: 0, ..PeriodicDmpConfig::default() },
        PeriodicDmpConfig { kernels: 1, ..PeriodicDmpConfig::default() },
        PeriodicDmpConfig { alpha_z: f64::NAN, ..PeriodicDmpConfig::default() },
        PeriodicDmpConfig { forgetting: 0.0, ..PeriodicDmpConfig::default() },
    ] {
        assert!(PeriodicDmp::new(config).is_err());
    }
}

proptest! {
    #[test]
    fn a_shift_of_the_phase_shifts_the_path(start in 0.0..TAU, omega in 0.5..8.0_f64) {
        let mut dmp = learned();
        dmp.start_on_path(start, omega).unwrap();
        for _ in 0..100 {
            let s = dmp.step(0.003, omega).unwrap();
            prop_assert!((s.y[0] - wave(s.phase)[0]).abs() < 1e-3);
        }
    }
}

#[test]
fn a_step_that_is_refused_learns_nothing_and_the_coupling_waits() {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(1)).unwrap();
    dmp.set_weights(&[0.5; 25]).unwrap();
    let mut undisturbed = dmp.clone();
    dmp.couple(&[2.0]).unwrap();
    undisturbed.couple(&[2.0]).unwrap();
    dmp.dmp.transformation.put_slope(&[f64::MAX], &[-f64::MAX], TimeScale::Frequency(3.0));
    assert!(matches!(dmp.step(0.1, 3.0), Err(MotionError::NotFinite { .. })));
    assert_eq!(dmp.weights(), [0.5; 25]);
    assert_eq!(dmp.learner.gain, undisturbed.learner.gain);
    dmp.dmp.transformation.put_slope(&[0.0], &[0.0], TimeScale::Frequency(3.0));
    assert_eq!(dmp.step(0.1, 3.0), undisturbed.step(0.1, 3.0));
    assert_eq!(dmp.weights(), undisturbed.weights());
    assert_ne!(dmp.weights(), [0.5; 25]);
}
