//! `CalibrateHandEye`: finds the true pose of the cameras by observing the marker on the robot's own hand.
//!
//! The hand moves to several places over where the arm works. At each one, the marker's position is measured by the camera,
//! and computed for the camera pose that is known so far. Both point sets give what is left of its error (least squares, Arun et
//! al.).

use armarium_motion::rigid_fit;
use armarium_robot::Marker;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm, workspace};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, marker};
use crate::hand_eye::Mounting;
use crate::inputs::{Inputs, seen_at};
use crate::motions::failed;
use crate::surface::from_level;

/// Places relative to the middle, m: spread in all three directions, the third one out of what the hand faces where it works.
const PLACES: [[f64; 3]; 6] = [
    [-0.09, -0.05, 0.00],
    [0.08, -0.06, 0.05],
    [0.09, 0.05, -0.02],
    [-0.08, 0.06, 0.06],
    [0.00, 0.00, 0.10],
    [0.00, 0.01, -0.04],
];

/// From the middle of the arm's workspace to the middle of the places, m.
const OVER_WORKSPACE: [f64; 3] = [0.0, -0.01, 0.15];
/// Places that are enough, and a residual of the fit with which none is left out, m.
const ENOUGH: usize = 4;
const GOOD: f64 = 0.004;
/// Frames that are averaged at each place.
const FRAMES: usize = 5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "CalibrateHandEye",
        "Looks at its own hand in several places and corrects where the cameras look.",
    )
    .optional(
        "center",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "Middle of the places of the TCP, root frame, m; empty: over the arm's workspace.",
    )
    .optional(
        "yaw",
        Type::quantity(Unit::RAD),
        0.5,
        "How far the hand is turned, facing as where it works, from forward towards the robot's middle.",
    )
    .optional("residual", Type::quantity(Unit::M), 0.012, "Largest residual of the fit that is accepted.")
    .output("residual", Type::quantity(Unit::M), "Root mean square distance of the fitted points.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let mut arm = LeasedArm::take(&equipment, &context, &[]).await?;
    let model = equipment.robot.model();
    let (works, hand) =
        (workspace(model, &arm.limb, &equipment.robot.sensed().borrow().position)?, hand(model, &arm.limb)?);
    let facing = from_level(&hand.grasps_from(&works.rotation));
    let over_workspace = works.translation.vector + facing * Vector3::from(OVER_WORKSPACE);
    let center = context.vector_if_given("center")?.unwrap_or(over_workspace);
    let yaw = model.side_of(&arm.limb) * context.number("yaw")?;
    let palm = facing * hand.palm_down(yaw);
    let largest = context.number("residual")?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let marker = marker(model, &arm.limb)?;
    // The mounting through which everything is seen now.
    let known = Mounting::load(&*equipment.memory, &equipment.agent).await?;
    let (mut seen, mut expected) = (Vec::new(), Vec::new());
    for place in PLACES {
        let tcp = Isometry3::from_parts((center + facing * Vector3::from(place)).into(), palm);
        arm.go(&mut senses, tcp, 0.2, |_| Ok(())).await?;
        if let Some((is, should)) = look(&equipment, &marker, &mut arm, &mut senses).await? {
            seen.push(is);
            expected.push(should);
        }
    }
    if seen.len() < ENOUGH {
        return Err(Failure::new(format!(
            "the marker on the hand was seen in {} of {} places; do both cameras work, and is the light on?",
            seen.len(),
            PLACES.len()
        )));
    }
    let mut fit = rigid_fit(&seen, &expected).map_err(failed)?;
    // Where the hand hides a part of the marker, that is seen beside its place.
    while fit.rms > GOOD && seen.len() > ENOUGH {
        let off = |i: usize| (fit.target_from_source * seen[i] - expected[i]).norm();
        let worst = (0..seen.len()).max_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0);
        seen.remove(worst);
        expected.remove(worst);
        fit = rigid_fit(&seen, &expected).map_err(failed)?;
    }
    if fit.rms > largest {
        return Err(Failure::new(format!(
            "hand and cameras do not agree: {:.0} mm remain after calibration; are the eyes in the right order?",
            fit.rms * 1e3
        )));
    }
    let stamp_ns = senses.newest().stamp_ns;
    let found = Mounting { believed_from_left: known.believed_from_left * fit.target_from_source, ..known };
    found.store(&*equipment.memory, &equipment.agent, stamp_ns).await?;
    Ok(Outcome::success().with("residual", fit.rms))
}

/// The class under which the processor observes the marker.
const MARKER: &str = "marker";

/// The marker's position in the left camera's frame, as seen and as computed from the joints of arm and head; the mean of
/// several frames with the hand at rest.
async fn look(
    equipment: &Equipment,
    marker: &Marker,
    arm: &mut LeasedArm,
    senses: &mut Senses,
) -> Result<Option<(Point3<f64>, Point3<f64>)>, Failure> {
    let mut sight = equipment.look(equipment.track(marker.color, Some(marker.diameter), MARKER));
    let (mut seen, mut expected, mut count, mut waited) = (Vector3::zeros(), Vector3::zeros(), 0, 0.0);
    while count < FRAMES && waited < 1.5 {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        arm.hold(&sample)?;
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        let well_seen = frame.of_class(MARKER).filter(|marker| marker.confidence > 0.5);
        if let Some(at) = well_seen.and_then(seen_at) {
            let left_from_root = frame.root_from_left.inverse();
            let should = equipment.link_at(marker.link, frame.stamp_ns)?.translation.vector;
            seen += (left_from_root * at).coords;
            expected += (left_from_root * Point3::from(should)).coords;
            count += 1;
        }
    }
    let mean = |sum: Vector3<f64>| Point3::from(sum / count as f64);
    Ok((count >= 2).then(|| (mean(seen), mean(expected))))
}
