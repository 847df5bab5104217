//! Force adaptation: learns, as a function of the phase, the motion along a surface normal that keeps a desired
//! force, on an unknown surface (after Gams et al., "Coupling movement primitives", T-RO 2014).
//!
//! Feedback and learning work in parallel. The feedback integrates the force error. Learning adds what the feedback
//! would do without delay: error and feedback together are exactly what the learned motion lacks, so each cycle
//! removes the same share of it at every frequency. The present force belongs to the phase of some milliseconds
//! ago, and is assigned to that phase. The contact stiffness is estimated from one cycle to the next at equal
//! phases, where the surface is the same and only the motion has changed.
//!
//! Input is a force, output an offset; it knows no pose and moves nothing. [`crate::Touchdown`] makes the contact.

use std::f64::consts::TAU;

use crate::constants::POSITIVE;
use crate::error::{MotionError, finite, positive, within};
use crate::surface_correction::SurfaceCorrection;

constants! {
    /// The constants of a [`SurfaceAdaptation`].
    pub struct SurfaceConfig {
        /// Desired normal force, N, positive.
        force: f64 = 8.0, POSITIVE;
        /// Kernels over the phase.
        kernels: usize = 36, 4.0..=1000.0;
        /// First guess of the contact stiffness, N/m. Too high slows learning down; too low by more than a factor of 3
        /// may oscillate.
        stiffness: f64 = 4000.0, POSITIVE;
        /// Whether the stiffness is estimated from one cycle to the next. This needs an unchanged motion along the
        /// surface: if it is changed, other places of the surface look like a contact without stiffness.
        identify: bool = true;
        /// Bandwidth of the feedback, rad/s.
        bandwidth: f64 = 7.0, POSITIVE;
        /// Time from a command to its effect in the measured force, s.
        delay: f64 = 0.03, 0.0..=0.5;
        /// Share of the missing correction that each cycle adds to the learned motion, 0 to 1.
        learning: f64 = 0.5, 0.0..=1.0;
        /// Largest speed of the offset, m/s.
        max_speed: f64 = 0.12, POSITIVE;
        /// Largest offset by feedback and learned motion, m.
        max_offset: f64 = 0.08, POSITIVE;
        /// Outward surface normal in the motion's frame, any length.
        normal: [f64; 3] = [0.0, 0.0, 1.0];
    }
}

/// The correction to add to the motion now.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfaceCommand {
    /// Offset along the outward normal, m: negative presses harder.
    pub offset: f64,
    /// Velocity of the offset, m/s.
    pub velocity: f64,
}

/// Learns the motion along the surface normal that keeps the force.
#[derive(Debug, Clone)]
pub struct SurfaceAdaptation {
    config: SurfaceConfig,
    correction: SurfaceCorrection,
    psi: Vec<f64>,
    feedback: f64,
    feedback_on: bool,
    learning_on: bool,
    stiffness: f64,
    offset: f64,
    smooth_error: f64,
    past: OffsetHistory,
    cycle: Cycle,
    stiffness_by_cycle: PhaseStiffness,
    rms: Vec<f64>,
    cycles: u32,
}

/// Number of cycles whose error is kept.
const MAX_CYCLES_KEPT: usize = 256;

impl SurfaceAdaptation {
    /// Starts without a learned correction, at offset 0: the height at which the hand touches the surface.
    ///
    /// # Errors
    /// When a constant is invalid.
    pub fn new(config: SurfaceConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let width = 2.5 * config.kernels as f64;
        let correction = SurfaceCorrection::new(vec![0.0; config.kernels], width, config.normal)?;
        Self::resume(config, correction, 0.0)
    }

    /// Starts from a stored correction, at its offset for `phase` rad; its kernels and normal replace those of
    /// `config`.
    ///
    /// # Errors
    /// When a constant is invalid or the phase is not finite.
    pub fn resume(
        config: SurfaceConfig,
        correction: SurfaceCorrection,
        phase: f64,
    ) -> Result<Self, MotionError> {
        config.check_ranges()?;
        finite("phase", &[phase])?;
        Ok(Self {
            psi: vec![0.0; correction.weights().len()],
            offset: correction.offset(phase),
            correction,
            feedback: 0.0,
            feedback_on: true,
            learning_on: true,
            stiffness: config.stiffness,
            smooth_error: 0.0,
            past: OffsetHistory::default(),
            cycle: Cycle::default(),
            stiffness_by_cycle: PhaseStiffness::default(),
            rms: Vec::with_capacity(MAX_CYCLES_KEPT),
            cycles: 0,
            config,
        })
    }

