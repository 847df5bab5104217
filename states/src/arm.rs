//! An arm and what helps it under a skill's command: sense, then command, at the rate of the robot's samples.
//!
//! It holds their leases for as long as it lives, and converts desired TCP poses and twists to joint velocities. Which
//! limbs help an arm (a torso, so that it reaches further) is said in the robot file; one that somebody else commands does
//! not help. The input `arm` names the arm. It plans nothing.

use std::sync::Arc;

use armarium_motion::{LinePoint, StraightLine};
use armarium_robot::{
    DifferentialIk, IkConfig, Jacobian, Kinematics, Lease, LeaseError, LeaseLimits, Limb, LinkId, Model,
    PoseOptions, Robot, Sensed, Twist, newest, pose_error, solve_pose,
};
use armarium_runtime::skill::{Failure, NameKind, SkillContext, SkillManifest};
use armarium_values::Type;
use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use rand_chacha::ChaCha8Rng;
use tokio_util::sync::CancellationToken;

use crate::equipment::Equipment;
use crate::grasp::held_in_tcp;
use crate::motions::failed;
use crate::places::places_at;

/// Steps of the inverse kinematics for each point of a way, and how far from it the TCP may be, m.
const SETTLES: usize = 2;
const OFF_THE_WAY: f64 = 0.002;
/// Gain of the TCP's position and orientation error, 1/s.
const TRACKING_GAIN: f64 = 12.0;
/// At what speed joints take a posture, and within what they have taken it, rad/s and rad.
const TURNING: f64 = 0.3;
const TURNED: f64 = 0.01;
/// How far from its goal the TCP may be for that, m: on the way to another posture the hand is beside its line.
const SHORT: f64 = 0.1;
/// A joint that is so near to its limit, rad (m), goes no farther: a little more than what the inverse kinematics keeps.
const AT_LIMIT: f64 = 0.025;

/// Delivers the newest samples of the robot until the skill is cancelled.
pub(crate) struct Senses {
    sensed: newest::NewestReceiver<Arc<Sensed>>,
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
        let dt = seconds(before, sample.stamp_ns).clamp(1e-4, 0.1);
        Ok((sample, dt))
    }

    /// The newest sample, without waiting.
    pub(crate) fn newest(&self) -> Arc<Sensed> {
        self.sensed.borrow()
    }
}

/// The time from one stamp to a later one, s; 0 if it is not later.
pub(crate) fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// The input that names the arm.
const ARM: &str = "arm";

/// Adds the input that names the arm, for a skill that does not move it.
pub(crate) fn names_the_arm(manifest: SkillManifest) -> SkillManifest {
    let manifest =
        manifest.optional(ARM, Type::String, "", "The arm, a group of the robot; empty: the one that works.");
    manifest.names(NameKind::Arm)
}

/// Adds the input that names the arm that a skill commands.
pub(crate) fn moves_the_arm(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    commands(names_the_arm(manifest), equipment, |arm| Some(arm.name.clone()))
}

/// Adds the input that names the arm whose hand a skill commands.
pub(crate) fn moves_the_hand(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    commands(names_the_arm(manifest), equipment, |arm| arm.hand.clone())
}

/// Says for each arm which limb is commanded.
fn commands(
    manifest: SkillManifest,
    equipment: &Equipment,
    limb: impl Fn(&Limb) -> Option<String>,
) -> SkillManifest {
    let model = equipment.robot.model();
    let usual = equipment.arm().ok().map(|arm| ("", arm));
    let named = usual.into_iter().chain(model.arms().map(|arm| (arm.name.as_str(), arm)));
    named.fold(manifest, |manifest, (name, arm)| match limb(arm) {
        Some(limb) => manifest.limb_by_input(ARM, name, &limb),
        None => manifest,
    })
}

/// The arm that the input names.
pub(crate) fn chosen<'e>(equipment: &'e Equipment, context: &SkillContext) -> Result<&'e Limb, Failure> {
    let name = context.text(ARM)?;
    if name.is_empty() {
        return equipment.arm();
    }
    let model = equipment.robot.model();
    model.arm(name).ok_or_else(|| {
        let known = model.arms().map(|arm| arm.name.as_str()).collect::<Vec<_>>().join(", ");
        Failure::new(format!("the robot `{}` has no arm `{name}`; it has {known}", model.name()))
    })
}

/// The link of an arm's TCP.
pub(crate) fn tcp_of(arm: &Limb) -> Result<LinkId, Failure> {
    arm.tcp.ok_or_else(|| Failure::new(format!("the arm `{}` has no TCP", arm.name)))
}

/// The wrench sensor of an arm, as an index into the model's.
pub(crate) fn sensor_of(arm: &Limb) -> Result<usize, Failure> {
    arm.wrench.ok_or_else(|| Failure::new(format!("the arm `{}` has no wrench sensor", arm.name)))
}

