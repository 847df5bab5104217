//! The guard's force handling: wrench sensors, their faults, and how arms yield to a force.
//!
//! It computes velocities; [`Guard`](crate::Guard) applies them. The compensation itself is in `wrist.rs`. Arms whose
//! hands hold one load share their faults, and where one yields, the others go with it.

use std::sync::Arc;

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::GuardConfig;
use crate::seam::lease::LeaseTable;
use crate::wrist::WristEstimator;
use crate::{Fault, ForceTorque, Jacobian, Kinematics, LinkId, Model, SensedWrench, WrenchSensor};

/// Once over its limit, the arm yields until the force is less than this share of it.
const YIELD_UNTIL: f64 = 0.8;
/// Damping of the yielding motion's least squares.
const YIELD_DAMPING: f64 = 0.05;

/// Over its limit: the limit and the largest force so far, N.
#[derive(Clone, Copy, Debug)]
struct Yielding {
    limit_n: f64,
    worst_n: f64,
}

/// One wrench sensor and its status.
#[derive(Debug)]
pub(super) struct Sensor {
    name: Arc<str>,
    /// The hand beyond it.
    hand: Option<String>,
    /// The limbs that move it, as indices into the lease table.
    carriers: Vec<usize>,
    estimator: WristEstimator,
    changed_ns: u64,
    frozen: bool,
    /// Its newest sample; `None` before the first one that is finite.
    sensed: Option<SensedWrench>,
    yielding: Option<Yielding>,
}

impl Sensor {
    /// The sensors of a robot, in the order of its description.
    pub(super) fn all(model: &Model) -> Vec<Self> {
        let sensor = |(index, wrench): (usize, &WrenchSensor)| {
            let frame = wrench.frame;
            let arm = model.arms().find(|arm| arm.wrench == Some(index));
            let moves = |joints: &[usize]| joints.iter().any(|&j| model.moves(j, frame));
            let limbs = model.limbs().values().enumerate();
            Self {
                name: wrench.name.as_str().into(),
                hand: arm.and_then(|arm| arm.hand.clone()),
                carriers: limbs.filter(|(_, limb)| moves(&limb.joints)).map(|(i, _)| i).collect(),
                estimator: WristEstimator::new(model, frame, arm.and_then(|arm| arm.tcp).unwrap_or(frame)),
                changed_ns: 0,
                frozen: false,
                sensed: None,
                yielding: None,
            }
        };
        model.wrenches().iter().enumerate().map(sensor).collect()
    }

    /// The newest sample.
    pub(super) fn sensed(&self) -> SensedWrench {
        self.sensed.unwrap_or_default()
    }

    /// Takes over what the hand beyond the sensor holds.
    pub(super) fn load(&mut self, table: &LeaseTable) {
        let load = self.hand.as_ref().and_then(|hand| table.loads.get(hand));
        self.estimator.set_load(load);
    }

    /// Takes the present force as zero.
    pub(super) fn tare(&mut self, kinematics: &Kinematics) {
        self.estimator.tare(kinematics);
    }

    /// Processes a raw sample; a sample that is not finite is ignored.
    pub(super) fn sense(
        &mut self,
        kinematics: &Kinematics,
        velocity: &[f64],
        raw: Option<&ForceTorque>,
        (stamp_ns, dt): (u64, f64),
        frozen_ns: u64,
    ) {
        if let Some(&raw) = raw.filter(|raw| raw.is_finite()) {
            if self.sensed.is_none_or(|before| before.raw != raw) {
                self.changed_ns = stamp_ns;
            }
            let external = self.estimator.update(kinematics, velocity, raw, dt.max(1e-6));
            self.sensed = Some(SensedWrench { raw, external });
        }
        self.frozen = stamp_ns.saturating_sub(self.changed_ns) >= frozen_ns;
    }

    pub(super) fn find_faults(&mut self, table: &mut LeaseTable, config: &GuardConfig, stamp_ns: u64) {
        if self.frozen {
            self.yielding = None;
            let frozen_ms = stamp_ns.saturating_sub(self.changed_ns) / 1_000_000;
            self.fail(table, &Fault::FrozenWrench { sensor: Arc::clone(&self.name), frozen_ms });
            return;
        }
        let force_n = self.sensed().external.force.norm();
        let limit_n = self.limit(table, config);
        self.yielding = match self.yielding {
            _ if table.stopped.is_some() => None,
            Some(Yielding { limit_n, worst_n }) if force_n > YIELD_UNTIL * limit_n => {
                Some(Yielding { limit_n, worst_n: worst_n.max(force_n) })
            }
            Some(_) => None,
            None => (force_n > limit_n).then_some(Yielding { limit_n, worst_n: force_n }),
        };
        if let Some(Yielding { limit_n, worst_n: force_n }) = self.yielding {
            self.fail(table, &Fault::Force { sensor: Arc::clone(&self.name), force_n, limit_n });
        }
    }

