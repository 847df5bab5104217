//! Ways of an arm around what is known to be there: the robot's own bodies, and the things and places that memory holds.
//!
//! Asked before an arm sets out, with the place of every joint: is the straight way free, and if not, is there another one?
//! What nobody has told memory is not known. A thing that the hand is at, or goes to, is what it works on and in no way.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_motion::StraightLine;
use armarium_robot::planning::{KnownBox, Nearness, PlanError, Planner};
use armarium_robot::{
    DifferentialIk, IkConfig, Limb, LinkId, Load, Model, PoseOptions, Sensed, Twist, pose_error, solve_pose,
};
use armarium_runtime::skill::Failure;
use nalgebra::{Isometry3, Point3};

use crate::arm::{ArmLeases, LeasedArm, Senses, tcp_of};
use crate::equipment::Equipment;
use crate::grasp::held_in_tcp;
use crate::motions::failed;
use crate::places::{KnownPlace, distance, known};

/// A thing that is nearer than this to where the hand grasps is what it works on, m.
const AT_HAND: f64 = 0.05;
/// Step of a rehearsed line, s, and the gain of its tracking, 1/s.
const STEP_S: f64 = 0.02;
const GAIN: f64 = 12.0;
/// Most steps of a rehearsed line, and after how many more of them the arm is where it can come.
const STEPS: usize = 2000;
const SETTLING: usize = 40;
/// A rehearsed line has arrived within this, m and rad.
const ARRIVED: (f64, f64) = (0.01, 0.1);

/// Corners of a path: the positions of all joints, rad (m).
pub(crate) type Path = Vec<Vec<f64>>;

/// An arm and what helps it, among what memory knows now.
pub(crate) struct Around {
    model: Arc<Model>,
    boxes: Vec<KnownBox>,
    /// The places that the hand may not touch.
    kept: Vec<String>,
    /// What the hands hold.
    loads: BTreeMap<String, Load>,
    arm: String,
    tcp: LinkId,
    joints: Vec<usize>,
    equipment: Equipment,
}

