//! A whole demonstration of a coach, as seen by a camera: rest, swipe, periodic part; noisy, jittery, at 15 Hz.

use std::f64::consts::TAU;

use armarium_motion::{DemonstrationSegmenter, DemonstrationStage, Imitation, SegmenterConfig};
use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

struct Coach {
    shape: &'static str,
    size: [f64; 2],
    frequency: f64,
    turned: f64,
    pause: f64,
    jitter: f64,
}

impl Coach {
    fn path(&self, phase: f64) -> Vector3<f64> {
        let (a, b) = (0.5 * self.size[0], 0.5 * self.size[1]);
        let (x, y) = match self.shape {
            "ellipse" => (a * libm::cos(phase), b * libm::sin(phase)),
            "eight" => (a * libm::sin(phase), b * libm::sin(2.0 * phase)),
            _ => (a * libm::sin(phase), b * libm::sin(phase)),
        };
        let (s, c) = libm::sincos(self.turned);
        Vector3::new(0.28 + c * x - s * y, 0.53 + s * x + c * y, 1.15)
    }
}

fn min_jerk(from: Vector3<f64>, to: Vector3<f64>, s: f64) -> Vector3<f64> {
    let s = s.clamp(0.0, 1.0);
    from + (to - from) * (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s))
}

struct Outcome {
    frequency_error: f64,
    path_rms: f64,
    swipe_error: f64,
}

fn learn(coach: &Coach, noise: f64, seed: u64) -> Outcome {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let (from, to) = (Vector3::new(0.20, 0.48, 1.15), Vector3::new(0.36, 0.58, 1.15));
    let mut periods = Vec::new();
    for _ in 0..15 {
        periods.push((1.0 + coach.jitter * normal.sample(&mut random)) / coach.frequency);
    }
    let swipe_end = 1.0 + 1.5;
    let way = swipe_end + coach.pause;
    let periodic = way + 0.8;
    let total: f64 = periods.iter().sum();
    let truth = |t: f64| {
        if t < 1.0 {
            from
        } else if t < way {
            min_jerk(from, to, (t - 1.0) / 1.5)
        } else if t < periodic {
            min_jerk(to, coach.path(0.0), (t - way) / 0.8)
        } else {
            let mut left = t - periodic;
            for p in &periods {
                if left < *p {
                    return coach.path(TAU * left / p);
                }
                left -= p;
            }
            coach.path(0.0)
        }
    };
    let mut segmenter = DemonstrationSegmenter::new(SegmenterConfig::default()).unwrap();
    let mut imitation = Imitation::with_dofs(3).unwrap();
    let mut last: Option<f64> = None;
    let frames = ((periodic + total + 3.0) * 15.0) as usize;
    for k in 0..frames {
        let t = k as f64 / 15.0;
        if random.random::<f64>() < 0.08 {
            continue;
        }
        let shake = Vector3::from_fn(|_, _| noise * normal.sample(&mut random));
        let seen = truth(t) + shake;
        let known = segmenter.observe(t, Point3::from(seen)).unwrap();
        if known.stage == DemonstrationStage::Periodic {
            let dt = last.map_or(1.0 / 15.0, |l| t - l);
            imitation.observe(dt, seen.as_slice()).unwrap();
            last = Some(t);
        }
    }
    let known = segmenter.known();
    assert_eq!(known.stage, DemonstrationStage::Ended, "{} {}", coach.shape, coach.frequency);
    let swipe = known.swipe.unwrap();
    let swipe_error = (swipe.start.coords - from).norm().max((swipe.end.coords - to).norm());
    let (primitive, hz) = imitation.result().unwrap();
    let path = primitive.steady_path(200).unwrap();
    let rms = |shift: usize| {
        let sum: f64 = (0..200)
            .map(|s| {
                let truth = coach.path(TAU * ((s + shift) % 200) as f64 / 200.0);
                (Vector3::from_column_slice(&path.y[s]) - truth).norm_squared()
            })
            .sum();
        (sum / 200.0).sqrt()
    };
    let path_rms = (0..200).map(rms).fold(f64::INFINITY, f64::min);
    let true_hz = 15.0 / total;
    Outcome { frequency_error: hz / true_hz - 1.0, path_rms, swipe_error }
}

#[test]
fn demonstrations_are_learned() {
    let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
    for shape in ["ellipse", "eight", "line"] {
        for frequency in [0.3, 0.5, 0.8] {
            for (turned, size) in [(0.0, [0.10, 0.06]), (0.6, [0.16, 0.10])] {
                for pause in [0.0, 0.6] {
                    for (seed, noise) in [(1, 0.002), (2, 0.005)] {
                        let coach = Coach { shape, size, frequency, turned, pause, jitter: 0.02 };
                        let o = learn(&coach, noise, seed);
                        println!(
                            "{shape} {frequency} {turned} {pause} {noise}: f {:.4} rms {:.4} swipe {:.4}",
                            o.frequency_error, o.path_rms, o.swipe_error
                        );
                        worst.0 = worst.0.max(o.frequency_error.abs());
                        worst.1 = worst.1.max(o.path_rms);
                        worst.2 = worst.2.max(o.swipe_error);
                    }
                }
            }
        }
    }
    println!("worst {worst:?}");
    assert!(worst.0 < 0.01, "frequency {}", worst.0);
    assert!(worst.1 < 0.008, "path {}", worst.1);
    assert!(worst.2 < 0.015, "swipe {}", worst.2);
}
