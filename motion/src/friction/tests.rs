//! Tests the friction model with sliding bristles, pushes and noise.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::f64::consts::TAU;

/// A spring of `stiffness` N/m between hand and table that slides at Coulomb's limit: a different law from Dahl's.
struct Bristle {
    stiffness: f64,
    mu: f64,
    stretch: Vector2<f64>,
}

impl Bristle {
    fn force(&mut self, velocity: Vector2<f64>, normal: f64, dt: f64) -> Vector2<f64> {
        self.stretch += velocity * dt;
        let limit = self.mu * normal / self.stiffness;
        let length = self.stretch.norm();
        if length > limit {
            self.stretch *= limit / length;
        }
        -self.stretch * self.stiffness
    }
}

struct Outcome {
    worst_held: f64,
    mu: f64,
    pushed: Vector2<f64>,
}

/// 30 s of wiping. If `push`, from 20 s on there is a push of 12 N along y in a fifth of each cycle.
fn wipe(mu: f64, normal: f64, stiffness: f64, line: bool, hz: f64, push: bool) -> Outcome {
    let mut model = FrictionModel::new(FrictionConfig::default()).unwrap();
    let mut bristle = Bristle { stiffness, mu, stretch: Vector2::zeros() };
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let noise = Normal::new(0.0, 0.3).unwrap();
    let dt = 0.001;
    let (mut held, mut worst_held) = (0.0_f64, 0.0_f64);
    let (mut pushed, mut count) = (Vector2::zeros(), 0.0);
    for k in 0..30_000 {
        let t = f64::from(k) * dt;
        let phase = TAU * hz * t;
        let omega = TAU * hz;
        let side = if line { 0.0 } else { 0.03 };
        let velocity = Vector2::new(-0.05 * omega * libm::sin(phase), side * omega * libm::cos(phase));
        let pressed = normal + 0.5 * libm::sin(3.0 * phase);
        let mut force = bristle.force(velocity, pressed, dt);
        force += Vector2::new(0.6 + 0.01 * t, -0.4);
        force += Vector2::from_fn(|_, _| noise.sample(&mut random));
        let on = push && t > 20.0 && (phase / TAU).fract() < 0.2;
        if on {
            force.y += 12.0;
        }
        let measured = pressed + noise.sample(&mut random);
        let rest = model.step(dt, measured, velocity.into(), force.into()).unwrap();
        let rest = Vector2::from(rest);
        if on && (phase / TAU).fract() > 0.1 {
            pushed += rest;
            count += 1.0;
        }
        if t > 6.0 && !on {
            held = if rest.norm() > 4.0 { held + dt } else { 0.0 };
            worst_held = worst_held.max(held);
        }
    }
    Outcome { worst_held, mu: model.mu(), pushed: if count > 0.0 { pushed / count } else { pushed } }
}

#[test]
fn wiping_alone_is_no_push_and_a_push_is_seen() {
    for mu in [0.2, 0.5, 0.8] {
        for normal in [5.0, 8.0, 15.0] {
            for stiffness in [1000.0, 5000.0, 50_000.0] {
                for line in [true, false] {
                    for hz in [0.3, 0.8] {
                        let alone = wipe(mu, normal, stiffness, line, hz, false);
                        let pushed = wipe(mu, normal, stiffness, line, hz, true);
                        let what = format!("mu {mu} N {normal} k {stiffness} line {line} {hz} Hz");
                        println!(
                            "{what}: held {:.3} mu {:.3} | held {:.3} mu {:.3} push {:.2} {:.2}",
                            alone.worst_held,
                            alone.mu,
                            pushed.worst_held,
                            pushed.mu,
                            pushed.pushed.x,
                            pushed.pushed.y
                        );
                        assert!(alone.worst_held < 0.1, "{what}: held {}", alone.worst_held);
                        assert!((pushed.pushed.y - 12.0).abs() < 2.5, "{what}: push {}", pushed.pushed);
                        assert!(pushed.pushed.x.abs() < 2.5, "{what}: push {}", pushed.pushed);
                    }
                }
            }
        }
    }
}
