//! What hands hold by their soft pads and their soft grips: the forces in each step, and what two hands do to one body.

use armarium_values::distance_from_box;
use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::RigidBodyHandle;

use super::contacts::Touch;
use super::convert;
use super::pad::{Pad, PadReaction};
use super::plant::{DT, Object, Plant, moving};
use super::robot::ArmWithHand;

/// A hand that presses with its pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressingHand {
    /// The middle of the pad's face, m.
    pub at: Point3<f64>,
    /// The force of the hand on the body, N.
    pub force: Vector3<f64>,
    /// How many points of the pad slip.
    pub slipping: usize,
}

/// A body between the first robot's first two hands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressedLoad {
    /// The body, by its index.
    pub body: usize,
    /// What both hands do to it; nothing where they do not touch it.
    pub hands: [PressingHand; 2],
    /// The force upwards of what it stands on, the table or a static body, N.
    pub borne_n: f64,
    /// Whether they grip it by its handles, instead of pressing on its sides.
    pub gripped: bool,
}

impl Plant {
    /// Applies the forces of soft pads to the hands and to the boxes that they press.
    pub(super) fn press_pads(&mut self) {
        let Self { physics, objects, robots, .. } = self;
        for arm in robots.iter_mut().flat_map(|robot| &mut robot.arms) {
            let ArmWithHand { hand, pad: Some(padded), .. } = arm else { continue };
            let tcp = hand.moving(&physics.bodies);
            let face = tcp.pose * padded.mounted.middle;
            let far = |object: &Object| {
                let at = convert::to_pose(physics.bodies[object.handle].position());
                object.cuboid.map(|half| distance_from_box(&face, &at, &(2.0 * half)))
            };
            let boxes = objects.iter().enumerate().filter_map(|(i, object)| Some((i, far(object)?)));
            let Some((nearest, _)) = boxes.min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
            let Object { handle, cuboid: Some(half), .. } = &objects[nearest] else { continue };
            let carried = moving(&physics.bodies[*handle], &Isometry3::identity());
            if padded.pad.as_ref().is_none_or(|(pressed, _)| *pressed != nearest) {
                padded.pad = Some((nearest, Pad::new(&padded.mounted, physics.bodies[*handle].mass())));
            }
            let Some((_, pad)) = &mut padded.pad else { continue };
            let side = pad.side(&tcp, &carried);
            padded.reaction = pad.step(&tcp, &carried, half, &side, DT);
            apply_between(&mut physics.bodies, (hand.palm, *handle), &tcp.pose, &padded.reaction);
        }
    }

    /// Applies the forces of soft grips to the hands and to what they grip.
    pub(super) fn pull_grips(&mut self) {
        let Self { physics, objects, robots, .. } = self;
        for hand in robots.iter_mut().flat_map(|robot| &mut robot.arms).map(|arm| &mut arm.hand) {
            let (tcp, palm) = (hand.moving(&physics.bodies), hand.palm);
            let Some(soft) = &mut hand.soft else { continue };
            let body = objects[soft.body].handle;
            soft.step(&tcp, &moving(&physics.bodies[body], &Isometry3::identity()));
            apply_between(&mut physics.bodies, (palm, body), &tcp.pose, &soft.reaction);
        }
    }

    /// What the first robot's first two hands hold together: the box that is nearest to the pads of both, or the body that both grip.
    pub fn pressed(&self) -> Option<PressedLoad> {
        let [first, second, ..] = self.robots[0].arms.as_slice() else { return None };
        let hands = || Some((self.presses(first)?, self.presses(second)?));
        let grips = || Some((self.grips(first)?, self.grips(second)?));
        let ((body, first), (other, second)) = hands().or_else(grips)?;
        let borne_n = self.contact(body).normal + self.borne_by_statics(body);
        let gripped = self.objects[body].has_handles;
        (body == other).then_some(PressedLoad { body, hands: [first, second], borne_n, gripped })
    }

    /// The force upwards of static bodies on a body, N.
    fn borne_by_statics(&self, body: usize) -> f64 {
        let own = &self.objects[body];
        let stands = |collider| {
            let other = self.objects.iter().find(|object| object.colliders.contains(&collider));
            other.is_some_and(|other| self.physics.bodies[other.handle].is_fixed())
        };
        let force = |touch: &Touch| {
            let [first, second] = touch.colliders;
            let onto = own.colliders.contains(&second) && stands(first);
            let from = own.colliders.contains(&first) && stands(second);
            touch.force.z * (f64::from(u8::from(onto)) - f64::from(u8::from(from)))
        };
        self.touches.iter().map(force).sum()
    }

    /// The box that is nearest to an arm's pad, and what the pad does to it.
    fn presses(&self, arm: &ArmWithHand) -> Option<(usize, PressingHand)> {
        let padded = arm.pad.as_ref()?;
        let (body, _) = padded.pad.as_ref()?;
        let PadReaction { force, slipping, .. } = padded.reaction;
        let at = arm.hand.tcp(&self.physics.bodies) * padded.mounted.middle;
        Some((*body, PressingHand { at, force: -force, slipping }))
    }

    /// The body with handles that a hand grips, and what the hand does to it, with the contacts of its pads.
    fn grips(&self, arm: &ArmWithHand) -> Option<(usize, PressingHand)> {
        let soft = arm.hand.soft.as_ref()?;
        let at = arm.hand.tcp(&self.physics.bodies) * soft.at;
        let body = Some(self.objects[soft.body].handle);
        let own = |i: usize, touch: &Touch| arm.colliders.contains(&touch.colliders[i]);
        let contacts = self.touches.iter().filter_map(|touch| match touch.bodies {
            [_, second] if second == body && own(0, touch) => Some(touch.force),
            [first, _] if first == body && own(1, touch) => Some(-touch.force),
            _ => None,
        });
        let force = contacts.fold(-soft.reaction.force, |sum, force| sum + force);
        Some((soft.body, PressingHand { at, force, slipping: 0 }))
    }
}

/// Applies what a body does to a hand to both; the torque is about the TCP.
fn apply_between(
    bodies: &mut rapier::RigidBodySet,
    (palm, body): (RigidBodyHandle, RigidBodyHandle),
    tcp: &Isometry3<f64>,
    &PadReaction { force, torque, .. }: &PadReaction,
) {
    let at = convert::vector(&tcp.translation.vector);
    for (handle, sign) in [(palm, 1.0), (body, -1.0)] {
        let body = &mut bodies[handle];
        body.add_force_at_point(convert::vector(&(force * sign)), at, true);
        body.add_torque(convert::vector(&(torque * sign)), true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pad_is_nearest_to_the_box_whose_side_it_touches() {
        let face = Point3::new(0.15, 0.46, 1.17);
        let wide = (Isometry3::translation(-0.1, 0.46, 1.17), Vector3::new(0.25, 0.1, 0.1));
        let low = (Isometry3::translation(0.0, 0.48, 0.99), Vector3::new(0.05, 0.08, 0.02));
        assert_eq!(distance_from_box(&face, &wide.0, &(2.0 * wide.1)), 0.0);
        assert!(
            (face - wide.0.translation.vector).coords.norm()
                > (face - low.0.translation.vector).coords.norm()
        );
        assert!(distance_from_box(&face, &low.0, &(2.0 * low.1)) > 0.15);
    }
}