/// The compensated force that a wrench sensor feels, root frame, N.
pub(crate) fn force_at(sensor: usize, sample: &Sensed) -> Vector3<f64> {
    sample.wrenches.get(sensor).map_or_else(Vector3::zeros, |felt| felt.external.force)
}

/// Where an arm works, with the platform where it is at the positions `now` of all joints: the pose of its TCP in the posture in
/// which it is ready (root from TCP).
pub(crate) fn workspace(model: &Model, arm: &Limb, now: &[f64]) -> Result<Isometry3<f64>, Failure> {
    Ok(model.link_pose(&model.taken_at(model.ready(&arm.name), now), tcp_of(arm)?))
}

/// An arm and the limbs that help it, leased together.
pub(crate) struct ArmLeases {
    pub(crate) lease: Lease,
    /// The joints of the helpers, then the arm's.
    pub(crate) joints: Vec<usize>,
    /// The places that its hand may touch.
    pub(crate) touches: Vec<String>,
}

impl ArmLeases {
    /// Leases an arm, with these helpers as far as nobody else commands them. Its hand may come near to the places in memory at which it
    /// is, or would be with its TCP at one of `targets` (root frame).
    pub(crate) async fn take(
        equipment: &Equipment,
        context: &SkillContext,
        arm: &Limb,
        (helpers, targets): (&[String], &[Isometry3<f64>]),
    ) -> Result<Self, Failure> {
        let touches = at_hand(equipment, arm, targets).await?;
        let mut limbs: Vec<&str> = helpers.iter().chain([&arm.name]).map(String::as_str).collect();
        let lease = loop {
            match try_lease(equipment, context, &limbs, &touches) {
                Err(LeaseError::Taken { limb, .. }) if limb != arm.name => limbs.retain(|name| *name != limb),
                lease => break lease.map_err(failed)?,
            }
        };
        let model = equipment.robot.model();
        let joints = limbs.iter().flat_map(|limb| model.limb(limb)).copied().collect();
        Ok(Self { lease, joints, touches })
    }

    /// Sets the velocities, in the order of the joints.
    pub(crate) fn command(&self, velocities: &[f64]) -> Result<(), Failure> {
        self.lease.command(velocities).map_err(failed)
    }
}

/// An arm and what helps it, with their leases.
pub(crate) struct LeasedArm {
    pub(crate) leases: ArmLeases,
    model: Arc<Model>,
    pub(crate) limb: Limb,
    tcp: LinkId,
    ik: DifferentialIk,
    kinematics: Kinematics,
    /// The posture towards which the null space pulls, rad.
    posture: Vec<f64>,
    /// For the search of postures.
    random: ChaCha8Rng,
    pub(crate) equipment: Equipment,
}

impl LeasedArm {
    /// Leases the arm that the input names, and what helps it, for the skill in `context`, whose TCP goes to `targets`.
    pub(crate) async fn take(
        equipment: &Equipment,
        context: &SkillContext,
        targets: &[Isometry3<f64>],
    ) -> Result<Self, Failure> {
        let limb = chosen(equipment, context)?;
        let leases = ArmLeases::take(equipment, context, limb, (&limb.helped_by, targets)).await?;
        Self::with(equipment, limb, leases)
    }

    /// Leases an arm without what helps it, whose TCP goes to `targets`.
    pub(crate) async fn take_limb(
        equipment: &Equipment,
        context: &SkillContext,
        limb: &Limb,
        targets: &[Isometry3<f64>],
    ) -> Result<Self, Failure> {
        Self::with(equipment, limb, ArmLeases::take(equipment, context, limb, (&[], targets)).await?)
    }

