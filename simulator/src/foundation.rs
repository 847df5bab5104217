//! The soft underside of an object: a grid of springs, with friction, on the table.
//!
//! An elastic (Winkler) foundation: the underside is a grid of cells. Each cell has an independent spring and
//! damper along the table's normal, and a bristle along its surface that sticks up to Coulomb's limit and then
//! slips (the stick-slip of Dahl's and LuGre's models without their rate effects). The result is force, moment and
//! local pressure. It does not depend on what holds the object. The sides and the top have no springs.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::table::{DirtGrid, TableTop};
use crate::world::Softness;

/// Approximate edge of a cell, m.
const CELL: f64 = 0.01;
/// Part of critical damping (of the free object) along the normal and along the surface.
const DAMPING_RATIO: f64 = 0.6;
/// Ratio of shear stiffness to normal stiffness: 8 N at friction 0.5 stick up to 1 mm on the default sponge.
const SHEAR_RATIO: f64 = 2.0;
/// The evenly distributed force on the whole underside at which it begins to clean, N: more than 2, less than 5.
pub const CLEANING_FORCE: f64 = 2.5;

/// The underside of one object.
#[derive(Clone, Debug)]
pub struct ElasticFoundation {
    half: Vector3<f64>,
    counts: [usize; 2],
    stiffness: f64,
    damping: f64,
    shear_stiffness: f64,
    shear_damping: f64,
    /// Deflection of each cell's bristle, root frame, m; `None` without contact.
    bristles: Vec<Option<Vector3<f64>>>,
}

/// The motion of an object: pose of its frame (its middle), velocity of its middle, m/s, and angular velocity,
/// rad/s, root frame.
#[derive(Clone, Copy, Debug)]
pub struct RigidMotion {
    /// Pose of the object.
    pub root_from_object: Isometry3<f64>,
    /// Velocity of its middle, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular: Vector3<f64>,
}

/// Force and torque of the table on the object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoundationReaction {
    /// Force, root frame, N.
    pub force: Vector3<f64>,
    /// Torque about the object's middle, root frame, N m.
    pub torque: Vector3<f64>,
    /// Sum of the cells' normal forces, N.
    pub normal: f64,
    /// The sum of the cells' friction forces, root frame, N.
    pub friction: Vector3<f64>,
}

impl ElasticFoundation {
    /// The underside of an object with half edges `size / 2`.
    pub fn new(object: &Softness) -> Self {
        let half = Vector3::from(object.size) / 2.0;
        let counts = [object.size[0], object.size[1]].map(|s| ((s / CELL).round() as usize).clamp(2, 20));
        let cells = (counts[0] * counts[1]) as f64;
        let shear = SHEAR_RATIO * object.stiffness;
        Self {
            half,
            counts,
            stiffness: object.stiffness / cells,
            damping: 2.0 * DAMPING_RATIO * (object.stiffness * object.mass).sqrt() / cells,
            shear_stiffness: shear / cells,
            shear_damping: 2.0 * DAMPING_RATIO * (shear * object.mass).sqrt() / cells,
            bristles: vec![None; counts[0] * counts[1]],
        }
    }

    /// Half the object's edges, m.
    pub fn half(&self) -> &Vector3<f64> {
        &self.half
    }

    /// Middle of a cell of the underside, object frame, m.
    fn cell(&self, i: usize) -> Point3<f64> {
        let (column, row) = (i % self.counts[0], i / self.counts[0]);
        let place = |k: usize, n: usize| self.half[k] * ((2 * n + 1) as f64 / self.counts[k] as f64 - 1.0);
        Point3::new(place(0, column), place(1, row), -self.half.z)
    }

    /// Whether a cell could touch: the object's bounding sphere reaches the table's plane.
    fn is_near(&self, table: &TableTop, pose: &Isometry3<f64>) -> bool {
        let local = table.root_from_top().inverse_transform_point(&Point3::from(pose.translation.vector));
        local.z < self.half.norm() + 0.03
    }

