//! A compensated force/torque sensor in a wrist: the force and torque of the environment on the hand.
//!
//! The hand (every link beyond the sensor, and its load) obeys the Newton-Euler equations. `f` and `t` are the
//! force and torque that the hand exerts on the sensor; `m`, `c`, `I` are its mass, centre (from the sensor's
//! origin) and inertia; `a_c`, `w`, `al` are the acceleration of its centre, its angular velocity and its angular
//! acceleration. The environment's share, in the root frame and about the sensor's origin, is
//!
//! ```text
//! f_env = f + m (a_c - g)
//! t_env = t + c x m (a_c - g) + I al + w x I w
//! ```
//!
//! The acceleration is the difference of the velocities that the joint sensors report. It and the force pass
//! through the same low-pass (two equal poles, together -3 dB at 39 Hz, delay 5 ms), so that they stay synchronous.
//! The fingers are assumed not to move in the hand. Friction and contact are not modelled: everything that remains
//! counts as the environment's.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::model::GRAVITY;
use crate::{ForceTorque, Kinematics, LinkId, Load, Model, Twist};

/// Frequency of each of the two poles of the low-pass, Hz.
const POLE_HZ: f64 = 60.0;
/// Number of samples that a tare averages: the last 0.1 s at 1 kHz.
const TARE_SAMPLES: usize = 100;

/// The mass of a grasped object, kg, from the compensated wrist force before and after the grasp, in the same
/// posture and at rest, while the load is not yet set (see [`Robot::set_load`](crate::Robot::set_load)).
pub fn load_mass(before: &ForceTorque, after: &ForceTorque) -> f64 {
    (after.force - before.force).dot(&GRAVITY) / GRAVITY.norm_squared()
}

/// The rigid body beyond the sensor, in the root frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BodyBeyondSensor {
    pub(crate) mass: f64,
    /// Vector from the sensor's origin to the centre of mass, m.
    pub(crate) center: Vector3<f64>,
    /// Inertia about the centre of mass, kg m².
    inertia: Matrix3<f64>,
}

/// The links of the hand and its load.
#[derive(Clone, Debug)]
pub(crate) struct LoadedHand {
    sensor: LinkId,
    tcp: LinkId,
    links: Vec<LinkId>,
    load: Option<Load>,
}

impl LoadedHand {
    pub(crate) fn new(model: &Model, sensor: LinkId, tcp: LinkId) -> Self {
        let links = model.subtree(sensor).filter(|l| model.links()[l.0].inertial.is_some()).collect();
        Self { sensor, tcp, links, load: None }
    }

    pub(crate) fn body(&self, kinematics: &Kinematics) -> BodyBeyondSensor {
        let origin = Point3::from(kinematics.pose(self.sensor).translation.vector);
        let mut body = BodyBeyondSensor { mass: 0.0, center: Vector3::zeros(), inertia: Matrix3::zeros() };
        let mut about_origin = Matrix3::zeros();
        let mut add = |mass: f64, center: Vector3<f64>, inertia: Matrix3<f64>| {
            body.mass += mass;
            body.center += mass * center;
            about_origin += inertia + steiner(mass, &center);
        };
        for &link in &self.links {
            let Some(inertial) = kinematics.model().links()[link.0].inertial else { continue };
            let pose = kinematics.pose(link);
            let rotation = pose.rotation.to_rotation_matrix();
            let inertia = rotation.matrix() * inertial.inertia * rotation.matrix().transpose();
            add(inertial.mass, pose * inertial.center - origin, inertia);
        }
        if let Some(load) = &self.load {
            add(load.mass_kg, kinematics.pose(self.tcp) * load.center_in_tcp - origin, Matrix3::zeros());
        }
        if body.mass > 0.0 {
            body.center /= body.mass;
        }
        body.inertia = about_origin - steiner(body.mass, &body.center);
        body
    }

    /// The force and torque of the hand on the sensor, in the sensor's frame, about its origin, for the given
    /// motion and the environment's `force` at the TCP (root frame). For drivers without physics.
    pub(crate) fn reaction(
        &self,
        kinematics: &Kinematics,
        force: &Vector3<f64>,
        angular: &Vector3<f64>,
        acceleration: &Twist,
    ) -> ForceTorque {
        let sensor = kinematics.pose(self.sensor);
        let arm = kinematics.pose(self.tcp).translation.vector - sensor.translation.vector;
        let load = inertial_load(&self.body(kinematics), angular, acceleration);
        let on_sensor = ForceTorque { force: *force, torque: arm.cross(force) }.minus(load);
        on_sensor.map(|v| sensor.rotation.inverse() * v)
    }
}

