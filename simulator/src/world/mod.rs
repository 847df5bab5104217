//! The world file: what stands where, how it feels, what the coach does, and what goes wrong.
//!
//! Each section is declared once, with its keys, units, bounds and defaults: the types, the reader and the JSON Schema are made of
//! that. Lengths are m, forces N, times s, in the robot's root frame (x right, y forward, z up); keys that end in
//! `_deg` are degrees. A value that cannot be used adds a finding and reading goes on, so that one pass finds everything;
//! what joins several values is looked at when each is right by itself. This module does not simulate anything.

mod agents;
mod bodies;
mod coach;
mod faults;
mod mirror;
mod person;
mod physics;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use armarium_robot::description::{self, default_robot, shipped_robots};
use armarium_robot::{Limb, Model};
use armarium_source::yaml::Node;
use armarium_source::{Finding, Findings, Rule, Source, Span, code, form};
use nalgebra::{Isometry3, Vector3};
use serde_json::Value as Json;

use crate::error::SimulationError;

pub use agents::{AgentSpec, CoverSpec};
pub use armarium_visionx::Gesture;
pub use bodies::{BodyMotion, BodyShape, BodySpec, ContentsSpec, HingeSpec, Place, SlideSpec, Softness};
pub use coach::{
    CoachSpec, CoachingAction, CoachingStep, DemonstrationSpec, Palm, PathShape, Push, Show, SwipeSpec,
    Timing, ToolSpec,
};
pub use faults::{ARM, Disturbance, Faults, HAND, ImageFault, WorldEvent, WrenchFault};
pub use person::{ActorSpec, PersonAction, PersonSpec, Side, Sleeves};
pub use physics::{DepthSpec, Imperfections, Physics};

/// Standard gravity, m/s², along the world's negative z.
pub const GRAVITY: f64 = 9.81;
/// Most objects; each costs physics.
const MAX_OBJECTS: usize = 8;
/// Most bodies besides them.
const MAX_BODIES: usize = 64;
/// Most robots besides the first; each costs physics and rendering.
const MAX_ROBOTS: usize = 4;
/// Most people; each costs physics and rendering.
const MAX_ACTORS: usize = 8;
/// Most agents with eyes; each costs rendering.
const MAX_AGENTS: usize = 8;
/// The names of the referee's probes.
pub const PROBES: [&str; 18] = [
    "grasp",
    "imitation",
    "force",
    "wiped_fraction",
    "gestures",
    "coaching",
    "body_coaching",
    "bodies",
    "people",
    "guiding",
    "reaching",
    "carrying",
    "learning_together",
    "environment",
    "gaze",
    "segmentation",
    "touch",
    "slip",
];
/// Most entries of another list.
const MAX_LIST: usize = 1000;

/// What is nearer than this is not looked at, m.
const MIN_LOOK_DISTANCE: f64 = 0.1;

/// A place or an extent, m, up to `max` either way.
const fn within(max: f64) -> Rule {
    Rule::number("m", -max, max)
}

/// A colour's channel.
const COLOR: Rule = Rule::number("", 0.0, 255.0);

