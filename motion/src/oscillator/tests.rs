//! On which signals the oscillator settles, and how fast.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// The time from which on the one-period mean of Omega stays within 1 %, in periods.
fn settles_after(config: OscillatorConfig, f: f64, dt: f64, signal: impl Fn(f64, f64) -> Vec<f64>) -> f64 {
    let mut osc = AdaptiveOscillator::new(config).unwrap();
    let mut noise = ChaCha8Rng::seed_from_u64(3);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let steps = (16.0 / f / dt) as usize;
    let window = (1.0 / f / dt).round() as usize;
    let mut omegas = Vec::new();
    for k in 0..steps {
        let t = k as f64 * dt;
        osc.update(dt, &signal(TAU * f * t, normal.sample(&mut noise))).unwrap();
        omegas.push(if osc.running() { osc.omega() } else { 0.0 });
    }
    let good = |k: usize| {
        let mean = omegas[k + 1 - window..=k].iter().sum::<f64>() / window as f64;
        (mean / (TAU * f) - 1.0).abs() < 0.01
    };
    let last_bad = (window - 1..steps).rev().find(|k| !good(*k)).unwrap_or(0);
    last_bad as f64 * dt * f
}

fn shape(kind: &str, p: f64, n: f64) -> Vec<f64> {
    match kind {
        "sine" => vec![libm::sin(p)],
        "small" => vec![0.1 * libm::sin(p)],
        "large" => vec![5.0 * libm::sin(p) + 3.0],
        "harmonics3" => {
            vec![0.6 * libm::sin(p) + 0.3 * libm::cos(2.0 * p + 0.4) + 0.2 * libm::sin(3.0 * p + 1.1)]
        }
        "square" => vec![libm::sin(p).signum()],
        "offset" => vec![0.5 + 0.5 * libm::sin(p)],
        "noise" => vec![libm::sin(p) + 0.2 * n],
        "eight" => vec![0.5 * libm::sin(p) + 0.87 * libm::sin(2.0 * p)],
        "weak" => vec![0.2 * libm::sin(p) + 0.8 * libm::sin(2.0 * p + 0.3)],
        "plane" => vec![0.5 * libm::sin(p), 0.3 * libm::sin(2.0 * p), 1.0],
        _ => vec![
            0.4 * libm::sin(p) + 0.3 * libm::sin(2.0 * p),
            0.3 * libm::sin(p) - 0.3 * libm::sin(2.0 * p),
            0.0,
        ],
    }
}

#[test]
fn it_settles_within_eight_periods() {
    for kind in [
        "sine",
        "small",
        "large",
        "harmonics3",
        "square",
        "offset",
        "noise",
        "eight",
        "weak",
        "plane",
        "turned",
    ] {
        for f in [0.3, 0.5, 0.8, 1.3, 2.0, 3.0] {
            for dt in [0.001, 1.0 / 60.0] {
                let config = OscillatorConfig::with_dims(shape(kind, 0.0, 0.0).len());
                let periods = settles_after(config, f, dt, |p, n| shape(kind, p, n));
                println!("{kind} {f} {dt:.4}: {periods:.1}");
                assert!(periods < 8.0, "{kind} {f} Hz {dt} s: {periods}");
            }
        }
    }
}

#[test]
fn it_follows_a_step_of_frequency() {
    let mut osc = AdaptiveOscillator::new(OscillatorConfig::default()).unwrap();
    let mut phase = 0.0_f64;
    for k in 0..40_000 {
        let f = if k < 20_000 { 1.0 } else { 1.6 };
        phase += TAU * f * 0.001;
        osc.update(0.001, &[0.7 * libm::sin(phase) + 0.3 * libm::sin(2.0 * phase + 0.5)]).unwrap();
        if k == 20_000 + 5000 {
            assert!((osc.frequency_hz() / 1.6 - 1.0).abs() < 0.01, "{}", osc.frequency_hz());
        }
    }
    assert!((osc.frequency_hz() - 1.6).abs() < 0.002);
    assert!(osc.settled());
}

#[test]
fn the_bare_rule_has_its_basin() {
    let config = |coupling| OscillatorConfig {
        estimate: false,
        rule: OscillatorRule::Paper { coupling, learning: 2.0 },
        ..OscillatorConfig::default()
    };
    assert!(settles_after(config(15.0), 1.3, 0.001, |p, _| vec![libm::sin(p)]) < 8.0);
    assert!(settles_after(config(15.0), 0.3, 0.001, |p, _| vec![libm::sin(p)]) > 15.0);
}

#[test]
fn coordinates_keep_their_phases_while_the_frequency_is_found() {
    // The first periods are slower, like a coach's: the phase lags until the frequency is found.
    let (mut osc, dt) = (AdaptiveOscillator::new(OscillatorConfig::with_dims(2)).unwrap(), 1.0 / 15.0);
    let mut phase = 0.0_f64;
    for k in 0..450 {
        phase += TAU * dt * if k < 60 { 0.46 } else { 0.5 };
        osc.update(dt, &[0.05 * libm::cos(phase), 0.03 * libm::sin(phase)]).unwrap();
        if k % 30 == 0 && k >= 120 {
            let [x, y] = [0, 1].map(|d| {
                let (a, b) = osc.series.weight(d, 1);
                libm::atan2(b, a)
            });
            assert!(((y - x).rem_euclid(TAU) - TAU / 4.0).abs() < 0.02, "sample {k}: {x} {y}");
        }
    }
}
