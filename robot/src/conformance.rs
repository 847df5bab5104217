//! The rules that every robot driver must follow, whatever moves its joints. A driver's test calls [`check`].
//!
//! The robot must be running (a task that steps the guard, or a real robot), with tokio's clock. The check moves
//! the limb by some tenths of a radian and ends with the robot stopped and reset. It uses only the [`Robot`]
//! trait.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::bodies::{Bodies, least_distance};
use crate::planning::KnownBox;
use crate::{Fault, Kinematics, Lease, LeaseError, LeaseLimits, LinkId, Model, Robot, Sensed, newest};

/// A joint slower than this stands still, rad/s (m/s).
pub const STANDING: f64 = 0.01;
/// Time within which every joint of the limb must stand still, ns.
pub const STANDING_WITHIN_NS: u64 = 200_000_000;
/// How long an arm gives way to what it has met at most, until the force is under its limit, ns.
const GIVES_WAY_NS: u64 = 500_000_000;
/// Over how long a speed is averaged, ns. The guard bounds what is commanded; a drive that is stepped to its speed overshoots
/// for some 30 ms (by 28 % in the simulator).
const MEAN_NS: u64 = 50_000_000;
/// What a tared sensor may feel of a resting hand, N: its noise.
const TARED_N: f64 = 2.0;
/// The least distance of two bodies that anybody may ever see, m; the guard keeps 20 mm.
const APART: f64 = 0.005;
/// Random postures of the limb in which a collision is looked for.
const POSTURES: u32 = 300;
/// Longest wait for one sample.
const SAMPLE_WITHIN: Duration = Duration::from_secs(1);

/// A rule that the robot broke.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{rule}: {what}")]
pub struct Violation {
    /// The rule.
    pub rule: &'static str,
    /// What happened instead.
    pub what: String,
}

/// Checks one limb of a running robot that stands still and that nothing commands.
///
/// # Errors
/// The first [`Violation`].
pub async fn check(robot: &Arc<dyn Robot>, limb: &str) -> Result<(), Violation> {
    let mut probe = LimbCheck::new(robot, limb)?;
    probe.samples_come_in_order().await?;
    probe.every_sensor_is_tared_by_itself().await?;
    probe.leases_are_exclusive()?;
    probe.limbs_are_leased_together_or_not_at_all()?;
    probe.commands_move_the_joints().await?;
    probe.lease_limits_bound_the_tcp_speed().await?;
    probe.lease_limits_hold_whichever_joints_move_the_tcp().await?;
    probe.a_dropped_lease_brakes().await?;
    probe.a_silent_commander_is_faulted().await?;
    probe.nonsense_is_refused().await?;
    probe.a_panic_brakes().await?;
    probe.a_stop_lasts_until_it_is_reset().await?;
    // Last, as they may end at something that nobody knows, such as a table.
    probe.bodies_stay_apart().await?;
    probe.the_hand_stays_away_from_what_is_known().await
}

/// Full speed of `joints`, each away from its nearer limit.
fn full_speed(model: &Model, joints: &[usize], sensed: &Sensed) -> Vec<f64> {
    let speed = |&j: &usize| {
        let (joint, q) = (&model.joints()[j], sensed.position[j]);
        if joint.upper - q >= q - joint.lower { joint.velocity } else { -joint.velocity }
    };
    joints.iter().map(speed).collect()
}

struct LimbCheck<'a> {
    robot: &'a Arc<dyn Robot>,
    limb: &'a str,
    joints: Vec<usize>,
    sensed: newest::NewestReceiver<Arc<Sensed>>,
    /// The rule that is being checked.
    rule: &'static str,
}

impl<'a> LimbCheck<'a> {
    fn new(robot: &'a Arc<dyn Robot>, limb: &'a str) -> Result<Self, Violation> {
        let joints = robot.model().limb(limb).to_vec();
        if joints.is_empty() {
            return Err(Violation { rule: "the limb exists", what: format!("`{limb}` does not") });
        }
        Ok(Self { robot, limb, joints, sensed: robot.sensed(), rule: "" })
    }