impl Around {
    /// What is around `arm`, which moves by these leases, on its way from the positions `now` of all joints; `target` is where its
    /// TCP goes, root frame, if that is known.
    pub(crate) async fn of(
        equipment: &Equipment,
        arm: &Limb,
        leases: &ArmLeases,
        now: &[f64],
        target: Option<&Isometry3<f64>>,
    ) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let tcp = tcp_of(arm)?;
        let held = model.hand_of(arm).map_or_else(Point3::origin, held_in_tcp);
        let here = model.link_pose(now, tcp);
        let grasps: Vec<_> =
            target.into_iter().chain([&here]).map(|root_from_tcp| root_from_tcp * held).collect();
        let loads = equipment.robot.loads();
        let in_the_way = |known: &KnownPlace| {
            let held =
                loads.values().any(|load| known.thing.as_ref().is_some_and(|id| id.as_str() == load.name));
            let at_hand = || grasps.iter().any(|grasp| distance(&known.shape, grasp) < AT_HAND);
            known.thing.is_none() || !(held || at_hand())
        };
        let known: Vec<KnownPlace> =
            known(equipment.remembered()).await?.into_iter().filter(in_the_way).collect();
        let places = known.iter().filter(|known| known.thing.is_none()).map(|known| &known.shape.name);
        let kept = places.filter(|name| !leases.touches.contains(name)).cloned().collect();
        let joints = leases.joints.clone();
        let (boxes, arm) = (known.into_iter().map(|known| known.shape).collect(), arm.name.clone());
        Ok(Self { boxes, kept, loads, tcp, joints, arm, equipment: equipment.clone(), model })
    }

    /// A path from `now` to `goal`, if that is free: only these two where the straight way is free; fails where no way is found.
    pub(crate) async fn way_to_joints(self, now: Vec<f64>, goal: Vec<f64>) -> Result<Path, Failure> {
        planned(move || self.plan(&mut self.planner(), &now, &goal)).await
    }

    /// A path to a pose of the TCP (root frame), if its straight line at `speed` m/s is blocked or ends short of it; `None` if that is free, and
    /// arrives or nothing else does. Fails where the line is blocked and the pose is out of reach or not free, or no way to it is found.
    pub(crate) async fn way_to_pose(
        self,
        now: Vec<f64>,
        target: Isometry3<f64>,
        speed: f64,
    ) -> Result<Option<Path>, Failure> {
        planned(move || self.plan_to_pose(&now, &target, speed)).await
    }

    /// Which two bodies are so near each other with all joints at `now` that the guard lets them come no nearer, if any are.
    async fn stopped_by(self, now: Vec<f64>) -> Result<Option<Nearness>, Failure> {
        planned(move || Ok(self.planner().stopped_by(&self.joints, &now))).await
    }

    fn planner(&self) -> Planner {
        Planner::carrying(&self.model, &self.loads, &self.boxes).stopped_before(&self.kept)
    }

    fn plan(&self, planner: &mut Planner, now: &[f64], goal: &[f64]) -> Result<Path, Failure> {
        planner.plan(&self.joints, now, goal, self.equipment.seed).map_err(failed)
    }

    fn plan_to_pose(
        &self,
        now: &[f64],
        target: &Isometry3<f64>,
        speed: f64,
    ) -> Result<Option<Path>, Failure> {
        let mut planner = self.planner();
        let line = self.rehearse(now, target, speed)?;
        let end = line.last().map_or(now, Vec::as_slice);
        let error = pose_error(&self.model.link_pose(end, self.tcp), target);
        let arrives = error.linear.norm() < ARRIVED.0 && error.angular.norm() < ARRIVED.1;
        let is_free = match planner.check(&line) {
            Ok(()) => true,
            Err(PlanError::WayBlocked(_) | PlanError::GoalBlocked(_)) => false,
            Err(other) => return Err(failed(other)),
        };
        if is_free {
            // On a straight line joints may come to limits that another posture spares them.
            let around = if arrives { None } else { self.plan_to_posture(&mut planner, now, target).ok() };
            return Ok(around);
        }
        if arrives && let Ok(path) = self.plan(&mut planner, now, end) {
            return Ok(Some(path));
        }
        self.plan_to_posture(&mut planner, now, target).map(Some)
    }

    /// A path to a posture in which the TCP is at a pose (root frame).
    fn plan_to_posture(
        &self,
        planner: &mut Planner,
        now: &[f64],
        target: &Isometry3<f64>,
    ) -> Result<Path, Failure> {
        let solved = solve_pose(
            &self.model,
            self.tcp,
            &self.joints,
            target,
            &self.model.taken_at(self.model.ready(&self.arm), now),
            &PoseOptions::default(),
            &mut self.equipment.random(),
        );
        let mut goal = solved.map_err(failed)?;
        // The other joints stay where they are.
        let moved: Vec<f64> = self.joints.iter().map(|&j| goal[j]).collect();
        goal.copy_from_slice(now);
        self.joints.iter().zip(moved).for_each(|(&j, q)| goal[j] = q);
        self.plan(planner, now, &goal)
    }

    /// The joints on the straight line of the TCP, as differential kinematics would move them.
    fn rehearse(&self, now: &[f64], target: &Isometry3<f64>, speed: f64) -> Result<Path, Failure> {
        let posture: Vec<f64> = self.joints.iter().map(|&j| self.model.ready(&self.arm)[j]).collect();
        let mut ik = DifferentialIk::new(&self.model, self.tcp, &self.joints, IkConfig::default());
        let mut q = now.to_vec();
        let mut line =
            StraightLine::new(self.model.link_pose(&q, self.tcp), *target, speed).map_err(failed)?;
        let (mut path, mut rested) = (vec![q.clone()], 0);
        while path.len() < STEPS && rested < SETTLING {
            let point = line.step(STEP_S).map_err(failed)?;
            let error = pose_error(&self.model.link_pose(&q, self.tcp), &point.pose);
            let twist = Twist {
                linear: point.linear + GAIN * error.linear,
                angular: point.angular + GAIN * error.angular,
            };
            for (&j, velocity) in self.joints.iter().zip(ik.step(&q, &twist, Some(&posture)).velocities) {
                q[j] += STEP_S * velocity;
            }
            rested += usize::from(line.rested(0.0));
            path.push(q.clone());
        }
        Ok(path)
    }
}