form! {
    /// A whole world.
    pub struct World: "a world", check Self::fits {
        /// Name of the world, for reports.
        pub name as "world": String = "kitchen".into(), Rule::NAME;
        /// The robot and its sensors' noise.
        pub robot: RobotSpec = RobotSpec::default();
        /// How far robots and cameras are from ideal ones.
        pub physics: Physics = Physics::default();
        /// The stereo pair on the head.
        pub camera: CameraSpec = CameraSpec::default();
        /// The table.
        pub table: TableSpec = TableSpec::default();
        /// Objects that lie on the table; an empty list is a table without a sponge.
        pub objects: Vec<ObjectSpec> = vec![ObjectSpec::default()], Rule::most(MAX_OBJECTS);
        /// Other bodies: rigid ones, those with hinges, cups and trays.
        pub bodies: Vec<BodySpec> = Vec::new(), Rule::most(MAX_BODIES);
        /// Robots besides the first, each with its own guard, cameras and errors. One that runs no chart stands still.
        pub robots: Vec<RobotSpec> = Vec::new(), Rule::most(MAX_ROBOTS);
        /// The person who demonstrates and coaches.
        pub coach: CoachSpec = CoachSpec::default();
        /// People who act: the coach, and others who keep to a schedule.
        pub actors: Vec<ActorSpec> = Vec::new(), Rule::most(MAX_ACTORS);
        /// The probes that judge the run: `grasp`, `imitation`, `force`, `wiped_fraction`, `gestures`, `coaching`, `body_coaching`, `bodies`,
        /// `people`, `guiding`, `reaching`, `carrying`, `learning_together`, `environment`, `gaze`, `segmentation`, `touch`; by default each that finds something.
        pub probes: Vec<String> = Vec::new(), Rule { most: MAX_LIST, ..Rule::NAME };
        /// Sensors that are broken.
        pub faults: Faults = Faults::default();
        /// Accidents.
        pub disturbances: Vec<Disturbance> = Vec::new(), Rule::most(MAX_LIST);
        /// Other agents who look on.
        pub agents: Vec<AgentSpec> = Vec::new(), Rule::most(MAX_AGENTS);
        /// Boards that stand in somebody's view.
        pub covers: Vec<CoverSpec> = Vec::new(), Rule::most(MAX_LIST);
    }
}

form! {
    /// Which robot, and how noisy its sensors are.
    pub struct RobotSpec: "a robot", check Self::is_there {
        /// The name by which other agents call it.
        pub name: String = "local".into(), Rule::NAME;
        /// Its name among the robots that the program carries, or its robot file, beside this one.
        pub model: String = default_robot().into(), Rule { most: 1000, ..Rule::NAME };
        /// The arm that wipes: a group of the robot, or a word of its name such as `right`; none for its first arm.
        pub arm: Option<String> = None, Rule::NAME;
        /// Where its root is on the floor; of a robot with a platform, where that stands at the start. The first robot's root is
        /// the world's origin.
        pub at: [f64; 2] = [0.0; 2], within(5.0);
        /// How far it, or its platform, is turned about the vertical, degrees.
        pub yaw_deg: f64 = 0.0, Rule::degrees(361.0, "yaw");
        /// Standard deviations of its sensors.
        pub noise: NoiseSpec = NoiseSpec::default();
        /// Soft pads on the faces with which its hands press. A robot that has any touches with them alone.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub pads: Option<PadSpec> = None;
        /// Of a robot besides the first: the chart that it runs, a file beside the world's. Without one it stands still.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub runs: Option<String> = None, Rule::NAME;
        /// Inputs of that chart.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        pub inputs: BTreeMap<String, Json> = BTreeMap::new();
    }
}

form! {
    /// A soft pad on a hand.
    #[derive(Copy)]
    pub struct PadSpec: "a pad" {
        /// Stiffness of the whole pad across the box's side, N/m.
        pub stiffness: f64 = 6000.0, Rule::number("N/m", 100.0, 20_000.0);
        /// Stiffness along it, N/m.
        pub shear_stiffness: f64 = 2000.0, Rule::number("N/m", 100.0, 20_000.0);
        /// Coulomb friction of pad on box.
        pub friction: f64 = 0.9, Rule::number("", 0.0, 3.0);
        /// Thickness, m: it is pressed in by less.
        pub thickness: f64 = 0.03, Rule::number("m", 0.002, 0.2);
        /// Half its edges, along the fingers and across them, m.
        pub half: [f64; 2] = [0.08, 0.09], Rule::number("m", 0.005, 0.5);
    }
}

