//! `VisualServoTowardsTargetPose`: moves the hand to a grasp of an object by observing both.
//!
//! Hand and object are seen by the same cameras, and the error is computed from both, so that an error of the
//! cameras' mounting cancels. The hand comes from over the object: first to the pre-pose, then straight to the grasp.

use armarium_motion::{PositionServo, ServoConfig, ServoObservation, ServoStatus};
use armarium_robot::Limb;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use armarium_visionx::{ObjectLocalizer, ObjectStep, Sight, Sighting, StereoStep};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm, seconds, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp, marker};
use crate::inputs::{Inputs, pose_value, seen_at};
use crate::motions::failed;
use crate::skills::move_tcp::tolerances;
use crate::surface::ContactPlane;

/// An object of which a smaller share than this is visible (the hand covers it) does not move the target.
const WELL_VISIBLE: f64 = 0.8;
/// The weight of a new detection in the filtered target.
const DETECTION_WEIGHT: f64 = 0.2;
/// A detection further than this from the filtered target is rejected, m.
const MAX_JUMP: f64 = 0.06;
/// A force of this size on the way down means that the hand has hit something, N.
const STOPPING_FORCE: f64 = 12.0;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "VisualServoTowardsTargetPose",
        "Brings the hand to an object's grasp pose, seeing hand and object with the same cameras.",
    )
    .input("object", Type::object(), "The object in memory.")
    .input("target", Type::Pose, "Planned pose of the TCP at the grasp.")
    .input("pre_pose", Type::Pose, "Pose of the TCP above it.");
    let manifest = tolerances(manifest, 0.004, 0.06)
        .optional("timeout", Type::Duration, 20.0, "Longest time for each of the two parts.")
        .output("tcp", Type::Pose, "Pose of the TCP at the end.")
        .output("seen_error", Type::quantity(Unit::M), "Distance of the hand from the grasp, as seen.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let mut arm = LeasedArm::take(&equipment, &context, &[context.pose("target")?]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut sight = Detections::new(&equipment, &context, &arm.limb).await?;
    let over = context.pose("pre_pose")?.translation.vector - context.pose("target")?.translation.vector;
    servo(&equipment, &context, &mut arm, &mut senses, &mut sight, over).await?;
    let distance = servo(&equipment, &context, &mut arm, &mut senses, &mut sight, Vector3::zeros()).await?;
    let tcp = arm.tcp(&senses.newest());
    Ok(Outcome::success().with("tcp", pose_value(&tcp)).with("seen_error", distance))
}

/// Servoes to `over` the grasp (root frame, m); returns the remaining distance, as seen.
async fn servo(
    equipment: &Equipment,
    context: &SkillContext,
    arm: &mut LeasedArm,
    senses: &mut Senses,
    sight: &mut Detections,
    over: Vector3<f64>,
) -> Result<f64, Failure> {
    let mut law = PositionServo::new(ServoConfig {
        position_tolerance: context.number("position_tolerance")?,
        rotation_tolerance: context.number("orientation_tolerance")?,
        timeout: context.number("timeout")?,
        max_linear: 0.12,
        ..ServoConfig::default()
    })
    .map_err(failed)?;
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    let marker_link = marker(equipment.robot.model(), &arm.limb)?.link;
    let mut last_frame_ns = None;
    loop {
        let (sample, _) = senses.next().await?;
        if let Some(frame) = sight.sight.newest().map_err(failed)? {
            let before = last_frame_ns.replace(frame.stamp_ns).unwrap_or(frame.stamp_ns);
            let dt = seconds(before, frame.stamp_ns).max(1e-3);
            let tcp = equipment.link_at(tcp_of(&arm.limb)?, frame.stamp_ns)?;
            let marker = equipment.link_at(marker_link, frame.stamp_ns)?;
            let observation = sight.observe(&frame, &tcp, &marker, &over);
            let command = law.step(dt, observation.as_ref()).map_err(failed)?;
            match command.status {
                ServoStatus::Running => {}
                ServoStatus::Converged => return Ok(command.distance),
                status => return Err(Failure::new(explain(status, command.distance))),
            }
            (linear, angular) = (command.linear, command.angular);
        }
        // An arm without a sensor feels nothing.
        let force = arm.force(&sample).map_or(0.0, |force| force.norm());
        if force > STOPPING_FORCE {
            return Err(Failure::new(format!(
                "the hand met something on its way to the object: {force:.0} N at the wrist"
            )));
        }
        arm.twist(&sample, linear, angular)?;
    }
}

fn explain(status: ServoStatus, distance: f64) -> String {
    let left = distance * 1e3;
    match status {
        ServoStatus::Lost => "the marker on the hand was lost from sight while servoing".into(),
        ServoStatus::Diverged => {
            format!("servoing diverged: the hand moves away from the object ({left:.0} mm)")
        }
        _ => format!("servoing took too long: the hand is still {left:.0} mm from the object"),
    }
}

/// The classes under which the processors observe the hand's marker and the object.
const HAND: &str = "hand";
const OBJECT: &str = "object";

/// The detections of hand and object.
struct Detections {
    sight: Sight,
    /// Centre of the object as seen, root frame.
    center: Point3<f64>,
    /// The middle of what the hand holds, in its TCP's frame.
    held_in_tcp: Point3<f64>,
    /// The hand's planned orientation.
    palm: UnitQuaternion<f64>,
}

impl Detections {
    async fn new(equipment: &Equipment, context: &SkillContext, arm: &Limb) -> Result<Self, Failure> {
        let (class, pose) = equipment.remembered().thing(&context.entity("object")?).await?;
        let surface = ContactPlane::under(equipment.remembered(), &pose.translation.vector.into()).await?;
        let marker = marker(equipment.robot.model(), arm)?;
        let localizer = ObjectLocalizer::new(equipment.images.calibration(), class.size, class.color);
        let localizer = localizer.standing_on(surface.rotation());
        let both: Vec<Box<dyn StereoStep>> = vec![
            Box::new(ObjectStep::new(localizer, OBJECT)),
            Box::new(equipment.track(marker.color, Some(marker.diameter), HAND)),
        ];
        Ok(Self {
            sight: equipment.look(both),
            center: Point3::from(pose.translation.vector),
            held_in_tcp: held_in_tcp(hand(equipment.robot.model(), arm)?),
            palm: context.pose("target")?.rotation,
        })
    }

    /// Hand and target as seen in one frame; `None` if the hand's marker is not visible.
    ///
    /// `tcp` and `marker` are the poses from forward kinematics; the detected marker gives the visual offset from
    /// them.
    fn observe(
        &mut self,
        frame: &Sighting,
        tcp: &Isometry3<f64>,
        marker: &Isometry3<f64>,
        over: &Vector3<f64>,
    ) -> Option<ServoObservation> {
        self.look_for_object(frame);
        let seen = frame.of_class(HAND).filter(|marker| marker.confidence > 0.3).and_then(seen_at)?;
        let shift = Translation3::from(seen.coords - marker.translation.vector);
        let target = self.center.coords - self.palm * self.held_in_tcp.coords + over;
        Some(ServoObservation { hand: shift * tcp, target: Isometry3::from_parts(target.into(), self.palm) })
    }

    fn look_for_object(&mut self, frame: &Sighting) {
        let object = frame.of_class(OBJECT).filter(|object| object.confidence > WELL_VISIBLE);
        let Some(seen) = object.and_then(seen_at) else { return };
        let step = seen - self.center;
        if step.norm() < MAX_JUMP {
            self.center += DETECTION_WEIGHT * step;
        }
    }
}
