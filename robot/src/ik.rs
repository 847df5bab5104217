//! Differential inverse kinematics: from a twist of a link to joint velocities, by damped least squares.
//!
//! The task is `S (J dq - v) = 0` with row weights `S`. Each singular direction of `S J` is damped by its own
//! singular value only, so that a well-conditioned direction is followed exactly beside an ill-conditioned one. The
//! null space of the task pulls the joints towards a posture. A joint at its limit is blocked, and the others solve
//! the task again. Finally the whole velocity is scaled to the joint speed limits, which keeps its direction.

use std::sync::Arc;

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use crate::{Jacobian, Kinematics, LinkId, Model, Twist};

/// Weights and bounds of [`DifferentialIk`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkConfig {
    /// Weights of linear x, y, z: which errors count when not all can vanish. In the link's frame; 0 leaves an axis
    /// free.
    pub linear_weight: Vector3<f64>,
    /// Weights of angular x, y, z (m/rad), likewise: `(1, 1, 0) * 0.3` leaves the rotation about the link's z free.
    pub angular_weight: Vector3<f64>,
    /// Singular values of the weighted Jacobian below this are damped.
    pub singular: f64,
    /// Damping at a singular value of 0.
    pub damping: f64,
    /// Gain of the pull towards the posture, 1/s.
    pub posture_gain: f64,
    /// Largest share of a joint's speed limit that this pull may use.
    pub posture_share: f64,
    /// Distance to keep from joint limits, rad (m).
    pub margin: f64,
    /// Time constant with which a joint may approach its margin: its speed is the remaining distance over this
    /// time, s.
    pub limit_time_s: f64,
    /// Share of the joint speed limits that is used.
    pub speed_share: f64,
}

impl Default for IkConfig {
    fn default() -> Self {
        Self {
            linear_weight: Vector3::repeat(1.0),
            angular_weight: Vector3::repeat(0.3),
            singular: 0.06,
            damping: 0.06,
            posture_gain: 1.0,
            posture_share: 0.3,
            margin: 0.02,
            limit_time_s: 0.1,
            speed_share: 1.0,
        }
    }
}

/// Number of bisections to find the scale of a twist that is too fast.
const SCALE_HALVINGS: usize = 5;

/// The joint velocities of one step.
#[derive(Clone, Copy, Debug)]
pub struct IkStep<'a> {
    /// Velocities of the chosen joints, rad/s (m/s), in their order.
    pub velocities: &'a [f64],
    /// The twist of the link's origin with them, root frame.
    pub twist: Twist,
    /// The share of the twist that respects the joint speed limits, in `0..=1`; below 1 the motion is slower than
    /// requested.
    pub scale: f64,
    /// The part of the (scaled) twist that is not achieved, weighted, m/s: 0 away from singularities and joint
    /// limits.
    pub residual: f64,
    /// Smallest singular value of the weighted Jacobian over the axes that are not free.
    pub singular: f64,
}

/// Solves the velocity of one link with some of the joints. Allocates only in [`new`](Self::new).
#[derive(Clone, Debug)]
pub struct DifferentialIk {
    kinematics: Kinematics,
    joints: Vec<usize>,
    link: LinkId,
    config: IkConfig,
    jacobian: Jacobian,
    weighted: Jacobian,
    velocity: Vec<f64>,
    pull: Vec<f64>,
    blocked: Vec<bool>,
    saved: Vec<f64>,
    saved_blocked: Vec<bool>,
}

impl DifferentialIk {
    /// Moves `link` with `joints` (indices into the model's joints: a limb's, or a limb's and the torso's).
    pub fn new(model: &Arc<Model>, link: LinkId, joints: &[usize], config: IkConfig) -> Self {
        let n = joints.len();
        Self {
            kinematics: Kinematics::new(model),
            joints: joints.to_vec(),
            link,
            config,
            jacobian: Jacobian::zeros(n),
            weighted: Jacobian::zeros(n),
            velocity: vec![0.0; n],
            pull: vec![0.0; n],
            blocked: vec![false; n],
            saved: vec![0.0; n],
            saved_blocked: vec![false; n],
        }
    }