form! {
    /// Imperfections of the robot's sensors; all draws are seeded.
    pub struct NoiseSpec: "`noise`" {
        /// White noise of each force axis at 1 kHz, N; torque axes have a twentieth of it, N m.
        pub wrench: f64 = 0.3, Rule::number("N", 0.0, 20.0);
        /// Standard deviation of slow noise of each force axis, N; torque axes have a twentieth of it, N m. It is forgotten with a
        /// time constant of 50 ms.
        pub wrench_colored: f64 = 0.1, Rule::number("N", 0.0, 20.0);
        /// Standard deviation of the constant offset of each force axis, N; torque axes a twentieth, N m.
        pub wrench_bias: f64 = 1.0, Rule::number("N", 0.0, 100.0);
        /// Rate at which the offset begins to drift, each force axis with its own sign and part of it, N/s; torque axes a
        /// twentieth. The drift returns: it stays within five minutes of this rate.
        pub wrench_drift: f64 = 0.01, Rule::number("N/s", 0.0, 10.0);
        /// White noise of each joint angle, rad.
        pub joint: f64 = 0.0002, Rule::number("rad", 0.0, 0.1);
        /// Error of a platform's odometry: standard deviation of the share of each way, and of each turn, that it misses.
        pub odometry: f64 = 0.01, Rule::number("", 0.0, 0.5);
    }
}

form! {
    /// The stereo pair.
    pub struct CameraSpec: "a camera" {
        /// Width, px.
        pub width: u32 = 640, Rule::number("px", 32.0, 1920.0);
        /// Height, px.
        pub height: u32 = 480, Rule::number("px", 32.0, 1200.0);
        /// Frames a second.
        pub rate: f64 = 15.0, Rule::number("Hz", 1.0, 120.0);
        /// Focal length, px.
        pub focal: f64 = 515.0, Rule::number("px", 20.0, 4000.0);
        /// Distance of the eyes, m.
        pub baseline: f64 = 0.093, Rule::number("m", 0.02, 0.5);
        /// Standard deviation of each pixel's channels, grey levels of 255.
        pub noise: f64 = 2.0, Rule::number("", 0.0, 64.0);
        /// How long the shutter is open, s: what moves is smeared.
        pub exposure: f64 = 0.008, Rule::number("s", 0.0, 0.1);
        /// From the exposure of a frame to its arrival, s.
        pub latency: f64 = 0.03, Rule::number("s", 0.0, 1.0);
        /// Standard deviation of the latency, s.
        pub jitter: f64 = 0.003, Rule::number("s", 0.0, 0.1);
        /// By how much the camera's clock differs from the robot's at most, s; how much it is, the seed draws.
        pub stamp_offset: f64 = 0.003, Rule::number("s", 0.0, 0.1);
        /// Standard deviation of the stamps about the exposures in that clock, s.
        pub stamp_jitter: f64 = 0.002, Rule::number("s", 0.0, 0.1);
        /// The share of frames that are lost.
        pub dropped: f64 = 0.01, Rule::number("", 0.0, 1.0);
        /// How depth errs; `none` is a camera without depth.
        pub depth: Option<DepthSpec> = Some(DepthSpec::default()), Rule::OR_NONE;
        /// How far the true camera is from where the robot believes it to be, in the camera's frame.
        pub mounting_error: MountingError = MountingError::default();
    }
}

form! {
    /// The difference between the true and the believed camera pose.
    pub struct MountingError: "`mounting_error`" {
        /// Shift, m, camera frame (x right, y down, z forward).
        pub position: [f64; 3] = [0.0; 3], within(0.2);
        /// Rotation vector, degrees, camera frame.
        pub rotation_deg: [f64; 3] = [0.0; 3], Rule::degrees(45.0, "rotation");
        /// Length of a further shift in a direction that the seed draws, m.
        pub distance: f64 = 0.01, Rule::number("m", 0.0, 0.2);
        /// Angle of a further rotation about an axis that the seed draws, degrees.
        pub angle_deg: f64 = 2.0, Rule::degrees(45.0, "angle");
    }
}