    fn with(equipment: &Equipment, limb: &Limb, leases: ArmLeases) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let tcp = tcp_of(limb)?;
        let posture = leases.joints.iter().map(|&j| model.ready(&limb.name)[j]).collect();
        let ik = DifferentialIk::new(&model, tcp, &leases.joints, IkConfig::default());
        let kinematics = Kinematics::new(&model);
        Ok(Self {
            leases,
            limb: limb.clone(),
            model,
            tcp,
            ik,
            kinematics,
            posture,
            random: equipment.random(),
            equipment: equipment.clone(),
        })
    }

    /// The compensated force on its hand at a sample, root frame, N.
    pub(crate) fn force(&self, sample: &Sensed) -> Result<Vector3<f64>, Failure> {
        Ok(force_at(sensor_of(&self.limb)?, sample))
    }

    /// The compensated wrench on its hand at a sample: force, N, and torque about the TCP, N m, root frame.
    pub(crate) fn wrench(&self, sample: &Sensed) -> Result<Vector6<f64>, Failure> {
        let felt = sample.wrenches.get(sensor_of(&self.limb)?);
        let felt = felt.map(|felt| felt.external).unwrap_or_default();
        Ok(Vector6::from_iterator(felt.force.iter().chain(&felt.torque).copied()))
    }

    /// `root_from_tcp` at a sample.
    pub(crate) fn tcp(&self, sample: &Sensed) -> Isometry3<f64> {
        self.model.link_pose(&sample.position, self.tcp)
    }

    /// From now on the null space pulls towards these joint positions.
    pub(crate) fn pull_towards(&mut self, posture: &[f64]) {
        self.posture.copy_from_slice(posture);
    }

    /// From now on the null space pulls towards how the arm reaches a pose (root frame), if it does: on the way there alone it may come to
    /// a posture from which it does not go on. Returns whether it does.
    pub(crate) fn pull_towards_pose(&mut self, sample: &Sensed, root_from_tcp: &Isometry3<f64>) -> bool {
        let (joints, options) = (&self.leases.joints, PoseOptions::default());
        let solved = solve_pose(
            &self.model,
            self.tcp,
            joints,
            root_from_tcp,
            &sample.position,
            &options,
            &mut self.random,
        );
        let Ok(solved) = solved else { return false };
        self.posture = joints.iter().map(|&joint| solved[joint]).collect();
        true
    }

    /// Where the TCP stands so far from a pose (root frame), m, because a joint is at its limit, whether it is to take another posture that
    /// reaches the pose. The null space pulls towards that from now on.
    pub(crate) fn needs_another_posture(
        &mut self,
        sample: &Sensed,
        root_from_tcp: &Isometry3<f64>,
        distance: f64,
    ) -> bool {
        let at_limit = self.leases.joints.iter().any(|&joint| {
            let (known, q) = (&self.model.joints()[joint], sample.position[joint]);
            known.upper - q < AT_LIMIT || q - known.lower < AT_LIMIT
        });
        self.pull_towards_pose(sample, root_from_tcp) && at_limit && distance < SHORT
    }

    /// Moves the joints themselves towards that posture, all together and slowly, as the hand leaves its line meanwhile; returns whether they
    /// are there.
    pub(crate) fn take_posture(&mut self, sample: &Sensed) -> Result<bool, Failure> {
        let off: Vec<f64> =
            self.positions(sample).iter().zip(&self.posture).map(|(q, goal)| goal - q).collect();
        let farthest = off.iter().fold(0.0_f64, |most, off| most.max(off.abs()));
        let rate = TRACKING_GAIN.min(TURNING / farthest.max(1e-9));
        let velocities: Vec<f64> = off.iter().map(|off| rate * off).collect();
        self.leases.command(&velocities)?;
        Ok(farthest < TURNED)
    }

    /// The positions of its joints at a sample, in their order.
    pub(crate) fn positions(&self, sample: &Sensed) -> Vec<f64> {
        self.leases.joints.iter().map(|&joint| sample.position[joint]).collect()
    }

    /// Pose and velocity of the TCP with these positions and velocities of its joints, the others as in a sample.
    pub(crate) fn tcp_with(&mut self, sample: &Sensed, q: &[f64], qd: &[f64]) -> LinePoint {
        let (mut position, mut velocity) = (sample.position.clone(), vec![0.0; sample.position.len()]);
        for (i, &joint) in self.leases.joints.iter().enumerate() {
            (position[joint], velocity[joint]) = (q[i], qd[i]);
        }
        self.kinematics.update(&position);
        let twist = self.kinematics.twist(self.tcp, &Point3::origin(), &velocity);
        LinePoint { pose: *self.kinematics.pose(self.tcp), linear: twist.linear, angular: twist.angular }
    }

    /// Velocity of a point of the TCP's frame at a sample, root frame, m/s and rad/s, and the columns of its Jacobian, one per
    /// joint.
    pub(crate) fn twist_and_columns(
        &mut self,
        sample: &Sensed,
        at: &Point3<f64>,
    ) -> (Vector6<f64>, Vec<Vector6<f64>>) {
        self.kinematics.update(&sample.position);
        let twist = self.kinematics.twist(self.tcp, at, &sample.velocity);
        let mut jacobian = Jacobian::zeros(self.leases.joints.len());
        self.kinematics.jacobian_into(self.tcp, at, &self.leases.joints, &mut jacobian);
        let six = Vector6::from_iterator(twist.linear.iter().chain(&twist.angular).copied());
        (six, jacobian.column_iter().map(|column| column.into_owned()).collect())
    }

    /// The joint positions along a way of the TCP, one every `dt` s, from those of a sample. The null space pulls towards these.
    pub(crate) fn joints_along(
        &mut self,
        sample: &Sensed,
        dt: f64,
        way: impl Iterator<Item = LinePoint>,
    ) -> Result<Vec<Vec<f64>>, Failure> {
        let mut q = sample.position.clone();
        let begin = self.positions(sample);
        let mut all = Vec::new();
        for point in way {
            let mut off = f64::INFINITY;
            for _ in 0..SETTLES {
                let error = pose_error(&self.model.link_pose(&q, self.tcp), &point.pose);
                off = error.linear.norm();
                let twist = Twist { linear: error.linear / dt, angular: error.angular / dt };
                let step = self.ik.step(&q, &twist, Some(&begin));
                for (&joint, speed) in self.leases.joints.iter().zip(step.velocities) {
                    q[joint] += speed * dt;
                }
            }
            if off > OFF_THE_WAY {
                let (name, to, mm) = (&self.limb.name, point.pose.translation, off * 1e3);
                return Err(Failure::new(format!(
                    "the arm `{name}` does not reach ({:.3}, {:.3}, {:.3}) m: {mm:.0} mm are missing",
                    to.x, to.y, to.z
                )));
            }
            all.push(self.leases.joints.iter().map(|&joint| q[joint]).collect());
        }
        Ok(all)
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
        let error = pose_error(&self.tcp(sample), target);
        self.twist(sample, linear + TRACKING_GAIN * error.linear, angular + TRACKING_GAIN * error.angular)?;
        Ok(error.linear.norm())
    }

    /// Moves the TCP on a straight line to a pose (root frame) at `speed` m/s, until it has rested there; `check` takes the distance from the
    /// line after each step, m.
    pub(crate) async fn go(
        &mut self,
        senses: &mut Senses,
        goal: Isometry3<f64>,
        speed: f64,
        check: impl Fn(f64) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let mut line = StraightLine::new(self.tcp(&senses.newest()), goal, speed).map_err(failed)?;
        while !line.rested(0.3) {
            let (sample, dt) = senses.next().await?;
            let point = line.step(dt).map_err(failed)?;
            check(self.track(&sample, &point.pose, point.linear, point.angular)?)?;
        }
        Ok(())
    }

    /// Moves the TCP with a twist in the root frame: m/s, rad/s. Returns the twist that its joints can follow.
    pub(crate) fn twist(
        &mut self,
        sample: &Sensed,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
    ) -> Result<Twist, Failure> {
        let step = self.ik.step(&sample.position, &Twist { linear, angular }, Some(&self.posture));
        self.leases.command(step.velocities)?;
        Ok(step.twist)
    }

    /// Holds the arm still.
    pub(crate) fn hold(&mut self, sample: &Sensed) -> Result<(), Failure> {
        self.twist(sample, Vector3::zeros(), Vector3::zeros()).map(|_| ())
    }

    /// Holds its joints still, and with them what the null space would move.
    pub(crate) fn stand(&self) -> Result<(), Failure> {
        self.leases.command(&vec![0.0; self.leases.joints.len()])
    }
}