    /// The kinematics at the configuration of the last step.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// The joints that it moves.
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }

    /// The joint velocities that move the link's origin with `twist` (root frame) at the configuration `q` (all
    /// joints of the model). The null space pulls the chosen joints towards `posture`, if given.
    ///
    /// A twist that is not finite yields velocities of 0 and a scale of 0.
    ///
    /// # Source
    /// Chiaverini 1997 (damping), Flacco et al. 2012 (joints at their limits; differs in: if the task cannot be
    /// met, it takes the least-squares solution, so that the arm slides along its limits instead of standing).
    pub fn step(&mut self, q: &[f64], twist: &Twist, posture: Option<&[f64]>) -> IkStep<'_> {
        self.velocity.fill(0.0);
        if !twist.linear.iter().chain(&twist.angular).all(|v| v.is_finite()) {
            let twist = Twist::default();
            return IkStep { velocities: &self.velocity, twist, scale: 0.0, residual: 0.0, singular: 0.0 };
        }
        self.kinematics.update(q);
        let task = self.weigh(twist);
        self.draw(q, posture);
        self.blocked.fill(false);
        let mut singular = self.solve(&task);
        for _ in 0..self.joints.len() {
            if !self.block(q) {
                break;
            }
            singular = self.solve(&task);
        }
        let scale = self.bound_speed(&task);
        let residual = (self.product(&self.velocity) - scale * task).norm();
        let achieved = product(&self.jacobian, &self.velocity);
        let [linear, angular] = [0, 3].map(|row| achieved.fixed_rows::<3>(row).into_owned());
        let twist = Twist { linear, angular };
        IkStep { velocities: &self.velocity, twist, scale, residual, singular }
    }

    /// Computes the weighted Jacobian, in the link's frame, and returns the weighted twist.
    fn weigh(&mut self, twist: &Twist) -> Vector6<f64> {
        self.kinematics.jacobian_into(self.link, &Point3::origin(), &self.joints, &mut self.jacobian);
        let link_from_root = self.kinematics.pose(self.link).rotation.inverse();
        let (wl, wa) = (self.config.linear_weight, self.config.angular_weight);
        let weigh = |linear: Vector3<f64>, angular: Vector3<f64>| {
            let l = (link_from_root * linear).component_mul(&wl);
            let a = (link_from_root * angular).component_mul(&wa);
            Vector6::new(l.x, l.y, l.z, a.x, a.y, a.z)
        };
        for (from, mut to) in self.jacobian.column_iter().zip(self.weighted.column_iter_mut()) {
            to.copy_from(&weigh(from.fixed_rows::<3>(0).into_owned(), from.fixed_rows::<3>(3).into_owned()));
        }
        weigh(twist.linear, twist.angular)
    }

    /// Computes the bounded velocity towards the posture.
    fn draw(&mut self, q: &[f64], posture: Option<&[f64]>) {
        let joints = self.kinematics.model().joints();
        for (i, &j) in self.joints.iter().enumerate() {
            let now = q.get(j).copied().unwrap_or(0.0);
            let goal = posture.and_then(|p| p.get(i)).copied().filter(|g| g.is_finite()).unwrap_or(now);
            let bound = self.config.posture_share * joints[j].velocity;
            self.pull[i] = (self.config.posture_gain * (goal - now)).clamp(-bound, bound);
        }
    }

    /// Solves the task with the joints that are not blocked; blocked joints keep their velocity. Returns the
    /// smallest singular value over the axes that count.
    fn solve(&mut self, task: &Vector6<f64>) -> f64 {
        self.solve_from(task, true)
    }

    /// Solves with the least change from the velocity towards the posture, or else from the present velocity.
    fn solve_from(&mut self, task: &Vector6<f64>, pull: bool) -> f64 {
        for i in 0..self.joints.len() {
            if pull && !self.blocked[i] {
                self.velocity[i] = self.pull[i];
            }
        }
        let missing = task - self.product(&self.velocity);
        let mut gram = Matrix6::zeros();
        for (column, _) in self.weighted.column_iter().zip(&self.blocked).filter(|(_, blocked)| !**blocked) {
            let column: Vector6<f64> = column.into_owned();
            gram += column * column.transpose();
        }
        let eigen = gram.symmetric_eigen();
        let counts = |v: &Vector6<f64>| {
            let (wl, wa) = (&self.config.linear_weight, &self.config.angular_weight);
            (0..6).any(|r| v[r].abs() > 1e-6 && if r < 3 { wl[r] > 0.0 } else { wa[r - 3] > 0.0 })
        };
        let mut solved = Vector6::zeros();
        let mut smallest = f64::INFINITY;
        for i in 0..6 {
            let direction: Vector6<f64> = eigen.eigenvectors.column(i).into_owned();
            let squared = eigen.eigenvalues[i].max(0.0);
            let singular = squared.sqrt();
            if !counts(&direction) {
                continue;
            }
            smallest = smallest.min(singular);
            let lack = (1.0 - (singular / self.config.singular).powi(2)).max(0.0);
            let damped = squared + self.config.damping.powi(2) * lack;
            if damped > 0.0 {
                solved += direction * (direction.dot(&missing) / damped);
            }
        }
        for (i, column) in self.weighted.column_iter().enumerate() {
            if !self.blocked[i] {
                self.velocity[i] += column.dot(&solved);
            }
        }
        smallest
    }

    /// Blocks the joint that exceeds its position bound the most, at the speed that it may have. Returns whether
    /// there was one.
    fn block(&mut self, q: &[f64]) -> bool {
        let joints = self.kinematics.model().joints();
        let mut worst: Option<(usize, f64, f64)> = None;
        for (i, &j) in self.joints.iter().enumerate().filter(|(i, _)| !self.blocked[*i]) {
            let now = q.get(j).copied().unwrap_or(0.0);
            let speed = |distance: f64| distance / self.config.limit_time_s;
            // A joint beyond its margin is not driven back; it only may not move further out.
            let up = speed((joints[j].upper - self.config.margin - now).max(0.0));
            let down = speed((now - joints[j].lower - self.config.margin).max(0.0));
            let allowed = self.velocity[i].clamp(-down, up);
            let excess = (self.velocity[i] - allowed).abs();
            if excess > 1e-9 && worst.is_none_or(|(_, _, most)| excess > most) {
                worst = Some((i, allowed, excess));
            }
        }
        let Some((i, allowed, _)) = worst else { return false };
        self.blocked[i] = true;
        self.velocity[i] = allowed;
        true
    }

    /// Brings the joints within their speed limits: by the null space as far as possible, else by scaling the whole
    /// motion. Returns the scale.
    fn bound_speed(&mut self, task: &Vector6<f64>) -> f64 {
        let Some((_, excess)) = self.excess() else { return 1.0 };
        self.saved.copy_from_slice(&self.velocity);
        self.saved_blocked.copy_from_slice(&self.blocked);
        let missed = (self.product(&self.velocity) - task).norm() + 1e-3 * task.norm();
        // A scale of 1 / excess always fits; the largest scale that fits is between that and 1.
        let (mut fits, mut fails) = (1.0 / excess, 1.0);
        if self.relieve(task, 1.0, missed) {
            return 1.0;
        }
        for _ in 0..SCALE_HALVINGS {
            let scale = 0.5 * (fits + fails);
            if self.relieve(task, scale, missed) { fits = scale } else { fails = scale }
        }
        if !self.relieve(task, fits, missed) {
            self.restart(fits);
        }
        fits
    }

    /// Restores the saved solution, scaled.
    fn restart(&mut self, scale: f64) {
        for (velocity, saved) in self.velocity.iter_mut().zip(&self.saved) {
            *velocity = scale * saved;
        }
        self.blocked.copy_from_slice(&self.saved_blocked);
    }

    /// Whether the saved solution, scaled, can be brought within the speed limits: joints that are too fast are set
    /// to their limit and the others compensate, with an error of at most `missed` of the scaled task.
    fn relieve(&mut self, task: &Vector6<f64>, scale: f64, missed: f64) -> bool {
        self.restart(scale);
        let scaled = task * scale;
        for _ in 0..=self.joints.len() {
            let Some((worst, excess)) = self.excess() else { return true };
            if self.blocked[worst] {
                return false;
            }
            self.blocked[worst] = true;
            self.velocity[worst] /= excess;
            self.solve_from(&scaled, false);
            if (self.product(&self.velocity) - scaled).norm() > missed * scale {
                return false;
            }
        }
        false
    }

    /// The joint that exceeds its speed limit the most, and the factor; `None` if all are within their limits.
    fn excess(&self) -> Option<(usize, f64)> {
        let joints = self.kinematics.model().joints();
        let share =
            |i: usize| self.velocity[i].abs() / (self.config.speed_share * joints[self.joints[i]].velocity);
        let worst = (0..self.joints.len()).max_by(|a, b| share(*a).total_cmp(&share(*b)))?;
        (share(worst) > 1.0 + 1e-9).then(|| (worst, share(worst)))
    }

    fn product(&self, velocity: &[f64]) -> Vector6<f64> {
        product(&self.weighted, velocity)
    }
}

fn product(jacobian: &Jacobian, velocity: &[f64]) -> Vector6<f64> {
    let columns = jacobian.column_iter().zip(velocity);
    columns.map(|(column, speed)| column * *speed).sum()
}