    /// Advances the bristles by `dt` s and returns the table's reaction on the object.
    pub fn step(&mut self, table: &TableTop, motion: &RigidMotion, dt: f64) -> FoundationReaction {
        let mut total = FoundationReaction::default();
        if !self.is_near(table, &motion.root_from_object) {
            self.bristles.fill(None);
            return total;
        }
        for i in 0..self.bristles.len() {
            let arm = motion.root_from_object.rotation * self.cell(i).coords;
            let point = Point3::from(motion.root_from_object.translation.vector + arm);
            let surface = table.surface(&point).filter(|s| s.depth > 0.0);
            let Some(surface) = surface else {
                self.bristles[i] = None;
                continue;
            };
            let velocity = motion.linear + motion.angular.cross(&arm);
            let closing = -velocity.dot(&surface.normal);
            let normal = (self.stiffness * surface.depth + self.damping * closing).max(0.0);
            let slip = velocity + surface.normal * closing;
            let friction = self.friction(i, &surface.normal, &slip, table.friction() * normal, dt);
            let force = surface.normal * normal + friction;
            total.force += force;
            total.torque += arm.cross(&force);
            total.normal += normal;
            total.friction += friction;
        }
        total
    }

    /// Deflects a cell's bristle by the slip and returns its force, at most `limit` N.
    fn friction(
        &mut self,
        cell: usize,
        normal: &Vector3<f64>,
        slip: &Vector3<f64>,
        limit: f64,
        dt: f64,
    ) -> Vector3<f64> {
        let old = self.bristles[cell].unwrap_or_default();
        let mut stretch = old + slip * dt;
        stretch -= normal * stretch.dot(normal);
        let mut force = -stretch * self.shear_stiffness - slip * self.shear_damping;
        let magnitude = force.norm();
        if magnitude > limit {
            force *= limit / magnitude;
            stretch = -force / self.shear_stiffness;
        }
        self.bristles[cell] = Some(stretch);
        force
    }

    /// Compression of a cell at which it begins to clean, m: [`CLEANING_FORCE`] spread over the whole underside.
    pub fn cleaning_depth(&self) -> f64 {
        CLEANING_FORCE / (self.stiffness * self.bristles.len() as f64)
    }

    /// Marks the cells that the object wipes: cells of the grid under a cell of the underside whose elastic
    /// pressure is over the threshold. Returns whether any was new.
    pub fn wipe(&self, table: &TableTop, pose: &Isometry3<f64>, dirt: &mut DirtGrid) -> bool {
        let threshold = self.cleaning_depth();
        let presses: Vec<bool> = (0..self.bristles.len())
            .map(|i| table.surface(&(pose * self.cell(i))).is_some_and(|s| s.depth > threshold))
            .collect();
        presses.contains(&true) && self.under(table, pose, dirt, |cell| presses[cell])
    }

    /// Marks the cells of the grid that lie under the object.
    pub fn cover(&self, table: &TableTop, pose: &Isometry3<f64>, dirt: &mut DirtGrid) -> bool {
        self.under(table, pose, dirt, |_| true)
    }