/// The joints with which an arm could reach now: its own, and those of its helpers that nobody else commands.
pub(crate) fn free_joints(equipment: &Equipment, context: &SkillContext, arm: &Limb) -> Vec<usize> {
    let is_free = |helper: &&String| try_lease(equipment, context, &[helper.as_str()], &[]).is_ok();
    let model = equipment.robot.model();
    let limbs = arm.helped_by.iter().filter(is_free).chain([&arm.name]);
    limbs.flat_map(|limb| model.limb(limb)).copied().collect()
}

/// Leases a limb, with the chart's limits. Its hand may come near to what `touches` names.
pub(crate) fn lease(
    equipment: &Equipment,
    context: &SkillContext,
    limb: &str,
    touches: &[String],
) -> Result<Lease, Failure> {
    try_lease(equipment, context, &[limb], touches).map_err(failed)
}

fn try_lease(
    equipment: &Equipment,
    context: &SkillContext,
    limbs: &[&str],
    touches: &[String],
) -> Result<Lease, LeaseError> {
    let limits = LeaseLimits { force_n: context.limits.force_n, speed_m_s: context.limits.speed_m_s };
    equipment.robot.lease_together(limbs, &context.state, limits, touches)
}

/// The places in memory at which an arm's hand is, or would be with its TCP at one of `targets` (root frame): what it works on.
pub(crate) async fn at_hand(
    equipment: &Equipment,
    arm: &Limb,
    targets: &[Isometry3<f64>],
) -> Result<Vec<String>, Failure> {
    let model = equipment.robot.model();
    let Some(hand) = model.hand_of(arm) else { return Ok(Vec::new()) };
    let here = model.link_pose(&equipment.robot.sensed().borrow().position, tcp_of(arm)?);
    let grasps = targets.iter().chain([&here]).map(|root_from_tcp| root_from_tcp * held_in_tcp(hand));
    places_at(equipment.remembered(), &grasps.collect::<Vec<_>>()).await
}
