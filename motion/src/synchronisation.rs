//! A learned trajectory that follows the phase and frequency of any periodic signal: the two-layer system of both
//! papers, with the adaptive oscillator as its first layer and a periodic primitive as its second.
//!
//! It does not learn the trajectory; [`crate::Imitation`] does.

use std::f64::consts::{PI, TAU};

use crate::error::{MotionError, positive, within};
use crate::oscillator::{AdaptiveOscillator, OscillatorConfig};
use crate::periodic::{DmpState, PeriodicDmp};

constants! {
    /// How a primitive follows the oscillator.
    #[derive(Copy)]
    pub struct SynchronisationConfig {
        /// Lead of the primitive's phase over the signal's, rad.
        lead: f64 = 0.0, f64::MIN..=f64::MAX;
        /// Rate at which a phase difference is corrected, as a share of the frequency per rad.
        gain: f64 = 0.5, 1e-6..=100.0;
        /// Upper bound on the primitive's speed relative to the signal's while it catches up; it never runs backwards.
        fastest: f64 = 2.0, 1.0..=100.0;
    }
}

/// A primitive with the phase and frequency of a signal.
///
/// # Source
/// Petrič et al. 2014, section II, and Gams et al. 2009; differs in: the primitive does not copy the oscillator's
/// phase but follows it with a bounded speed, so that position and velocity stay smooth while the oscillator locks,
/// relocks or follows a step.
#[derive(Debug, Clone)]
pub struct Synchronisation {
    config: SynchronisationConfig,
    oscillator: AdaptiveOscillator,
    primitive: PeriodicDmp,
}

impl Synchronisation {
    /// Lets `primitive` follow signals, with an oscillator of this configuration. The primitive rests until the
    /// oscillator runs.
    ///
    /// # Errors
    /// Names the invalid constant.
    pub fn new(
        config: SynchronisationConfig,
        oscillator: OscillatorConfig,
        primitive: PeriodicDmp,
    ) -> Result<Self, MotionError> {
        config.check_ranges()?;
        Ok(Self { config, oscillator: AdaptiveOscillator::new(oscillator)?, primitive })
    }

    /// Processes the sample `signal` (one value per coordinate), `dt` s after the previous one, and advances the
    /// primitive.
    ///
    /// # Errors
    /// As [`AdaptiveOscillator::update`] and [`PeriodicDmp::step`]; a refused sample changes nothing.
    pub fn step(&mut self, dt: f64, signal: &[f64]) -> Result<DmpState<'_>, MotionError> {
        positive("dt", dt)?;
        within("dt", dt, 0.0, 1e6)?;
        self.oscillator.update(dt, signal)?;
        if !self.oscillator.running() {
            return self.primitive.step(dt, 0.0);
        }
        let omega = self.oscillator.omega();
        // The primitive should be where the oscillator will be after this step.
        let behind =
            wrapped(self.oscillator.phase() + self.config.lead - self.primitive.phase() - omega * dt);
        let faster = (self.config.gain * omega * dt).min(1.0) * behind / dt;
        let omega = (omega + faster).clamp(0.0, self.config.fastest * omega);
        self.primitive.step(dt, omega)
    }

    /// How far the primitive's phase lags its reference, rad, in -pi..pi.
    pub fn behind(&self) -> f64 {
        wrapped(self.oscillator.phase() + self.config.lead - self.primitive.phase())
    }

    /// The oscillator.
    pub fn oscillator(&self) -> &AdaptiveOscillator {
        &self.oscillator
    }

    /// The primitive.
    pub fn primitive(&self) -> &PeriodicDmp {
        &self.primitive
    }
}

/// Wraps an angle to -pi..pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{OscillatorConfig, PeriodicDmpConfig, PhaseSample};

    fn primitive() -> PeriodicDmp {
        let sample = |k: usize| {
            let phase = TAU * k as f64 / 400.0;
            let (s, c) = libm::sincos(phase);
            PhaseSample { phase, y: vec![s, 2.0 * c], dy: vec![c, -2.0 * s], ddy: vec![-s, -2.0 * c] }
        };
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(2)).unwrap();
        dmp.learn_batch(&(0..400).map(sample).collect::<Vec<_>>()).unwrap();
        dmp
    }

    #[test]
    fn the_trajectory_follows_the_rhythm_of_a_signal_that_it_does_not_resemble() {
        let dt = 0.002;
        let lead = 0.7;
        let config = SynchronisationConfig { lead, ..SynchronisationConfig::default() };
        let mut system = Synchronisation::new(config, OscillatorConfig::default(), primitive()).unwrap();
        let mut phase = 0.0_f64;
        let mut last = system.primitive().state().y[0];
        for k in 0..30_000 {
            let hz = if k < 15_000 { 0.7 } else { 1.1 };
            phase += TAU * hz * dt;
            // The fundamental is largest at phase 0.3, and that is phase 0 of the oscillator.
            let signal = 3.0 + libm::cos(phase - 0.3) + 0.4 * libm::sin(2.0 * phase);
            let state = system.step(dt, &[signal]).unwrap();
            let (y, at) = (state.y[0], state.phase);
            let fastest = 2.0 * 1.5 * TAU * 1.1 * dt;
            assert!((y - last).abs() < fastest, "{k}: {}", y - last);
            last = y;
            if k % 15_000 > 12_000 {
                let off = wrapped(at - (phase - 0.3 + lead));
                assert!(off.abs() < 0.06, "{k}: {off}");
                assert!((y - libm::sin(at)).abs() < 0.02);
            }
        }
    }

    #[test]
    fn without_a_rhythm_it_stands_and_a_refused_sample_changes_nothing() {
        let config = SynchronisationConfig::default();
        let mut system = Synchronisation::new(config, OscillatorConfig::default(), primitive()).unwrap();
        for _ in 0..500 {
            system.step(0.01, &[0.2]).unwrap();
        }
        assert_eq!(system.primitive().phase(), 0.0);
        let before = system.primitive().clone();
        assert!(system.step(0.0, &[0.2]).is_err());
        assert!(system.step(f64::NAN, &[0.2]).is_err());
        assert!(system.step(0.01, &[f64::NAN]).is_err());
        assert!(system.step(0.01, &[0.2, 0.3]).is_err());
        assert_eq!(*system.primitive(), before);
        let backwards = SynchronisationConfig { fastest: 0.5, ..config };
        assert!(Synchronisation::new(backwards, OscillatorConfig::default(), primitive()).is_err());
    }
}