form! {
    /// The table.
    pub struct TableSpec: "a table" {
        /// Height of its top at the centre, m.
        pub height: f64 = 0.95, Rule::number("m", 0.3, 1.6);
        /// Centre x, y, m.
        pub center: [f64; 2] = [0.25, 0.60], within(3.0);
        /// Width along x and depth along y, m.
        pub size: [f64; 2] = [1.0, 0.7], Rule::number("m", 0.2, 4.0);
        /// Rotation about x (positive: the far edge is higher) and about y (positive: the right edge is lower), degrees.
        pub tilt_deg: [f64; 2] = [1.0, -1.5], Rule::degrees(15.0, "tilt");
        /// Bumps on its top.
        pub bumps: Vec<BumpSpec> = vec![BumpSpec { at: [0.28, 0.55], height: 0.004, radius: 0.05 }], Rule::most(100);
        /// Coulomb friction of sponge on table.
        pub friction: f64 = 0.5, Rule::number("", 0.0, 2.0);
        /// Colour, RGB.
        pub color: [u8; 3] = [150, 115, 80], COLOR;
    }
}

form! {
    /// A smooth bump: `height * (1 - r^2 / radius^2)^2` within `radius` of `at`, nothing beyond.
    pub struct BumpSpec: "a bump" {
        /// Centre x, y, m.
        pub at: [f64; 2] = [0.28, 0.55], within(5.0);
        /// Height at the centre, m; negative is a dent.
        pub height: f64 = 0.004, within(0.03);
        /// Where it ends, m.
        pub radius: f64 = 0.05, Rule::number("m", 0.01, 1.0);
    }
}

form! {
    /// A soft box that lies on the table.
    pub struct ObjectSpec: "an object", check Self::bears_itself {
        /// Its name, as in prior knowledge.
        pub name: String = "sponge".into(), Rule::NAME;
        /// Centre x, y, m.
        pub at: [f64; 2] = [0.35, 0.50], within(5.0);
        /// Rotation about the vertical, degrees.
        pub yaw_deg: f64 = 20.0, Rule::degrees(361.0, "yaw");
        /// Length, width, height, m.
        pub size: [f64; 3] = [0.10, 0.07, 0.04], Rule::number("m", 0.02, 0.4);
        /// Mass, kg.
        pub mass: f64 = 0.15, Rule::number("kg", 0.05, 2.0);
        /// Stiffness of the whole underside, N/m.
        pub stiffness: f64 = 2000.0, Rule::number("N/m", 800.0, 10_000.0);
        /// Colour, RGB.
        pub color: [u8; 3] = [240, 210, 40], COLOR;
    }
}

/// Names of agents are parts of network keys.
fn check_agent_name(name: &str, node: &Node, findings: &mut Findings) {
    let usual = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.chars().all(usual) {
        let help = Some("letters, digits, `_` and `-`".into());
        findings.error_help(
            code::NAME,
            node.place("name"),
            format!("`{name}` cannot be an agent's name"),
            help,
        );
    }
}

/// Whether the hand of every arm has a face with which it presses.
fn presses(model: &Model) -> bool {
    model.arms().all(|arm| model.hand_of(arm).is_some_and(|hand| hand.press_in_tcp.is_some()))
}

impl RobotSpec {
    /// The robot itself.
    ///
    /// # Errors
    /// Everything that is wrong with its files.
    pub fn load(&self) -> Result<Arc<Model>, Vec<Finding>> {
        description::find(&self.model).map(|found| found.model)
    }

    pub(crate) fn model(&self) -> Result<Arc<Model>, SimulationError> {
        self.load().map_err(|findings| SimulationError::Robot { robot: self.model.clone(), findings })
    }