/// The inertia of a point mass at `c`, kg m².
fn steiner(mass: f64, c: &Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::identity() * c.norm_squared() - c * c.transpose())
}

/// `m (a_c - g)`, and its torque about the sensor's origin.
fn inertial_load(body: &BodyBeyondSensor, angular: &Vector3<f64>, acceleration: &Twist) -> ForceTorque {
    let (w, al, c) = (angular, &acceleration.angular, &body.center);
    let at_center = acceleration.linear + al.cross(c) + w.cross(&w.cross(c));
    let force = body.mass * (at_center - GRAVITY);
    ForceTorque { force, torque: c.cross(&force) + body.inertia * al + w.cross(&(body.inertia * w)) }
}

/// Compensates one sensor; stepped with each sample. Allocates only in [`new`](Self::new).
#[derive(Clone, Debug)]
pub(crate) struct WristEstimator {
    hand: LoadedHand,
    previous: Option<Twist>,
    /// In the sensor's frame.
    bias: ForceTorque,
    recent: Vec<ForceTorque>,
    next: usize,
    /// The two poles of the low-pass, root frame; `None` before the first sample.
    poles: Option<[ForceTorque; 2]>,
}

impl WristEstimator {
    pub(crate) fn new(model: &Model, sensor: LinkId, tcp: LinkId) -> Self {
        Self {
            hand: LoadedHand::new(model, sensor, tcp),
            previous: None,
            bias: ForceTorque::default(),
            recent: Vec::with_capacity(TARE_SAMPLES),
            next: 0,
            poles: None,
        }
    }

    /// Processes the next raw sample at the configuration of `kinematics`; `velocity` of all joints, `dt` s since
    /// the last sample.
    pub(crate) fn update(
        &mut self,
        kinematics: &Kinematics,
        velocity: &[f64],
        raw: ForceTorque,
        dt: f64,
    ) -> ForceTorque {
        let pose = kinematics.pose(self.hand.sensor);
        let now = kinematics.twist(self.hand.sensor, &Point3::origin(), velocity);
        let before = self.previous.replace(now).unwrap_or(now);
        let acceleration =
            Twist { linear: (now.linear - before.linear) / dt, angular: (now.angular - before.angular) / dt };
        let load = inertial_load(&self.hand.body(kinematics), &now.angular, &acceleration);
        let in_sensor = raw.minus(load.map(|v| pose.rotation.inverse() * -v));
        self.remember(in_sensor);
        let in_root = in_sensor.minus(self.bias).map(|v| pose.rotation * v);
        let poles = self.poles.get_or_insert([in_root; 2]);
        let share = 1.0 - libm::exp(-std::f64::consts::TAU * POLE_HZ * dt);
        poles[0].toward(in_root, share);
        let first = poles[0];
        poles[1].toward(first, share);
        let ForceTorque { force, torque } = poles[1];
        let arm = kinematics.pose(self.hand.tcp).translation.vector - pose.translation.vector;
        ForceTorque { force, torque: torque - arm.cross(&force) }
    }

    fn remember(&mut self, sample: ForceTorque) {
        if self.recent.len() < TARE_SAMPLES {
            self.recent.push(sample);
        } else {
            self.recent[self.next] = sample;
        }
        self.next = (self.next + 1) % TARE_SAMPLES;
    }

    /// Takes the mean of the last 0.1 s as the sensor's bias.
    pub(crate) fn tare(&mut self, kinematics: &Kinematics) {
        if self.recent.is_empty() {
            return;
        }
        #[expect(clippy::cast_precision_loss, reason = "at most 100")]
        let n = self.recent.len() as f64;
        let mut mean = ForceTorque::default();
        for sample in &self.recent {
            mean.force += sample.force / n;
            mean.torque += sample.torque / n;
        }
        let rotation = kinematics.pose(self.hand.sensor).rotation;
        let change = mean.minus(self.bias).map(|v| rotation * v);
        self.bias = mean;
        for pole in self.poles.iter_mut().flatten() {
            *pole = pole.minus(change);
        }
    }

    /// What the hand holds. Samples taken before do not count for a tare.
    pub(crate) fn set_load(&mut self, load: Option<&Load>) {
        if self.hand.load.as_ref() == load {
            return;
        }
        self.hand.load = load.cloned();
        self.recent.clear();
        self.next = 0;
    }
}