    /// Advances by `dt` s, at `phase` rad of a motion of `omega` rad/s, with the measured normal force `force` (N,
    /// pressing is positive). Returns the offset to command. Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, `omega` negative or a value not finite; nothing is changed.
    pub fn step(
        &mut self,
        dt: f64,
        phase: f64,
        omega: f64,
        force: f64,
    ) -> Result<SurfaceCommand, MotionError> {
        positive("dt", dt)?;
        finite("phase", &[phase])?;
        within("omega", omega, 0.0, 1e4)?;
        within("force", force, -1e6, 1e6)?;
        let error = force - self.config.force;
        self.smooth_error += (error - self.smooth_error) * (1.0 - libm::exp(-dt / 0.05));
        self.past.push(dt, self.feedback);
        let credited = phase - omega * self.config.delay;
        if self.learning_on {
            self.learn(credited, omega * dt, error);
        }
        if self.feedback_on {
            // Bounded, so that after a lost contact the surface is not approached faster than it may be touched.
            let limit = 0.3 * self.config.max_speed;
            let rate = (self.config.bandwidth * error / self.stiffness).clamp(-limit, limit);
            let bound = self.config.max_offset;
            self.feedback = (self.feedback + rate * dt).clamp(-bound, bound);
        }
        let command = self.command(dt, phase);
        self.note(credited, phase, omega * dt, error, force);
        Ok(command)
    }

    /// Updates the kernels of the phase that the force belongs to with what the learned motion lacks there.
    fn learn(&mut self, credited: f64, advance: f64, error: f64) {
        let kernels = self.correction.kernels();
        kernels.evaluate(credited, &mut self.psi);
        let missing = error / self.stiffness + self.past.at(self.config.delay);
        let scale = self.config.learning * advance / (TAU * kernels.mean());
        let bound = self.config.max_offset;
        // A single hit must not change the motion by more than the speed limit could follow.
        let missing = missing.clamp(-0.25 * bound, 0.25 * bound);
        for (w, psi) in self.correction.weights.iter_mut().zip(&self.psi) {
            *w = (*w + (scale * psi).min(1.0) * missing).clamp(-bound, bound);
        }
    }

    fn command(&mut self, dt: f64, phase: f64) -> SurfaceCommand {
        let wanted = self.correction.offset(phase) + self.feedback;
        let most = self.config.max_speed * dt;
        let moved = (wanted - self.offset).clamp(-most, most);
        self.offset += moved;
        SurfaceCommand { offset: self.offset, velocity: moved / dt }
    }

    fn note(&mut self, credited: f64, phase: f64, advance: f64, error: f64, force: f64) {
        self.cycle.add(advance, error);
        self.stiffness_by_cycle.add(credited, phase, force, self.offset);
        if self.cycle.turned < TAU {
            return;
        }
        let rms = (self.cycle.square / self.cycle.weight.max(f64::MIN_POSITIVE)).sqrt();
        if self.rms.len() == MAX_CYCLES_KEPT {
            self.rms.remove(0);
        }
        self.rms.push(rms);
        self.cycles = self.cycles.saturating_add(1);
        self.cycle = Cycle::default();
        let found = self.stiffness_by_cycle.close(self.stiffness, self.config.force);
        if self.config.identify {
            self.stiffness = found;
        }
    }

    /// RMS force error of each whole cycle so far, N, the newest last (256 at most).
    pub fn rms(&self) -> &[f64] {
        &self.rms
    }

    /// Number of whole cycles so far.
    pub fn cycles(&self) -> u32 {
        self.cycles
    }

    /// Whether the RMS force error of the last two cycles was within `tolerance` N (noise included).
    pub fn settled(&self, tolerance: f64) -> bool {
        self.rms.len() >= 2 && self.rms.iter().rev().take(2).all(|rms| *rms <= tolerance)
    }

    /// The estimated contact stiffness, N/m.
    pub fn stiffness(&self) -> f64 {
        self.stiffness
    }

    /// Factor by which the motion should slow down while the force error is large, 0.4 to 1.
    pub fn pace(&self) -> f64 {
        (1.3 - self.smooth_error.abs() / self.config.force).clamp(0.4, 1.0)
    }

    /// Turns the feedback on or off. Its present sum is moved to the learned motion, so that the offset does not
    /// jump.
    pub fn set_feedback(&mut self, on: bool) {
        if !on {
            for w in &mut self.correction.weights {
                *w += self.feedback;
            }
            self.feedback = 0.0;
            self.past = OffsetHistory::default();
        }
        self.feedback_on = on;
    }

    /// Turns the learning on or off.
    pub fn set_learning(&mut self, on: bool) {
        self.learning_on = on;
    }