    fn broken<T>(&self, what: impl Into<String>) -> Result<T, Violation> {
        Err(Violation { rule: self.rule, what: what.into() })
    }

    fn lease(&self, limits: LeaseLimits) -> Result<Lease, Violation> {
        self.robot
            .lease(self.limb, "conformance", limits)
            .or_else(|error| self.broken(format!("no lease of the free limb: {error}")))
    }

    async fn sample(&mut self) -> Result<Arc<Sensed>, Violation> {
        match tokio::time::timeout(SAMPLE_WITHIN, self.sensed.changed()).await {
            Ok(Ok(())) => Ok(self.sensed.borrow_and_update()),
            Ok(Err(_)) => self.broken("the robot is gone"),
            Err(_) => self.broken("no sample within a second"),
        }
    }

    /// Commands `share` of full speed at each sample for `for_ns`. Returns the last sample and the command.
    async fn run(
        &mut self,
        lease: &Lease,
        share: f64,
        for_ns: u64,
    ) -> Result<(Arc<Sensed>, Vec<f64>), Violation> {
        let start = self.sample().await?;
        let command: Vec<f64> =
            full_speed(self.robot.model(), &self.joints, &start).iter().map(|v| share * v).collect();
        loop {
            if let Err(fault) = lease.command(&command) {
                return self.broken(format!("a sound command was refused: {fault}"));
            }
            let now = self.sample().await?;
            if now.stamp_ns >= start.stamp_ns + for_ns {
                return Ok((now, command));
            }
        }
    }

    /// The limb stands still; where it has met something, once it has given way.
    async fn stands_after(&mut self, met: bool) -> Result<(), Violation> {
        let start = self.sample().await?.stamp_ns;
        while met && self.sample().await?.stamp_ns < start + GIVES_WAY_NS {}
        self.stands().await
    }

    /// After `STANDING_WITHIN_NS` the limb stands still, and continues to do so for the same time.
    async fn stands(&mut self) -> Result<(), Violation> {
        let start = self.sample().await?.stamp_ns;
        loop {
            let now = self.sample().await?;
            if now.stamp_ns < start + STANDING_WITHIN_NS {
                continue;
            }
            for &j in &self.joints {
                let speed = now.velocity[j];
                if speed.abs() > STANDING {
                    let name = &self.robot.model().joints()[j].name;
                    let after_ms = (now.stamp_ns - start) / 1_000_000;
                    return self.broken(format!("joint `{name}` moves at {speed:.3} after {after_ms} ms"));
                }
            }
            if now.stamp_ns >= start + 2 * STANDING_WITHIN_NS {
                return Ok(());
            }
        }
    }

    async fn samples_come_in_order(&mut self) -> Result<(), Violation> {
        self.rule = "samples come in order and describe every joint";
        let joints = self.robot.model().joints().len();
        let mut last = self.sample().await?.stamp_ns;
        for _ in 0..20 {
            let now = self.sample().await?;
            if now.stamp_ns <= last {
                return self.broken(format!("stamp {} came after {last}", now.stamp_ns));
            }
            if now.position.len() != joints || now.velocity.len() != joints {
                return self.broken(format!("{} positions for {joints} joints", now.position.len()));
            }
            let sensors = self.robot.model().wrenches().len();
            if now.wrenches.len() != sensors {
                return self.broken(format!("{} wrenches for {sensors} sensors", now.wrenches.len()));
            }
            last = now.stamp_ns;
        }
        Ok(())
    }

