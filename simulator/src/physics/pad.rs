//! A soft pad between a hand and a side of a box: springs across it, bristles along it.
//!
//! The pad is a grid of points on the hand. Each point that the box has pressed in has a spring and damper across
//! the box's side, and a bristle along it that sticks up to Coulomb's limit and then slips, like the cells of an
//! [`ElasticFoundation`](crate::foundation::ElasticFoundation). A pad can only push: a box that is not pressed from
//! both sides falls. The pad does not depend on the hand that it is on.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::start::MountedPad;
use crate::world::PadSpec;

/// Number of points along each edge.
const POINTS: usize = 3;
/// Part of critical damping of the box on its pads.
const DAMPING_RATIO: f64 = 0.2;

/// A body that moves: pose, velocity of the pose's origin, m/s, and angular velocity, rad/s, root frame.
#[derive(Clone, Copy, Debug)]
pub struct Moving {
    /// Where its frame is.
    pub pose: Isometry3<f64>,
    /// Velocity of its frame's origin, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular: Vector3<f64>,
}

impl Moving {
    pub(super) fn velocity_at(&self, point: &Point3<f64>) -> Vector3<f64> {
        self.linear + self.angular.cross(&(point.coords - self.pose.translation.vector))
    }
}

/// Force of the box on the hand, N, and its torque about the hand's origin, N m, root frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PadReaction {
    /// Force.
    pub force: Vector3<f64>,
    /// Torque about the origin of the hand's frame.
    pub torque: Vector3<f64>,
    /// Sum of the normal forces, N.
    pub normal: f64,
    /// Number of points that slip.
    pub slipping: usize,
}

/// The pad.
#[derive(Clone, Debug)]
pub struct Pad {
    spec: PadSpec,
    /// Damping across and along the side, of one point, N s/m.
    damping: [f64; 2],
    /// The direction in which it presses, hand's frame.
    normal: Vector3<f64>,
    /// Points in the hand's frame, m.
    points: Vec<Point3<f64>>,
    /// Deflection of each point's bristle, box frame, m; `None` without contact.
    bristles: Vec<Option<Vector3<f64>>>,
}

impl Pad {
    /// A pad on a hand, for a box of `mass` kg.
    pub fn new(mounted: &MountedPad, mass: f64) -> Self {
        let MountedPad { spec, middle, edges, normal } = *mounted;
        let [u, v] = [edges[0] * spec.half[0], edges[1] * spec.half[1]];
        let place = |k: usize| 2.0 * k as f64 / (POINTS - 1) as f64 - 1.0;
        let points: Vec<_> =
            (0..POINTS * POINTS).map(|k| middle + u * place(k % POINTS) + v * place(k / POINTS)).collect();
        let count = points.len() as f64;
        let damping =
            [spec.stiffness, spec.shear_stiffness].map(|k| 2.0 * DAMPING_RATIO * (k * mass).sqrt() / count);
        Self { spec, damping, normal, bristles: vec![None; points.len()], points }
    }

    /// The side of a box that the pad can press: the axis of the box's frame that is most opposite to its direction.
    pub fn side(&self, hand: &Moving, carried: &Moving) -> Vector3<f64> {
        let against = -(carried.pose.rotation.inverse() * hand.pose.rotation * self.normal);
        let axis = against.iamax();
        let mut side = Vector3::zeros();
        side[axis] = against[axis].signum();
        side
    }

