//! The canonical system of the discrete-periodic primitive (3), (4): a phase that spirals onto a circle.

use serde::{Deserialize, Serialize};

use crate::error::{MotionError, finite, within};

/// How fast the radius converges when the movement runs at another frequency than the demonstrated one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CanonicalRule {
    /// (4): in proportion to the frequency, so that the whole movement scales in time.
    #[default]
    Modified,
    /// As in Ernesti, Righetti, Do, Asfour and Schaal (Humanoids 2012): at the speed of the demonstration at every
    /// frequency, so that the phase leaves the learned spiral.
    Original,
}

constants! {
    /// The constants of (4), (8) and (9), dimensionless.
    pub struct CanonicalSystem {
        /// Speed eta of convergence, 1 per rad.
        eta: f64 = 6.0, 1e-3..=1e3;
        /// Exponent alpha.
        alpha: f64 = 1.0 / 6.0, 1e-3..=10.0;
        /// Exponent beta.
        beta: f64 = 1e-3, 0.0..=10.0;
        /// Radius mu of the limit cycle.
        mu: f64 = 1.0, 1e-3..=1e3;
        /// Radius mu1, over mu, at which the discrete part has ended.
        mu1: f64 = 1.2;
        /// Radius mu2, over mu1, at which the transition begins.
        mu2: f64 = 1.4;
        /// The rule for other frequencies than the demonstrated one.
        rule: CanonicalRule = CanonicalRule::Modified;
    }
}

/// Largest phase step, rad, that is integrated at once.
const STEP: f64 = 0.02;
/// After this phase, rad, any radius has converged.
const SETTLED: f64 = 1e4;

impl CanonicalSystem {
    pub(super) fn validate(&self) -> Result<(), MotionError> {
        self.check_ranges()?;
        within("mu1", self.mu1, self.mu * (1.0 + 1e-6), 1e6)?;
        within("mu2", self.mu2, self.mu1 * (1.0 + 1e-6), 1e6)
    }

    /// `dr / dphi` of (4).
    fn slope(&self, radius: f64) -> f64 {
        self.eta
            * (libm::pow(self.mu, self.alpha) - libm::pow(radius, self.alpha))
            * libm::pow(radius, self.beta)
    }

    fn pieces(&self, turned: f64) -> f64 {
        // Near the cycle the deviation decays at this rate; the step stays well within the stability of the rule.
        let rate = self.eta * self.alpha * libm::pow(self.mu, self.alpha + self.beta - 1.0);
        (turned.abs() / (STEP / rate.max(1.0))).ceil().max(1.0)
    }

    fn midpoint(&self, radius: f64, turned: f64) -> f64 {
        let middle = (radius + 0.5 * turned * self.slope(radius)).max(0.0);
        (radius + turned * self.slope(middle)).max(1e-9)
    }

    /// The radius after the phase has advanced by `turned` rad (not negative), by the midpoint rule.
    pub(super) fn advance(&self, radius: f64, turned: f64) -> f64 {
        if turned > SETTLED {
            return self.mu;
        }
        let pieces = self.pieces(turned);
        (0..pieces as usize).fold(radius, |radius, _| self.midpoint(radius, turned / pieces))
    }

    /// The phases (phi, r) at `count` equal steps from `turn` rad before (mu1, 0) up to it, by integrating back;
    /// refused when the radius diverges.
    pub(super) fn spiral(&self, turn: f64, count: usize) -> Result<Vec<(f64, f64)>, MotionError> {
        let piece = turn / (count - 1) as f64;
        let pieces = self.pieces(piece);
        let mut radius = self.mu1;
        let mut spiral = vec![(0.0, radius)];
        for i in 1..count {
            for _ in 0..pieces as usize {
                radius = self.midpoint(radius, -piece / pieces);
                // Beyond this radius, the kernels cannot be distinguished any more.
                if !(radius.is_finite() && radius < 1e12) {
                    return Err(MotionError::NotFinite { what: "initial radius" });
                }
            }
            spiral.push((-piece * i as f64, radius));
        }
        spiral.reverse();
        spiral.iter().try_for_each(|(phi, r)| finite("initial phase", &[*phi, *r]))?;
        Ok(spiral)
    }

    /// Share b of the periodic kernels (8) and a of the discrete ones (9) at a radius, each 0 to 1.
    pub(super) fn blend(&self, radius: f64) -> (f64, f64) {
        let tricube = |s: f64| (1.0 - s.powi(3)).powi(3);
        let s = ((radius - self.mu1) / (self.mu2 - self.mu1)).clamp(0.0, 1.0);
        if s <= 0.0 {
            (1.0, 0.0)
        } else if s >= 1.0 {
            (0.0, 1.0)
        } else {
            (tricube(s), tricube(1.0 - s))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_exponent_one_the_radius_decays_exponentially() {
        // alpha = 1, beta = 0 has the closed form r = mu + (r0 - mu) exp(-eta phi).
        let system = CanonicalSystem { alpha: 1.0, beta: 0.0, eta: 2.0, ..CanonicalSystem::default() };
        let r = system.advance(5.0, 0.7);
        assert!((r - (1.0 + 4.0 * libm::exp(-1.4_f64))).abs() < 1e-4, "{r}");
        let spiral = system.spiral(3.0, 13).unwrap();
        assert_eq!(spiral.len(), 13);
        for (phi, r) in spiral {
            assert!((r / (1.0 + 0.2 * libm::exp(-2.0 * phi)) - 1.0).abs() < 1e-3, "{phi} {r}");
        }
    }

    #[test]
    fn back_and_forth_ends_where_it_began() {
        let system = CanonicalSystem::default();
        let (phi, r) = system.spiral(2.0 * std::f64::consts::TAU, 25).unwrap()[0];
        assert!((phi + 2.0 * std::f64::consts::TAU).abs() < 1e-12);
        // The value of an independent integration with 1000 steps.
        assert!((r / 34.070_048 - 1.0).abs() < 1e-3, "{r}");
        assert!((system.advance(r, -phi) - 1.2).abs() < 1e-3);
        assert!((system.advance(r, 500.0) - 1.0).abs() < 1e-9);
        assert_eq!(system.advance(r, 1e9), 1.0);
        let runaway = CanonicalSystem { alpha: 2.0, ..system };
        assert_eq!(runaway.spiral(50.0, 25), Err(MotionError::NotFinite { what: "initial radius" }));
    }

    #[test]
    fn the_shares_meet_at_the_borders() {
        let system = CanonicalSystem::default();
        assert_eq!(system.blend(1.1), (1.0, 0.0));
        assert_eq!(system.blend(1.5), (0.0, 1.0));
        let (b, a) = system.blend(1.3);
        assert!((b - 0.875_f64.powi(3)).abs() < 1e-9 && (a - b).abs() < 1e-9);
        let (b, a) = system.blend(1.2 + 1e-9);
        assert!(b > 1.0 - 1e-9 && a < 1e-9);
    }
}
