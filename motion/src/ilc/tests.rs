//! Learning from epoch to epoch, on models with a known result.

use super::*;
use crate::{DiscretePeriodicConfig, TimeSample};
use nalgebra::{Vector2, Vector3};
use std::f64::consts::TAU;

const OMEGA: f64 = TAU;
const DT: f64 = 0.004;

/// A smooth rise over 1 s to an oscillation of `a` at phase `lead`.
fn wave(t: f64, lift: f64, a: f64, lead: f64) -> f64 {
    let s = (t / 1.0).clamp(0.0, 1.0);
    let rise = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
    rise * (lift + a * libm::sin(OMEGA * (t - 1.0) + lead))
}

fn samples(of: impl Fn(f64) -> Vec<f64>) -> Vec<TimeSample> {
    let positions: Vec<Vec<f64>> = (0..=1000).map(|k| of(DT * f64::from(k))).collect();
    crate::differentiate(DT, &positions).unwrap()
}

fn primitive() -> DiscretePeriodicDmp {
    let config = DiscretePeriodicConfig { alpha_z: 8.0, beta_z: 2.0, ..DiscretePeriodicConfig::with_dofs(2) };
    let mut dmp = DiscretePeriodicDmp::new(config, OMEGA, 1.0).unwrap();
    dmp.learn(&samples(|t| vec![wave(t, 0.08, 0.02, 0.6), 0.1])).unwrap();
    dmp
}

fn target(t: f64) -> [f64; 2] {
    [wave(t, 0.15, 0.04, 0.0), 0.1]
}

/// Runs one epoch of the discrete part and three periods with the error `500 N/m x k1` and returns its RMS error.
fn epoch(
    ilc: &mut LearningControl,
    dmp: &mut DiscretePeriodicDmp,
    omega: f64,
    gains: FeedbackError,
) -> [f64; 2] {
    dmp.restart();
    let dt = DT * OMEGA / omega;
    let (mut all, mut discrete) = (0.0, 0.0);
    let mut last = [0.0; 2];
    for k in 0..1000 {
        let wanted = target(DT * f64::from(k));
        let y = [dmp.state().y[0], dmp.state().y[1]];
        let wrench = [500.0 * (wanted[0] - y[0]), 500.0 * (wanted[1] - y[1])];
        let ahead = target(DT * f64::from(k + 1));
        let twist = [(ahead[0] - wanted[0]) / dt - last[0], (ahead[1] - wanted[1]) / dt - last[1]];
        let mut e = [0.0; 2];
        gains.in_task_space(&wrench, &twist, &mut e).unwrap();
        ilc.step(dmp, omega, &e).unwrap();
        let state = dmp.step(dt, omega).unwrap();
        last.copy_from_slice(state.yd);
        all += (wanted[0] - y[0]).powi(2) / 1000.0;
        discrete += if k < 250 { (wanted[0] - y[0]).powi(2) / 250.0 } else { 0.0 };
    }
    ilc.finish(dmp).unwrap();
    [all.sqrt(), discrete.sqrt()]
}

#[test]
fn the_error_falls_exponentially_in_both_parts_and_faster_with_velocities() {
    let run = |gains: FeedbackError| -> Vec<[f64; 2]> {
        let mut dmp = primitive();
        let mut ilc = LearningControl::new(LearningControlConfig::default(), 2, 1000).unwrap();
        let errors = (0..8).map(|_| epoch(&mut ilc, &mut dmp, OMEGA, gains)).collect();
        assert_eq!(ilc.epochs(), 8);
        errors
    };
    let forces = run(FeedbackError { k1: 0.03, k2: 0.0, ..FeedbackError::default() });
    let both = run(FeedbackError { k1: 0.03, k2: 1.0, ..FeedbackError::default() });
    for part in 0..2 {
        for pair in forces.windows(2).take(4) {
            assert!(pair[1][part] < 0.7 * pair[0][part], "{forces:?}");
        }
        assert!(forces[7][part] < 0.02 * forces[0][part], "{forces:?}");
    }
    assert!(both[1][1] < forces[1][1] && both[2][1] < forces[2][1], "{both:?} {forces:?}");
}

#[test]
fn what_was_learned_holds_at_another_frequency() {
    let gains = FeedbackError { k1: 0.03, k2: 0.0, ..FeedbackError::default() };
    let mut dmp = primitive();
    let mut ilc = LearningControl::new(LearningControlConfig::default(), 2, 1000).unwrap();
    let before = epoch(&mut ilc, &mut dmp, OMEGA, gains)[0];
    for _ in 0..9 {
        epoch(&mut ilc, &mut dmp, OMEGA, gains);
    }
    let nothing = LearningControlConfig { q: 1.0, l: 0.0, c: 0.0 };
    for omega in [0.5 * OMEGA, OMEGA, 1.7 * OMEGA] {
        let mut only_watching = LearningControl::new(nothing, 2, 1000).unwrap();
        let error = epoch(&mut only_watching, &mut dmp.clone(), omega, gains)[0];
        assert!(error < 0.02 * before, "{omega}: {error} of {before}");
    }
}