    /// Its root in the world.
    pub fn world_from_root(&self) -> Isometry3<f64> {
        let [x, y] = self.at;
        Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * self.yaw_deg.to_radians())
    }

    /// The arm that wipes; `None` when the robot has no such arm.
    pub fn arm<'m>(&self, model: &'m Model) -> Option<&'m Limb> {
        let Some(wanted) = &self.arm else { return model.arms().next() };
        let is_word = |limb: &Limb| limb.name.split('_').any(|word| word == wanted);
        model.arm(wanted).or_else(|| model.arms().find(|limb| is_word(limb)))
    }

    fn is_there(&mut self, node: &Node, findings: &mut Findings) {
        check_agent_name(&self.name, node, findings);
        if description::is_file(&self.model) {
            let beside = findings.source.path.parent().unwrap_or(Path::new("")).join(&self.model);
            self.model = beside.to_string_lossy().into_owned();
        }
        let known = || shipped_robots();
        match self.load() {
            Ok(model) if self.arm(&model).is_none() => {
                let wanted = self.arm.as_deref().unwrap_or("");
                let arms = || model.arms().map(|limb| limb.name.as_str());
                let help = Some(format!("its arms: {}", arms().collect::<Vec<_>>().join(", ")));
                let message = format!("the robot `{}` has no arm `{wanted}`", model.name());
                findings.unknown(code::REFERENCE, (node.place("arm"), wanted), message, arms(), help);
            }
            Ok(model) if self.pads.is_some() && !presses(&model) => {
                let help = Some("say with `press_in_tcp` in the robot file where each hand has them".into());
                let message = format!("not every arm of the robot `{}` has a face for a pad", model.name());
                findings.error_help(code::REFERENCE, node.place("pads"), message, help);
            }
            Ok(_) => {}
            Err(wrong) => {
                let why = wrong.first().map_or_else(String::new, ToString::to_string);
                let (at, message) =
                    (node.place("model"), format!("the robot `{}` cannot be used", self.model));
                findings.unknown(code::REFERENCE, (at, &self.model), message, known(), Some(why));
            }
        }
    }
}

impl ObjectSpec {
    fn bears_itself(&self, node: &Node, findings: &mut Findings) {
        if self.mass * GRAVITY > 0.25 * self.stiffness * self.size[2] {
            let message = format!("object `{}` is too soft: its weight alone presses it flat", self.name);
            let help = Some("make it lighter, thicker or stiffer".into());
            findings.error_help(code::VALUE, node.span, message, help);
        }
    }
}

impl World {
    /// Its robot.
    ///
    /// # Errors
    /// [`SimulationError::Robot`] with everything that is wrong with the robot's files.
    pub fn model(&self) -> Result<Arc<Model>, SimulationError> {
        self.robot.model()
    }

    /// The middle of a nominally grasped object in the frame of the TCP of the arm that works, m; 0 where it has no hand.
    pub fn grasp_in_tcp(&self) -> Vector3<f64> {
        let grasp =
            |model: &Model| Some(model.hand_of(self.robot.arm(model)?)?.grasp_in_tcp.translation.vector);
        self.model().ok().and_then(|model| grasp(&model)).unwrap_or_default()
    }

    /// Reads a world file; what it does not say is as in the default world. Values of ranges are drawn by `seed`
    /// ([`armarium_source::draw()`]).
    ///
    /// # Errors
    /// Everything that is wrong with the file, in the order of the text.
    pub fn load(path: &Path, seed: u64) -> Result<Self, Vec<Finding>> {
        Self::read(Source::read(path).map_err(|finding| vec![*finding])?, seed)
    }

    /// Reads a world from text; `file` names it in errors. Values of ranges are drawn by the seed 1.
    ///
    /// # Errors
    /// Everything that is wrong with the text, in its order.
    pub fn parse(file: &Path, text: &str) -> Result<Self, Vec<Finding>> {
        Self::read(Arc::new(Source::new(file, text)), 1)
    }

    /// As [`World::load`], from the text of a file.
    ///
    /// # Errors
    /// Everything that is wrong with the text, in its order.
    pub fn read(source: Arc<Source>, seed: u64) -> Result<Self, Vec<Finding>> {
        armarium_source::draw(source, seed)?.read()
    }

    /// The schema of world files (JSON Schema 2020-12).
    pub fn schema() -> serde_json::Value {
        let mut schema = armarium_source::schema::<Self>();
        schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
        schema["title"] = "Armarium world".into();
        schema
    }

