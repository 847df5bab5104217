//! `CalibrateHandEye`: finds the true pose of the cameras by observing the marker on the robot's own hand, or a tool in it.
//!
//! The hand moves to several places over where the arm works. At each one, the marker's position is measured by the camera,
//! and computed for the camera pose that is known so far. Both point sets give what is left of its error (least squares, Arun et
//! al.). How a tool lies in the hand is not known before: the hand also turns, and that is found with the rest.

use armarium_knowledge::ObjectClass;
use armarium_motion::{RigidFit, rigid_fit, rigid_fit_held};
use armarium_robot::{Limb, LinkId, Marker};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Observation, Type, Unit};
use armarium_visionx::{ObjectLocalizer, ObjectStep, StereoStep};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm, tcp_of, workspace};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp, marker};
use crate::hand_eye::Mounting;
use crate::inputs::{Inputs, seen_at};
use crate::motions::failed;
use crate::prior::object_class;
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

/// Places at which a tool is shown, and how the hand is turned there, rad: about what it faces, and tilted forward and to the left. They
/// are more and further apart, as where the tool is in the hand is sought, too.
const PLACES_OF_TOOL: [([f64; 3], [f64; 3]); 9] = [
    ([-0.11, -0.07, 0.00], [0.5, 0.0, 0.25]),
    ([0.10, -0.08, 0.05], [-0.5, 0.25, 0.0]),
    ([0.11, 0.06, -0.02], [0.3, -0.25, 0.0]),
    ([-0.10, 0.08, 0.07], [-0.3, 0.0, -0.25]),
    ([0.00, 0.00, 0.12], [0.0, 0.2, 0.2]),
    ([0.00, 0.01, -0.04], [0.0, -0.2, 0.2]),
    ([-0.11, 0.06, 0.10], [0.4, -0.2, 0.0]),
    ([0.11, 0.00, 0.10], [-0.4, 0.0, -0.2]),
    ([0.00, -0.10, 0.10], [0.0, 0.25, -0.2]),
];