    async fn every_sensor_is_tared_by_itself(&mut self) -> Result<(), Violation> {
        self.rule = "a tare makes what one sensor feels of the resting hand zero";
        if self.robot.tare("no such sensor").is_ok() {
            return self.broken("a sensor that is not there was tared");
        }
        let model = Arc::clone(self.robot.model());
        for sensor in model.wrenches() {
            let start = self.sample().await?;
            // A tare averages the last 0.1 s.
            let mut now = Arc::clone(&start);
            while now.stamp_ns < start.stamp_ns + 150_000_000 {
                now = self.sample().await?;
            }
            if let Err(error) = self.robot.tare(&sensor.name) {
                return self.broken(error.to_string());
            }
            let tared = now.stamp_ns;
            while now.stamp_ns < tared + 50_000_000 {
                now = self.sample().await?;
            }
            let felt = model.wrenches().iter().zip(&now.wrenches).find(|(of, _)| of.name == sensor.name);
            let force = felt.map_or(0.0, |(_, felt)| felt.external.force.norm());
            if force > TARED_N {
                return self.broken(format!("`{}` still feels {force:.1} N", sensor.name));
            }
        }
        Ok(())
    }

    fn leases_are_exclusive(&mut self) -> Result<(), Violation> {
        self.rule = "a limb has one commander";
        let none = LeaseLimits::default();
        let lease = self.lease(none)?;
        match self.robot.lease(self.limb, "another", none) {
            Err(LeaseError::Taken { holder, .. }) if holder == "conformance" => {}
            other => return self.broken(format!("a second lease gave {other:?}")),
        }
        match self.robot.lease("no such limb", "another", none) {
            Err(LeaseError::Unknown { .. }) => {}
            other => return self.broken(format!("an unknown limb gave {other:?}")),
        }
        drop(lease);
        drop(self.lease(none)?);
        Ok(())
    }

    fn limbs_are_leased_together_or_not_at_all(&mut self) -> Result<(), Violation> {
        self.rule = "several limbs are leased together or not at all";
        let model = Arc::clone(self.robot.model());
        let apart = |limb: &&String| model.limb(limb).iter().all(|joint| !self.joints.contains(joint));
        let Some(other) = model.limbs().keys().find(apart) else { return Ok(()) };
        let none = LeaseLimits::default();
        let both = [self.limb, other.as_str()];
        let held = self.lease(none)?;
        match self.robot.lease_together(&[other.as_str(), self.limb], "another", none, &[]) {
            Err(LeaseError::Taken { limb, .. }) if limb == self.limb => {}
            unexpected => return self.broken(format!("with one of them taken: {unexpected:?}")),
        }
        drop(held);
        let Ok(lease) = self.robot.lease_together(&both, "conformance", none, &[]) else {
            return self.broken(format!("`{}` and `{other}` are free and were refused", self.limb));
        };
        let joints = self.joints.len() + model.limb(other).len();
        if let Err(fault) = lease.command(&vec![0.0; joints]) {
            return self.broken(format!("a command for both was refused: {fault}"));
        }
        for limb in both {
            if !matches!(self.robot.lease(limb, "another", none), Err(LeaseError::Taken { .. })) {
                return self.broken(format!("`{limb}` was leased twice"));
            }
        }
        drop(lease);
        both.iter().try_for_each(|limb| match self.robot.lease(limb, "another", none) {
            Ok(_) => Ok(()),
            Err(error) => self.broken(format!("`{limb}` is not free again: {error}")),
        })
    }

