//! An arm and what helps it under a skill's command: sense, then command, at the rate of the robot's samples.
//!
//! It holds their leases for as long as it lives, and converts desired TCP poses and twists to joint velocities. Which
//! limbs help an arm (a torso, so that it reaches further) is said in the robot file. It plans nothing.

use std::sync::Arc;

use armarium_robot::{
    DifferentialIk, IkConfig, Kinematics, Lease, LeaseLimits, Limb, LinkId, Model, Robot, Sensed, Twist,
    newest,
};
use armarium_runtime::skill::{Failure, SkillContext, SkillManifest};
use nalgebra::{Isometry3, Point3, Vector3};
use tokio_util::sync::CancellationToken;

use crate::equipment::Equipment;

/// Gain of the TCP's position and orientation error, 1/s.
const TRACKING_GAIN: f64 = 12.0;

/// Delivers the newest samples of the robot until the skill is cancelled.
pub(crate) struct Senses {
    sensed: newest::Receiver<Arc<Sensed>>,
    cancel: CancellationToken,
    last_ns: Option<u64>,
}

impl Senses {
    pub(crate) fn new(robot: &dyn Robot, context: &SkillContext) -> Self {
        Self { sensed: robot.sensed(), cancel: context.cancel.clone(), last_ns: None }
    }

    /// Waits for the next sample; returns it with the time since the previous one, s.
    pub(crate) async fn next(&mut self) -> Result<(Arc<Sensed>, f64), Failure> {
        tokio::select! {
            biased;
            () = self.cancel.cancelled() => return Err(Failure::new("cancelled")),
            changed = self.sensed.changed() => {
                changed.map_err(|_| Failure::new("the robot does not send samples any more"))?;
            }
        }
        let sample = self.sensed.borrow_and_update();
        let before = self.last_ns.replace(sample.stamp_ns).unwrap_or(sample.stamp_ns);
        let dt = sample.stamp_ns.saturating_sub(before) as f64 * 1e-9;
        Ok((sample, dt.clamp(1e-4, 0.1)))
    }

    /// The newest sample, without waiting.
    pub(crate) fn newest(&self) -> Arc<Sensed> {
        self.sensed.borrow()
    }
}

/// The arm that a skill commands: the robot's first.
pub(crate) fn chosen(model: &Model) -> Result<&Limb, Failure> {
    let none = || Failure::new(format!("the robot `{}` has no arm: no group with a `tcp`", model.name()));
    model.arms().next().ok_or_else(none)
}

/// The link of the TCP of the arm that skills command.
pub(crate) fn tcp_of(model: &Model) -> Result<LinkId, Failure> {
    chosen(model)?.tcp.ok_or_else(|| Failure::new("the arm has no TCP"))
}

/// Adds the limbs that a skill commands when it moves the arm.
pub(crate) fn moves_the_arm(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    let Ok(arm) = chosen(equipment.robot.model()) else { return manifest };
    let limbs = arm.helped_by.iter().chain([&arm.name]);
    limbs.fold(manifest, |manifest, limb| manifest.limb(limb))
}

/// Leases the arm, after the limbs that help it, each with the number of its joints.
pub(crate) fn lease_arm(
    equipment: &Equipment,
    context: &SkillContext,
) -> Result<Vec<(Lease, usize)>, Failure> {
    let model = equipment.robot.model();
    let arm = chosen(model)?;
    let limbs = arm.helped_by.iter().chain([&arm.name]);
    limbs.map(|limb| Ok((lease(equipment, context, limb)?, model.limb(limb).len()))).collect()
}

/// Gives each limb its part of the velocities.
pub(crate) fn command(leases: &[(Lease, usize)], velocities: &[f64]) -> Result<(), Failure> {
    let mut rest = velocities;
    let mut commanded = Ok(());
    for (lease, joints) in leases {
        let (own, others) = rest.split_at((*joints).min(rest.len()));
        commanded = commanded.and(lease.command(own));
        rest = others;
    }
    commanded.map_err(|fault| Failure::new(fault.to_string()))
}

/// An arm and what helps it, with their leases.
pub(crate) struct Arm {
    leases: Vec<(Lease, usize)>,
    model: Arc<Model>,
    tcp: LinkId,
    ik: DifferentialIk,
    kinematics: Kinematics,
    /// The posture towards which the null space pulls, rad.
    posture: Vec<f64>,
}

impl Arm {
    /// Leases the arm and what helps it for the skill in `context`.
    pub(crate) fn take(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let leases = lease_arm(equipment, context)?;
        let model = Arc::clone(equipment.robot.model());
        let arm = chosen(&model)?;
        let tcp = tcp_of(&model)?;
        let joints = model.reaching_joints(&arm.name);
        let posture = joints.iter().map(|&j| model.ready(&arm.name)[j]).collect();
        let ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
        let kinematics = Kinematics::new(&model);
        Ok(Self { leases, model, tcp, ik, kinematics, posture })
    }

    /// `root_from_tcp` at a sample.
    pub(crate) fn tcp(&self, sample: &Sensed) -> Isometry3<f64> {
        self.model.link_pose(&sample.position, self.tcp)
    }

    /// Velocity of the TCP at a sample, root frame, m/s.
    pub(crate) fn tcp_velocity(&mut self, sample: &Sensed) -> Vector3<f64> {
        self.kinematics.update(&sample.position);
        self.kinematics.twist(self.tcp, &Point3::origin(), &sample.velocity).linear
    }

    /// Moves the TCP towards `target` (root frame); the twist is the target's own velocity, m/s and rad/s. Returns
    /// the distance of the TCP from the target, m.
    pub(crate) fn track(
        &mut self,
        sample: &Sensed,
        target: &Isometry3<f64>,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
    ) -> Result<f64, Failure> {
        let tcp = self.tcp(sample);
        let position = target.translation.vector - tcp.translation.vector;
        let rotation = (target.rotation * tcp.rotation.inverse()).scaled_axis();
        self.twist(sample, linear + TRACKING_GAIN * position, angular + TRACKING_GAIN * rotation)?;
        Ok(position.norm())
    }

    /// Moves the TCP with a twist in the root frame: m/s, rad/s.
    pub(crate) fn twist(
        &mut self,
        sample: &Sensed,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
    ) -> Result<(), Failure> {
        let step = self.ik.step(&sample.position, &Twist { linear, angular }, Some(&self.posture));
        command(&self.leases, step.velocities)
    }

    /// Holds the arm still.
    pub(crate) fn hold(&mut self, sample: &Sensed) -> Result<(), Failure> {
        self.twist(sample, Vector3::zeros(), Vector3::zeros())
    }
}

/// Leases a limb, with the chart's limits.
pub(crate) fn lease(equipment: &Equipment, context: &SkillContext, limb: &str) -> Result<Lease, Failure> {
    let limits = LeaseLimits { force_n: context.limits.force_n, speed_m_s: context.limits.speed_m_s };
    equipment.robot.lease(limb, &context.state, limits).map_err(|e| Failure::new(e.to_string()))
}
