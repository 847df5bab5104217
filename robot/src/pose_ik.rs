//! Inverse kinematics of a whole pose: whether it is reachable, and with which joint positions.
//!
//! Levenberg-Marquardt from a seed, with restarts from random configurations. It ignores obstacles and plans no
//! path.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Point3, Unit, UnitQuaternion, Vector3, Vector6};
use rand::{Rng, RngExt};

use crate::{Jacobian, JointKind, Kinematics, LinkId, Model, Twist};

/// When a pose counts as reached, and how long to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseOptions {
    /// Largest position error, m.
    pub position_tolerance: f64,
    /// Largest orientation error, rad.
    pub orientation_tolerance: f64,
    /// Which rotations count, about the link's x, y, z; the others are free.
    pub orient: [bool; 3],
    /// Distance to keep from joint limits, rad (m).
    pub margin: f64,
    /// Iterations from each start.
    pub iterations: usize,
    /// Random starts after the seed.
    pub restarts: usize,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            position_tolerance: 1e-4,
            orientation_tolerance: 1e-3,
            orient: [true; 3],
            margin: 0.02,
            iterations: 100,
            restarts: 20,
        }
    }
}

/// The pose is unreachable (or no solution was found); gives the error of the nearest configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "`{link}` cannot reach the pose: {:.0} mm and {:.1} degrees remain",
    position_error_m * 1e3,
    orientation_error_rad.to_degrees()
)]
pub struct IkError {
    /// The link that should reach it.
    pub link: String,
    /// Remaining distance, m.
    pub position_error_m: f64,
    /// Remaining angle of the rotations that count, rad.
    pub orientation_error_rad: f64,
    /// The nearest configuration of all joints, rad (m).
    pub nearest: Vec<f64>,
}

/// Weight of orientation against position while iterating, m/rad.
const ORIENTATION_WEIGHT: f64 = 0.3;
/// Largest change of a joint in one iteration, rad (m).
const MAX_CHANGE: f64 = 0.4;
/// Random configurations of which the one nearest to the target is the next start: most starts that fail begin far away.
const CANDIDATES: usize = 20;
/// Range of starts for joints without limits, rad.
const UNBOUNDED: f64 = std::f64::consts::PI;

/// The difference `to - from` of two poses in the root frame: m, and the rotation vector from one to the other,
/// rad. Times a gain, it is a twist that moves towards `to`.
pub fn pose_error(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Twist {
    Twist {
        linear: to.translation.vector - from.translation.vector,
        angular: (to.rotation * from.rotation.inverse()).scaled_axis(),
    }
}

/// Finds positions of `joints` for which `link` is at `root_from_target`; the other joints stay as in `seed` (all
/// joints of the model). Returns all joints. The search from the seed comes first.
///
/// # Errors
/// [`IkError`] with the smallest error that was found.
///
/// # Source
/// Sugihara 2011 (damping by the error's square).
pub fn solve_pose(
    model: &Arc<Model>,
    link: LinkId,
    joints: &[usize],
    root_from_target: &Isometry3<f64>,
    seed: &[f64],
    options: &PoseOptions,
    rng: &mut impl Rng,
) -> Result<Vec<f64>, IkError> {
    let mut solver = Solver::new(model, link, joints, options);
    let mut q = model.zero();
    for (to, from) in q.iter_mut().zip(seed) {
        *to = *from;
    }
    let mut best: Option<(f64, IkError)> = None;
    for start in 0..=options.restarts {
        if start > 0 {
            q = solver.scattered(&q, root_from_target, rng);
        }
        solver.clamp(&mut q);
        let (position, orientation) = solver.descend(&mut q, root_from_target);
        if position <= options.position_tolerance && orientation <= options.orientation_tolerance {
            return Ok(q);
        }
        let cost = cost((position, orientation));
        if best.as_ref().is_none_or(|(least, _)| cost.total_cmp(least).is_lt()) {
            let error = IkError {
                link: model.links()[link.index()].name.clone(),
                position_error_m: position,
                orientation_error_rad: orientation,
                nearest: q.clone(),
            };
            best = Some((cost, error));
        }
    }
    Err(best.expect("the seed was tried").1)
}

/// One number for both errors, m.
fn cost((position, orientation): (f64, f64)) -> f64 {
    position + ORIENTATION_WEIGHT * orientation
}

struct Solver<'a> {
    kinematics: Kinematics,
    link: LinkId,
    joints: &'a [usize],
    options: &'a PoseOptions,
    jacobian: Jacobian,
    change: Vec<f64>,
    blocked: Vec<bool>,
}

impl<'a> Solver<'a> {
    fn new(model: &Arc<Model>, link: LinkId, joints: &'a [usize], options: &'a PoseOptions) -> Self {
        let n = joints.len();
        Self {
            kinematics: Kinematics::new(model),
            link,
            joints,
            options,
            jacobian: Jacobian::zeros(n),
            change: vec![0.0; n],
            blocked: vec![false; n],
        }
    }

    fn range(&self, joint: usize) -> (f64, f64) {
        let joint = &self.kinematics.model().joints()[joint];
        let margin = self.options.margin.clamp(0.0, (0.5 * (joint.upper - joint.lower)).max(0.0));
        (joint.lower + margin, joint.upper - margin)
    }

    fn clamp(&self, q: &mut [f64]) {
        for &j in self.joints {
            let (lower, upper) = self.range(j);
            q[j] = q[j].max(lower).min(upper);
        }
    }

