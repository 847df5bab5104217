//! Bodies of the robot stop before each other: the speed at which two of them approach is bounded by the distance that
//! is left between them, in the measured and in the commanded configuration. Pure; it only limits commands.

use std::sync::Arc;

use crate::bodies::{Bodies, Distances, KEPT, Near};
use crate::{Kinematics, LinkId, Model};

/// From this distance on they slow down, m.
const SLOWING: f64 = 0.2;
/// Approaching speed per distance that is left, 1/s. From the largest speed of a TCP, 1 m/s, this brakes with at most
/// 4 m/s² and comes to rest at [`KEPT`] without overshoot.
const RATE: f64 = 4.0;

/// Watches the robot's own bodies.
#[derive(Debug)]
pub(crate) struct Clearance {
    measured: Distances,
    commanded: Distances,
    commanded_kinematics: Kinematics,
    /// For each pair, the limbs that move one of its bodies against the other, as indices into the lease table.
    carriers: Vec<Vec<usize>>,
}

impl Clearance {
    pub(crate) fn new(model: &Arc<Model>) -> Self {
        let bodies = Arc::new(Bodies::new(model));
        let carriers = |[a, b]: [LinkId; 2]| {
            let moves = |joints: &[usize]| joints.iter().any(|&j| model.moves(j, a) != model.moves(j, b));
            let limbs = model.limbs().values().enumerate();
            limbs.filter(|(_, limb)| moves(&limb.joints)).map(|(index, _)| index).collect()
        };
        Self {
            measured: Distances::new(&bodies),
            commanded: Distances::new(&bodies),
            commanded_kinematics: Kinematics::new(model),
            carriers: bodies.pairs().map(carriers).collect(),
        }
    }

    /// Takes over the measured poses and the commanded joint positions.
    pub(crate) fn update(&mut self, measured: &Kinematics, commanded: &[f64]) {
        self.measured.update(measured);
        self.commanded_kinematics.update(commanded);
        self.commanded.update(&self.commanded_kinematics);
    }

    /// For each pair that approaches too fast with the joint velocities `desired`: the limbs that move it, and the
    /// factor by which they have to be slower.
    pub(crate) fn bounds<'a>(&'a self, desired: &'a [f64]) -> impl Iterator<Item = (&'a [usize], f64)> {
        let kinematics = &self.commanded_kinematics;
        let near = self.measured.near(SLOWING).chain(self.commanded.near(SLOWING));
        near.filter_map(move |(pair, near)| {
            let approach = approach(kinematics, &near, desired);
            let limit = RATE * (near.distance - KEPT).max(0.0);
            (approach > limit).then(|| (self.carriers[pair].as_slice(), limit / approach))
        })
    }
}

/// The speed at which the nearest points of two bodies approach, m/s.
fn approach(kinematics: &Kinematics, near: &Near, desired: &[f64]) -> f64 {
    let [first, second] = [0, 1].map(|i| {
        let (link, point) = (near.links[i], near.points[i]);
        let in_link = kinematics.pose(link).inverse_transform_point(&point);
        kinematics.twist(link, &in_link, desired).linear
    });
    (first - second).dot(&near.direction)
}
