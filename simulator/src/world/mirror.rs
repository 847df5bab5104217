//! A world mirrored across the robot's sagittal plane, the plane x = 0: what is at its right is at its left then. So work that
//! was laid out for one arm is laid out for the other.

use armarium_robot::Model;

use super::{AgentSpec, CoachingAction, World};

/// The end of a mirrored world's name.
const MIRRORED: &str = "_mirrored";

impl World {
    /// This world for another arm: mirrored, with another name, if that is on the other side of the robot. An arm that the
    /// robot does not have changes nothing.
    #[must_use]
    pub fn for_arm(mut self, model: &Model, arm: &str) -> Self {
        let side = |limb| model.side_of(limb);
        let Some(then) = model.arm(arm).map(side) else { return self };
        let now = self.robot.arm(model).map(side);
        self.robot.arm = Some(arm.to_owned());
        if now.is_some_and(|now| now != then) { self.mirrored() } else { self }
    }

    /// For people: that it is mirrored, if it is.
    pub fn mirror_note(&self) -> &'static str {
        if self.name.ends_with(MIRRORED) { ", mirrored for the other arm" } else { "" }
    }

    /// Everything mirrored but the robot itself, which stands mirrored.
    fn mirrored(mut self) -> Self {
        let flip = |x: &mut f64| *x = if *x == 0.0 { 0.0 } else { -*x };
        self.name = match self.name.strip_suffix(MIRRORED) {
            Some(name) => name.to_owned(),
            None => self.name + MIRRORED,
        };
        flip(&mut self.robot.at[0]);
        flip(&mut self.robot.yaw_deg);
        let table = &mut self.table;
        flip(&mut table.center[0]);
        flip(&mut table.tilt_deg[1]);
        table.bumps.iter_mut().for_each(|bump| flip(&mut bump.at[0]));
        for object in &mut self.objects {
            flip(&mut object.at[0]);
            flip(&mut object.yaw_deg);
        }
        for body in &mut self.bodies {
            body.mirror();
        }
        for person in self.actors.iter_mut().filter_map(|actor| actor.person.as_mut()) {
            person.mirror();
        }
        for robot in &mut self.robots {
            flip(&mut robot.at[0]);
            flip(&mut robot.yaw_deg);
        }
        if let Some(shown) = &mut self.coach.demonstration {
            flip(&mut shown.size[0]);
            flip(&mut shown.swipe.from[0]);
            flip(&mut shown.swipe.to[0]);
        }
        for step in &mut self.coach.coaching {
            match &mut step.action {
                CoachingAction::Push { push } => flip(&mut push.force[0]),
                CoachingAction::Show(show) => {
                    flip(&mut show.offset[0]);
                    show.direction.iter_mut().for_each(|direction| flip(&mut direction[0]));
                }
            }
        }
        for disturbance in &mut self.disturbances {
            flip(&mut disturbance.force[0]);
            disturbance.by.iter_mut().for_each(|by| flip(&mut by[0]));
        }
        for AgentSpec { at, looks_at, .. } in &mut self.agents {
            flip(&mut at[0]);
            flip(&mut looks_at[0]);
        }
        for cover in &mut self.covers {
            flip(&mut cover.at[0]);
            flip(&mut cover.yaw_deg);
        }
        // Rotations mirror as the normals of their planes: those about an axis in the plane change their sign.
        let error = &mut self.camera.mounting_error;
        flip(&mut error.position[0]);
        error.rotation_deg[1..].iter_mut().for_each(flip);
        self
    }
}