    /// The smallest force limit of the leases that move the hand, N.
    fn limit(&self, table: &LeaseTable, config: &GuardConfig) -> f64 {
        let GuardConfig { force_n, most_force_n, .. } = *config;
        let held = self.carriers.iter().filter_map(|&i| table.slots[i].held.as_ref());
        let limits = held.map(|held| held.limits.force_n.map_or(force_n, |said| said.min(most_force_n)));
        limits.reduce(f64::min).unwrap_or(force_n).max(0.0)
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

    /// The velocity with which the hand goes along the force while that is over its limit, m/s.
    fn yielding_velocity(&self, config: &GuardConfig) -> Option<Vector3<f64>> {
        let Yielding { limit_n, .. } = self.yielding?;
        let force = self.sensed().external.force;
        let over = force.norm() - 0.5 * YIELD_UNTIL * limit_n;
        let speed = (config.yield_gain * over.max(0.0)).min(config.yield_speed_m_s);
        Some(force.try_normalize(1e-6)? * speed)
    }
}

/// An arm, as far as it yields.
#[derive(Debug)]
struct YieldingArm {
    /// Its index in the lease table.
    limb: usize,
    hand: Option<String>,
    wrench: Option<usize>,
    tcp: LinkId,
    joints: Vec<usize>,
    jacobian: Jacobian,
    /// The arms with whose hands its own holds a load, as indices among the arms.
    partners: Vec<usize>,
}

/// All arms that can yield.
#[derive(Debug)]
pub(super) struct YieldingArms(Vec<YieldingArm>);

impl YieldingArms {
    pub(super) fn new(model: &Model) -> Self {
        let arm = |(index, limb): (usize, &crate::Limb)| {
            Some(YieldingArm {
                limb: index,
                hand: limb.hand.clone(),
                wrench: limb.wrench,
                tcp: limb.tcp?,
                joints: limb.joints.clone(),
                jacobian: Jacobian::zeros(limb.joints.len()),
                partners: Vec::new(),
            })
        };
        Self(model.limbs().values().enumerate().filter_map(arm).collect())
    }

    /// Finds the arms that hold one load together.
    pub(super) fn load(&mut self, table: &LeaseTable) {
        let held = |arm: &YieldingArm| Some(table.loads.get(arm.hand.as_ref()?)?.name.clone());
        let held: Vec<Option<String>> = self.0.iter().map(held).collect();
        for (i, arm) in self.0.iter_mut().enumerate() {
            let with = |k: &usize| *k != i && held[i].is_some() && held[*k] == held[i];
            arm.partners = (0..held.len()).filter(with).collect();
        }
    }

    /// Arms that hold one load share their faults: where one is taken from its commander, the others are, too.
    pub(super) fn share_faults(&self, table: &mut LeaseTable) {
        for arm in self.0.iter().filter(|arm| !arm.partners.is_empty()) {
            let fault = table.slots[arm.limb].held.as_ref().and_then(|held| held.fault.clone());
            let Some(fault) = fault else { continue };
            arm.partners.iter().for_each(|&partner| table.slots[self.0[partner].limb].fail(&fault));
        }
    }

    /// Joint velocities of the arms that yield: each moves its TCP along the force without turning it. An arm that
    /// holds a load together with one that yields goes with it.
    pub(super) fn yield_into(
        &mut self,
        sensors: &[Sensor],
        kinematics: &Kinematics,
        config: &GuardConfig,
        desired: &mut [f64],
    ) {
        let own = |arm: &YieldingArm| sensors.get(arm.wrench?)?.yielding_velocity(config);
        for i in 0..self.0.len() {
            let arm = &self.0[i];
            let velocity =
                own(arm).or_else(|| arm.partners.iter().find_map(|&partner| own(&self.0[partner])));
            if let Some(velocity) = velocity {
                self.0[i].move_tcp(kinematics, velocity, desired);
            }
        }
    }
}

impl YieldingArm {
    /// Joint velocities that move the TCP straight, by damped least squares.
    fn move_tcp(&mut self, kinematics: &Kinematics, linear: Vector3<f64>, desired: &mut [f64]) {
        let twist = Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0);
        kinematics.jacobian_into(self.tcp, &Point3::origin(), &self.joints, &mut self.jacobian);
        let mut normal = Matrix6::identity() * (YIELD_DAMPING * YIELD_DAMPING);
        for column in self.jacobian.column_iter() {
            let column: Vector6<f64> = column.into_owned();
            normal += column * column.transpose();
        }
        let Some(solved) = normal.cholesky().map(|c| c.solve(&twist)) else { return };
        for (column, &joint) in self.jacobian.column_iter().zip(&self.joints) {
            desired[joint] = column.dot(&solved);
        }
    }
}
