//! The world file: what stands where, how it feels, what the coach does, and what goes wrong.
//!
//! The types mirror the file key by key, so that the schema, the defaults and the documentation are one thing;
//! `read` turns a file into them and reports everything that is wrong with it at once. Lengths are m, forces N,
//! times s, in the robot's root frame (x right, y forward, z up); keys that end in `_deg` are degrees.
//! This module does not simulate anything.

mod agents;
mod defaults;
mod read;
#[cfg(test)]
mod tests;
mod tree;

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;

pub use agents::{AgentSpec, CoverSpec};

/// Standard gravity, m/s², along the world's negative z.
pub const GRAVITY: f64 = 9.81;

/// A whole world.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "Armarium world", default)]
pub struct World {
    /// Name of the world, for reports.
    #[serde(rename = "world")]
    pub name: String,
    /// The robot and its sensors' noise.
    pub robot: RobotSpec,
    /// The stereo pair on the head.
    pub camera: CameraSpec,
    /// The table.
    pub table: TableSpec,
    /// Objects that lie on the table; an empty list is a table without a sponge.
    pub objects: Vec<ObjectSpec>,
    /// The person who demonstrates and coaches.
    pub coach: CoachSpec,
    /// Sensors that are broken.
    pub faults: Faults,
    /// Accidents.
    pub disturbances: Vec<Disturbance>,
    /// Other agents who look on.
    pub agents: Vec<AgentSpec>,
    /// Boards that stand in somebody's view.
    pub covers: Vec<CoverSpec>,
}

/// Which robot, and how noisy its sensors are.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotSpec {
    /// The name by which other agents call it.
    pub name: String,
    /// Name of the model.
    pub model: RobotModel,
    /// The arm that wipes.
    pub arm: Arm,
    /// Standard deviations of its sensors.
    pub noise: NoiseSpec,
}

/// Robots that the simulator knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotModel {
    /// ARMAR-III.
    #[default]
    Armar3,
}

/// The arm that wipes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// The right arm, which alone has dynamics and a wrist sensor.
    #[default]
    Right,
}

/// Imperfections of the robot's sensors; all draws are seeded.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseSpec {
    /// White noise of each force axis at 1 kHz, N; torque axes have a twentieth of it, N m.
    #[schemars(range(min = 0.0, max = 20.0))]
    pub wrench: f64,
    /// Standard deviation of the constant offset of each force axis, N; torque axes a twentieth, N m.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub wrench_bias: f64,
    /// Rate of the offset's drift, each force axis with its own sign and part of it, N/s; torque axes a twentieth.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub wrench_drift: f64,
    /// White noise of each joint angle, rad.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub joint: f64,
}

/// The stereo pair.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSpec {
    /// Width, px.
    #[schemars(range(min = 32, max = 1920))]
    pub width: u32,
    /// Height, px.
    #[schemars(range(min = 32, max = 1200))]
    pub height: u32,
    /// Frames a second.
    #[schemars(range(min = 1.0, max = 120.0))]
    pub rate: f64,
    /// Focal length, px.
    #[schemars(range(min = 20.0, max = 4000.0))]
    pub focal: f64,
    /// Distance of the eyes, m.
    #[schemars(range(min = 0.02, max = 0.5))]
    pub baseline: f64,
    /// Standard deviation of each pixel's channels, grey levels of 255.
    #[schemars(range(min = 0.0, max = 64.0))]
    pub noise: f64,
    /// How far the true camera is from where the robot believes it to be, in the camera's frame.
    pub mounting_error: MountingError,
}

/// The difference between the true and the believed camera pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MountingError {
    /// Shift, m, camera frame (x right, y down, z forward).
    pub position: [f64; 3],
    /// Rotation vector, degrees, camera frame.
    pub rotation_deg: [f64; 3],
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TableSpec {
    /// Height of its top at the centre, m.
    #[schemars(range(min = 0.3, max = 1.6))]
    pub height: f64,
    /// Centre x, y, m.
    pub center: [f64; 2],
    /// Width along x and depth along y, m.
    pub size: [f64; 2],
    /// Rotation about x (positive: the far edge is higher) and about y (positive: the right edge is lower), degrees.
    pub tilt_deg: [f64; 2],
    /// Bumps on its top.
    pub bumps: Vec<Bump>,
    /// Coulomb friction of sponge on table.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub friction: f64,
    /// Colour, RGB.
    pub color: [u8; 3],
}