    /// Drives the limb towards a posture in which bodies of the robot would overlap.
    async fn bodies_stay_apart(&mut self) -> Result<(), Violation> {
        self.rule = "bodies of the robot stay apart, whatever is commanded";
        let model = Arc::clone(self.robot.model());
        let bodies = Bodies::new(&model);
        let mut kinematics = Kinematics::new(&model);
        let start = self.sample().await?;
        kinematics.update(&start.position);
        let before = least_distance(&bodies, &kinematics);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut goal = start.position.clone();
        let overlaps = (0..POSTURES).any(|_| {
            for &j in &self.joints {
                let joint = &model.joints()[j];
                let (lower, upper) = (joint.lower.max(-3.0), joint.upper.min(3.0));
                goal[j] = if lower < upper { rng.random_range(lower..upper) } else { lower };
            }
            kinematics.update(&goal);
            least_distance(&bodies, &kinematics) < 0.0
        });
        if !overlaps {
            return Ok(());
        }
        let lease = self.lease(LeaseLimits::default())?;
        let mut met = false;
        loop {
            let now = self.sample().await?;
            let towards = |&j: &usize| (goal[j] - now.position[j]) * 5.0;
            let command: Vec<f64> = self.joints.iter().map(towards).collect();
            match lease.command(&command) {
                Ok(()) => {}
                // It has met something that it does not know.
                Err(Fault::Force { .. }) => {
                    met = true;
                    break;
                }
                Err(fault) => return self.broken(format!("a sound command was refused: {fault}")),
            }
            kinematics.update(&now.position);
            let distance = least_distance(&bodies, &kinematics);
            if distance < APART.min(before - APART) {
                return self.broken(format!("two bodies came within {:.1} mm", distance * 1e3));
            }
            if now.stamp_ns > start.stamp_ns + 1_000_000_000 {
                break;
            }
        }
        drop(lease);
        self.stands_after(met).await
    }

