//! From a world file's tree to a [`World`], collecting everything that is wrong on the way.
//!
//! Each section starts from its default and overwrites what the file says. A value that cannot be used leaves the
//! default in place and adds a finding, so that one pass finds everything. The checks that join several values
//! (an object beside its table) come last, and only when everything else is right.

mod agents;
mod coach;
mod values;

use std::path::Path;

use serde_saphyr::Location;

use self::values::{Reader, Unit};
use super::tree::Node;
use super::{
    Bump, Disturbance, ImageFault, Milestone, MountingError, NoiseSpec, ObjectSpec, RobotModel, World,
    WorldError, WrenchFault,
};

/// Largest world file, bytes.
const MAX_BYTES: usize = 1 << 20;
/// Most entries of a list in a world file.
const MAX_LIST: usize = 1000;
/// Most objects; each costs physics.
const MAX_OBJECTS: usize = 8;
/// Most agents with eyes; each costs rendering.
const MAX_AGENTS: usize = 8;

pub(super) fn load(path: &Path) -> Result<World, Vec<WorldError>> {
    match std::fs::read_to_string(path) {
        Ok(text) => parse(path, &text),
        Err(e) => Err(vec![WorldError {
            file: path.to_owned(),
            line: 0,
            column: 0,
            span: (0, 0),
            code: "world::unreadable",
            message: format!("the world file cannot be read: {e}"),
            help: "check the path and that the file is UTF-8 text".into(),
            text: String::new(),
        }]),
    }
}

pub(super) fn parse(file: &Path, text: &str) -> Result<World, Vec<WorldError>> {
    let mut reader = Reader { file, text, findings: Vec::new() };
    let mut world = World::default();
    if text.len() > MAX_BYTES {
        let at = Location::UNKNOWN;
        reader.find(at, "world::too_large", "the world file is over 1 MB".into(), String::new());
    } else if let Some(root) = reader.tree() {
        reader.world(&root, &mut world);
    }
    if reader.findings.is_empty() {
        Ok(world)
    } else {
        reader.findings.sort_by_key(|f| (f.line, f.column));
        Err(reader.findings)
    }
}

