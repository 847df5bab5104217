//! The right arm of ARMAR-III as the coached robot: its inverse kinematics near a posture, and its execution in the
//! simulator behind the robot's guard or, for comparison, with ideal joints.

use std::sync::Arc;

use armarium_robot::description::default_robot;
use armarium_robot::{Kinematics, Lease, LeaseLimits, LinkId, Model, Robot};
use armarium_simulator::modification::{Compared, ModificationFigures, modification, of_path};
use armarium_simulator::world::World;
use armarium_simulator::{Options, Simulation};
use nalgebra::{Matrix3, Point3, SVector, Vector3};

use super::error::ExperimentError;

/// Joints of the arm.
pub(crate) const JOINTS: usize = 7;
/// Angles or speeds of the arm's joints, rad or rad/s.
pub(crate) type Joints = SVector<f64, JOINTS>;

/// The arm; the rest of the robot stands still.
pub(crate) struct HumanoidArm {
    name: String,
    kinematics: Kinematics,
    tcp: LinkId,
    joints: [usize; JOINTS],
    /// All joints of the robot, the arm's in its best working posture.
    rest: Vec<f64>,
}

impl HumanoidArm {
    pub(crate) fn new() -> Result<Self, ExperimentError> {
        let failed = |what: String| ExperimentError::Failed(what);
        let model =
            Model::shipped(default_robot()).map_err(|wrong| failed(format!("{:?}", wrong.first())))?;
        let missing = || ExperimentError::Failed("the robot lacks an arm of seven joints".into());
        let limb = model.arms().next().ok_or_else(missing)?;
        let joints = limb.joints.as_slice().try_into().map_err(|_| missing())?;
        let tcp = limb.tcp.ok_or_else(missing)?;
        let (name, rest) = (limb.name.clone(), model.ready(&limb.name).to_vec());
        Ok(Self { name, rest, kinematics: Kinematics::new(&model), tcp, joints })
    }

    /// All joints, with the arm's at `q`.
    fn all(&self, q: &Joints) -> Vec<f64> {
        let mut all = self.rest.clone();
        self.joints.iter().zip(q.iter()).for_each(|(j, q)| all[*j] = *q);
        all
    }

    /// TCP position (m) and the columns of its Jacobian (m/rad) for the arm's joints, root frame.
    pub(crate) fn at(&mut self, q: &Joints) -> (Vector3<f64>, [Vector3<f64>; JOINTS]) {
        let all = self.all(q);
        self.kinematics.update(&all);
        let x = self.kinematics.pose(self.tcp).translation.vector;
        let columns = self.joints.map(|j| self.kinematics.column(j, self.tcp, &Point3::from(x)).linear);
        (x, columns)
    }

    /// The arm's joints in the preferred posture.
    pub(crate) fn posture(&self) -> Joints {
        Joints::from_fn(|i, _| self.rest[self.joints[i]])
    }

    /// The joint angles nearest to `posture` that move the TCP to `x`, m; the hand's orientation is free.
    pub(crate) fn inverse(&mut self, x: Vector3<f64>, posture: &Joints) -> Result<Joints, ExperimentError> {
        let mut q = *posture;
        for _ in 0..500 {
            let (here, columns) = self.at(&q);
            let square: Matrix3<f64> = columns.iter().map(|c| c * c.transpose()).sum();
            let away = q - posture;
            let moved: Vector3<f64> = columns.iter().zip(away.iter()).map(|(c, a)| c * *a).sum();
            let wanted = moved + x - here;
            let inverse = (square + Matrix3::identity() * 1e-10).try_inverse().unwrap_or_else(Matrix3::zeros);
            let multiplier = inverse * wanted;
            let step = Joints::from_fn(|i, _| columns[i].dot(&multiplier)) - away;
            q += step * (0.3 / step.norm()).min(0.8);
            if step.norm() < 1e-12 {
                break;
            }
        }
        let apart = (self.at(&q).0 - x).norm();
        if apart < 1e-6 && self.margin(&q) > 0.0 {
            return Ok(q);
        }
        Err(ExperimentError::Failed(format!(
            "the arm does not reach ({:.3}, {:.3}, {:.3}) m within its limits",
            x.x, x.y, x.z
        )))
    }

    /// The smallest distance of a joint from its limit, rad; negative beyond the limit.
    pub(crate) fn margin(&self, q: &Joints) -> f64 {
        let model = self.kinematics.model();
        let margin = |(j, q): (&usize, &f64)| {
            let joint = &model.joints()[*j];
            (q - joint.lower).min(joint.upper - q)
        };
        self.joints.iter().zip(q.iter()).map(margin).fold(f64::INFINITY, f64::min)
    }

