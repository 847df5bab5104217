//! A robot in the room: its joints with their servos, its arms with their hands, and which of them sleep.
//!
//! It does not know the objects beyond what its hands hold; [`Plant`](super::Plant) makes and breaks the joints between them.

use std::sync::Arc;

use armarium_robot::{ForceTorque, Limb, LinkId, Model};
use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::assembly::Assembly;
use super::build::{RobotBodies, add_robot};
use super::drives::Joints;
use super::hand::SimulatedHand;
use super::pad::{Pad, PadReaction};
use super::people::LedHand;
use super::plant::External;
use crate::error::PlantError;
use crate::start::{MountedPad, RobotErrors, RobotStart};

/// An arm sleeps after this many steps of rest.
const SLEEPS_AFTER: u32 = 300;
/// How far the first set points may be from where the joints are, rad (m): some deviations of the joint sensors.
const FIRST_TARGET: f64 = 2e-3;
/// A joint that is slower than this rests, rad/s (m/s).
const RESTING: f64 = 1e-3;

/// An arm with its hand.
pub(super) struct ArmWithHand {
    /// Its joints and those of its hand.
    joints: Vec<usize>,
    /// Its wrench sensor.
    pub(super) sensor: Option<usize>,
    pub(super) colliders: Vec<ColliderHandle>,
    /// Whether something touched it in the last step.
    pub(super) touched: bool,
    pub(super) hand: SimulatedHand,
    pub(super) pad: Option<PaddedHand>,
    /// What a person who leads its hand did in the last step.
    pub(super) led: Option<LedHand>,
    pub(super) rest: ArmSleep,
}

/// A soft pad on a hand, and the box that it presses.
pub(super) struct PaddedHand {
    pub(super) mounted: MountedPad,
    pub(super) pad: Option<(usize, Pad)>,
    /// The force of the box on the hand in the last step; the torque is about the TCP.
    pub(super) reaction: PadReaction,
}

/// Whether an arm sleeps.
///
/// It falls asleep when for [`SLEEPS_AFTER`] steps its set points have not changed, its joints have stood, and nothing has
/// touched or pushed it or what it holds. It wakes in the step in which one of these ends. Asleep, its joints are stiff where
/// they are, and it keeps its grip.
#[derive(Debug)]
pub(super) struct ArmSleep {
    pub(super) asleep: bool,
    /// Number of steps for which it has rested.
    steps: u32,
    /// The set points of the last step; at first, where the joints are.
    targets: Vec<f64>,
    /// How far a set point may be from the one before without asking for motion, rad (m).
    tolerance: f64,
}

impl ArmSleep {
    /// Takes a step's set points over; returns whether they ask for motion.
    fn asks_for_motion(&mut self, joints: &[usize], (position, velocity): (&[f64], &[f64])) -> bool {
        let mut moving = false;
        for (&joint, target) in joints.iter().zip(&mut self.targets) {
            moving |= velocity[joint] != 0.0 || (*target - position[joint]).abs() > self.tolerance;
            *target = position[joint];
        }
        self.tolerance = 0.0;
        moving
    }
}

/// A robot in the physics.
pub(super) struct PlantRobot {
    model: Arc<Model>,
    room_from_root: Isometry3<f64>,
    errors: RobotErrors,
    pub(super) joints: Joints,
    /// The joints of the arms, of what helps them and carries them, and of their hands.
    heavy: Vec<usize>,
    parts: RobotBodies,
    pub(super) arms: Vec<ArmWithHand>,
    /// The arm that works, as an index into `arms`.
    pub(super) working: usize,
}

impl PlantRobot {
    /// Adds a robot to the room; all its arms sleep at first. There are `objects` things that its hands could hold.
    pub(super) fn new(
        physics: &mut rapier::PhysicsWorld,
        robot: RobotStart,
        objects: usize,
    ) -> Result<Self, PlantError> {
        let start = robot.true_position();
        let RobotStart { model, arm: works, room_from_root, errors, pads, .. } = robot;
        let limbs: Vec<&Limb> = model.arms().collect();
        let own = |arm: &Limb| -> Vec<usize> {
            let hand = arm.hand.as_deref().map_or(&[][..], |hand| model.limb(hand));
            arm.joints.iter().chain(hand).copied().collect()
        };
        let mut heavy: Vec<usize> = limbs.iter().flat_map(|arm| own(arm)).collect();
        let touching = heavy.clone();
        let drives = model.platform().into_iter().flat_map(|platform| platform.joints);
        for joint in limbs.iter().flat_map(|arm| model.reaching_joints(&arm.name)).chain(drives) {
            if !heavy.contains(&joint) {
                heavy.push(joint);
            }
        }
        let carriers: Vec<usize> = heavy.iter().copied().filter(|joint| !touching.contains(joint)).collect();
        let touching = if pads.is_empty() { touching } else { Vec::new() };
        let assembly = Assembly::new(&model, &start, (&carriers, &touching), errors.hand_mass_scale);
        let still = vec![0.0; start.len()];
        let parts = add_robot(physics, &model, &assembly, (&room_from_root, &errors), (&start, &still))?;
        let arm = |limb: &&Limb| {
            let hand = SimulatedHand::new(&model, limb, (&assembly, &parts), objects)?;
            let targets = own(limb).iter().map(|&joint| start[joint]).collect();
            Some(ArmWithHand {
                joints: own(limb),
                sensor: limb.wrench,
                colliders: Vec::new(),
                touched: false,
                hand,
                pad: None,
                led: None,
                // The first set points are where the joints are sensed to be.
                rest: ArmSleep { asleep: true, steps: 0, targets, tolerance: FIRST_TARGET },
            })
        };
        let working = limbs.iter().position(|arm| arm.name == works);
        let mut arms: Vec<ArmWithHand> = limbs.iter().filter_map(arm).collect();
        for (arm, pad) in arms.iter_mut().zip(&pads) {
            arm.pad = Some(PaddedHand { mounted: *pad, pad: None, reaction: PadReaction::default() });
        }
        let working = working.filter(|working| *working < arms.len());
        let working = working.ok_or_else(|| PlantError::Missing { what: "arm that works".into() })?;
        let joints = Joints::new(&model, parts.bodies.clone(), &heavy, &start);
        let mut robot = Self { model, room_from_root, errors, joints, heavy, parts, arms, working };
        robot.find_colliders();
        Ok(robot)
    }