    /// A random configuration that is near the target.
    fn scattered(&mut self, q: &[f64], target: &Isometry3<f64>, rng: &mut impl Rng) -> Vec<f64> {
        let mut nearest = (f64::INFINITY, q.to_vec());
        for _ in 0..CANDIDATES {
            let mut candidate = q.to_vec();
            for &j in self.joints {
                let (lower, upper) = self.range(j);
                let lower = lower.max(-UNBOUNDED);
                candidate[j] = rng.random_range(lower..=upper.min(UNBOUNDED).max(lower));
            }
            self.kinematics.update(&candidate);
            let cost = cost(norms(&self.error(target)));
            if cost < nearest.0 {
                nearest = (cost, candidate);
            }
        }
        nearest.1
    }

    /// Iterates until the error no longer decreases. Returns the position and orientation errors, m and rad.
    fn descend(&mut self, q: &mut [f64], target: &Isometry3<f64>) -> (f64, f64) {
        let mut errors = (f64::INFINITY, f64::INFINITY);
        for _ in 0..self.options.iterations {
            self.kinematics.update(q);
            let error = self.error(target);
            errors = norms(&error);
            let reached = errors.0 <= self.options.position_tolerance * 0.1
                && errors.1 <= self.options.orientation_tolerance * 0.1;
            if reached || !error.iter().all(|e| e.is_finite()) || self.improve(q, &error) < 1e-9 {
                break;
            }
        }
        errors
    }

    /// The pose error in the link's frame, m and rad, without the free rotations.
    fn error(&self, target: &Isometry3<f64>) -> Vector6<f64> {
        let link_from_target = self.kinematics.pose(self.link).inverse() * target;
        let linear = link_from_target.translation.vector;
        let mut angular = turn(&link_from_target.rotation, self.options.orient);
        for axis in 0..3 {
            if !self.options.orient[axis] {
                angular[axis] = 0.0;
            }
        }
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// One damped step; returns the largest change of a joint.
    fn improve(&mut self, q: &mut [f64], error: &Vector6<f64>) -> f64 {
        self.kinematics.jacobian_into(self.link, &Point3::origin(), self.joints, &mut self.jacobian);
        let link_from_root = self.kinematics.pose(self.link).rotation.inverse();
        let weight = self.options.orient.map(|on| if on { ORIENTATION_WEIGHT } else { 0.0 });
        let weight = Vector3::from(weight);
        for mut column in self.jacobian.column_iter_mut() {
            let linear = link_from_root * column.fixed_rows::<3>(0).into_owned();
            let angular = (link_from_root * column.fixed_rows::<3>(3).into_owned()).component_mul(&weight);
            column.fixed_rows_mut::<3>(0).copy_from(&linear);
            column.fixed_rows_mut::<3>(3).copy_from(&angular);
        }
        let mut task = *error;
        for axis in 0..3 {
            task[3 + axis] *= weight[axis];
        }
        self.blocked.fill(false);
        while self.solve(&task) && self.block(q) {}
        let most = self.change.iter().fold(0.0_f64, |most, c| most.max(c.abs()));
        let scale = if most > MAX_CHANGE { MAX_CHANGE / most } else { 1.0 };
        for (&j, change) in self.joints.iter().zip(&self.change) {
            q[j] += scale * change;
            if self.turns_on(j) {
                let (lower, upper) = self.range(j);
                q[j] += if q[j] > upper {
                    -TAU
                } else if q[j] < lower {
                    TAU
                } else {
                    0.0
                };
            }
        }
        self.clamp(q);
        most
    }

    fn solve(&mut self, task: &Vector6<f64>) -> bool {
        let mut gram = Matrix6::identity() * (0.1 * task.norm_squared() + 1e-8);
        for (column, _) in self.jacobian.column_iter().zip(&self.blocked).filter(|(_, b)| !**b) {
            let column: Vector6<f64> = column.into_owned();
            gram += column * column.transpose();
        }
        let Some(solved) = gram.cholesky().map(|c| c.solve(task)) else { return false };
        for (i, column) in self.jacobian.column_iter().enumerate() {
            self.change[i] = if self.blocked[i] { 0.0 } else { column.dot(&solved) };
        }
        true
    }

    /// Whether a joint has a whole turn: where its range ends it may go on at the other end, as the pose is the same.
    fn turns_on(&self, joint: usize) -> bool {
        let (lower, upper) = self.range(joint);
        let turns = self.kinematics.model().joints()[joint].kind == JointKind::Revolute;
        turns && upper.is_finite() && lower.is_finite() && upper - lower > TAU - 0.01
    }

    /// Blocks a joint that is at its limit and would exceed it.
    fn block(&mut self, q: &[f64]) -> bool {
        for (i, &j) in self.joints.iter().enumerate() {
            let (lower, upper) = self.range(j);
            let out = (q[j] <= lower && self.change[i] < -1e-12) || (q[j] >= upper && self.change[i] > 1e-12);
            if !self.blocked[i] && out && !self.turns_on(j) {
                self.blocked[i] = true;
                self.change[i] = 0.0;
                return true;
            }
        }
        false
    }
}

/// The position and orientation parts of an error, m and rad.
fn norms(error: &Vector6<f64>) -> (f64, f64) {
    (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
}

/// The rotation vector of `rotation`. If the rotation about one axis is free, the shortest rotation that aligns
/// that axis.
fn turn(rotation: &UnitQuaternion<f64>, orient: [bool; 3]) -> Vector3<f64> {
    let mut free = (0..3).filter(|&axis| !orient[axis]);
    match (free.next(), free.next()) {
        (Some(axis), None) => {
            let here = Vector3::ith_axis(axis);
            let there = rotation * here;
            // Opposite axes: any rotation by pi about a perpendicular axis.
            let across = Unit::new_normalize(Vector3::ith((axis + 1) % 3, 1.0));
            UnitQuaternion::rotation_between_axis(&here, &Unit::new_unchecked(there.into_inner()))
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&across, std::f64::consts::PI))
                .scaled_axis()
        }
        _ => rotation.scaled_axis(),
    }
}