    /// Starts the execution with the arm's joints at `q`; `seed` determines all randomness of the simulator.
    pub(crate) fn execution(
        &self,
        q: &Joints,
        physics: bool,
        seed: u64,
    ) -> Result<Execution, ExperimentError> {
        if !physics {
            return Ok(Execution::Ideal { position: *q, velocity: Joints::zeros(), path: Vec::new() });
        }
        let failed = |error: &dyn std::error::Error| ExperimentError::Failed(error.to_string());
        let world = World { objects: Vec::new(), ..World::ideal() };
        let options = Options { start: Some(self.all(q)), ..Options::default() };
        let simulation = Simulation::new(&world, seed, options).map_err(|e| failed(&e))?;
        let robot = simulation.robot();
        let lease = robot.lease(&self.name, "coaching", LeaseLimits::default()).map_err(|e| failed(&e))?;
        let simulated = SimulatedArm { simulation: Box::new(simulation), robot, lease, joints: self.joints };
        Ok(Execution::Simulated(simulated))
    }
}

/// The executor of the arm's motion.
pub(crate) enum Execution {
    /// Ideal joints without tracking error.
    Ideal {
        /// Angles, rad.
        position: Joints,
        /// Speeds, rad/s.
        velocity: Joints,
        /// Position of the TCP after each [`DT`].
        path: Vec<Vector3<f64>>,
    },
    /// The simulator: sensors, guard, servos, inertia, and the referee.
    Simulated(SimulatedArm),
}

/// The simulated robot with its arm leased.
pub(crate) struct SimulatedArm {
    simulation: Box<Simulation>,
    robot: Arc<dyn Robot>,
    lease: Lease,
    joints: [usize; JOINTS],
}

/// Step of the execution, s.
pub(crate) const DT: f64 = 0.001;
/// Gain on the position error in the velocity command, 1/s.
const FOLLOW: f64 = 15.0;

impl Execution {
    /// Drives the joints to `q` (rad) with `qd` (rad/s) for one [`DT`].
    pub(crate) fn drive(
        &mut self,
        arm: &mut HumanoidArm,
        q: &[f64],
        qd: &[f64],
    ) -> Result<(), ExperimentError> {
        match self {
            Self::Ideal { position, velocity, path } => {
                path.push(arm.at(position).0);
                position.copy_from_slice(q);
                velocity.copy_from_slice(qd);
                Ok(())
            }
            Self::Simulated(SimulatedArm { simulation, robot, lease, joints }) => {
                let here = robot.sensed().borrow();
                let velocity = std::array::from_fn::<f64, JOINTS, _>(|i| {
                    // Before the first step there is no sensor sample.
                    let behind = here.position.get(joints[i]).map_or(0.0, |at| q[i] - at);
                    let behind = if here.stamp_ns == 0 { 0.0 } else { behind };
                    qd[i] + FOLLOW * behind
                });
                lease.command(&velocity).map_err(|fault| ExperimentError::Failed(fault.to_string()))?;
                simulation.step();
                Ok(())
            }
        }
    }

    /// Measured joint positions (rad) and speeds (rad/s); `None` before the first sample.
    pub(crate) fn joints(&self) -> Option<(Joints, Joints)> {
        match self {
            Self::Ideal { position, velocity, .. } => Some((*position, *velocity)),
            Self::Simulated(SimulatedArm { robot, joints, .. }) => {
                let sensed = robot.sensed().borrow();
                let of = |all: &[f64]| Joints::from_fn(|i, _| all[joints[i]]);
                (sensed.stamp_ns > 0).then(|| (of(&sensed.position), of(&sensed.velocity)))
            }
        }
    }

    /// True position of the TCP, m, root frame, after each [`DT`] from the start, as recorded by the referee.
    pub(crate) fn truth(&self) -> Vec<Vector3<f64>> {
        match self {
            Self::Ideal { path, .. } => path.clone(),
            Self::Simulated(SimulatedArm { simulation, .. }) => {
                let log = simulation.referee().log();
                log.records.iter().map(|r| r.tcp.translation.vector).collect()
            }
        }
    }

    /// The referee's judgement, or for ideal joints the same figures of their path.
    pub(crate) fn judge(&self, compared: &Compared) -> ModificationFigures {
        let figures = match self {
            Self::Ideal { path, .. } => of_path(path, compared),
            Self::Simulated(SimulatedArm { simulation, .. }) => {
                modification(&simulation.referee().log(), compared)
            }
        };
        figures.unwrap_or(ModificationFigures { displacement_m: f64::NAN, far_side_rms_m: f64::NAN })
    }
}

/// The largest absolute value.
pub(crate) fn largest(values: &[Joints]) -> f64 {
    values.iter().map(Joints::amax).fold(0.0, f64::max)
}