    fn under(
        &self,
        table: &TableTop,
        pose: &Isometry3<f64>,
        dirt: &mut DirtGrid,
        test: impl Fn(usize) -> bool,
    ) -> bool {
        let top_from_object = table.root_from_top().inverse() * pose;
        let object_from_top = top_from_object.inverse();
        let low = top_from_object * Point3::new(0.0, 0.0, -self.half.z);
        let radius = libm::hypot(self.half.x, self.half.y) + 0.01;
        let [nx, ny] = self.counts.map(|c| c as f64);
        dirt.mark([low.x, low.y], radius, |x, y| {
            let p = object_from_top * Point3::new(x, y, low.z);
            let column = (p.x / self.half.x + 1.0) / 2.0 * nx;
            let row = (p.y / self.half.y + 1.0) / 2.0 * ny;
            if !(0.0..nx).contains(&column) || !(0.0..ny).contains(&row) {
                return false;
            }
            test(row as usize * self.counts[0] + column as usize)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{BodySpec, ObjectSpec, TableSpec};

    const DT: f64 = 1e-3;

    fn sponge() -> Softness {
        BodySpec::from(&ObjectSpec::default()).softness().unwrap()
    }

    fn level(friction: f64) -> TableTop {
        TableTop::new(&TableSpec { tilt_deg: [0.0; 2], bumps: vec![], friction, ..TableSpec::default() })
    }

    fn pressed(depth: f64, linear: Vector3<f64>) -> RigidMotion {
        let root_from_object = Isometry3::translation(0.3, 0.5, 0.95 + 0.02 - depth);
        RigidMotion { root_from_object, linear, angular: Vector3::zeros() }
    }

    #[test]
    fn a_static_press_is_stiffness_times_depth() {
        let mut foundation = ElasticFoundation::new(&sponge());
        let r = foundation.step(&level(0.5), &pressed(0.004, Vector3::zeros()), DT);
        assert!((r.normal - 8.0).abs() < 1e-9, "{r:?}");
        assert!((r.force - Vector3::z() * 8.0).norm() < 1e-9);
        assert!(r.torque.norm() < 1e-9);
        assert_eq!(foundation.step(&level(0.5), &pressed(-0.001, Vector3::zeros()), DT).normal, 0.0);
    }

    #[test]
    fn sliding_friction_is_coulombs_and_starts_with_the_shear_stiffness() {
        let mut foundation = ElasticFoundation::new(&sponge());
        let slow = pressed(0.004, Vector3::x() * 0.02);
        let table = level(0.5);
        let first = foundation.step(&table, &slow, DT).friction.x;
        let second = foundation.step(&table, &slow, DT).friction.x;
        let slope = -(second - first) / (0.02 * DT);
        assert!((slope - 4000.0).abs() < 1e-6, "{slope}");
        let mut last = FoundationReaction::default();
        for _ in 0..200 {
            last = foundation.step(&table, &slow, DT);
        }
        assert!((last.friction - Vector3::x() * -4.0).norm() < 1e-9, "{last:?}");
    }

    #[test]
    fn friction_holds_at_rest_after_sliding() {
        let mut foundation = ElasticFoundation::new(&sponge());
        let table = level(0.5);
        for _ in 0..200 {
            foundation.step(&table, &pressed(0.004, Vector3::x() * 0.05), DT);
        }
        let rest = foundation.step(&table, &pressed(0.004, Vector3::zeros()), DT);
        assert!(rest.friction.x < -2.0 && rest.friction.norm() <= 4.0 + 1e-9);
    }

    /// A free object on an inclined table stays if the slope is less than the friction, and else slides with `g
    /// (sin a - mu cos a)`.
    #[test]
    fn the_slope_decides() {
        for (mu, slides) in [(0.30, false), (0.20, true)] {
            let spec =
                TableSpec { tilt_deg: [15.0, 0.0], bumps: vec![], friction: mu, ..TableSpec::default() };
            let table = TableTop::new(&spec);
            let object = sponge();
            let mut foundation = ElasticFoundation::new(&object);
            let n = table.plane_normal();
            let sink = object.mass * 9.81 * n.z / object.stiffness;
            let start = table.root_from_top() * Point3::new(0.0, 0.0, 0.02 - sink);
            let (mut position, mut velocity) = (start.coords, Vector3::zeros());
            let rotation = table.root_from_top().rotation;
            for _ in 0..300 {
                let motion = RigidMotion {
                    root_from_object: Isometry3::from_parts(position.into(), rotation),
                    linear: velocity,
                    angular: Vector3::zeros(),
                };
                let force = foundation.step(&table, &motion, DT).force - Vector3::z() * 9.81 * object.mass;
                velocity += force / object.mass * DT;
                position += velocity * DT;
            }
            let slope = 15f64.to_radians();
            let expected = 9.81 * (libm::sin(slope) - mu * libm::cos(slope)) * 0.3;
            if slides {
                assert!((velocity.norm() / expected - 1.0).abs() < 0.1, "{} {expected}", velocity.norm());
            } else {
                assert!(velocity.norm() < 1e-3, "{}", velocity.norm());
            }
        }
    }

    #[test]
    fn five_newton_clean_and_two_do_not() {
        let table = level(0.5);
        let foundation = ElasticFoundation::new(&sponge());
        let mut dirt = DirtGrid::new(&table);
        assert!(!foundation.wipe(&table, &pressed(0.001, Vector3::zeros()).root_from_object, &mut dirt));
        assert!(foundation.wipe(&table, &pressed(0.0025, Vector3::zeros()).root_from_object, &mut dirt));
        let area = dirt.cells().iter().filter(|m| **m).count() as f64 * 0.0025 * 0.0025;
        assert!((area - 0.007).abs() < 1e-6, "{area}");
        let mut footprint = DirtGrid::new(&table);
        foundation.cover(&table, &pressed(0.0, Vector3::zeros()).root_from_object, &mut footprint);
        assert_eq!(footprint.covered_by(&dirt), Some(1.0));
    }
}
