//! The ideal reading of a six-axis sensor in a wrist, computed from the motion of hand and load.
//!
//! Momentum balance of everything beyond the sensor (palm, fingers, the held object), by finite differences of the
//! simulated motion: the sensor exerts `dP/dt - weight - external forces`, and the hand exerts the opposite on the
//! sensor. It is exact for the simulated motion, whatever the solver does internally. Noise is not added here.

use armarium_robot::ForceTorque;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rapier3d_f64::prelude::RigidBody;

use super::assembly::Wrist;
use super::convert;
use super::grip::Load;
use super::mass::Mass;
use super::plant::DT;
use crate::world::GRAVITY;

/// Momentum of a body about the room's origin, and the point at which its weight acts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Momentum {
    linear: Vector3<f64>,
    angular: Vector3<f64>,
    mass: f64,
    center: Vector3<f64>,
}

impl Momentum {
    pub(super) fn of_body(body: &RigidBody) -> Self {
        let properties = body.mass_properties();
        let local = &properties.local_mprops;
        let frame = convert::to_pose(body.position()).rotation.to_rotation_matrix();
        let principal = {
            let q = local.principal_inertia_local_frame;
            nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z))
                .to_rotation_matrix()
        };
        let axes = frame * principal;
        let moments = convert::to_vector(local.principal_inertia());
        let inertia = axes.matrix() * Matrix3::from_diagonal(&moments) * axes.matrix().transpose();
        let center = convert::to_vector(body.center_of_mass());
        Self::new(
            body.mass(),
            center,
            convert::to_vector(body.linvel()),
            inertia * convert::to_vector(body.angvel()),
        )
    }

    /// The momentum of a part that moves with a body.
    fn of_part(part: &Mass, body: &RigidBody) -> Self {
        let pose = convert::to_pose(body.position());
        let center = (pose * part.center()).coords;
        let angular = convert::to_vector(body.angvel());
        let arm = center - convert::to_vector(body.center_of_mass());
        let linear = convert::to_vector(body.linvel()) + angular.cross(&arm);
        let r = pose.rotation.to_rotation_matrix();
        let inertia = r.matrix() * part.inertia() * r.matrix().transpose();
        Self::new(part.mass, center, linear, inertia * angular)
    }

    fn new(mass: f64, center: Vector3<f64>, velocity: Vector3<f64>, spin: Vector3<f64>) -> Self {
        let linear = velocity * mass;
        Self { linear, angular: center.cross(&linear) + spin, mass, center }
    }

    /// Rate of change since `before`, minus the weight: the sum of all other forces, and their torque about the
    /// room's origin.
    fn demand(&self, before: &Self) -> (Vector3<f64>, Vector3<f64>) {
        let weight = Vector3::new(0.0, 0.0, -GRAVITY * self.mass);
        let force = (self.linear - before.linear) / DT - weight;
        let torque = (self.angular - before.angular) / DT - self.center.cross(&weight);
        (force, torque)
    }
}

/// The sensor.
#[derive(Clone, Debug)]
pub(super) struct WristWrench {
    palm: Mass,
    body_from_sensor: Isometry3<f64>,
    palm_before: Momentum,
    fingers_before: Vec<Momentum>,
    objects_before: Vec<Momentum>,
    /// Whether the bodies of the hand are others than in the step before, whose momenta are unknown then.
    renewed: bool,
    reading: ForceTorque,
}

impl WristWrench {
    pub(super) fn new(wrist: &Wrist, objects: usize) -> Self {
        Self {
            palm: wrist.palm,
            body_from_sensor: wrist.body_from_sensor,
            palm_before: Momentum::default(),
            fingers_before: vec![Momentum::default(); wrist.fingers.len()],
            objects_before: vec![Momentum::default(); objects],
            renewed: false,
            reading: ForceTorque::default(),
        }
    }

    /// Goes on with other bodies of the same hand. The reading stays for one step.
    pub(super) fn renew(&mut self, wrist: &Wrist) {
        let (reading, objects_before) = (self.reading, std::mem::take(&mut self.objects_before));
        *self = Self { reading, objects_before, renewed: true, ..Self::new(wrist, 0) };
    }

    pub(super) fn reading(&self) -> ForceTorque {
        self.reading
    }

    /// Takes the present motion for that of the step before.
    pub(super) fn remember(&mut self, palm: &RigidBody, fingers: &[Momentum], objects: &[Momentum]) {
        self.keep(Momentum::of_part(&self.palm, palm), fingers, objects);
    }

    fn keep(&mut self, palm: Momentum, fingers: &[Momentum], objects: &[Momentum]) {
        self.palm_before = palm;
        self.fingers_before.copy_from_slice(fingers);
        self.objects_before.copy_from_slice(objects);
    }

    /// The force and torque that the hand exerts on a held object. `outside` is the sum of all other forces except
    /// the weight, with their torque about the object's middle.
    pub(super) fn load(
        &self,
        object: usize,
        now: &Momentum,
        outside: &Vector3<f64>,
        outside_torque: &Vector3<f64>,
    ) -> Load {
        let (force, torque) = now.demand(&self.objects_before[object]);
        let force = force - outside;
        let torque = torque - now.center.cross(outside) - outside_torque;
        Load { force, torque: torque - now.center.cross(&force) }
    }

    /// Updates the reading from the motion of a step and the external forces in it (torque about the room's
    /// origin).
    pub(super) fn update(
        &mut self,
        palm: &RigidBody,
        fingers: &[Momentum],
        objects: &[Momentum],
        held: Option<usize>,
        (outside, outside_torque): (&Vector3<f64>, &Vector3<f64>),
    ) {
        if std::mem::take(&mut self.renewed) {
            return self.remember(palm, fingers, objects);
        }
        let palm_now = Momentum::of_part(&self.palm, palm);
        let (mut force, mut torque) = palm_now.demand(&self.palm_before);
        let bodies = fingers.iter().zip(&self.fingers_before);
        let load = held.map(|h| (&objects[h], &self.objects_before[h]));
        for (now, before) in bodies.chain(load) {
            let (f, t) = now.demand(before);
            force += f;
            torque += t;
        }
        let on_sensor = outside - force;
        let torque_on_sensor = outside_torque - torque;
        let root_from_sensor = convert::to_pose(palm.position()) * self.body_from_sensor;
        let origin: Point3<f64> = root_from_sensor.translation.vector.into();
        let about_sensor = torque_on_sensor - origin.coords.cross(&on_sensor);
        self.reading.force = root_from_sensor.inverse_transform_vector(&on_sensor);
        self.reading.torque = root_from_sensor.inverse_transform_vector(&about_sensor);
        self.keep(palm_now, fingers, objects);
    }
}