    /// Puts a board before the hand and drives it there at full speed.
    async fn the_hand_stays_away_from_what_is_known(&mut self) -> Result<(), Violation> {
        self.rule = "a hand stops before what is known to be there, unless its lease names it";
        let model = Arc::clone(self.robot.model());
        let Some(tcp) = model.find_limb(self.limb).and_then(|limb| limb.tcp) else { return Ok(()) };
        let start = self.sample().await?;
        let command = full_speed(&model, &self.joints, &start);
        let mut speeds = vec![0.0; model.joints().len()];
        self.joints.iter().zip(&command).for_each(|(&j, speed)| speeds[j] = *speed);
        let mut kinematics = Kinematics::new(&model);
        kinematics.update(&start.position);
        let way = kinematics.twist(tcp, &Point3::origin(), &speeds).linear;
        let Some(way) = way.try_normalize(1e-3) else { return Ok(()) };
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &way).unwrap_or_default();
        let at = kinematics.pose(tcp).translation.vector + way * 0.3;
        let board = KnownBox {
            name: "board".into(),
            root_from_box: Isometry3::from_parts(at.into(), facing),
            size: Vector3::new(0.6, 0.6, 0.02),
        };
        let bodies = Bodies::new(&model).before(&model, tcp, &board);
        let before = least_distance(&bodies, &kinematics);
        if let Err(error) = self.robot.set_surroundings(vec![board]) {
            return self.broken(error.to_string());
        }
        let lease = self.lease(LeaseLimits::default())?;
        let mut met = false;
        loop {
            match lease.command(&command) {
                Ok(()) => {}
                // It has met something that it does not know.
                Err(Fault::Force { .. }) => {
                    met = true;
                    break;
                }
                Err(fault) => return self.broken(format!("a sound command was refused: {fault}")),
            }
            let now = self.sample().await?;
            kinematics.update(&now.position);
            let distance = least_distance(&bodies, &kinematics);
            if distance < APART.min(before - APART) {
                return self.broken(format!("it came within {:.1} mm", distance * 1e3));
            }
            if now.stamp_ns > start.stamp_ns + 700_000_000 {
                break;
            }
        }
        drop(lease);
        if let Err(error) = self.robot.set_surroundings(Vec::new()) {
            return self.broken(error.to_string());
        }
        self.stands_after(met).await
    }

    async fn commands_move_the_joints(&mut self) -> Result<(), Violation> {
        self.rule = "commands are joint velocities in limb order";
        let lease = self.lease(LeaseLimits::default())?;
        let before = self.sample().await?;
        let (after, command) = self.run(&lease, 0.3, 500_000_000).await?;
        for (&j, v) in self.joints.iter().zip(&command) {
            let (moved, joint) = (after.position[j] - before.position[j], &self.robot.model().joints()[j]);
            let room =
                if *v > 0.0 { joint.upper - after.position[j] } else { after.position[j] - joint.lower };
            if moved * v.signum() < 0.3 * v.abs() * 0.5 && room > 0.05 * joint.velocity {
                return self.broken(format!("`{}` went {moved:.4} in 0.5 s at {v}", joint.name));
            }
            if moved.abs() > 1.2 * v.abs() * 0.5 + 0.01 * joint.velocity {
                return self.broken(format!("`{}` went {moved:.4} in 0.5 s at {v}", joint.name));
            }
        }
        let zero = vec![0.0; self.joints.len()];
        let _ = lease.command(&zero);
        self.stands().await?;
        match lease.fault() {
            None => Ok(()),
            Some(fault) => self.broken(format!("a limb that was told to stand was faulted: {fault}")),
        }
    }

    async fn lease_limits_bound_the_tcp_speed(&mut self) -> Result<(), Violation> {
        self.rule = "a lease's speed limit bounds the TCP's speed";
        let Some(tcp) = self.robot.model().find_limb(self.limb).and_then(|limb| limb.tcp) else {
            return Ok(());
        };
        self.bounds_the_tcp(tcp, &[self.limb.to_owned()]).await
    }

    /// One holder commands every limb that moves the TCP: neither a single limb nor all together exceed the limit.
    async fn lease_limits_hold_whichever_joints_move_the_tcp(&mut self) -> Result<(), Violation> {
        self.rule = "a lease's speed limit bounds the TCP's speed, whichever joints of its holder move it";
        let model = Arc::clone(self.robot.model());
        let moves = |limb: &str, tcp: LinkId| model.limb(limb).iter().any(|&j| model.moves(j, tcp));
        let tcps: Vec<LinkId> = model.limbs().values().filter_map(|limb| limb.tcp).collect();
        for tcp in tcps.into_iter().filter(|&tcp| moves(self.limb, tcp)) {
            let limbs: Vec<String> = model.limbs().keys().filter(|limb| moves(limb, tcp)).cloned().collect();
            for limb in &limbs {
                self.bounds_the_tcp(tcp, std::slice::from_ref(limb)).await?;
            }
            self.bounds_the_tcp(tcp, &limbs).await?;
        }
        Ok(())
    }

    /// Commands full speed to all `limbs`, and looks at the speed of `tcp` all the time: its mean over [`MEAN_NS`].
    async fn bounds_the_tcp(&mut self, tcp: LinkId, limbs: &[String]) -> Result<(), Violation> {
        let limit = 0.1;
        let limits = LeaseLimits { speed_m_s: Some(limit), ..LeaseLimits::default() };
        let model = Arc::clone(self.robot.model());
        let mut leases = Vec::new();
        for limb in limbs {
            match self.robot.lease(limb, "conformance", limits) {
                Ok(lease) => leases.push((model.limb(limb).to_vec(), lease)),
                Err(error) => return self.broken(format!("no lease of the free limb `{limb}`: {error}")),
            }
        }
        let start = self.sample().await?;
        let commands: Vec<Vec<f64>> =
            leases.iter().map(|(joints, _)| full_speed(&model, joints, &start)).collect();
        let mut kinematics = Kinematics::new(&model);
        let mut fastest = 0.0_f64;
        let mut speeds = VecDeque::new();
        loop {
            for ((_, lease), command) in leases.iter().zip(&commands) {
                if let Err(fault) = lease.command(command) {
                    return self.broken(format!("a sound command was refused: {fault}"));
                }
            }
            let now = self.sample().await?;
            kinematics.update(&now.position);
            let speed = kinematics.twist(tcp, &Point3::origin(), &now.velocity).linear.norm();
            speeds.push_back((now.stamp_ns, speed));
            while speeds.front().is_some_and(|(stamp_ns, _)| stamp_ns + MEAN_NS < now.stamp_ns) {
                speeds.pop_front();
            }
            if now.stamp_ns >= start.stamp_ns + MEAN_NS {
                let sum: f64 = speeds.iter().map(|(_, speed)| speed).sum();
                fastest = fastest.max(sum / speeds.len() as f64);
            }
            if now.stamp_ns >= start.stamp_ns + 400_000_000 {
                break;
            }
        }
        drop(leases);
        self.stands().await?;
        if fastest > 1.2 * limit {
            let limbs = limbs.join(" and ");
            return self.broken(format!("{limbs} moved it at {fastest:.3} m/s with a limit of {limit} m/s"));
        }
        Ok(())
    }

    async fn a_dropped_lease_brakes(&mut self) -> Result<(), Violation> {
        self.rule = "from full speed, the limb stands within 200 ms after its lease is dropped";
        let lease = self.lease(LeaseLimits::default())?;
        self.run(&lease, 1.0, 250_000_000).await?;
        drop(lease);
        self.stands().await
    }

    async fn a_silent_commander_is_faulted(&mut self) -> Result<(), Violation> {
        self.rule = "from full speed, the limb stands within 200 ms after the last command, and says so";
        let lease = self.lease(LeaseLimits::default())?;
        self.run(&lease, 1.0, 250_000_000).await?;
        self.stands().await?;
        match (lease.fault(), lease.command(&vec![0.0; self.joints.len()])) {
            (Some(Fault::Watchdog { .. }), Err(Fault::Watchdog { .. })) => Ok(()),
            other => self.broken(format!("the lease reports {other:?}")),
        }
    }

    async fn nonsense_is_refused(&mut self) -> Result<(), Violation> {
        self.rule = "a command that is not finite brakes the limb and faults the lease";
        let lease = self.lease(LeaseLimits::default())?;
        self.run(&lease, 1.0, 250_000_000).await?;
        let Err(Fault::NotFinite { .. }) = lease.command(&vec![f64::NAN; self.joints.len()]) else {
            return self.broken("NaN was taken");
        };
        self.stands().await?;
        if !matches!(lease.fault(), Some(Fault::NotFinite { .. })) {
            return self.broken(format!("the lease reports {:?}", lease.fault()));
        }
        drop(lease);
        let lease = self.lease(LeaseLimits::default())?;
        match lease.command(&vec![0.0; self.joints.len() + 1]) {
            Err(Fault::WrongLength { .. }) => Ok(()),
            other => self.broken(format!("a command of the wrong length gave {other:?}")),
        }
    }

    async fn a_panic_brakes(&mut self) -> Result<(), Violation> {
        self.rule = "from full speed, the limb stands within 200 ms after its commander panics";
        let lease = self.lease(LeaseLimits::default())?;
        self.run(&lease, 1.0, 250_000_000).await?;
        let task = tokio::spawn(async move {
            let _lease = lease;
            std::panic::resume_unwind(Box::new("a commander that fails"));
        });
        if task.await.is_ok() {
            return self.broken("the commander did not panic");
        }
        self.stands().await?;
        drop(self.lease(LeaseLimits::default())?);
        Ok(())
    }

    async fn a_stop_lasts_until_it_is_reset(&mut self) -> Result<(), Violation> {
        self.rule = "from full speed, the robot stands within 200 ms after stop, until it is reset";
        let lease = self.lease(LeaseLimits::default())?;
        self.run(&lease, 1.0, 250_000_000).await?;
        self.robot.stop("conformance");
        self.stands().await?;
        if !matches!(lease.fault(), Some(Fault::Stopped { .. })) {
            return self.broken(format!("the lease reports {:?}", lease.fault()));
        }
        match self.robot.lease(self.limb, "another", LeaseLimits::default()) {
            Err(LeaseError::Stopped { .. }) => {}
            other => return self.broken(format!("a stopped robot gave {other:?}")),
        }
        self.robot.reset();
        if !matches!(lease.fault(), Some(Fault::Stopped { .. })) {
            return self.broken("a lease that was stopped commands again after the reset");
        }
        drop(lease);
        drop(self.lease(LeaseLimits::default())?);
        Ok(())
    }
}