/// A smooth bump: `height * (1 - r^2 / radius^2)^2` within `radius` of `at`, nothing beyond.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Bump {
    /// Centre x, y, m.
    pub at: [f64; 2],
    /// Height at the centre, m; negative is a dent.
    #[schemars(range(min = -0.03, max = 0.03))]
    pub height: f64,
    /// Where it ends, m.
    #[schemars(range(min = 0.01, max = 1.0))]
    pub radius: f64,
}

/// A soft box that lies on the table.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectSpec {
    /// Its name, as in prior knowledge.
    pub name: String,
    /// Centre x, y, m.
    pub at: [f64; 2],
    /// Rotation about the vertical, degrees.
    pub yaw_deg: f64,
    /// Length, width, height, m.
    pub size: [f64; 3],
    /// Mass, kg.
    #[schemars(range(min = 0.05, max = 2.0))]
    pub mass: f64,
    /// Stiffness of the whole underside, N/m.
    #[schemars(range(min = 800.0, max = 10000.0))]
    pub stiffness: f64,
    /// Colour, RGB.
    pub color: [u8; 3],
}

/// The coach.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CoachSpec {
    /// What the coach demonstrates with.
    pub tool: ToolSpec,
    /// What the coach demonstrates; `none` is a coach who never does.
    #[schemars(with = "DemonstrationForm")]
    pub demonstration: Option<Demonstration>,
    /// What the coach does while the robot wipes, in order, each after the one before.
    pub coaching: Vec<CoachingStep>,
    /// When the coach has gone, s from the start of wiping.
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub ends: f64,
}

/// The demonstration's forms in the file; only for the schema.
#[derive(Serialize, JsonSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "the schema alone is used")]
enum DemonstrationForm {
    /// A demonstration.
    Some(Demonstration),
    /// The coach never demonstrates.
    None(NoDemonstration),
}

#[derive(Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[expect(dead_code, reason = "the schema alone is used")]
enum NoDemonstration {
    /// The coach never demonstrates.
    None,
}

/// The coach's tool: a block of 0.09 x 0.06 x 0.04 m.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ToolSpec {
    /// Colour, RGB.
    pub color: [u8; 3],
}

/// A swipe that shows where, then a periodic motion about the swipe's middle.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Demonstration {
    /// Form of the path.
    pub shape: Shape,
    /// Full width (x) and depth (y) of the path, m.
    pub size: [f64; 2],
    /// Periods of the whole path a second (a figure of eight counts once), Hz.
    #[schemars(range(min = 0.05, max = 5.0))]
    pub frequency: f64,
    /// The swipe across the workspace.
    pub swipe: Swipe,
    /// Height of the tool's centre above the table's height, m.
    #[schemars(range(min = 0.05, max = 0.8))]
    pub height: f64,
    /// How many periods; 0 is a coach who never demonstrates.
    #[schemars(range(min = 0, max = 1000))]
    pub periods: u32,
    /// Unsteadiness of the hand: standard deviation of position as a part of half the path's size, and of speed
    /// as a part of the speed; smooth and seeded.
    #[schemars(range(min = 0.0, max = 0.3))]
    pub jitter: f64,
}

/// Form of the demonstrated path; `theta` is 2 pi times the phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// `x = cx + sx/2 cos theta, y = cy + sy/2 sin theta`.
    #[default]
    Ellipse,
    /// `x = cx + sx/2 cos theta, y = cy + sy/2 sin 2 theta`.
    Eight,
    /// Along the diagonal of `size`: `x = cx + sx/2 cos theta, y = cy + sy/2 cos theta`.
    Line,
}

/// The first swipe, from lower left to upper right: it gives the workspace.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Swipe {
    /// Start x, y, m.
    pub from: [f64; 2],
    /// End x, y, m.
    pub to: [f64; 2],
}

/// One thing that the coach does while the robot wipes.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct CoachingStep {
    /// Earliest time, s from the start of wiping.
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub at: f64,
    /// What.
    #[serde(flatten)]
    pub action: CoachingAction,
}

/// A push or a gesture.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum CoachingAction {
    /// The coach pushes the robot's hand.
    Push {
        /// How.
        push: Push,
    },
    /// The coach shows a gesture beside the path.
    Show(Show),
}

/// A push on the hand, once a cycle.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Push {
    /// Phase of the path, 0 to 1, about which the coach pushes.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub phase: f64,
    /// How far from that phase, in phase.
    #[schemars(range(min = 0.01, max = 0.5))]
    pub arc: f64,
    /// Largest force, N.
    pub force: [f64; 3],
    /// How many cycles.
    #[schemars(range(min = 1, max = 1000))]
    pub cycles: u32,
}