    /// The object in question before one is grasped, by its index: the one named `sponge`, else the first.
    pub fn first_object(&self) -> Option<usize> {
        let sponge = self.objects.iter().position(|object| object.name == "sponge");
        sponge.or_else(|| (!self.objects.is_empty()).then_some(0))
    }

    /// The people besides the coach.
    pub fn people(&self) -> impl Iterator<Item = &PersonSpec> {
        self.actors.iter().filter_map(|actor| actor.person.as_ref())
    }

    /// The coach among the actors is the world's coach.
    fn find_coach(&mut self, root: &Node, findings: &mut Findings) {
        let mut coaches = Vec::new();
        self.actors.retain_mut(|actor| actor.coach.take().map(|coach| coaches.push(coach)).is_none());
        if coaches.len() + usize::from(root.get("coach").is_some()) > 1 {
            let at = root.get("actors").map_or(root.span, |node| node.span);
            let help = Some("under `coach`, or as one of the `actors`".into());
            findings.error_help(code::DUPLICATE, at, "there is more than one coach", help);
        }
        if let Some(coach) = coaches.pop() {
            self.coach = coach;
        }
    }

    /// What can only be judged when all sections are known.
    fn fits(&mut self, root: &Node, findings: &mut Findings) {
        self.find_coach(root, findings);
        self.apply_physics(root);
        self.objects_lie_on_the_table(root, findings);
        self.names_differ(root, findings);
        self.names_exist(root, findings);
        self.robots_run(root, findings);
        self.agents_look_away(root, findings);
    }

    fn objects_lie_on_the_table(&self, root: &Node, findings: &mut Findings) {
        for (i, object) in self.objects.iter().enumerate() {
            let off = (0..2).any(|k| (object.at[k] - self.table.center[k]).abs() > self.table.size[k] / 2.0);
            if off {
                let [x, y] = object.at;
                let message = format!("object `{}` at ({x}, {y}) is not on the table", object.name);
                let help = Some("move it, or the table".into());
                findings.error_help(code::VALUE, place(root, "objects", i, "at"), message, help);
            }
        }
    }

    /// Objects and bodies have different names; so have robots and agents.
    fn names_differ(&self, root: &Node, findings: &mut Findings) {
        let things = self.objects.iter().map(|o| &o.name).enumerate().map(|(i, name)| (name, "objects", i));
        let bodies = self.bodies.iter().map(|b| &b.name).enumerate().map(|(i, name)| (name, "bodies", i));
        let again = named_again(things.chain(bodies));
        for (name, list, i) in again {
            let message = format!("two bodies are named `{name}`");
            findings.error(code::DUPLICATE, place(root, list, i, "name"), message);
        }
        let own = [(&self.robot.name, "robot", 0)];
        let robots = self.robots.iter().map(|r| &r.name).enumerate().map(|(i, name)| (name, "robots", i));
        let agents = self.agents.iter().map(|a| &a.name).enumerate().map(|(i, name)| (name, "agents", i));
        for (name, list, i) in named_again(own.into_iter().chain(robots).chain(agents)) {
            let message = format!("two agents are named `{name}`");
            let help = Some(
                "each robot is an agent too; the first is named under `robot`, by default `local`".into(),
            );
            findings.error_help(code::DUPLICATE, place(root, list, i, "name"), message, help);
        }
    }

