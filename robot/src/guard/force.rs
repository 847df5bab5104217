//! The guard's force handling: one wrist sensor, its faults, and how the arm yields to a force.
//!
//! It computes velocities; [`Guard`](crate::Guard) applies them. The compensation itself is in `wrist.rs`.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::{GuardConfig, Sample};
use crate::model::Limb;
use crate::seam::lease::LeaseTable;
use crate::wrist::WristEstimator;
use crate::{Fault, Jacobian, Kinematics, Model, Wrist};

/// Once over its limit, the arm yields until the force is less than this share of it.
const YIELD_UNTIL: f64 = 0.8;
/// Damping of the yielding motion's least squares.
const YIELD_DAMPING: f64 = 0.05;

/// The wrist sensor of one limb and its status.
#[derive(Debug)]
pub(super) struct Sensor {
    pub(super) limb: Limb,
    /// The limbs that move the hand, as indices into the lease table.
    carriers: Vec<usize>,
    pub(super) estimator: WristEstimator,
    raw: Option<(Vector3<f64>, Vector3<f64>)>,
    pub(super) changed_ns: u64,
    pub(super) frozen: bool,
    pub(super) wrist: Wrist,
    /// While yielding: the limit that was exceeded and the largest force, N.
    pub(super) yielding: Option<(f64, f64)>,
    jacobian: Jacobian,
}

impl Sensor {
    pub(super) fn of(model: &Model) -> Option<Self> {
        let (limb, sensor, tcp) =
            model.limbs().values().find_map(|limb| Some((limb, model.sensor_of(limb)?, limb.tcp?)))?;
        let moves = |limb: &Limb| limb.joints.iter().any(|&j| model.moves(j, sensor));
        let carriers = model.limbs().values().enumerate().filter(|(_, l)| moves(l)).map(|(i, _)| i).collect();
        Some(Self {
            limb: limb.clone(),
            carriers,
            estimator: WristEstimator::new(model, sensor, tcp),
            raw: None,
            changed_ns: 0,
            frozen: false,
            wrist: Wrist::default(),
            yielding: None,
            jacobian: Jacobian::zeros(limb.joints.len()),
        })
    }

    /// Processes a raw sample; a sample that is not finite is ignored.
    pub(super) fn sense(&mut self, kinematics: &Kinematics, sample: &Sample, stamp_ns: u64, dt: f64) {
        let raw = (sample.force_raw, sample.torque_raw);
        if !raw.0.iter().chain(&raw.1).all(|v| v.is_finite()) {
            return;
        }
        if self.raw.replace(raw) != Some(raw) {
            self.changed_ns = stamp_ns;
        }
        self.wrist = self.estimator.update(kinematics, &sample.velocity, raw, dt.max(1e-6));
    }

    pub(super) fn find_faults(&mut self, table: &mut LeaseTable, config: &GuardConfig, stamp_ns: u64) {
        if self.frozen {
            self.yielding = None;
            let frozen_ms = stamp_ns.saturating_sub(self.changed_ns) / 1_000_000;
            self.fail(table, &Fault::FrozenWrench { frozen_ms });
            return;
        }
        let force = self.wrist.force.norm();
        let limit = self.limit(table, config);
        self.yielding = match self.yielding {
            _ if table.stopped.is_some() => None,
            Some((limit, worst)) if force > YIELD_UNTIL * limit => Some((limit, worst.max(force))),
            Some(_) => None,
            None => (force > limit).then_some((limit, force)),
        };
        if let Some((limit_n, force_n)) = self.yielding {
            self.fail(table, &Fault::Force { force_n, limit_n });
        }
    }

    /// The smallest force limit of the leases that move the hand, N.
    fn limit(&self, table: &LeaseTable, config: &GuardConfig) -> f64 {
        let of = |&i: &usize| table.slots[i].held.as_ref().and_then(|held| held.limits.force_n);
        self.carriers.iter().filter_map(of).fold(config.force_n, f64::min).max(0.0)
    }

    /// Sets the fault of every lease that moves the hand; a force fault keeps the largest force.
    fn fail(&self, table: &mut LeaseTable, fault: &Fault) {
        for &i in &self.carriers {
            table.slots[i].fail(fault);
            let held = table.slots[i].held.as_mut();
            if let (Some(Some(Fault::Force { force_n: old, .. })), Fault::Force { force_n, .. }) =
                (held.map(|h| &mut h.fault), fault)
            {
                *old = old.max(*force_n);
            }
        }
    }

    /// Joint velocities that move the TCP along the force without turning it, by damped least squares.
    pub(super) fn yield_into(
        &mut self,
        kinematics: &Kinematics,
        config: &GuardConfig,
        limit: f64,
        desired: &mut [f64],
    ) {
        let Some(tcp) = self.limb.tcp else { return };
        let force = self.wrist.force;
        let over = force.norm() - 0.5 * YIELD_UNTIL * limit;
        let Some(direction) = force.try_normalize(1e-6) else { return };
        let linear = direction * (config.yield_gain * over.max(0.0)).min(config.yield_speed_m_s);
        let twist = Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0);
        kinematics.jacobian_into(tcp, &Point3::origin(), &self.limb.joints, &mut self.jacobian);
        let mut normal = Matrix6::identity() * (YIELD_DAMPING * YIELD_DAMPING);
        for column in self.jacobian.column_iter() {
            let column: Vector6<f64> = column.into_owned();
            normal += column * column.transpose();
        }
        let Some(solved) = normal.cholesky().map(|c| c.solve(&twist)) else { return };
        for (column, &joint) in self.jacobian.column_iter().zip(&self.limb.joints) {
            desired[joint] = column.dot(&solved);
        }
    }
}
