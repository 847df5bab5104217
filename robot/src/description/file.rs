//! The robot file: what a URDF does not say of a robot. Groups, hands, sensors, cameras, postures, limits.
//!
//! Only its form is here; `resolve.rs` finds the names in the URDF. `armarium robot new` writes one.

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Field, Findings, Rule, choice, form};
use indexmap::IndexMap;
use serde::Serialize;

use crate::model::PlatformKind;

/// The path of a file.
const PATH: Rule = Rule { min: 1.0, most: 1000, ..Rule::ANY };
/// Names by which parts are found.
type Named<T> = IndexMap<String, T>;

form! {
    /// A robot file.
    pub struct RobotFile: "a robot file" {
        /// Its name.
        pub name as "robot": String, Rule::NAME;
        /// Its URDF, beside this file.
        pub description: String, PATH;
        /// Its SRDF, beside this file: groups, end effectors and group states are taken from it.
        pub semantics: Option<String> = None, PATH;
        /// Folders, beside this file, in which the packages of `package://` are.
        pub packages: Vec<String> = Vec::new(), PATH;
        /// The posture in which it begins; all joints at 0 where none is named.
        pub start: Option<String> = None, Rule::NAME;
        /// Groups of joints that are commanded together: arms, torso, head.
        pub groups: Named<GroupFile> = Named::new();
        /// Hands.
        pub hands: Named<HandFile> = Named::new();
        /// Force/torque sensors.
        pub wrenches: Named<WrenchFile> = Named::new();
        /// Cameras.
        pub cameras: Named<CameraFile> = Named::new();
        /// Named postures: positions of joints, rad or m; joints that are not named are at 0.
        pub postures: Named<Named<Position>> = Named::new();
        /// The robot's own limits.
        pub limits: LimitsFile = LimitsFile::default();
        /// What it drives on; where the URDF hangs on a planar or floating joint and nothing is said, a holonomic platform.
        pub platform: Option<PlatformFile> = None;
    }
}

form! {
    /// What a robot drives on.
    pub struct PlatformFile: "a platform" {
        /// How it moves.
        pub kind: PlatformKind = PlatformKind::Holonomic;
        /// Largest speed along the floor, m/s.
        pub speed: f64 = 0.5, Rule::number("m/s", 0.01, 5.0);
        /// Largest speed of its turn, rad/s.
        pub turn: f64 = 1.0, Rule::number("rad/s", 0.01, 10.0);
        /// Largest acceleration, m/s2, and rad/s2 of its turn: it stands within 200 ms from full speed, if that is great enough.
        pub acceleration: f64 = 8.0, Rule::number("", 0.01, 20.0);
    }
}

choice!(PlatformKind {
    "holonomic" => Self::Holonomic, "differential" => Self::Differential, "none" => Self::None,
});

form! {
    /// A group of joints. One with a `tcp` is an arm; the first arm is the one that skills use where none is named.
    pub struct GroupFile: "a group" {
        /// Its joints, in the order of its commands.
        pub joints: Vec<String> = Vec::new(), Rule::ANY;
        /// Or its first and its last joint, both included.
        pub chain: Option<[String; 2]> = None, Rule::NAME;
        /// Its tool centre point, a link.
        pub tcp: Option<String> = None, Rule::NAME;
        /// The hand at its end.
        pub hand: Option<String> = None, Rule::NAME;
        /// Its force/torque sensor.
        pub wrench: Option<String> = None, Rule::NAME;
        /// The groups that move with it so that it reaches further.
        pub helped_by: Vec<String> = Vec::new(), Rule::ANY;
        /// The posture in which it is ready to work.
        pub ready: Option<String> = None, Rule::NAME;
        /// The postures that it takes in place of others: `{home: home_left}`.
        pub postures: Named<String> = Named::new(), Rule::NAME;
    }
}