    /// What is knocked, what bodies stand on, and the probes exist.
    fn names_exist(&self, root: &Node, findings: &mut Findings) {
        let names: Vec<&str> = (self.objects.iter().map(|o| o.name.as_str()))
            .chain(self.bodies.iter().map(|b| b.name.as_str()))
            .chain([HAND, ARM])
            .collect();
        for (i, disturbance) in self.disturbances.iter().enumerate() {
            if !names.contains(&disturbance.knock.as_str()) {
                let message = format!("there is no object `{}`", disturbance.knock);
                let help = Some(format!("known: {}", names.join(", ")));
                findings.error_help(code::REFERENCE, place(root, "disturbances", i, "knock"), message, help);
            }
            if disturbance.slippery.is_some() && [HAND, ARM].contains(&disturbance.knock.as_str()) {
                let message = "only an object gets slippery, not the robot";
                findings.error(code::VALUE, place(root, "disturbances", i, "slippery"), message);
            }
        }
        for (i, body) in self.bodies.iter().enumerate() {
            let before =
                || self.objects.iter().map(|o| &o.name).chain(self.bodies[..i].iter().map(|b| &b.name));
            for (key, other) in [("on", &body.on), ("beside", &body.beside)] {
                if let Some(other) = other
                    && !before().any(|name| name == other)
                {
                    let message =
                        format!("`{}` stands {key} `{other}`, which is no body before it", body.name);
                    let help = Some(format!("name `{other}` above it in the list"));
                    findings.error_help(code::REFERENCE, place(root, "bodies", i, key), message, help);
                }
            }
        }
        for (probe, node) in self.probes.iter().zip(root.get("probes").map_or(&[][..], Node::items)) {
            if !PROBES.contains(&probe.as_str()) {
                let message = format!("there is no probe `{probe}`");
                let help = Some(format!("known: {}", PROBES.join(", ")));
                findings.unknown(code::REFERENCE, (node.span, probe), message, PROBES, help);
            }
        }
    }

    fn robots_run(&self, root: &Node, findings: &mut Findings) {
        let elsewhere = self.robot.at != [0.0; 2] || self.robot.yaw_deg != 0.0;
        let first = |key: &str| root.get("robot").map_or(root.span, |node| node.place(key));
        if elsewhere && !self.robot.load().is_ok_and(|model| model.platform().is_some()) {
            let help = Some("move the others".into());
            findings.error_help(
                code::VALUE,
                first("at"),
                "the first robot stands at the world's origin",
                help,
            );
        }
        if self.robot.runs.is_some() {
            let help = Some("leave it out: `armarium run CHART` names the first robot's chart".into());
            findings.error_help(
                code::VALUE,
                first("runs"),
                "the first robot runs the chart of the run",
                help,
            );
        }
        for (i, robot) in self.robots.iter().enumerate() {
            if robot.runs.is_none() && !robot.inputs.is_empty() {
                let message = format!("`{}` has inputs, and no chart that takes them", robot.name);
                let help = Some("name its chart under `runs`".into());
                findings.error_help(code::VALUE, place(root, "robots", i, "inputs"), message, help);
            }
        }
    }

    fn agents_look_away(&mut self, root: &Node, findings: &mut Findings) {
        let [x, y] = self.table.center;
        for (agent, node) in self.agents.iter_mut().zip(root.get("agents").map_or(&[][..], Node::items)) {
            if node.get("looks_at").is_none() {
                agent.looks_at = [x, y, self.table.height];
            }
            let squared: f64 = agent.at.iter().zip(agent.looks_at).map(|(a, b)| (a - b).powi(2)).sum();
            if squared.sqrt() < MIN_LOOK_DISTANCE {
                let message = format!("`{}` looks at a point in its own eyes", agent.name);
                let help = Some("move `at` or `looks_at`".into());
                findings.error_help(code::VALUE, node.place("looks_at"), message, help);
            }
        }
    }
}

/// Where a list's entry says something; of what is no list, where that says it.
fn place(root: &Node, list: &str, i: usize, key: &str) -> Span {
    let Some(node) = root.get(list) else { return root.span };
    node.items().get(i).unwrap_or(node).place(key)
}

/// The entries whose name another before has.
fn named_again<'w>(
    entries: impl Iterator<Item = (&'w String, &'static str, usize)>,
) -> Vec<(&'w String, &'static str, usize)> {
    let mut before = BTreeSet::new();
    entries.filter(|(name, ..)| !before.insert(*name)).collect()
}
