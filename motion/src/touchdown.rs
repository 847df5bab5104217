//! Makes contact: lowers the hand until the force shows contact, then increases it to the desired force, with
//! little overshoot on a surface of unknown stiffness.

use crate::constants::POSITIVE;
use crate::error::{MotionError, positive, within};

constants! {
    /// The constants of a [`Touchdown`].
    pub struct TouchdownConfig {
        /// Desired normal force, N.
        force: f64 = 8.0, POSITIVE;
        /// Speed of the approach, m/s. Before the controller can react, the force rises by stiffness times speed times
        /// delay.
        speed: f64 = 0.03, POSITIVE;
        /// Force that counts as contact, N; above noise and bias.
        contact_force: f64 = 1.5, POSITIVE;
        /// How long the force must exceed it, s.
        contact_time: f64 = 0.004, 0.0..=1.0;
        /// The highest expected contact stiffness, N/m.
        stiffness: f64 = 8000.0, POSITIVE;
        /// Time constant of pressing, s, at that stiffness.
        press_time: f64 = 0.12, POSITIVE;
        /// The force is reached when it stays within this share of the desired one ...
        tolerance: f64 = 0.15, POSITIVE;
        /// ... for this long, s.
        hold_time: f64 = 0.15, 0.0..=60.0;
        /// Largest distance down, m.
        farthest: f64 = 0.3, POSITIVE;
        /// Longest duration of pressing, s.
        longest_press: f64 = 6.0, POSITIVE;
    }
}

/// The status of a touchdown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TouchdownStatus {
    /// Moving down.
    Approaching,
    /// In contact, increasing the force.
    Pressing,
    /// The force is reached and held.
    Done,
    /// There was no surface within the allowed distance.
    NoSurface,
    /// The contact was made, but the force was not reached in time.
    NotReached,
}

/// Lowers the hand to a surface.
#[derive(Debug, Clone)]
pub struct Touchdown {
    config: TouchdownConfig,
    status: TouchdownStatus,
    smooth: f64,
    over: f64,
    held: f64,
    pressing: f64,
    depth: f64,
    contact_depth: f64,
    velocity: f64,
}

impl Touchdown {
    /// A touchdown above the surface, before its first step.
    ///
    /// # Errors
    /// When a constant is not positive.
    pub fn new(config: TouchdownConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        Ok(Self {
            config,
            status: TouchdownStatus::Approaching,
            smooth: 0.0,
            over: 0.0,
            held: 0.0,
            pressing: 0.0,
            depth: 0.0,
            contact_depth: 0.0,
            velocity: 0.0,
        })
    }

    /// Advances by `dt` s with the measured normal force `force` (N, pressing is positive). Returns the velocity
    /// along the outward normal to command, m/s (negative is down), and 0 once it has ended.
    ///
    /// # Errors
    /// When `dt` is not positive or the force not finite; nothing is changed.
    pub fn step(&mut self, dt: f64, force: f64) -> Result<f64, MotionError> {
        positive("dt", dt)?;
        within("force", force, -1e6, 1e6)?;
        self.smooth += (force - self.smooth) * (1.0 - libm::exp(-dt / 0.006));
        self.velocity = match self.status {
            TouchdownStatus::Approaching => self.approach(dt, force),
            TouchdownStatus::Pressing => self.press(dt),
            _ => 0.0,
        };
        self.depth -= self.velocity * dt;
        Ok(self.velocity)
    }

    fn approach(&mut self, dt: f64, force: f64) -> f64 {
        self.over = if force > self.config.contact_force { self.over + dt } else { 0.0 };
        // A hard contact needs no second sample.
        if self.over > self.config.contact_time || force > 0.6 * self.config.force + self.config.contact_force
        {
            self.status = TouchdownStatus::Pressing;
            self.contact_depth = self.depth;
            self.smooth = force;
            return 0.0;
        }
        if self.depth >= self.config.farthest {
            self.status = TouchdownStatus::NoSurface;
            return 0.0;
        }
        -self.config.speed
    }

    fn press(&mut self, dt: f64) -> f64 {
        let error = self.smooth - self.config.force;
        let near = error.abs() <= self.config.tolerance * self.config.force;
        self.held = if near { self.held + dt } else { 0.0 };
        self.pressing += dt;
        if self.held > self.config.hold_time {
            self.status = TouchdownStatus::Done;
            return 0.0;
        }
        if self.pressing > self.config.longest_press {
            self.status = TouchdownStatus::NotReached;
            return 0.0;
        }
        // On a soft surface the motion is faster: the stiffness is estimated from the travel so far.
        let softer = (self.pressing / 0.5).clamp(1.0, 8.0);
        let rate = softer / (self.config.stiffness * self.config.press_time);
        (rate * error).clamp(-self.config.speed, self.config.speed)
    }

    /// The status of the touchdown.
    pub fn status(&self) -> TouchdownStatus {
        self.status
    }

    /// Distance down since the first step, m.
    pub fn depth(&self) -> f64 {
        self.depth
    }

    /// The stiffness computed from the travel since contact, N/m, once that is measurable.
    pub fn stiffness(&self) -> Option<f64> {
        let way = self.depth - self.contact_depth;
        (self.status == TouchdownStatus::Done && way > 2e-4).then(|| {
            ((self.config.force - self.config.contact_force) / way).clamp(200.0, 2.0 * self.config.stiffness)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    fn land(stiffness: f64, delay: f64, force: f64, dt: f64) -> (f64, f64, TouchdownStatus) {
        let mut law = Touchdown::new(TouchdownConfig { force, ..TouchdownConfig::default() }).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let noise = Normal::new(0.0, 0.3).unwrap();
        let steps = (delay / dt).round() as usize;
        let mut queue = vec![0.0; steps + 1];
        let (mut z, mut worst, mut t) = (0.05_f64, 0.0_f64, 0.0);
        for k in 0.. {
            z += queue[k % (steps + 1)] * dt;
            let truth = (-stiffness * z).max(0.0);
            worst = worst.max(truth);
            queue[k % (steps + 1)] = law.step(dt, truth + noise.sample(&mut random)).unwrap();
            t += dt;
            if !matches!(law.status(), TouchdownStatus::Approaching | TouchdownStatus::Pressing) {
                break;
            }
        }
        (worst, t, law.status())
    }

    #[test]
    fn it_lands_softly_on_everything() {
        for stiffness in [500.0, 2000.0, 8000.0] {
            for delay in [0.005, 0.02] {
                for (force, dt) in [(5.0, 0.001), (8.0, 0.001), (15.0, 0.005)] {
                    let (worst, t, status) = land(stiffness, delay, force, dt);
                    println!("{stiffness} {delay} {force}: {worst:.1} N {t:.2} s");
                    assert_eq!(status, TouchdownStatus::Done);
                    assert!(worst < 18.0 && t < 6.0, "{stiffness} {delay} {force}: {worst} N {t} s");
                }
            }
        }
    }

    #[test]
    fn without_a_surface_it_says_so() {
        let mut law = Touchdown::new(TouchdownConfig::default()).unwrap();
        for _ in 0..20_000 {
            law.step(0.001, 0.0).unwrap();
        }
        assert_eq!(law.status(), TouchdownStatus::NoSurface);
        assert!((law.depth() - 0.3).abs() < 1e-3);
    }
}