/// A gesture beside the path.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Show {
    /// What the hand shows.
    pub gesture: Gesture,
    /// Phase of the coach's path, 0 to 1, beside which the hand waits.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub phase: f64,
    /// From the path's point (at the height of the robot's TCP when it wipes) to the palm, m.
    pub offset: [f64; 3],
    /// How long the hand waits there, s.
    #[serde(rename = "for")]
    #[schemars(range(min = 0.1, max = 600.0))]
    pub duration: f64,
    /// Where `point_one` points, and how far the coach means, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
}

/// The four gestures of the coach.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, serde::Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Gesture {
    /// The path is pulled towards the hand.
    Fist,
    /// The whole motion moves along the finger.
    PointOne,
    /// The path is pushed away from the hand.
    PointTwo,
    /// The coach is coming to take the robot by the hand.
    OpenHand,
}

/// Sensors that are broken from a time on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// What is wrong with the images.
    pub images: ImageFault,
    /// What is wrong with the wrist sensor.
    pub wrench: WrenchFault,
    /// From when on, s of the robot's time.
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub from: f64,
}

/// What is wrong with the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageFault {
    /// Nothing.
    #[default]
    None,
    /// The lenses are covered: every pixel is 0.
    Black,
    /// Left and right are exchanged.
    Swapped,
    /// The last image before the fault is repeated.
    Frozen,
}

/// What is wrong with the wrist sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WrenchFault {
    /// Nothing.
    #[default]
    None,
    /// The last sample before the fault is repeated.
    Frozen,
}

/// An accident: a force on an object or on the robot's hand.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbance {
    /// What the time counts from.
    pub after: Milestone,
    /// When, s after that.
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub at: f64,
    /// Name of an object, or `hand`.
    pub knock: String,
    /// Force at its centre, N.
    pub force: [f64; 3],
    /// How long, s; the force rises and falls as half a sine.
    #[serde(rename = "for")]
    #[schemars(range(min = 0.001, max = 60.0))]
    pub duration: f64,
}

/// What a disturbance's time counts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Milestone {
    /// The moment when an object is held for the first time.
    Grasp,
    /// The moment when the robot says that it is wiping.
    #[default]
    Wiping,
}

/// One thing that is wrong with a world file, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorldError {
    /// The file.
    pub file: PathBuf,
    /// Line from 1; 0 when the file could not be read.
    pub line: usize,
    /// Column from 1, in characters.
    pub column: usize,
    /// Byte offset and length in the file's text.
    pub span: (usize, usize),
    /// A stable code, for instance `world::unknown_key`.
    pub code: &'static str,
    /// What is wrong.
    pub message: String,
    /// What to do about it; may be empty.
    pub help: String,
    /// The text of the line, for a caret under `column`.
    pub text: String,
}

impl fmt::Display for WorldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: {}", self.file.display(), self.line, self.column, self.message)?;
        if !self.text.is_empty() {
            let caret = " ".repeat(self.column.saturating_sub(1));
            write!(f, "\n  | {}\n  | {caret}^", self.text)?;
        }
        if !self.help.is_empty() {
            write!(f, "\n  = help: {}", self.help)?;
        }
        Ok(())
    }
}

impl std::error::Error for WorldError {}

impl World {
    /// Reads a world file; what it does not say is as in the default world.
    ///
    /// # Errors
    /// Everything that is wrong with the file, in the order of the text.
    pub fn load(path: &Path) -> Result<Self, Vec<WorldError>> {
        read::load(path)
    }

    /// Reads a world from text; `file` names it in errors.
    ///
    /// # Errors
    /// Everything that is wrong with the text, in its order.
    pub fn parse(file: &Path, text: &str) -> Result<Self, Vec<WorldError>> {
        read::parse(file, text)
    }

    /// The schema of world files (JSON Schema 2020-12).
    #[must_use]
    pub fn schema() -> serde_json::Value {
        let mut schema = schemars::schema_for!(World).to_value();
        read::add_radian_keys(&mut schema);
        schema
    }

    /// The object that is wiped with: the one named `sponge`, else the first.
    #[must_use]
    pub fn sponge(&self) -> Option<&ObjectSpec> {
        self.objects.iter().find(|o| o.name == "sponge").or_else(|| self.objects.first())
    }
}
