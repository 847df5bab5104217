//! Forward kinematics and Jacobians of all links at one joint configuration. Allocates only in [`Kinematics::new`].
//!
//! A point `p` on a link moves with `v = sum_j a_j x (p - o_j) qd_j` over the revolute joints that move the link,
//! and `a_j qd_j` over the prismatic ones, where `o_j` is the joint's origin and `a_j` its axis, both in the root
//! frame.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6xX, Point3, Translation3, UnitQuaternion, Vector3};

use crate::{JointKind, JointMotion, LinkId, Model};

/// A `6 x n` Jacobian: rows linear x, y, z (m/s), then angular x, y, z (rad/s), in the root frame.
pub type Jacobian = Matrix6xX<f64>;

/// The velocity of a point on a link, in the root frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Velocity of the point, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity of the link, rad/s.
    pub angular: Vector3<f64>,
}

/// The poses of all links at the configuration of the last [`update`](Self::update).
#[derive(Clone, Debug)]
pub struct Kinematics {
    model: Arc<Model>,
    root_from_link: Vec<Isometry3<f64>>,
    /// The axis of each link's motion, root frame.
    axis: Vec<Vector3<f64>>,
    /// A point on that axis, root frame, m.
    origin: Vec<Point3<f64>>,
}

impl Kinematics {
    /// The poses at the configuration [`Model::zero`].
    pub fn new(model: &Arc<Model>) -> Self {
        let n = model.links().len();
        let mut kinematics = Self {
            model: Arc::clone(model),
            root_from_link: vec![Isometry3::identity(); n],
            axis: vec![Vector3::zeros(); n],
            origin: vec![Point3::origin(); n],
        };
        kinematics.update(&model.zero());
        kinematics
    }

    /// The robot's model.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Computes all poses at `q`, rad (m), in the order of the model's joints; missing values are read as 0.
    pub fn update(&mut self, q: &[f64]) {
        for (i, link) in self.model.links().iter().enumerate() {
            let root_from_parent = link.parent.map_or_else(Isometry3::identity, |p| self.root_from_link[p.0]);
            let mut pose = root_from_parent * link.parent_from_link;
            if let Some(motion) = &link.motion {
                let position = motion.position(q);
                self.axis[i] = pose.rotation * motion.axis.into_inner();
                self.origin[i] = Point3::from(pose.translation.vector);
                match motion.kind {
                    JointKind::Revolute => {
                        pose.rotation *= UnitQuaternion::from_axis_angle(&motion.axis, position);
                    }
                    JointKind::Prismatic => {
                        pose.translation.vector += self.axis[i] * position;
                    }
                }
            }
            self.root_from_link[i] = pose;
        }
    }

    /// The pose of a link: maps its coordinates into the root frame.
    pub fn pose(&self, link: LinkId) -> &Isometry3<f64> {
        &self.root_from_link[link.0]
    }

    /// The axis of a joint in the root frame.
    pub fn axis(&self, joint: usize) -> &Vector3<f64> {
        &self.axis[self.model.joints()[joint].link.0]
    }

    /// The origin of a joint's frame in the root frame, m (for a prismatic joint: at position 0).
    pub fn origin(&self, joint: usize) -> &Point3<f64> {
        &self.origin[self.model.joints()[joint].link.0]
    }

    /// The velocity of the point `p` (in the root frame) of `link` when the joint moves at 1 rad/s (m/s).
    pub fn column(&self, joint: usize, link: LinkId, p: &Point3<f64>) -> Twist {
        let mut sum = Twist::default();
        for (mover, motion) in self.model.motions(link).filter(|(_, motion)| motion.joint == joint) {
            self.add(&mut sum, (mover, motion), p, 1.0);
        }
        sum
    }

    /// Adds the velocity of `p` when the joint of one motion moves at `speed`.
    fn add(&self, sum: &mut Twist, (mover, motion): (LinkId, &JointMotion), p: &Point3<f64>, speed: f64) {
        let (axis, speed) = (self.axis[mover.0], motion.multiplier * speed);
        match motion.kind {
            JointKind::Revolute => {
                sum.linear += axis.cross(&(p - self.origin[mover.0])) * speed;
                sum.angular += axis * speed;
            }
            JointKind::Prismatic => sum.linear += axis * speed,
        }
    }

    /// Writes the Jacobian of the point `point_in_link` (m) for `joints` into `out`, which has one column per
    /// joint.
    pub fn jacobian_into(
        &self,
        link: LinkId,
        point_in_link: &Point3<f64>,
        joints: &[usize],
        out: &mut Jacobian,
    ) {
        let p = self.pose(link) * point_in_link;
        for (mut column, &joint) in out.column_iter_mut().zip(joints) {
            let twist = self.column(joint, link, &p);
            column.fixed_rows_mut::<3>(0).copy_from(&twist.linear);
            column.fixed_rows_mut::<3>(3).copy_from(&twist.angular);
        }
    }

    /// The Jacobian of a link's origin for `joints`; allocates.
    pub fn jacobian(&self, link: LinkId, joints: &[usize]) -> Jacobian {
        let mut out = Jacobian::zeros(joints.len());
        self.jacobian_into(link, &Point3::origin(), joints, &mut out);
        out
    }

    /// The velocity of the point `point_in_link` (m) of `link` when the joints move with `velocity`, rad/s (m/s);
    /// missing values are read as 0.
    pub fn twist(&self, link: LinkId, point_in_link: &Point3<f64>, velocity: &[f64]) -> Twist {
        let p = self.pose(link) * point_in_link;
        let mut sum = Twist::default();
        for (mover, motion) in self.model.motions(link) {
            let speed = velocity.get(motion.joint).copied().unwrap_or(0.0);
            self.add(&mut sum, (mover, motion), &p, speed);
        }
        sum
    }
}

impl Model {
    /// The pose of a link at `q` in the root frame; for many links or many calls use [`Kinematics`].
    pub fn link_pose(&self, q: &[f64], link: LinkId) -> Isometry3<f64> {
        let mut root_from_link = Isometry3::identity();
        let mut next = Some(link);
        while let Some(id) = next {
            let link = &self.links[id.0];
            let motion = link.motion.map_or_else(Isometry3::identity, |motion| {
                let position = motion.position(q);
                match motion.kind {
                    JointKind::Revolute => Isometry3::from_parts(
                        Translation3::identity(),
                        UnitQuaternion::from_axis_angle(&motion.axis, position),
                    ),
                    JointKind::Prismatic => Translation3::from(motion.axis.into_inner() * position).into(),
                }
            });
            root_from_link = link.parent_from_link * motion * root_from_link;
            next = link.parent;
        }
        root_from_link
    }

    /// The Jacobian of a link's origin at `q` for `joints`; for many calls use [`Kinematics`].
    #[must_use]
    pub fn jacobian(self: &Arc<Self>, q: &[f64], link: LinkId, joints: &[usize]) -> Jacobian {
        let mut kinematics = Kinematics::new(self);
        kinematics.update(q);
        kinematics.jacobian(link, joints)
    }
}