/// Plans on a thread of its own, so that the robot's control goes on meanwhile.
async fn planned<T: Send + 'static>(
    plan: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let planned = tokio::task::spawn_blocking(plan).await;
    planned.map_err(|error| Failure::new(format!("planning ended early: {error}")))?
}

/// Stops an arm that has not come to its goal, and says why, as the end of a message: which two bodies the guard lets come no nearer, if any.
pub(crate) async fn stops_short(arm: &LeasedArm, sample: &Sensed) -> Result<String, Failure> {
    arm.stand()?;
    let now = &sample.position;
    let near = match Around::of(&arm.equipment, &arm.limb, &arm.leases, now, None).await {
        Ok(around) => around.stopped_by(now.clone()).await.ok().flatten(),
        Err(_) => None,
    };
    let why = near.map(|near| {
        let mm = near.distance_m * 1e3;
        format!("; `{}` is {mm:.0} mm from `{}`, and may come no nearer", near.first, near.second)
    });
    Ok(why.unwrap_or_else(|| "; is that within reach?".to_owned()))
}

/// Moves what is leased along a path of all joints, from corner to corner, all joints together; fails where the last corner is not
/// reached within `timeout` s.
pub(crate) async fn follow(
    senses: &mut Senses,
    model: &Model,
    leases: &ArmLeases,
    path: &Path,
    (tolerance, timeout): (f64, f64),
) -> Result<(), Failure> {
    /// The share of each joint's speed and acceleration limits that is used.
    const SPEED_SHARE: f64 = 0.8;
    const ACCELERATION_SHARE: f64 = 0.3;
    /// A corner counts as passed within this, rad (m): a fraction of the distance that paths keep.
    const PASSED: f64 = 0.01;
    let speed = |joint: usize| model.joints()[joint].velocity * SPEED_SHARE;
    let acceleration = |joint: usize| model.joints()[joint].acceleration * ACCELERATION_SHARE;
    let mut elapsed = 0.0;
    let mut corners = path.iter().skip(1).peekable();
    while let Some(corner) = corners.next() {
        let tolerance = if corners.peek().is_some() { tolerance.max(PASSED) } else { tolerance };
        loop {
            let (sample, dt) = senses.next().await?;
            elapsed += dt;
            // All joints arrive together: the slowest one determines the speed, including braking.
            let error = |joint: usize| corner[joint] - sample.position[joint];
            let moved = || leases.joints.iter().copied();
            let worst = moved().map(|j| error(j).abs()).fold(0.0, f64::max);
            if worst < tolerance {
                break;
            }
            if elapsed > timeout {
                return Err(Failure::new(format!(
                    "the posture was not reached within {timeout:.0} s: a joint is still {worst:.3} rad away"
                )));
            }
            let time_left = moved().map(|j| error(j).abs() / speed(j)).fold(0.0, f64::max);
            let braking = moved()
                .map(|j| error(j).abs() / (2.0 * acceleration(j) * error(j).abs()).sqrt().max(1e-6))
                .fold(0.0, f64::max);
            let time_left = time_left.max(braking).max(0.08);
            let velocity: Vec<f64> = moved().map(|j| error(j) / time_left).collect();
            leases.command(&velocity)?;
        }
    }
    Ok(())
}
