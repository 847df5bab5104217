//! How far the simulated robot, its drives and its depth sensor are from ideal ones.
//!
//! `physics: ideal` takes away all of it, also what `camera` does not say: a robot that is what its model says. By default the
//! robot is a plausible one. This module simulates nothing.

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Field, Findings, Rule, form};
use serde::Serialize;
use serde_json::{Value as Json, json};

use super::{CameraSpec, NoiseSpec, World};

form! {
    /// Imperfections of the robots' bodies and drives.
    pub struct Imperfections: "`physics`" {
        /// Error of the compensation of a robot's own weight, as a share of the weight; its sign is drawn.
        pub gravity_error: f64 = 0.03, Rule::number("", 0.0, 0.5);
        /// Standard deviation of the error of each turning joint's zero, degrees.
        pub joint_zero_deg: f64 = 0.3, Rule::degrees(5.0, "joint_zero");
        /// Play between a turning joint's motor, where the angle is measured, and its link, degrees: the measured angle lags behind
        /// by up to half of it. The drive's force does not know it.
        pub backlash_deg: f64 = 0.1, Rule::degrees(5.0, "backlash");
        /// Coulomb friction of each joint, as a share of its effort.
        pub joint_friction: f64 = 0.01, Rule::number("", 0.0, 0.5);
        /// Time in which a drive settles to 2 %, s.
        pub drive_time: f64 = 0.05, Rule::number("s", 0.02, 0.5);
        /// By which share the mass beyond each wrench sensor is not what the robot's model says; its sign is drawn.
        pub hand_mass_error: f64 = 0.03, Rule::number("", 0.0, 0.5);
    }
}

/// The imperfections, as a map of keys or as the word `ideal` or `plausible`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Physics(pub Imperfections);

/// What an ideal robot has.
const IDEAL: Imperfections = Imperfections {
    gravity_error: 0.0,
    joint_zero_deg: 0.0,
    backlash_deg: 0.0,
    joint_friction: 0.0,
    drive_time: 0.04,
    hand_mass_error: 0.0,
};

const WORDS: [&str; 2] = ["ideal", "plausible"];

impl Field for Physics {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        match &node.value {
            Yaml::String(word) if word == WORDS[0] => self.0 = IDEAL,
            Yaml::String(word) if word == WORDS[1] => self.0 = Imperfections::default(),
            Yaml::String(_) => findings.form(node, "`ideal`, `plausible` or a map"),
            _ => self.0.read(node, rule, findings),
        }
    }
    fn schema(rule: &Rule) -> Json {
        json!({"anyOf": [{"enum": WORDS}, Imperfections::schema(rule)]})
    }
}

form! {
    /// How a depth camera errs. The defaults are those of a camera of the first Kinect's class (Khoshelham and Oude Elberink,
    /// Sensors 12 (2012), 1437-1454, section 3.3).
    pub struct DepthSpec: "`depth`" {
        /// Standard deviation at 1 m, m; it grows with the square of the distance.
        pub noise: f64 = 1.4e-3, Rule::number("m", 0.0, 0.1);
        /// Distance of two neighbouring values at 1 m, m; it grows with the square of the distance.
        pub step: f64 = 2.8e-3, Rule::number("m", 0.0, 0.1);
        /// From where to where it sees, m.
        pub range: [f64; 2] = [0.4, 4.0], Rule::number("m", 0.0, 100.0);
        /// A surface that is seen under a larger angle to its normal gives no depth, degrees.
        pub grazing_deg: f64 = 80.0, Rule::degrees(90.0, "grazing");
        /// Pixels beside an edge that give no depth.
        pub edge: u32 = 1, Rule::number("px", 0.0, 5.0);
    }
}

impl DepthSpec {
    /// One without errors.
    pub const IDEAL: Self = Self { noise: 0.0, step: 0.0, range: [0.0, 100.0], grazing_deg: 90.0, edge: 0 };
}

impl CameraSpec {
    /// Takes the errors away that the file does not name.
    fn idealise(&mut self, written: Option<&Node>) {
        let says = |key: &str| written.is_some_and(|node| node.get(key).is_some());
        if !says("exposure") {
            self.exposure = 0.0;
        }
        if !says("latency") {
            self.latency = 0.0;
        }
        if !says("jitter") {
            self.jitter = 0.0;
        }
        if !says("stamp_offset") {
            self.stamp_offset = 0.0;
        }
        if !says("stamp_jitter") {
            self.stamp_jitter = 0.0;
        }
        if !says("dropped") {
            self.dropped = 0.0;
        }
        if !says("depth") {
            self.depth = Some(DepthSpec::IDEAL);
        }
        if !says("mounting_error") {
            (self.mounting_error.distance, self.mounting_error.angle_deg) = (0.0, 0.0);
        }
    }
}

impl NoiseSpec {
    /// Takes the errors away that the file does not name: the noise of an ideal robot's sensors is white. Offsets and drift stay.
    fn idealise(&mut self, written: Option<&Node>) {
        if written.and_then(|robot| robot.get("noise")?.get("wrench_colored")).is_none() {
            self.wrench_colored = 0.0;
        }
    }
}

impl World {
    /// The default world with an ideal robot: nothing errs but the noise of joints, wrenches and pixels.
    #[must_use]
    pub fn ideal() -> Self {
        let mut world = Self { physics: Physics(IDEAL), ..Self::default() };
        world.camera.idealise(None);
        world.robot.noise.idealise(None);
        world
    }

    /// Takes over what the word `ideal` means for cameras and sensors.
    pub(super) fn apply_physics(&mut self, root: &Node) {
        let word = root.get("physics").map(|node| &node.value);
        if matches!(word, Some(Yaml::String(word)) if word == WORDS[0]) {
            self.camera.idealise(root.get("camera"));
            self.robot.noise.idealise(root.get("robot"));
            let others = root.get("robots").map_or(&[][..], Node::items);
            self.robots.iter_mut().zip(others).for_each(|(robot, node)| robot.noise.idealise(Some(node)));
        }
    }
}