#[test]
fn without_an_error_nothing_is_learned_and_q_forgets() {
    let mut dmp = primitive();
    dmp.set_control_weights(&[0.4; 100]).unwrap();
    let mut ilc =
        LearningControl::new(LearningControlConfig { q: 0.5, ..Default::default() }, 2, 1000).unwrap();
    dmp.restart();
    for _ in 0..1000 {
        ilc.step(&mut dmp, OMEGA, &[0.0; 2]).unwrap();
        dmp.step(DT, OMEGA).unwrap();
    }
    assert_eq!(ilc.samples(), 1000);
    ilc.finish(&mut dmp).unwrap();
    dmp.restart();
    let mut u = [0.0; 2];
    for _ in 0..1000 {
        dmp.control(OMEGA, &mut u).unwrap();
        assert!((u[0] - 0.2).abs() < 1e-6, "{u:?}");
        dmp.step(DT, OMEGA).unwrap();
    }
}

#[test]
fn the_joint_error_is_the_transpose_on_forces_and_the_pseudoinverse_on_velocities() {
    let columns = [Vector2::new(1.0, 0.5), Vector2::new(-0.2, 0.8), Vector2::new(0.3, 0.1)];
    let gains = FeedbackError { k1: 2.0, k2: 0.5, damping: 0.0 };
    let (force, velocity) = (Vector2::new(3.0, -1.0), Vector2::new(0.4, 0.2));
    let mut e = [0.0; 3];
    gains.in_joint_space(&columns, &force, &Vector2::zeros(), &mut e).unwrap();
    assert!((e[0] - 5.0).abs() < 1e-12 && (e[1] + 2.8).abs() < 1e-12 && (e[2] - 1.6).abs() < 1e-12);
    gains.in_joint_space(&columns, &Vector2::zeros(), &velocity, &mut e).unwrap();
    let reached: Vector2<f64> = columns.iter().zip(e).map(|(c, e)| c * e).sum();
    assert!((reached - 0.5 * velocity).norm() < 1e-12);
    // Six coordinates and two joints: with damping the result is the least-squares one.
    let tall = [nalgebra::Vector6::ith(0, 1.0), nalgebra::Vector6::ith(1, 2.0)];
    let damped = FeedbackError { damping: 1e-4, ..gains };
    let mut e = [0.0; 2];
    damped
        .in_joint_space(&tall, &nalgebra::Vector6::zeros(), &nalgebra::Vector6::repeat(1.0), &mut e)
        .unwrap();
    assert!((e[0] - 0.5).abs() < 1e-6 && (e[1] - 0.25).abs() < 1e-6, "{e:?}");
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut dmp = primitive();
    let mut ilc = LearningControl::new(LearningControlConfig::default(), 2, 3).unwrap();
    let before = dmp.clone();
    assert!(ilc.step(&mut dmp, OMEGA, &[0.0]).is_err());
    assert!(ilc.step(&mut dmp, OMEGA, &[f64::NAN, 0.0]).is_err());
    assert!(ilc.step(&mut dmp, 0.0, &[0.0; 2]).is_err());
    assert!(matches!(ilc.finish(&mut dmp), Err(MotionError::TooFew { .. })));
    assert_eq!(dmp, before);
    assert_eq!(ilc.samples(), 0);
    for _ in 0..3 {
        ilc.step(&mut dmp, OMEGA, &[0.1; 2]).unwrap();
    }
    assert!(ilc.step(&mut dmp, OMEGA, &[0.1; 2]).is_err());
    assert_eq!(ilc.samples(), 3);
    let mut other = DiscretePeriodicDmp::new(DiscretePeriodicConfig::default(), 1.0, 1.0).unwrap();
    assert!(ilc.finish(&mut other).is_err());
    ilc.abandon();
    assert_eq!((ilc.samples(), ilc.epochs()), (0, 0));
    for (config, dofs, samples) in [
        (LearningControlConfig { q: 1.5, ..Default::default() }, 2, 10),
        (LearningControlConfig { l: f64::NAN, ..Default::default() }, 2, 10),
        (LearningControlConfig::default(), 0, 10),
        (LearningControlConfig::default(), 2, 0),
    ] {
        assert!(LearningControl::new(config, dofs, samples).is_err());
    }
    let gains = FeedbackError::default();
    let mut e = [7.0; 2];
    assert!(gains.in_task_space(&[0.0], &[0.0; 2], &mut e).is_err());
    let columns = [Vector3::x(), Vector3::y()];
    let nan = Vector3::new(f64::NAN, 0.0, 0.0);
    assert!(gains.in_joint_space(&columns, &nan, &Vector3::zeros(), &mut e).is_err());
    assert!(gains.in_joint_space(&columns, &Vector3::x(), &Vector3::x(), &mut [0.0]).is_err());
    assert_eq!(e, [7.0; 2]);
}
