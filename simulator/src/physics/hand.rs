//! A hand of the robot: its palm and fingers in the physics, what its wrench sensor feels, and what it grips.
//!
//! An arm without a sensor has a hand, too; then nobody reads what is felt at its TCP.

use armarium_robot::{ForceTorque, Limb, LinkId, Model};
use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::assembly::{Assembly, Wrist};
use super::build::RobotBodies;
use super::contacts::ExternalWrench;
use super::convert;
use super::grip::{Grip, Load, PadPress};
use super::pad::Moving;
use super::plant::{DT, Object, PAD_FRICTION, moving};
use super::soft_grip::SoftGrip;
use super::wrench::{Momentum, WristWrench};

/// A hand, and what it does.
pub(super) struct SimulatedHand {
    /// The link in whose frame the sensor measures, and the TCP.
    frames: [LinkId; 2],
    /// The links of the pads.
    pad_links: Vec<LinkId>,
    /// All links beyond the sensor.
    links: Vec<LinkId>,
    pub(super) palm: RigidBodyHandle,
    fingers: Vec<RigidBodyHandle>,
    pads: Vec<ColliderHandle>,
    colliders: Vec<ColliderHandle>,
    body_from_tcp: Isometry3<f64>,
    wrench: WristWrench,
    pub(super) grip: Grip,
    /// The middle of what it grips, TCP frame.
    grasp: Point3<f64>,
    /// How it grips a body with handles.
    pub(super) soft: Option<SoftGrip>,
}

impl SimulatedHand {
    /// The hand of an arm; `None` if that has no TCP.
    pub(super) fn new(
        model: &Model,
        arm: &Limb,
        (assembly, robot): (&Assembly, &RobotBodies),
        objects: usize,
    ) -> Option<Self> {
        let tcp = arm.tcp?;
        let sensor = model.sensor_of(arm).unwrap_or(tcp);
        let links: Vec<LinkId> = model.subtree(sensor).collect();
        let wrist = assembly.wrist(model, sensor, tcp);
        let mut hand = Self {
            frames: [sensor, tcp],
            pad_links: model.hand_of(arm).map_or_else(Vec::new, |hand| hand.pads.clone()),
            links,
            palm: robot.base,
            fingers: Vec::new(),
            pads: Vec::new(),
            colliders: Vec::new(),
            body_from_tcp: Isometry3::identity(),
            wrench: WristWrench::new(&wrist, objects),
            grip: Grip::default(),
            grasp: model
                .hand_of(arm)
                .map_or_else(Point3::origin, |hand| hand.grasp_in_tcp.translation.vector.into()),
            soft: None,
        };
        hand.find(&wrist, robot);
        Some(hand)
    }

    /// Goes on with other bodies of the robot.
    pub(super) fn renew(&mut self, model: &Model, assembly: &Assembly, robot: &RobotBodies) {
        let wrist = assembly.wrist(model, self.frames[0], self.frames[1]);
        self.wrench.renew(&wrist);
        self.find(&wrist, robot);
    }

    fn find(&mut self, wrist: &Wrist, robot: &RobotBodies) {
        let of = |links: &[LinkId]| -> Vec<ColliderHandle> {
            let colliders = robot.colliders.iter().filter(|(link, _)| links.contains(link));
            colliders.map(|(_, collider)| *collider).collect()
        };
        self.palm = robot.carrier(wrist.lump);
        self.fingers = wrist.fingers.iter().map(|finger| robot.carrier(Some(*finger))).collect();
        (self.pads, self.colliders) = (of(&self.pad_links), of(&self.links));
        self.body_from_tcp = wrist.body_from_tcp;
    }

    /// Pose of the TCP.
    pub(super) fn tcp(&self, bodies: &rapier::RigidBodySet) -> Isometry3<f64> {
        convert::to_pose(bodies[self.palm].position()) * self.body_from_tcp
    }

    /// Velocity of the TCP, m/s, root frame.
    pub(super) fn tcp_velocity(&self, bodies: &rapier::RigidBodySet) -> Vector3<f64> {
        self.moving(bodies).linear
    }

    /// The motion of the TCP.
    pub(super) fn moving(&self, bodies: &rapier::RigidBodySet) -> Moving {
        moving(&bodies[self.palm], &self.body_from_tcp)
    }

