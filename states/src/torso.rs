//! A torso that turns with what both hands carry, so that they stay as straight before it as can be.
//!
//! It turns about the one of its joints that stands upright; the arms take back from their own motion what it adds.

use std::sync::Arc;

use armarium_motion::planar_turn;
use armarium_robot::{JointKind, Kinematics, Lease, Limb, LinkId, Model, Sensed, Twist};
use armarium_runtime::skill::{Failure, SkillContext};
use nalgebra::{Isometry3, Point3, Rotation2, Vector2, Vector3};

use crate::arm::lease;
use crate::equipment::Equipment;
use crate::motions::failed;

/// A joint is upright within this angle, rad.
const UPRIGHT: f64 = 0.3;
/// Gain of the missing turn, 1/s, and time constant with which the torso takes its speed, s.
const GAIN: f64 = 4.0;
const SMOOTH: f64 = 0.1;
/// The share of the joint's speed that it uses, and how far from its limits it stops, rad.
const SPEED_SHARE: f64 = 0.9;
const MARGIN: f64 = 0.03;

/// The limbs that help both arms.
pub(crate) fn helps_both([first, second]: [&Limb; 2]) -> impl Iterator<Item = &String> {
    first.helped_by.iter().filter(|limb| second.helped_by.contains(limb))
}

/// The torso, leased.
pub(crate) struct TurningTorso {
    lease: Lease,
    model: Arc<Model>,
    kinematics: Kinematics,
    joints: Vec<usize>,
    /// The joint about which it turns, and its speed, rad/s.
    joint: usize,
    rate: f64,
    /// Where the hands would be straight before it, as seen from the axis with the joint at zero, m: x right, y forward.
    before: [Vector2<f64>; 2],
}

impl TurningTorso {
    /// The limb that helps both arms and can turn; `None` if there is none, or somebody else commands it. `hands` are where the TCPs
    /// of both arms are, root frame.
    pub(crate) fn take(
        equipment: &Equipment,
        context: &SkillContext,
        arms: [&Limb; 2],
        (sample, hands): (&Sensed, &[Isometry3<f64>; 2]),
    ) -> Option<Self> {
        let model = Arc::clone(equipment.robot.model());
        let limb = helps_both(arms).next()?;
        let joints = model.limb(limb).to_vec();
        let mut kinematics = Kinematics::new(&model);
        kinematics.update(&sample.position);
        let upright = |joint: &usize| {
            let turns = model.joints()[*joint].kind == JointKind::Revolute;
            turns && kinematics.axis(*joint).angle(&Vector3::z()) < UPRIGHT
        };
        let joint = joints.iter().copied().find(upright)?;
        let lease = lease(equipment, context, limb, &[]).ok()?;
        let origin = *kinematics.origin(joint);
        let [one, other] = hands.map(|hand| (hand.translation.vector - origin.coords).xy());
        let (ahead, wide) = ((one + other).norm() / 2.0, (one - other).norm() / 2.0);
        // The first arm's hand is on the side on which it is before a torso that looks ahead.
        let back = Rotation2::new(-sample.position[joint]);
        let side = (back * (one - other)).x.signum();
        let before = [Vector2::new(side * wide, ahead), Vector2::new(-side * wide, ahead)];
        Some(Self { lease, model, kinematics, joints, joint, rate: 0.0, before })
    }

    /// Turns after hands at `hands` (root frame) for `dt` s.
    pub(crate) fn follow(
        &mut self,
        (sample, dt): (&Sensed, f64),
        hands: &[Isometry3<f64>; 2],
    ) -> Result<(), Failure> {
        self.kinematics.update(&sample.position);
        let (at, joint) = (sample.position[self.joint], &self.model.joints()[self.joint]);
        let (origin, back) = (*self.kinematics.origin(self.joint), Rotation2::new(-at));
        let now = hands.map(|hand| back * (hand.translation.vector - origin.coords).xy());
        let fastest = SPEED_SHARE * joint.velocity;
        let room = [joint.lower + MARGIN - at, joint.upper - MARGIN - at].map(|room| GAIN * room);
        let wanted = (GAIN * planar_turn(&self.before, &now)).clamp(-fastest, fastest);
        let wanted = wanted.max(room[0].min(0.0)).min(room[1].max(0.0));
        self.rate += (wanted - self.rate) * (1.0 - libm::exp(-dt / SMOOTH));
        let command: Vec<f64> =
            self.joints.iter().map(|joint| if *joint == self.joint { self.rate } else { 0.0 }).collect();
        self.lease.command(&command).map_err(failed)
    }

    /// The twist with which it carries a link that it moves, root frame, m/s and rad/s.
    pub(crate) fn carries(&self, link: LinkId) -> Twist {
        let unit = self.kinematics.column(self.joint, link, &Point3::origin());
        Twist { linear: unit.linear * self.rate, angular: unit.angular * self.rate }
    }
}