    /// The correction learned so far.
    pub fn correction(&self) -> &SurfaceCorrection {
        &self.correction
    }
}

/// The recent feedback, so that its value one delay ago can be read.
#[derive(Debug, Clone)]
struct OffsetHistory {
    values: [f64; 128],
    spacing: f64,
    since: f64,
    head: usize,
}

impl Default for OffsetHistory {
    fn default() -> Self {
        Self { values: [0.0; 128], spacing: 0.004, since: f64::INFINITY, head: 0 }
    }
}

impl OffsetHistory {
    fn push(&mut self, dt: f64, value: f64) {
        self.since += dt;
        if self.since >= self.spacing {
            self.since = 0.0;
            self.head = (self.head + 1) % self.values.len();
            self.values[self.head] = value;
        }
    }

    fn at(&self, delay: f64) -> f64 {
        let back = ((delay - self.since) / self.spacing).round().clamp(0.0, 127.0) as usize;
        self.values[(self.head + self.values.len() - back) % self.values.len()]
    }
}

/// Sums over the current cycle.
#[derive(Debug, Clone, Copy, Default)]
struct Cycle {
    turned: f64,
    square: f64,
    weight: f64,
}

impl Cycle {
    fn add(&mut self, advance: f64, error: f64) {
        self.turned += advance;
        self.square += advance * error * error;
        self.weight += advance;
    }
}

/// Least RMS change of the offset from one cycle to the next from which the stiffness is estimated, m; or 3 % of
/// the deflection of the contact, if that is more.
const MIN_CHANGE: f64 = 1e-4;
/// Number of phases at which two cycles are compared.
const BINS: usize = 48;

/// Force and offset over the phase, of this cycle and the last one.
#[derive(Debug, Clone)]
struct PhaseStiffness {
    force: [[f64; BINS]; 2],
    force_count: [[f64; BINS]; 2],
    offset: [[f64; BINS]; 2],
    offset_count: [[f64; BINS]; 2],
    products: f64,
    squares: f64,
}

impl Default for PhaseStiffness {
    fn default() -> Self {
        let zero = [[0.0; BINS]; 2];
        Self { force: zero, force_count: zero, offset: zero, offset_count: zero, products: 0.0, squares: 0.0 }
    }
}

impl PhaseStiffness {
    fn bin(phase: f64) -> usize {
        ((phase / TAU).rem_euclid(1.0) * BINS as f64) as usize % BINS
    }

    fn add(&mut self, credited: f64, phase: f64, force: f64, offset: f64) {
        let (f, o) = (Self::bin(credited), Self::bin(phase));
        self.force[0][f] += force;
        self.force_count[0][f] += 1.0;
        self.offset[0][o] += offset;
        self.offset_count[0][o] += 1.0;
    }

    /// Ends a cycle and returns the new estimate from the old one, for a desired `force`, N.
    fn close(&mut self, old: f64, force: f64) -> f64 {
        let mean = |sum: &[[f64; BINS]; 2], count: &[[f64; BINS]; 2], cycle: usize, bin: usize| {
            (count[cycle][bin] > 0.0).then(|| sum[cycle][bin] / count[cycle][bin])
        };
        // The old estimate has the weight of 48 differences of 0.1 mm, against noise when the motion no longer
        // changes.
        let prior = BINS as f64 * 1e-8;
        let (mut products, mut squares) = (0.0, 0.0);
        for bin in 0..BINS {
            let f = [0, 1].map(|cycle| mean(&self.force, &self.force_count, cycle, bin));
            let o = [0, 1].map(|cycle| mean(&self.offset, &self.offset_count, cycle, bin));
            if let ([Some(f), Some(g)], [Some(o), Some(p)]) = (f, o)
                && f > 0.5
                && g > 0.5
            {
                products -= (f - g) * (o - p);
                squares += (o - p) * (o - p);
            }
        }
        for sums in [&mut self.force, &mut self.force_count, &mut self.offset, &mut self.offset_count] {
            sums[1] = sums[0];
            sums[0] = [0.0; BINS];
        }
        // A very small change is caused by the noise of the force itself, which looks like a contact without
        // stiffness.
        let smallest = MIN_CHANGE.max(0.03 * force / old);
        if squares < BINS as f64 * smallest * smallest {
            return old;
        }
        self.products = 0.5 * self.products + products;
        self.squares = 0.5 * self.squares + squares;
        let new = (self.products + prior * old) / (self.squares + prior);
        new.clamp(0.5 * old, 2.0 * old).clamp(200.0, 20_000.0)
    }
}

#[cfg(test)]
mod tests;
