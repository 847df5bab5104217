//! Tests the discrete primitive against closed forms and properties.

use super::*;
use crate::dmp::TimeSample;
use crate::{ObstacleAvoidance, PotentialField};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

/// From rest at `a` to rest at `b` in `duration` s, the fifth-order polynomial.
fn quintic(a: &[f64], b: &[f64], duration: f64, steps: usize) -> Vec<TimeSample> {
    let sample = |k: usize| {
        let s = k as f64 / steps as f64;
        let (h, v, w) = (
            s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s),
            30.0 * s * s * (1.0 - s).powi(2) / duration,
            60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (duration * duration),
        );
        let of = |f: f64| a.iter().zip(b).map(|(a, b)| f * (b - a)).collect::<Vec<_>>();
        let y = a.iter().zip(b).map(|(a, b)| a + h * (b - a)).collect();
        TimeSample { t: duration * s, y, yd: of(v), ydd: of(w) }
    };
    (0..=steps).map(sample).collect()
}

fn learned() -> (DiscreteDmp, Vec<TimeSample>) {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(2)).unwrap();
    let samples = quintic(&[0.0, 0.3], &[1.0, -0.2], 1.5, 300);
    assert_eq!(dmp.learn_batch(&samples).unwrap(), 1.5);
    (dmp, samples)
}

fn run(dmp: &mut DiscreteDmp, steps: usize, duration: f64) -> Vec<Vec<f64>> {
    (0..steps).map(|_| dmp.step(duration / steps as f64, duration).unwrap().y.to_vec()).collect()
}

fn worst(a: &[Vec<f64>], b: impl Iterator<Item = Vec<f64>>) -> f64 {
    let apart =
        |(a, b): (&Vec<f64>, Vec<f64>)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    a.iter().zip(b).map(apart).fold(0.0, f64::max)
}

#[test]
fn without_weights_it_is_the_critically_damped_oscillator() {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::default()).unwrap();
    dmp.set_goal(&[1.0]).unwrap();
    for k in 1..=100 {
        let y = dmp.step(0.02, 2.0).unwrap().y[0];
        let a = 24.0 * 0.01 * f64::from(k);
        assert!((y - (1.0 - (1.0 + a) * libm::exp(-a))).abs() < 1e-12);
    }
    assert!((dmp.progress() - 1.0).abs() < 1e-12);
}

#[test]
fn it_repeats_what_it_was_shown_at_any_speed_and_size() {
    let (mut dmp, samples) = learned();
    let shown = || samples.iter().skip(1).map(|s| s.y.clone());
    let path = run(&mut dmp, 300, 1.5);
    assert!(worst(&path, shown()) < 2e-3, "{}", worst(&path, shown()));
    dmp.begin(&[0.0, 0.3], &[0.0; 2], 6.0).unwrap();
    let slow = run(&mut dmp, 300, 6.0);
    assert!(worst(&slow, path.iter().cloned()) < 1e-12);
    let twice = |y: &[f64]| vec![2.0 * y[0], 2.0 * y[1]];
    dmp.set_goal(&twice(&[1.0, -0.2])).unwrap();
    dmp.set_amplitude(2.0).unwrap();
    dmp.begin(&[0.0, 0.6], &[0.0; 2], 1.5).unwrap();
    let large = run(&mut dmp, 300, 1.5);
    assert!(worst(&large, path.iter().map(|y| twice(y))) < 1e-12);
}

#[test]
fn it_ends_at_a_goal_that_was_moved_on_the_way() {
    let (mut dmp, _) = learned();
    run(&mut dmp, 100, 1.5);
    dmp.set_goal(&[0.5, 0.5]).unwrap();
    for _ in 0..20 {
        run(&mut dmp, 100, 1.5);
    }
    assert!(worst(&[dmp.state().y.to_vec()], std::iter::once(vec![0.5, 0.5])) < 1e-6);
}

#[test]
fn online_learning_comes_to_the_same_movement() {
    let (_, samples) = learned();
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(2)).unwrap();
    dmp.set_goal(&samples[300].y).unwrap();
    for s in samples.iter().cycle().take(20 * 301) {
        dmp.learn(s.t, 1.5, 0.005, &s.y, &s.yd, &s.ydd).unwrap();
    }
    dmp.begin(&samples[0].y, &[0.0; 2], 1.5).unwrap();
    let path = run(&mut dmp, 300, 1.5);
    assert!(worst(&path, samples.iter().skip(1).map(|s| s.y.clone())) < 0.03);
}