    /// The object that a joint holds in the hand: what its sensor feels the motion of.
    pub(super) fn joined(&self) -> Option<usize> {
        self.grip.held().filter(|_| self.soft.is_none())
    }

    /// Grips a body with handles softly from now on.
    pub(super) fn grip_softly(&mut self, bodies: &rapier::RigidBodySet, (index, object): (usize, &Object)) {
        let pose = convert::to_pose(bodies[object.handle].position());
        self.soft = Some(SoftGrip::new(index, self.grasp, &self.tcp(bodies), &pose));
    }

    /// What the hand exerts on its sensor.
    pub(super) fn wrench(&self) -> ForceTorque {
        self.wrench.reading()
    }

    /// Whether a collision shape is beyond the sensor, or that of what the hand holds.
    pub(super) fn has(
        &self,
        collider: ColliderHandle,
        body: Option<RigidBodyHandle>,
        objects: &[Object],
    ) -> bool {
        self.colliders.contains(&collider)
            || self.joined().is_some_and(|held| Some(objects[held].handle) == body)
    }

    /// Advances the grip by a step. `outside` is the sum of the forces on the held object besides weight and hand, with
    /// their torque about its middle. `others` are the objects in other hands.
    pub(super) fn step_grip(
        &mut self,
        physics: &rapier::PhysicsWorld,
        objects: &[Object],
        momenta: &[Momentum],
        outside: Option<ExternalWrench>,
        others: &[usize],
    ) {
        let presses: Vec<Vec<PadPress>> = (0..objects.len())
            .map(|object| {
                let pads = self.pads.iter().filter(|_| !others.contains(&object));
                pads.map(|pad| press(physics, *pad, &objects[object])).collect()
            })
            .collect();
        let soft = self.soft.as_ref().map(|soft| Load { force: -soft.reaction.force, torque: soft.moment });
        let load = soft.or_else(|| {
            let (held, outside) = self.joined().zip(outside)?;
            Some(self.wrench.load(held, &momenta[held], &outside.force, &outside.torque))
        });
        let slippery = self.grip.held().and_then(|held| objects[held].slippery.as_ref());
        let friction = slippery.map_or(PAD_FRICTION, |slippery| slippery.friction.min(PAD_FRICTION));
        self.grip.step(&presses, load, friction, DT);
    }

    /// Lets time pass for a hand that touches and holds nothing, or that sleeps with what it holds.
    pub(super) fn rest_grip(&mut self) {
        self.grip.rest(DT);
    }

    /// Takes the present motion for that of the step before.
    pub(super) fn remember(&mut self, bodies: &rapier::RigidBodySet, objects: &[Momentum]) {
        let fingers = self.momenta(bodies);
        self.wrench.remember(&bodies[self.palm], &fingers, objects);
    }

    /// Updates what the sensor feels, from the motion of a step and the forces from outside in it, on the hand and what it
    /// holds.
    pub(super) fn feel(
        &mut self,
        bodies: &rapier::RigidBodySet,
        objects: &[Momentum],
        outside: &ExternalWrench,
    ) {
        let fingers = self.momenta(bodies);
        let held = self.joined();
        let outside = (&outside.force, &outside.torque);
        self.wrench.update(&bodies[self.palm], &fingers, objects, held, outside);
    }

    fn momenta(&self, bodies: &rapier::RigidBodySet) -> Vec<Momentum> {
        self.fingers.iter().map(|finger| Momentum::of_body(&bodies[*finger])).collect()
    }
}

/// The pressure of a pad on an object.
fn press(physics: &rapier::PhysicsWorld, pad: ColliderHandle, object: &Object) -> PadPress {
    let mut press = PadPress::default();
    if !object.loose {
        return press;
    }
    for collider in &object.colliders {
        let Some(pair) = physics.narrow_phase.contact_pair(pad, *collider) else { continue };
        press.touches |= pair.has_any_active_contact();
        // A manifold's normal goes from the first collider to the second one.
        let outwards = if pair.collider1 == pad { 1.0 } else { -1.0 };
        for manifold in pair.solver_manifolds() {
            let force = manifold.points.iter().map(|p| p.data.impulse).sum::<f64>() / DT;
            press.force += force;
            press.pushes += convert::to_vector(manifold.data.normal) * (outwards * force);
        }
    }
    press
}