/// Adds the radian twins of the `_deg` keys to the schema; the reader takes either.
pub(super) fn add_radian_keys(schema: &mut serde_json::Value) {
    let angle = serde_json::json!({
        "description": "The same in rad, or with its unit: `20 deg`.",
        "type": ["number", "string"],
    });
    for (definition, key) in
        [("ObjectSpec", "yaw"), ("CoverSpec", "yaw"), ("TableSpec", "tilt"), ("MountingError", "rotation")]
    {
        let value = if key == "yaw" {
            angle.clone()
        } else {
            serde_json::json!({
                "description": "The same in rad, or with units: `1 deg`.", "type": "array", "items": angle,
            })
        };
        if let Some(properties) = schema.pointer_mut(&format!("/$defs/{definition}/properties")) {
            properties[key] = value;
        }
    }
}
impl Reader<'_> {
    fn world(&mut self, root: &Node, world: &mut World) {
        let keys = [
            "world",
            "robot",
            "camera",
            "table",
            "objects",
            "coach",
            "faults",
            "disturbances",
            "agents",
            "covers",
        ];
        let Some(s) = self.section(root, &keys) else { return };
        self.text(s.get("world"), &mut world.name);
        if let Some(n) = s.get("robot") {
            self.robot(n, world);
        }
        if let Some(n) = s.get("camera") {
            self.camera(n, world);
        }
        if let Some(n) = s.get("table") {
            self.table(n, world);
        }
        let mut places = Vec::new();
        if let Some(items) = s.get("objects").and_then(|n| self.list(n, MAX_OBJECTS)) {
            world.objects = items.iter().map(|n| self.object(n)).collect();
            places = items.iter().map(|n| n.referenced).collect();
        }
        if let Some(n) = s.get("coach") {
            self.coach(n, &mut world.coach);
        }
        if let Some(n) = s.get("faults") {
            self.faults(n, world);
        }
        if let Some(items) = s.get("disturbances").and_then(|n| self.list(n, MAX_LIST)) {
            world.disturbances = items.iter().map(|n| self.disturbance(n, &world.objects)).collect();
        }
        for n in s.get("agents").and_then(|n| self.list(n, MAX_AGENTS)).unwrap_or_default() {
            let agent = self.agent(n, &world.agents, world);
            world.agents.push(agent);
        }
        if let Some(items) = s.get("covers").and_then(|n| self.list(n, MAX_LIST)) {
            world.covers = items.iter().map(|n| self.cover(n)).collect();
        }
        if self.findings.is_empty() {
            self.together(root, world, &places);
        }
    }

    fn robot(&mut self, node: &Node, world: &mut World) {
        let Some(s) = self.section(node, &["name", "model", "arm", "noise"]) else { return };
        if let Some(n) = s.get("name") {
            self.text(Some(n), &mut world.robot.name);
            let name = world.robot.name.clone();
            self.agent_name(n, &name);
        }
        self.choice(s.get("model"), &mut world.robot.model, &[("armar3", RobotModel::Armar3)]);
        self.choice(s.get("arm"), &mut world.robot.arm, &[("right", super::Arm::Right)]);
        if let Some(n) = s.get("noise") {
            self.noise(n, &mut world.robot.noise);
        }
    }

    fn noise(&mut self, node: &Node, noise: &mut NoiseSpec) {
        let keys = ["wrench", "wrench_bias", "wrench_drift", "joint"];
        let Some(s) = self.section(node, &keys) else { return };
        self.number(s.get("wrench"), &mut noise.wrench, Unit::Newton, 0.0..=20.0);
        self.number(s.get("wrench_bias"), &mut noise.wrench_bias, Unit::Newton, 0.0..=100.0);
        self.number(s.get("wrench_drift"), &mut noise.wrench_drift, Unit::NewtonPerSecond, 0.0..=10.0);
        self.number(s.get("joint"), &mut noise.joint, Unit::Radian, 0.0..=0.1);
    }

    fn camera(&mut self, node: &Node, world: &mut World) {
        let keys = ["width", "height", "rate", "focal", "baseline", "noise", "mounting_error"];
        let Some(s) = self.section(node, &keys) else { return };
        let camera = &mut world.camera;
        self.whole(s.get("width"), &mut camera.width, Unit::Pixel, 32..=1920);
        self.whole(s.get("height"), &mut camera.height, Unit::Pixel, 32..=1200);
        self.number(s.get("rate"), &mut camera.rate, Unit::Hertz, 1.0..=120.0);
        self.number(s.get("focal"), &mut camera.focal, Unit::Pixel, 20.0..=4000.0);
        self.number(s.get("baseline"), &mut camera.baseline, Unit::Metre, 0.02..=0.5);
        self.number(s.get("noise"), &mut camera.noise, Unit::None, 0.0..=64.0);
        if let Some(n) = s.get("mounting_error") {
            self.mounting(n, &mut camera.mounting_error);
        }
    }

    fn mounting(&mut self, node: &Node, error: &mut MountingError) {
        let Some(s) = self.section(node, &["position", "rotation_deg", "rotation"]) else { return };
        self.vector(s.get("position"), &mut error.position, Unit::Metre, -0.2..=0.2);
        self.angles(&s, "rotation", &mut error.rotation_deg, 45.0);
    }

    fn table(&mut self, node: &Node, world: &mut World) {
        let keys = ["height", "center", "size", "tilt_deg", "tilt", "bumps", "friction", "color"];
        let Some(s) = self.section(node, &keys) else { return };
        let table = &mut world.table;
        self.number(s.get("height"), &mut table.height, Unit::Metre, 0.3..=1.6);
        self.vector(s.get("center"), &mut table.center, Unit::Metre, -3.0..=3.0);
        self.vector(s.get("size"), &mut table.size, Unit::Metre, 0.2..=4.0);
        self.angles(&s, "tilt", &mut table.tilt_deg, 15.0);
        self.number(s.get("friction"), &mut table.friction, Unit::None, 0.0..=2.0);
        self.color(s.get("color"), &mut table.color);
        if let Some(items) = s.get("bumps").and_then(|n| self.list(n, 100)) {
            table.bumps = items.iter().map(|n| self.bump(n)).collect();
        }
    }

    fn bump(&mut self, node: &Node) -> Bump {
        let mut bump = Bump { at: [0.28, 0.55], height: 0.004, radius: 0.05 };
        if let Some(s) = self.section(node, &["at", "height", "radius"]) {
            self.vector(s.get("at"), &mut bump.at, Unit::Metre, -5.0..=5.0);
            self.number(s.get("height"), &mut bump.height, Unit::Metre, -0.03..=0.03);
            self.number(s.get("radius"), &mut bump.radius, Unit::Metre, 0.01..=1.0);
        }
        bump
    }

    fn object(&mut self, node: &Node) -> ObjectSpec {
        let mut object = ObjectSpec::default();
        let keys = ["name", "at", "yaw_deg", "yaw", "size", "mass", "stiffness", "color"];
        let Some(s) = self.section(node, &keys) else { return object };
        self.text(s.get("name"), &mut object.name);
        self.vector(s.get("at"), &mut object.at, Unit::Metre, -5.0..=5.0);
        self.number(s.get("yaw_deg"), &mut object.yaw_deg, Unit::Degree, -360.0..=360.0);
        if let Some(yaw) = s.get("yaw").and_then(|n| self.scalar(n, Unit::Radian, &(-6.3..=6.3))) {
            object.yaw_deg = yaw.to_degrees();
        }
        self.vector(s.get("size"), &mut object.size, Unit::Metre, 0.02..=0.4);
        self.number(s.get("mass"), &mut object.mass, Unit::Kilogram, 0.05..=2.0);
        self.number(s.get("stiffness"), &mut object.stiffness, Unit::NewtonPerMetre, 800.0..=10_000.0);
        self.color(s.get("color"), &mut object.color);
        object
    }
    fn faults(&mut self, node: &Node, world: &mut World) {
        let Some(s) = self.section(node, &["images", "wrench", "from"]) else { return };
        let images = [
            ("none", ImageFault::None),
            ("black", ImageFault::Black),
            ("swapped", ImageFault::Swapped),
            ("frozen", ImageFault::Frozen),
        ];
        self.choice(s.get("images"), &mut world.faults.images, &images);
        let wrench = [("none", WrenchFault::None), ("frozen", WrenchFault::Frozen)];
        self.choice(s.get("wrench"), &mut world.faults.wrench, &wrench);
        self.number(s.get("from"), &mut world.faults.from, Unit::Second, 0.0..=3600.0);
    }

    fn disturbance(&mut self, node: &Node, objects: &[ObjectSpec]) -> Disturbance {
        let mut d = Disturbance::default();
        let Some(s) = self.section(node, &["after", "at", "knock", "force", "for"]) else { return d };
        let milestones = [("grasp", Milestone::Grasp), ("wiping", Milestone::Wiping)];
        self.choice(s.get("after"), &mut d.after, &milestones);
        self.number(s.get("at"), &mut d.at, Unit::Second, 0.0..=3600.0);
        self.text(s.get("knock"), &mut d.knock);
        if d.knock != "hand" && !objects.iter().any(|o| o.name == d.knock) {
            let at = s.get("knock").unwrap_or(node).referenced;
            let names: Vec<_> = objects.iter().map(|o| o.name.as_str()).chain(["hand"]).collect();
            let message = format!("there is no object `{}`", d.knock);
            self.find(at, "world::value", message, format!("known: {}", names.join(", ")));
        }
        self.vector(s.get("force"), &mut d.force, Unit::Newton, -1000.0..=1000.0);
        self.number(s.get("for"), &mut d.duration, Unit::Second, 0.001..=60.0);
        d
    }

    /// What can only be judged when all values are known.
    fn together(&mut self, root: &Node, world: &World, places: &[Location]) {
        for (i, object) in world.objects.iter().enumerate() {
            let at = places.get(i).copied().unwrap_or(root.referenced);
            let on_table =
                (0..2).all(|k| (object.at[k] - world.table.center[k]).abs() <= world.table.size[k] / 2.0);
            if !on_table {
                let [x, y] = object.at;
                let message = format!("object `{}` at ({x}, {y}) is not on the table", object.name);
                self.find(at, "world::value", message, "move it, or the table".into());
            }
            if object.mass * crate::world::GRAVITY > 0.25 * object.stiffness * object.size[2] {
                let message =
                    format!("object `{}` is too soft: its weight alone presses it flat", object.name);
                self.find(at, "world::value", message, "make it lighter, thicker or stiffer".into());
            }
            if world.objects[..i].iter().any(|o| o.name == object.name) {
                let message = format!("two objects are named `{}`", object.name);
                self.find(at, "world::value", message, String::new());
            }
        }
    }
}