#[test]
fn a_point_to_point_movement_is_coached_where_the_hand_is_and_nowhere_else() {
    let config = DiscreteDmpConfig { alpha_z: 25.0, beta_z: 6.25, ..DiscreteDmpConfig::with_dofs(2) };
    let mut dmp = DiscreteDmp::new(config).unwrap();
    dmp.learn_batch(&quintic(&[0.0, 0.0], &[1.0, 0.0], 2.0, 200)).unwrap();
    let field = PotentialField { gamma: 100.0, eta: 40.0, r_m: 0.15, beta: -8.0 / std::f64::consts::PI };
    let (o, d) = ([0.5, -0.05], Vector2::y());
    let mut sums = Vec::new();
    let mut path = Vec::new();
    for _ in 0..25 {
        dmp.begin(&[0.0; 2], &[0.0; 2], 2.0).unwrap();
        path.clear();
        let mut sum = 0.0;
        for _ in 0..200 {
            let strength = field.strength(&o, dmp.state().y, dmp.state().yd);
            dmp.couple((strength * d).as_slice()).unwrap();
            path.push(dmp.step(0.01, 2.0).unwrap().y.to_vec());
            sum += strength;
        }
        sums.push(sum);
    }
    let height = |from: usize, to: usize| path[from..to].iter().map(|y| y[1].abs()).fold(0.0, f64::max);
    assert!(height(90, 130) > 0.08, "{}", height(90, 130));
    assert!(height(0, 50) < 1e-3, "{}", height(0, 50));
    run(&mut dmp, 200, 2.0);
    assert!(worst(&[dmp.state().y.to_vec()], std::iter::once(vec![1.0, 0.0])) < 1e-3);
    assert!(sums[24] < 0.5 * sums[0], "{} {}", sums[0], sums[24]);
}

#[test]
fn it_goes_around_an_obstacle_and_learns_nothing_from_it() {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(3)).unwrap();
    let straight = quintic(&[0.0; 3], &[1.0, 0.0, 0.0], 1.0, 400);
    dmp.learn_batch(&straight).unwrap();
    let weights = dmp.weights().to_vec();
    let o = Vector3::new(0.5, 0.02, 0.0);
    let avoid = ObstacleAvoidance { reach: 0.3, ..ObstacleAvoidance::default() };
    let mut nearest = f64::INFINITY;
    for _ in 0..800 {
        let state = dmp.state();
        let (x, v) = (Vector3::from_column_slice(state.y), Vector3::from_column_slice(state.yd));
        nearest = nearest.min((x - o).norm());
        dmp.perturb(avoid.coupling(&o, &x, &v).as_slice()).unwrap();
        dmp.step(0.0025, 1.0).unwrap();
    }
    assert!(nearest > 0.05, "{nearest}");
    assert!(worst(&[dmp.state().y.to_vec()], std::iter::once(vec![1.0, 0.0, 0.0])) < 1e-3);
    assert_eq!(dmp.weights(), weights);
}

#[test]
fn what_is_wrong_is_named_and_changes_nothing() {
    let (mut dmp, samples) = learned();
    let before = dmp.clone();
    assert!(matches!(dmp.step(0.0, 1.0), Err(MotionError::OutOfRange { what: "dt", .. })));
    assert!(matches!(dmp.step(0.01, f64::NAN), Err(MotionError::NotFinite { what: "duration" })));
    assert!(matches!(dmp.learn_batch(&samples[..1]), Err(MotionError::TooFew { needed: 2, got: 1, .. })));
    let backwards: Vec<_> = samples.iter().rev().cloned().collect();
    assert!(matches!(
        dmp.learn_batch(&backwards),
        Err(MotionError::OutOfRange { what: "time between samples", .. })
    ));
    assert!(matches!(dmp.couple(&[1.0]), Err(MotionError::Size { what: "coupling", expected: 2, got: 1 })));
    assert!(dmp.begin(&[0.0, f64::INFINITY], &[0.0; 2], 1.0).is_err());
    assert!(dmp.learn(-1.0, 1.0, 0.01, &[0.0; 2], &[0.0; 2], &[0.0; 2]).is_err());
    assert_eq!(dmp, before);
    let zero = DiscreteDmpConfig { kernels: 1, ..DiscreteDmpConfig::default() };
    assert!(matches!(DiscreteDmp::new(zero), Err(MotionError::OutOfRange { what: "kernels", .. })));
}

#[test]
fn it_is_saved_and_loaded() {
    let (dmp, _) = learned();
    let text = serde_json::to_string(&dmp).unwrap();
    let mut loaded: DiscreteDmp = serde_json::from_str(&text).unwrap();
    let mut dmp = dmp;
    assert_eq!(run(&mut loaded, 50, 1.5), run(&mut dmp, 50, 1.5));
    assert!(serde_json::from_str::<DiscreteDmp>(&text.replacen("0.3", "null", 1)).is_err());
}

proptest! {
    #[test]
    fn whatever_is_finite_leaves_it_finite_and_leads_to_the_goal(
        inputs in prop::collection::vec((-1e6..1e6_f64, -1e6..1e6_f64, 1e-4..0.5_f64, 0.1..10.0_f64), 1..60),
        goal in -1e3..1e3_f64,
    ) {
        let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::default()).unwrap();
        for (coupling, perturbation, dt, duration) in inputs {
            dmp.couple(&[coupling]).unwrap();
            dmp.perturb(&[perturbation]).unwrap();
            let before = dmp.state().y[0];
            let y = dmp.step(dt, duration).unwrap().y[0];
            prop_assert!(y.is_finite() && (y - before).abs() < 1e9);
        }
        dmp.set_goal(&[goal]).unwrap();
        for _ in 0..2000 {
            dmp.step(0.02, 1.0).unwrap();
        }
        prop_assert!((dmp.state().y[0] - goal).abs() < 1e-3, "{}", dmp.state().y[0]);
    }
}