/// From the middle of the arm's workspace to the middle of the places, m.
const OVER_WORKSPACE: [f64; 3] = [0.0, -0.01, 0.15];
/// Places that are enough with a marker and with a tool, and a residual of the fit with which none is left out, m.
const ENOUGH: usize = 4;
const ENOUGH_OF_TOOL: usize = 6;
const GOOD: f64 = 0.004;
/// A tool is within this of where hands hold things, m, also where the cameras are not calibrated yet.
const IN_HAND: f64 = 0.1;
/// Frames that are averaged at each place.
const FRAMES: usize = 5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "CalibrateHandEye",
        "Looks at its own hand in several places and corrects where the cameras look.",
    )
    .optional(
        "tool",
        Type::String,
        "",
        "What the hand holds and shows, a class of prior knowledge; empty: the marker on the hand.",
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

/// What is looked at: the marker on the hand, or a tool that the hand holds.
enum CalibrationTarget {
    Marker(Marker),
    /// Where hands hold things, which is not exactly where it is, and how the TCP stands with the palm down.
    Tool {
        class: ObjectClass,
        tcp: LinkId,
        held: Point3<f64>,
        palm_down: UnitQuaternion<f64>,
    },
}

impl CalibrationTarget {
    async fn of(equipment: &Equipment, context: &SkillContext, arm: &Limb) -> Result<Self, Failure> {
        let model = equipment.robot.model();
        let tool = context.text("tool")?;
        if tool.is_empty() {
            let marker = marker(model, arm);
            let instead = |none: Failure| {
                Failure::new(format!("{}; with `tool` it calibrates by what the hand holds", none.reason))
            };
            return marker.map(Self::Marker).map_err(instead);
        }
        let (class, hand) = (object_class(&*equipment.memory, tool).await?, hand(model, arm)?);
        let (held, palm_down) = (held_in_tcp(hand), hand.palm_down(0.0));
        Ok(Self::Tool { class, tcp: tcp_of(arm)?, held, palm_down })
    }

    /// What is said when it was seen at too few places.
    fn unseen(&self, seen: usize, of: usize) -> String {
        match self {
            Self::Marker(_) => format!(
                "the marker on the hand was seen in {seen} of {of} places; do both cameras work, and is the light on?"
            ),
            Self::Tool { .. } => format!(
                "the tool in the hand was seen in {seen} of {of} places; do both cameras work, is the light on, and does the hand leave enough of it to be seen?"
            ),
        }
    }

    /// At how many places it must be seen.
    fn enough(&self) -> usize {
        match self {
            Self::Marker(_) => ENOUGH,
            Self::Tool { .. } => ENOUGH_OF_TOOL,
        }
    }

    /// Where it is shown, relative to the middle of the places, m, and how the hand is turned there, rad.
    fn places(&self) -> Vec<([f64; 3], [f64; 3])> {
        match self {
            Self::Marker(_) => PLACES.map(|place| (place, [0.0; 3])).to_vec(),
            Self::Tool { .. } => PLACES_OF_TOOL.to_vec(),
        }
    }

    /// The link that carries it.
    fn link(&self) -> LinkId {
        match self {
            Self::Marker(marker) => marker.link,
            Self::Tool { tcp, .. } => *tcp,
        }
    }

    /// What finds it in the pictures, with its link standing still at a pose. A tool was level when it was taken with the palm down.
    fn step(&self, equipment: &Equipment, root_from_link: &Isometry3<f64>) -> Vec<Box<dyn StereoStep>> {
        match self {
            Self::Marker(marker) => {
                vec![Box::new(equipment.track(marker.color, Some(marker.diameter), TARGET))]
            }
            Self::Tool { class, palm_down, .. } => {
                let level = root_from_link.rotation * palm_down.inverse();
                let box_of = ObjectLocalizer::new(equipment.images.calibration(), class.size, class.color);
                vec![Box::new(ObjectStep::new(box_of.standing_on(level), TARGET))]
            }
        }
    }

    /// Whether an observation is of it: of a marker most must be seen, a tool where the hand holds things.
    fn is_seen(&self, seen: &Observation, at: &Point3<f64>, root_from_link: &Isometry3<f64>) -> bool {
        match self {
            Self::Marker(_) => seen.confidence > 0.5,
            Self::Tool { held, .. } => (root_from_link * held - at).norm() < IN_HAND,
        }
    }

    /// The fit, and where on its link it is.
    fn fit(
        &self,
        seen: &[Point3<f64>],
        links: &[Isometry3<f64>],
    ) -> Result<(RigidFit, Point3<f64>), Failure> {
        match self {
            Self::Marker(_) => {
                let expected: Vec<Point3<f64>> =
                    links.iter().map(|link| link.translation.vector.into()).collect();
                Ok((rigid_fit(seen, &expected).map_err(failed)?, Point3::origin()))
            }
            Self::Tool { held, .. } => rigid_fit_held(seen, links, held).map_err(failed),
        }
    }
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
    let largest = context.number("residual")?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let target = CalibrationTarget::of(&equipment, &context, &arm.limb).await?;
    // The mounting through which everything is seen now.
    let known = Mounting::load(&*equipment.memory, &equipment.agent).await?;
    // Left camera frame: where it was seen, and its link there, place by place.
    let (mut seen, mut links) = (Vec::new(), Vec::new());
    let places = target.places();
    for (place, [about, forward, left]) in &places {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(*forward, *left, 0.0));
        let palm = facing * tilt * hand.palm_down(yaw + about);
        let tcp = Isometry3::from_parts((center + facing * Vector3::from(*place)).into(), palm);
        arm.go(&mut senses, tcp, 0.2, |_| Ok(())).await?;
        if let Some((is, link)) = look(&equipment, &target, &mut arm, &mut senses).await? {
            seen.push(is);
            links.push(link);
        }
    }
    let enough = target.enough();
    if seen.len() < enough {
        return Err(Failure::new(target.unseen(seen.len(), places.len())));
    }
    let (mut fit, mut place) = target.fit(&seen, &links)?;
    // Where the hand hides a part of it, it is seen beside its place.
    while fit.rms > GOOD && seen.len() > enough {
        let off = |i: usize| (fit.target_from_source * seen[i] - links[i] * place).norm();
        let worst = (0..seen.len()).max_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0);
        seen.remove(worst);
        links.remove(worst);
        let Ok(better) = target.fit(&seen, &links) else { break };
        (fit, place) = better;
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

/// The class under which the processor observes it.
const TARGET: &str = "target";

/// The position in the left camera's frame, as seen, and there the pose of its link as computed from the joints of arm and head. Of
/// several frames with the hand at rest, the mean; the rotation is that of the last one.
async fn look(
    equipment: &Equipment,
    target: &CalibrationTarget,
    arm: &mut LeasedArm,
    senses: &mut Senses,
) -> Result<Option<(Point3<f64>, Isometry3<f64>)>, Failure> {
    let standing = equipment.robot.model().link_pose(&senses.newest().position, target.link());
    let mut sight = equipment.look(target.step(equipment, &standing));
    let (mut seen, mut link, mut count, mut waited) = (Vector3::zeros(), Vector3::zeros(), 0, 0.0);
    let mut rotation = UnitQuaternion::identity();
    while count < FRAMES && waited < 1.5 {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        arm.hold(&sample)?;
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        let root_from_link = equipment.link_at(target.link(), frame.stamp_ns)?;
        let found = frame.of_class(TARGET).and_then(|found| Some((found, seen_at(found)?)));
        if let Some((_, at)) = found.filter(|(found, at)| target.is_seen(found, at, &root_from_link)) {
            let left_from_root = frame.root_from_left.inverse();
            let left_from_link = left_from_root * root_from_link;
            seen += (left_from_root * at).coords;
            link += left_from_link.translation.vector;
            rotation = left_from_link.rotation;
            count += 1;
        }
    }
    let n = count as f64;
    Ok((count >= 2).then(|| (Point3::from(seen / n), Isometry3::from_parts((link / n).into(), rotation))))
}
