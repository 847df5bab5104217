//! The height of a hand that lifts something and then shakes it: a discrete part that goes over into a periodic one.

use crate::error::{MotionError, finite, positive};

/// Up to `lift` within `duration`, then an oscillation about it. Position, velocity and acceleration are continuous.
///
/// # Source
/// The task of Gams et al. 2015, section V.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiftAndShake {
    /// How high it is lifted, m.
    pub lift: f64,
    /// Amplitude of the oscillation, m.
    pub amplitude: f64,
    /// Its phase at its beginning, rad.
    pub phase: f64,
    /// Its frequency, rad/s.
    pub omega: f64,
    /// Duration of the lift, s.
    pub duration: f64,
}

impl LiftAndShake {
    /// Checks its numbers.
    ///
    /// # Errors
    /// When one is not finite, or the frequency or the duration is not positive.
    pub fn check(&self) -> Result<(), MotionError> {
        finite("lift and shake", &[self.lift, self.amplitude, self.phase])?;
        positive("omega", self.omega)?;
        positive("duration", self.duration)
    }

    /// Height above the start after `t` s, m, and its velocity, m/s.
    pub fn at(&self, t: f64) -> [f64; 2] {
        let Self { lift, amplitude, phase, omega: w, duration } = *self;
        if t >= duration {
            let (sin, cos) = libm::sincos(w * (t - duration) + phase);
            return [lift + amplitude * sin, w * amplitude * cos];
        }
        let (sin, cos) = libm::sincos(phase);
        let [y, v, _] =
            rise([lift + amplitude * sin, w * amplitude * cos, -w * w * amplitude * sin], duration, t);
        [y, v]
    }
}

/// Position, velocity and acceleration at `t` s of the fifth-order polynomial from rest at 0 to `end` at `duration` s.
pub fn rise(end: [f64; 3], duration: f64, t: f64) -> [f64; 3] {
    let s = t / duration;
    let [y, v, a] = [end[0], end[1] * duration, end[2] * duration * duration];
    let c = [10.0 * y - 4.0 * v + 0.5 * a, 7.0 * v - 15.0 * y - a, 6.0 * y - 3.0 * v + 0.5 * a];
    let sum = |f: &dyn Fn(f64) -> f64| (3..6).zip(c).map(|(k, c)| c * f(f64::from(k))).sum::<f64>();
    [
        sum(&|k| libm::pow(s, k)),
        sum(&|k| k * libm::pow(s, k - 1.0)) / duration,
        sum(&|k| k * (k - 1.0) * libm::pow(s, k - 2.0)) / (duration * duration),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lift_goes_over_into_the_shaking_without_a_jump() {
        let path = LiftAndShake { lift: 0.1, amplitude: 0.03, phase: 0.6, omega: 5.0, duration: 1.5 };
        path.check().unwrap();
        assert_eq!(path.at(0.0), [0.0, 0.0]);
        let (before, after) = (path.at(1.5 - 1e-9), path.at(1.5));
        assert!((before[0] - after[0]).abs() < 1e-8 && (before[1] - after[1]).abs() < 1e-7);
        for t in [0.4, 1.2, 1.8, 3.0] {
            let slope = (path.at(t + 1e-6)[0] - path.at(t - 1e-6)[0]) / 2e-6;
            assert!((slope - path.at(t)[1]).abs() < 1e-6, "{t}");
        }
        assert!(LiftAndShake { duration: 0.0, ..path }.check().is_err());
    }

    #[test]
    fn a_rise_ends_as_it_is_told() {
        let [y, v, a] = rise([0.7, -3.0, 12.0], 0.8, 0.8);
        assert!((y - 0.7).abs() < 1e-12 && (v + 3.0).abs() < 1e-11 && (a - 12.0).abs() < 1e-10);
        assert_eq!(rise([0.7, -3.0, 12.0], 0.8, 0.0), [0.0; 3]);
    }
}
