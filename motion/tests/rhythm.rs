//! On which signals the adaptive oscillator settles, how fast and how exactly; with and without an estimated start.

use std::f64::consts::TAU;

use armarium_motion::{AdaptiveOscillator, OscillatorConfig, OscillatorRule};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.001;

fn signal(kind: &str, p: f64, normal: f64) -> f64 {
    match kind {
        "sine" => libm::sin(p),
        "harmonics3" => 0.6 * libm::sin(p) + 0.3 * libm::cos(2.0 * p + 0.4) + 0.2 * libm::sin(3.0 * p + 1.1),
        "square" => libm::sin(p).signum(),
        "offset" => 0.5 + 0.5 * libm::sin(p),
        "noise" => libm::sin(p) + 0.2 * normal,
        "step" => 0.7 * libm::sin(p) + 0.3 * libm::sin(2.0 * p + 0.5),
        _ => 0.5 * libm::sin(p) + 0.87 * libm::sin(2.0 * p),
    }
}

/// Omega over time, Hz, for a signal whose frequency (Hz) is a function of time, at `seconds` of it.
fn follow(
    config: &OscillatorConfig,
    kind: &str,
    amplitude: f64,
    seconds: f64,
    hz: impl Fn(f64) -> f64,
) -> Vec<f64> {
    let mut oscillator = AdaptiveOscillator::new(config.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut phase = 0.0;
    (0..(seconds / DT) as usize)
        .map(|k| {
            let v = amplitude * signal(kind, phase, StandardNormal.sample(&mut rng));
            oscillator.update(DT, &[v]).unwrap();
            phase += TAU * hz(DT * k as f64) * DT;
            oscillator.omega() / TAU
        })
        .collect()
}

/// The time from which on the one-period mean stays within 1 %, s; `None` if it never does.
fn settled(omega: &[f64], f: f64) -> Option<f64> {
    let window = (1.0 / f / DT).round() as usize;
    let mut sum: f64 = omega[..window].iter().sum();
    let mut since = None;
    for k in window..omega.len() {
        let good = (sum / window as f64 / f - 1.0).abs() <= 0.01;
        since = if good { since.or(Some(k)) } else { None };
        sum += omega[k] - omega[k - window];
    }
    since.map(|k| k as f64 * DT)
}

const FREQUENCIES: [f64; 6] = [0.3, 0.5, 0.8, 1.3, 2.1, 3.0];
const KINDS: [&str; 6] = ["sine", "harmonics3", "square", "offset", "noise", "eight"];

/// Periods until settled, within 30 of them.
fn periods(config: &OscillatorConfig, kind: &str, amplitude: f64, f: f64) -> f64 {
    let omega = follow(config, kind, amplitude, 30.0 / f, |_| f);
    settled(&omega, f).map_or(f64::INFINITY, |s| s * f)
}

fn bare() -> OscillatorConfig {
    let rule = OscillatorRule::Bare { coupling: 11.5, learning: 1.5 };
    OscillatorConfig { estimate: false, rule, ..OscillatorConfig::default() }
}

#[test]
fn with_an_estimated_start_every_signal_settles_within_eight_periods() {
    for f in FREQUENCIES {
        for kind in KINDS {
            let periods = periods(&OscillatorConfig::default(), kind, 1.0, f);
            assert!(periods < 8.0, "{kind} {f} Hz: {periods}");
        }
        for amplitude in [0.1, 5.0] {
            let periods = periods(&OscillatorConfig::default(), "harmonics3", amplitude, f);
            assert!(periods < 8.0, "amplitude {amplitude}, {f} Hz: {periods}");
        }
    }
}

#[test]
fn the_bare_oscillator_has_a_basin_about_its_start() {
    for f in [0.5, 0.7, 1.0, 1.3] {
        assert!(periods(&bare(), "sine", 1.0, f) < 8.0, "{f}");
        let small = periods(&bare(), "harmonics3", 0.1, f);
        assert!((small - periods(&bare(), "harmonics3", 5.0, f)).abs() < 0.01 && small < 9.0, "{f}: {small}");
    }
    for f in [0.3, 3.0] {
        assert!(periods(&bare(), "sine", 1.0, f) > 8.0, "{f}");
    }
}

#[test]
fn steps_and_chirps_are_followed() {
    let omega = follow(&OscillatorConfig::default(), "step", 1.0, 60.0, |t| if t < 30.0 { 1.0 } else { 1.6 });
    assert!(settled(&omega[..30_000], 1.0).unwrap() < 8.0);
    assert!(settled(&omega[30_000..], 1.6).unwrap() < 5.0);
    let hz = |t: f64| 0.8 + 0.8 * ((t - 10.0) / 40.0).clamp(0.0, 1.0);
    let omega = follow(&OscillatorConfig::default(), "sine", 1.0, 60.0, hz);
    for (k, omega) in omega.iter().enumerate().skip(5000) {
        let truth = hz(DT * k as f64);
        let largest = if k < 18_000 { 0.06 } else { 0.015 };
        assert!((omega / truth - 1.0).abs() < largest, "{k}: {omega} {truth}");
    }
    assert!((omega[59_999] / 1.6 - 1.0).abs() < 1e-3);
}
