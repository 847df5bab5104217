//! How stiffly a person holds what moves: the force against the displacement, in what swings faster than a person leads.
//!
//! Force and motion of a hand that follows a law are tied by that law, so its stiffness cannot be known from leading alone:
//! where the person wants to be is unknown. What swings is another thing. A person of the stiffness K and a hand of the mass M
//! swing at the frequency at which K and M balance, and the force then is about -K times the displacement, less the share that
//! moves the mass of the person's own hand. So both are high-passed, and their regression is what counts.

use nalgebra::Vector3;

/// Time constant of each of the two high-passes, s: leading is slower.
const SLOW_S: f64 = 0.1;
/// How much swinging is remembered, m² s: half a second at an amplitude of 7 mm.
const MEMORY: f64 = 1.2e-5;
/// The stiffness that is assumed before anything swung, N/m: that of a relaxed arm.
const AT_FIRST: f64 = 200.0;
/// The stiffest arm, N/m.
const STIFFEST: f64 = 1500.0;

/// The estimate; see the module.
#[derive(Debug, Clone)]
pub(super) struct StiffnessEstimate {
    force: HighPass,
    place: HighPass,
    /// The sums of -f . x, N m s, and of x . x, m² s. Only swinging makes them forget.
    work: f64,
    spread: f64,
}

impl Default for StiffnessEstimate {
    fn default() -> Self {
        let (force, place) = (HighPass::default(), HighPass::default());
        Self { force, place, work: AT_FIRST * MEMORY, spread: MEMORY }
    }
}

impl StiffnessEstimate {
    /// Takes a force, N, and where the hand is, m, into account.
    pub(super) fn observe(&mut self, dt: f64, force: &Vector3<f64>, place: &Vector3<f64>) {
        let (f, x) = (self.force.step(dt, force), self.place.step(dt, place));
        let spread = self.spread + dt * x.norm_squared();
        let work = self.work - dt * f.dot(&x);
        if !(spread.is_finite() && work.is_finite()) {
            return;
        }
        let kept = MEMORY / spread;
        (self.work, self.spread) = (kept * work, MEMORY);
    }

    /// The stiffness, N/m.
    pub(super) fn value(&self) -> f64 {
        (self.work / self.spread).clamp(0.0, STIFFEST)
    }
}

/// Two high-passes of first order in a row: a ramp leaves nothing.
#[derive(Debug, Clone, Default)]
struct HighPass {
    means: Option<[Vector3<f64>; 2]>,
}

impl HighPass {
    fn step(&mut self, dt: f64, value: &Vector3<f64>) -> Vector3<f64> {
        let share = 1.0 - libm::exp(-dt / SLOW_S);
        let [first, second] = self.means.get_or_insert([*value, Vector3::zeros()]);
        *first += (value - *first) * share;
        let fast = value - *first;
        *second += (fast - *second) * share;
        fast - *second
    }
}
