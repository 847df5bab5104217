//! When the hand holds an object.
//!
//! The grip begins while **both** finger pads press on an object from opposite sides: the object is then joined to the palm.
//! Closed fingers that push something side by side hold nothing. The grip ends when a pad has pressed less than
//! [`HOLDING_FORCE`] for [`RELEASE_AFTER`], or when the load exceeds the friction of the pads: force `F` and torque `T`
//! (about the object's middle) with `(F / Fc)^2 + (T / (Fc r))^2 > 1`, where `Fc` is the pads' friction on it times the sum of both
//! pads' normal forces and `r = ` [`CONTACT_RADIUS`]. With 40 N per pad and a friction of 0.9, this is 72 N and 2.2 N m. So an
//! object can be missed, dropped and knocked out of the hand. This file decides; [`Plant`](super::plant::Plant) makes and breaks
//! the joint.

use nalgebra::Vector3;

/// Normal force of a pad that counts as pressing, N.
pub const HOLDING_FORCE: f64 = 1.0;
/// Pads press from opposite sides when the cosine of the angle between their forces is less than this.
const OPPOSITE: f64 = -0.5;
/// How long a pad may press less before the grip ends, s.
pub const RELEASE_AFTER: f64 = 0.02;
/// Radius of the friction patch of a pad, m.
pub const CONTACT_RADIUS: f64 = 0.03;
/// Time constant of the load's low-pass filter, s: the pads' elasticity absorbs shorter peaks.
pub const LOAD_TIME: f64 = 0.005;
/// How long no object can be gripped after a slip, s.
pub const SLIP_PAUSE: f64 = 0.3;

/// The pressure of a pad on an object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PadPress {
    pub(super) touches: bool,
    /// Sum of the normal forces of all contacts, N.
    pub(super) force: f64,
    /// The same as vectors: the force on the object, root frame, N.
    pub(super) pushes: Vector3<f64>,
}

impl PadPress {
    /// Whether it presses from the other side than another pad.
    fn is_opposite(&self, other: &Self) -> bool {
        let [a, b] = [self, other].map(|press| press.pushes.try_normalize(1e-9).unwrap_or_default());
        a.dot(&b) < OPPOSITE
    }
}

/// Force, N, and torque about the object's middle, N m, that the hand exerts on the object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Load {
    pub(super) force: Vector3<f64>,
    pub(super) torque: Vector3<f64>,
}

/// Whether an object is held, and since when a pad presses too little.
#[derive(Clone, Debug, Default)]
pub(super) struct Grip {
    held: Option<usize>,
    loose_s: f64,
    pause_s: f64,
    load: Load,
}

impl Grip {
    pub(super) fn held(&self) -> Option<usize> {
        self.held
    }

    /// Advances by one step in which nothing changes.
    pub(super) fn rest(&mut self, dt: f64) {
        self.pause_s = (self.pause_s - dt).max(0.0);
    }

    /// Advances by one step. `presses` are those of all pads on each object, `load` is that of the held object,
    /// and `friction` the pads' on it.
    pub(super) fn step(&mut self, presses: &[Vec<PadPress>], load: Option<Load>, friction: f64, dt: f64) {
        self.rest(dt);
        let Some(held) = self.held else {
            let both = |p: &Vec<PadPress>| {
                p.iter().all(|p| p.touches && p.force > HOLDING_FORCE)
                    && p.iter().any(|a| p.iter().any(|b| a.is_opposite(b)))
            };
            if self.pause_s == 0.0 {
                self.held = presses.iter().position(both);
                self.loose_s = 0.0;
                self.load = Load::default();
            }
            return;
        };
        let pads = presses.get(held).map_or(&[][..], Vec::as_slice);
        let loose = pads.len() < 2 || pads.iter().any(|p| p.force < HOLDING_FORCE);
        self.loose_s = if loose { self.loose_s + dt } else { 0.0 };
        let load = load.unwrap_or_default();
        let rate = dt / (LOAD_TIME + dt);
        self.load.force += (load.force - self.load.force) * rate;
        self.load.torque += (load.torque - self.load.torque) * rate;
        let capacity = friction * pads.iter().map(|p| p.force).sum::<f64>();
        if self.loose_s > RELEASE_AFTER {
            self.held = None;
        } else if !loose && self.slips(capacity) {
            self.held = None;
            self.pause_s = SLIP_PAUSE;
        }
    }

    fn slips(&self, capacity: f64) -> bool {
        let torque = self.load.torque.norm() / CONTACT_RADIUS;
        self.load.force.norm_squared() + torque * torque > capacity * capacity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pads(a: f64, b: f64) -> Vec<Vec<PadPress>> {
        vec![[(a, 1.0), (b, -1.0)].map(|(force, side)| pad(force, Vector3::y() * side)).to_vec()]
    }

    fn pad(force: f64, towards: Vector3<f64>) -> PadPress {
        PadPress { touches: force > 0.0, force, pushes: towards * force }
    }

    fn pulled(force: f64) -> Option<Load> {
        Some(Load { force: Vector3::x() * force, torque: Vector3::zeros() })
    }

    #[test]
    fn both_pads_take_and_one_that_opens_drops() {
        let mut grip = Grip::default();
        grip.step(&pads(10.0, 0.0), None, 0.9, 1e-3);
        assert_eq!(grip.held(), None);
        grip.step(&pads(10.0, 9.0), None, 0.9, 1e-3);
        assert_eq!(grip.held(), Some(0));
        for _ in 0..19 {
            grip.step(&pads(10.0, 0.0), None, 0.9, 1e-3);
        }
        assert_eq!(grip.held(), Some(0));
        for _ in 0..3 {
            grip.step(&pads(10.0, 0.0), None, 0.9, 1e-3);
        }
        assert_eq!(grip.held(), None);
    }

    #[test]
    fn pads_that_push_side_by_side_hold_nothing() {
        let mut grip = Grip::default();
        for away in [Vector3::y(), Vector3::new(0.6, 0.8, 0.0), Vector3::x()] {
            grip.step(&[vec![pad(10.0, Vector3::y()), pad(10.0, away)]], None, 0.9, 1e-3);
            assert_eq!(grip.held(), None, "{away}");
        }
        grip.step(
            &[vec![pad(10.0, Vector3::y()), pad(10.0, Vector3::new(0.3, -0.95, 0.0))]],
            None,
            0.9,
            1e-3,
        );
        assert_eq!(grip.held(), Some(0));
    }

    #[test]
    fn friction_bounds_the_load() {
        for (force, holds) in [(70.0, true), (74.0, false)] {
            let mut grip = Grip::default();
            for _ in 0..50 {
                grip.step(&pads(40.0, 40.0), pulled(force), 0.9, 1e-3);
            }
            assert_eq!(grip.held().is_some(), holds, "{force}");
        }
    }

    #[test]
    fn what_is_slippery_bears_less() {
        for (friction, force, holds) in [(0.1, 7.0, true), (0.1, 9.0, false), (0.0, 0.1, false)] {
            let mut grip = Grip::default();
            for _ in 0..50 {
                grip.step(&pads(40.0, 40.0), pulled(force), friction, 1e-3);
            }
            assert_eq!(grip.held().is_some(), holds, "{force}");
        }
    }

    #[test]
    fn a_short_peak_is_carried() {
        let mut grip = Grip::default();
        for i in 0..50 {
            grip.step(&pads(40.0, 40.0), pulled(if i == 20 { 200.0 } else { 5.0 }), 0.9, 1e-3);
        }
        assert_eq!(grip.held(), Some(0));
    }
}