    /// The hand of the arm that works.
    pub(super) fn hand(&self) -> &SimulatedHand {
        &self.arms[self.working].hand
    }

    /// What the middle one of the joints of the arm that works moves; of an arm that sleeps, nothing.
    pub(super) fn forearm(&self) -> Option<RigidBodyHandle> {
        let arm = self.model.arms().nth(self.working)?;
        let joint = *arm.joints.get(arm.joints.len() / 2)?;
        let body = self.parts.bodies.iter().find(|body| body.index == joint && body.leads)?;
        Some(body.handle)
    }

    /// What its hands exert on its wrench sensors, in the order of the model's. A sensor of no arm feels nothing.
    pub(super) fn wrenches(&self) -> impl Iterator<Item = ForceTorque> + '_ {
        (0..self.model.wrenches().len()).map(|sensor| {
            let arm = self.arms.iter().find(|arm| arm.sensor == Some(sensor));
            arm.map_or_else(ForceTorque::default, |arm| arm.hand.wrench())
        })
    }

    /// Decides which arms are awake in this step; returns whether that has changed. `push` is the force on the hand that works;
    /// what else happens to the objects is in `external`.
    pub(super) fn wake_and_rest(
        &mut self,
        targets: (&[f64], &[f64]),
        push: &Vector3<f64>,
        external: &External,
    ) -> bool {
        let mut changed = false;
        for (i, arm) in self.arms.iter_mut().enumerate() {
            let asked = arm.rest.asks_for_motion(&arm.joints, targets);
            let moves = arm.joints.iter().any(|&joint| self.joints.velocity[joint].abs() > RESTING);
            let is_disturbed = |held: usize| {
                external.objects.get(held).is_some_and(|knock| *knock != Vector3::zeros())
                    || external.slippery.iter().any(|(slippery, _)| *slippery == held)
            };
            let pushed = (i == self.working && *push != Vector3::zeros())
                || arm.hand.joined().is_some_and(is_disturbed);
            let busy = asked || pushed || moves || arm.touched;
            arm.rest.steps = if busy { 0 } else { arm.rest.steps.saturating_add(1) };
            let asleep = if arm.rest.asleep { !busy } else { arm.rest.steps >= SLEEPS_AFTER };
            changed |= asleep != arm.rest.asleep;
            arm.rest.asleep = asleep;
        }
        changed
    }

    /// Builds its bodies again, for the arms that are awake now. Its hands must not be joined to anything.
    pub(super) fn rebuild(&mut self, physics: &mut rapier::PhysicsWorld) -> Result<(), PlantError> {
        let asleep =
            |joint: &usize| self.arms.iter().any(|arm| arm.rest.asleep && arm.joints.contains(joint));
        let dynamic: Vec<usize> = self.heavy.iter().copied().filter(|joint| !asleep(joint)).collect();
        let touching = self.arms.iter().filter(|arm| arm.pad.is_none());
        let touching: Vec<usize> = touching.flat_map(|arm| arm.joints.iter().copied()).collect();
        self.parts.remove(physics);
        let Joints { position, velocity, .. } = &self.joints;
        let assembly =
            Assembly::new(&self.model, position, (&dynamic, &touching), self.errors.hand_mass_scale);
        self.parts = add_robot(
            physics,
            &self.model,
            &assembly,
            (&self.room_from_root, &self.errors),
            (position, velocity),
        )?;
        self.joints.replace(self.parts.bodies.clone());
        for arm in &mut self.arms {
            arm.hand.renew(&self.model, &assembly, &self.parts);
        }
        self.find_colliders();
        Ok(())
    }

    fn find_colliders(&mut self) {
        let model = &self.model;
        for arm in &mut self.arms {
            let moved = |joint: &usize, link| model.moves(*joint, link);
            let colliders = self.parts.colliders.iter();
            let own = colliders.filter(|(link, _)| arm.joints.iter().any(|joint| moved(joint, *link)));
            arm.colliders = own.map(|(_, collider)| *collider).collect();
        }
    }

    /// The shapes of its parts that touch.
    pub(super) fn colliders(&self) -> impl Iterator<Item = ColliderHandle> + '_ {
        self.parts.colliders.iter().map(|(_, collider)| *collider)
    }

    /// The link of which this is a collision shape.
    pub(super) fn link_of(&self, collider: ColliderHandle) -> Option<LinkId> {
        self.parts.colliders.iter().find(|(_, own)| *own == collider).map(|(link, _)| *link)
    }

    /// Whether a collider is a part of this robot.
    pub(super) fn has(&self, collider: ColliderHandle) -> bool {
        self.link_of(collider).is_some()
    }
}