form! {
    /// A gripper.
    pub struct HandFile: "a hand" {
        /// Its joints.
        pub joints: Vec<String>, Rule::ANY;
        /// Positions of its joints when it is open; their upper limits where nothing is said.
        pub open: Option<Positions> = None;
        /// Positions of its joints when it is closed; their lower limits where nothing is said.
        pub closed: Option<Positions> = None;
        /// Further shapes that it takes: positions of its joints by the shape's name, for instance `pinch` or `flat`.
        pub shapes: Named<Positions> = Named::new();
        /// The links with which it touches what it holds; all that its joints move where nothing is said.
        pub pads: Vec<String> = Vec::new(), Rule::ANY;
        /// Where it grasps, in the frame of its arm's TCP: x along the approach, y along the closing direction.
        pub grasp_in_tcp: PoseFile = PoseFile::default();
        /// The middle of the face with which it presses on what it carries together with another hand, in the frame of its arm's
        /// TCP: x points out, y along the face.
        pub press_in_tcp: Option<PoseFile> = None;
        /// Width of a finger pad, m.
        pub pad_width: f64 = 0.02, Rule::number("m", 0.001, 0.3);
        /// The mark by which cameras track it.
        pub marker: Option<MarkerFile> = None;
    }
}

form! {
    /// A coloured ball on a hand.
    pub struct MarkerFile: "a marker" {
        /// The link in whose origin it is.
        pub link: String, Rule::NAME;
        /// Colour, RGB.
        pub color: [u8; 3], Rule::number("", 0.0, 255.0);
        /// Diameter, m.
        pub diameter: f64 = 0.04, Rule::number("m", 0.005, 0.3);
    }
}

form! {
    /// A force/torque sensor.
    pub struct WrenchFile: "a wrench sensor" {
        /// The link in whose frame it measures; what is attached beyond it is what it feels.
        pub frame: String, Rule::NAME;
    }
}

form! {
    /// A pair of parallel cameras.
    pub struct CameraFile: "a camera" {
        /// The link of the left camera: z along its optical axis, x to the image's right.
        pub left: String, Rule::NAME;
        /// The link of the right camera.
        pub right: String, Rule::NAME;
        /// The group that turns them.
        pub on: Option<String> = None, Rule::NAME;
    }
}

form! {
    /// The robot's own limits.
    pub struct LimitsFile: "`limits`" {
        /// Largest force at a wrench sensor, N.
        pub force: f64 = 40.0, Rule::number("N", 0.1, 10_000.0);
        /// The same for charts that say a limit of their own; without it, `force`.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub most_force: Option<f64> = None, Rule::number("N", 0.1, 10_000.0);
        /// Largest speed of any TCP, m/s.
        pub speed: f64 = 1.0, Rule::number("m/s", 0.01, 10.0);
    }
}

form! {
    /// A pose in a frame.
    pub struct PoseFile: "a pose" {
        /// Position, m.
        pub position: [f64; 3] = [0.0; 3], Rule::number("m", -100.0, 100.0);
        /// Rotations about the frame's x, y and z, in this order, degrees.
        pub rpy_deg: [f64; 3] = [0.0; 3], Rule::degrees(360.0, "rpy");
    }
}

/// The position of a joint: rad or m; written with a unit, it is checked against the joint's kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Position {
    /// Rad or m.
    pub value: f64,
    /// Whether it was written as a length or as an angle; `None` without a unit.
    #[serde(skip)]
    pub is_length: Option<bool>,
}

impl Field for Position {
    fn read(&mut self, node: &Node, _: &Rule, findings: &mut Findings) {
        let unit = match &node.value {
            Yaml::String(text) if text.trim_end().ends_with('m') => Some("m"),
            Yaml::String(_) => Some("rad"),
            _ => None,
        };
        self.is_length = unit.map(|unit| unit == "m");
        self.value.read(node, &Rule::unit(unit.unwrap_or("rad")), findings);
    }
    fn schema(_: &Rule) -> serde_json::Value {
        serde_json::json!({"type": ["number", "string"]})
    }
}

/// Positions of a hand's joints: one for all, or a list.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Positions(pub Vec<Position>);

impl Field for Positions {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        if matches!(node.value, Yaml::List(_)) {
            return self.0.read(node, rule, findings);
        }
        let mut one = Position::default();
        one.read(node, rule, findings);
        self.0 = vec![one];
    }
    fn schema(rule: &Rule) -> serde_json::Value {
        let one = Position::schema(rule);
        serde_json::json!({"anyOf": [one, {"type": "array", "items": one}]})
    }
}