    /// Advances the bristles by `dt` s. `half` are the box's half edges, m. The pad is on the side in the direction
    /// `outward`, a unit vector along an axis of the box's frame.
    pub fn step(
        &mut self,
        hand: &Moving,
        carried: &Moving,
        half: &Vector3<f64>,
        outward: &Vector3<f64>,
        dt: f64,
    ) -> PadReaction {
        let count = self.points.len() as f64;
        let (k, shear) = (self.spec.stiffness / count, self.spec.shear_stiffness / count);
        let mut total = PadReaction::default();
        for i in 0..self.points.len() {
            let point = hand.pose * self.points[i];
            let local = carried.pose.inverse_transform_point(&point);
            let depth = half.dot(&outward.abs()) - local.coords.dot(outward);
            let along = local.coords - outward * local.coords.dot(outward);
            let beside = (0..3).any(|axis| along[axis].abs() > half[axis]);
            if depth <= 0.0 || depth > self.spec.thickness || beside {
                self.bristles[i] = None;
                continue;
            }
            let moving = hand.velocity_at(&point) - carried.velocity_at(&point);
            let moving = carried.pose.rotation.inverse_transform_vector(&moving);
            let closing = -moving.dot(outward);
            let normal = (k * depth + self.damping[0] * closing).max(0.0);
            let slip = moving + outward * closing;
            let mut stretch = self.bristles[i].unwrap_or_default() + slip * dt;
            stretch -= outward * stretch.dot(outward);
            let mut friction = -stretch * shear - slip * self.damping[1];
            let (size, limit) = (friction.norm(), self.spec.friction * normal);
            if size > limit {
                friction *= limit / size;
                let longest = limit / shear;
                stretch *= longest / stretch.norm().max(longest).max(f64::MIN_POSITIVE);
                total.slipping += 1;
            }
            self.bristles[i] = Some(stretch);
            let force = carried.pose.rotation * (outward * normal + friction);
            total.force += force;
            total.torque += (point.coords - hand.pose.translation.vector).cross(&force);
            total.normal += normal;
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    fn at(x: f64, z: f64, vx: f64) -> Moving {
        Moving {
            pose: Isometry3::translation(x, 0.0, z),
            linear: Vector3::new(vx, 0.0, 0.0),
            angular: Vector3::zeros(),
        }
    }

    fn pad() -> Pad {
        let spec = PadSpec { stiffness: 4000.0, half: [0.05, 0.02], ..PadSpec::default() };
        let edges = [Vector3::y(), Vector3::z()];
        let mounted = MountedPad { spec, middle: Point3::origin(), edges, normal: -Vector3::x() };
        Pad::new(&mounted, 1.5)
    }

    const HALF: Vector3<f64> = Vector3::new(0.2, 0.15, 0.1);

    fn step(pad: &mut Pad, hand: Moving) -> PadReaction {
        let carried = at(0.0, 0.0, 0.0);
        assert_eq!(pad.side(&hand, &carried), Vector3::x());
        pad.step(&hand, &carried, &HALF, &Vector3::x(), DT)
    }

    #[test]
    fn it_pushes_and_never_pulls() {
        let mut pad = pad();
        assert_eq!(step(&mut pad, at(0.21, 0.0, 0.0)), PadReaction::default());
        let pressed = step(&mut pad, at(0.19, 0.0, 0.0));
        assert!((pressed.force - Vector3::x() * 40.0).norm() < 1e-9, "{pressed:?}");
        assert!(pressed.torque.norm() < 1e-9);
        assert_eq!(step(&mut pad, at(0.199, 0.0, 5.0)).force, Vector3::zeros());
        assert_eq!(step(&mut pad, at(0.19, 0.2, 0.0)).force, Vector3::zeros());
    }

    #[test]
    fn it_sticks_up_to_the_friction_and_then_slips() {
        let mut pad = pad();
        step(&mut pad, at(0.19, 0.0, 0.0));
        for k in 1..=30 {
            let mut hand = at(0.19, 1e-3 * f64::from(k), 0.0);
            let resting = step(&mut pad.clone(), at(0.19, 1e-3 * f64::from(k - 1), 0.0));
            let expected = (2000.0 * 1e-3 * f64::from(k - 1)).min(0.9 * 40.0);
            assert!((resting.force.z + expected).abs() < 1e-9, "{k} {resting:?}");
            hand.linear.z = 1.0;
            let moving = step(&mut pad, hand);
            assert!(moving.force.z >= -0.9 * 40.0 - 1e-9);
            assert_eq!(moving.slipping == 9, moving.force.z < -0.9 * 40.0 + 1e-9, "{k} {moving:?}");
        }
    }

    #[test]
    fn an_uneven_press_turns_the_hand() {
        let mut pad = pad();
        let mut hand = at(0.19, 0.0, 0.0);
        hand.pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.05);
        let pressed = step(&mut pad, hand);
        // Points at y = +-0.05, three each: 6 k (0.05)^2 theta against the rotation.
        let expected = -6.0 * 4000.0 / 9.0 * 0.05 * 0.05 * 0.05;
        assert!((pressed.torque.z - expected).abs() < 0.03 * expected.abs(), "{pressed:?}");
    }
}
