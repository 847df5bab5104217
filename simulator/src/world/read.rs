//! From a world file's tree to a [`World`], collecting everything that is wrong on the way.
//!
//! Each section starts from its default and overwrites what the file says. A value that cannot be used leaves the
//! default in place and adds a finding, so that one pass finds everything. The checks that join several values
//! (an object beside its table) come last, and only when everything else is right.

use std::ops::RangeInclusive;
use std::path::Path;

use serde_saphyr::{Location, Spanned};

use super::tree::{Node, Raw};
use super::{
    Bump, CoachSpec, CoachingAction, CoachingStep, Demonstration, Disturbance, Gesture, ImageFault,
    Milestone, MountingError, NoiseSpec, ObjectSpec, Push, RobotModel, Shape, Show, Swipe, World, WorldError,
    WrenchFault,
};

/// Largest world file, bytes.
const MAX_BYTES: usize = 1 << 20;
/// Most entries of a list in a world file.
const MAX_LIST: usize = 1000;
/// Most objects; each costs physics.
const MAX_OBJECTS: usize = 8;

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
    for (definition, key) in [("ObjectSpec", "yaw"), ("TableSpec", "tilt"), ("MountingError", "rotation")] {
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

/// Kinds of numbers and the units that the file may give them in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    None,
    Metre,
    Radian,
    Degree,
    Newton,
    Second,
    Hertz,
    Kilogram,
    NewtonPerMetre,
    NewtonPerSecond,
    Pixel,
}

impl Unit {
    /// Symbols with their size in this kind's own unit.
    fn symbols(self) -> &'static [(&'static str, f64)] {
        const DEG: f64 = std::f64::consts::PI / 180.0;
        match self {
            Self::None => &[],
            Self::Metre => &[("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)],
            Self::Radian => &[("rad", 1.0), ("deg", DEG)],
            Self::Degree => &[("deg", 1.0), ("rad", 1.0 / DEG)],
            Self::Newton => &[("N", 1.0)],
            Self::Second => &[("s", 1.0), ("ms", 1e-3), ("min", 60.0)],
            Self::Hertz => &[("Hz", 1.0)],
            Self::Kilogram => &[("kg", 1.0), ("g", 1e-3)],
            Self::NewtonPerMetre => &[("N/m", 1.0)],
            Self::NewtonPerSecond => &[("N/s", 1.0)],
            Self::Pixel => &[("px", 1.0)],
        }
    }
}

struct Reader<'a> {
    file: &'a Path,
    text: &'a str,
    findings: Vec<WorldError>,
}

/// A mapping whose keys have been checked.
struct Section<'n> {
    entries: &'n [(Spanned<String>, Node)],
}

impl<'n> Section<'n> {
    fn get(&self, key: &str) -> Option<&'n Node> {
        self.entries.iter().find(|(k, _)| k.value == key).map(|(_, v)| v)
    }
}

impl Reader<'_> {
    fn find(&mut self, at: Location, code: &'static str, message: String, help: String) {
        let line = usize::try_from(at.line()).unwrap_or(0);
        let column = usize::try_from(at.column()).unwrap_or(0);
        let offset = |v: Option<u64>| v.and_then(|v| usize::try_from(v).ok()).unwrap_or(0);
        let text = self.text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
        self.findings.push(WorldError {
            file: self.file.to_owned(),
            line,
            column,
            span: (offset(at.span().byte_offset()), offset(at.span().byte_len())),
            code,
            message,
            help,
            text: if line == 0 { String::new() } else { text.chars().take(200).collect() },
        });
    }

    fn tree(&mut self) -> Option<Node> {
        let options = serde_saphyr::options! { strict_booleans: true, with_snippet: false };
        if self.text.lines().all(|l| l.trim().is_empty() || l.trim_start().starts_with('#')) {
            return Some(Spanned::new(Raw::Map(Vec::new()), Location::UNKNOWN, Location::UNKNOWN));
        }
        match serde_saphyr::from_str_with_options::<Node>(self.text, options) {
            Ok(node) => Some(node),
            Err(e) => {
                let at = e.location().unwrap_or(Location::UNKNOWN);
                let message = e.without_snippet().to_string();
                self.find(at, "world::yaml", message, "the file must be YAML".into());
                None
            }
        }
    }

    fn section<'n>(&mut self, node: &'n Node, keys: &[&str]) -> Option<Section<'n>> {
        let entries: &[_] = match &node.value {
            Raw::Map(entries) => entries,
            Raw::Null => &[],
            other => {
                let message = format!("expected a mapping, not {}", other.kind());
                self.find(node.referenced, "world::type", message, format!("its keys: {}", keys.join(", ")));
                return None;
            }
        };
        for (key, _) in entries {
            if !keys.contains(&key.value.as_str()) {
                let help = match nearest(&key.value, keys) {
                    Some(k) => format!("did you mean `{k}`?"),
                    None => format!("known keys: {}", keys.join(", ")),
                };
                self.find(key.referenced, "world::unknown_key", format!("unknown key `{}`", key.value), help);
            }
        }
        Some(Section { entries })
    }

    /// A finite number in `range`, in the kind's own unit.
    fn scalar(&mut self, node: &Node, unit: Unit, range: &RangeInclusive<f64>) -> Option<f64> {
        let number = match &node.value {
            Raw::Number(v) => *v,
            Raw::Text(text) => self.quantity(node, text, unit)?,
            other => {
                let message = format!("expected a number, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
                return None;
            }
        };
        if number.is_finite() && range.contains(&number) {
            return Some(number);
        }
        let symbol = unit.symbols().first().map_or(String::new(), |(s, _)| format!(" {s}"));
        let message = format!("{number} is not possible here");
        let help = format!("it lies between {} and {}{symbol}", range.start(), range.end());
        self.find(node.referenced, "world::value", message, help);
        None
    }

    fn quantity(&mut self, node: &Node, text: &str, unit: Unit) -> Option<f64> {
        let trimmed = text.trim();
        let split = trimmed
            .find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e' | 'E')))
            .unwrap_or(trimmed.len());
        let (number, symbol) = (&trimmed[..split], trimmed[split..].trim());
        let Ok(number) = number.trim().parse::<f64>() else {
            let message = format!("expected a number, not `{text}`");
            self.find(node.referenced, "world::type", message, String::new());
            return None;
        };
        if let Some((_, size)) = unit.symbols().iter().find(|(s, _)| *s == symbol) {
            return Some(number * size);
        }
        let known: Vec<_> = unit.symbols().iter().map(|(s, _)| *s).collect();
        let help = if known.is_empty() {
            "this number has no unit".to_owned()
        } else {
            format!("known units here: {}", known.join(", "))
        };
        self.find(node.referenced, "world::unit", format!("`{symbol}` is not a unit of this number"), help);
        None
    }

    fn number(&mut self, node: Option<&Node>, into: &mut f64, unit: Unit, range: RangeInclusive<f64>) {
        if let Some(v) = node.and_then(|n| self.scalar(n, unit, &range)) {
            *into = v;
        }
    }

    fn whole(&mut self, node: Option<&Node>, into: &mut u32, unit: Unit, range: RangeInclusive<u32>) {
        let Some(node) = node else { return };
        let range = f64::from(*range.start())..=f64::from(*range.end());
        if let Some(v) = self.scalar(node, unit, &range) {
            if v.fract() == 0.0 {
                *into = v as u32;
            } else {
                self.find(
                    node.referenced,
                    "world::value",
                    format!("{v} is not a whole number"),
                    String::new(),
                );
            }
        }
    }

    fn vector<const N: usize>(
        &mut self,
        node: Option<&Node>,
        into: &mut [f64; N],
        unit: Unit,
        range: RangeInclusive<f64>,
    ) {
        let Some(node) = node else { return };
        match &node.value {
            Raw::List(items) if items.len() == N => {
                for (item, slot) in items.iter().zip(into) {
                    self.number(Some(item), slot, unit, range.clone());
                }
            }
            other => {
                let message = match other {
                    Raw::List(items) => format!("expected {N} numbers, not {}", items.len()),
                    other => format!("expected a list of {N} numbers, not {}", other.kind()),
                };
                self.find(node.referenced, "world::type", message, String::new());
            }
        }
    }

    fn color(&mut self, node: Option<&Node>, into: &mut [u8; 3]) {
        let mut rgb = into.map(f64::from);
        self.vector(node, &mut rgb, Unit::None, 0.0..=255.0);
        *into = rgb.map(|v| v.round() as u8);
    }

    fn text(&mut self, node: Option<&Node>, into: &mut String) {
        let Some(node) = node else { return };
        match &node.value {
            Raw::Text(t) if !t.is_empty() && t.len() <= 100 => into.clone_from(t),
            Raw::Text(_) => {
                let message = "a name has 1 to 100 characters".into();
                self.find(node.referenced, "world::value", message, String::new());
            }
            other => {
                let message = format!("expected text, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
            }
        }
    }

    fn choice<T: Copy>(&mut self, node: Option<&Node>, into: &mut T, choices: &[(&str, T)]) {
        let Some(node) = node else { return };
        let names: Vec<&str> = choices.iter().map(|(n, _)| *n).collect();
        let Raw::Text(text) = &node.value else {
            let message = format!("expected one of {}, not {}", names.join(", "), node.value.kind());
            self.find(node.referenced, "world::type", message, String::new());
            return;
        };
        if let Some((_, v)) = choices.iter().find(|(n, _)| n == text) {
            *into = *v;
            return;
        }
        let help = match nearest(text, &names) {
            Some(n) => format!("did you mean `{n}`? Known: {}", names.join(", ")),
            None => format!("known: {}", names.join(", ")),
        };
        self.find(node.referenced, "world::value", format!("`{text}` is not known here"), help);
    }

    fn list<'n>(&mut self, node: &'n Node, most: usize) -> Option<&'n [Node]> {
        match &node.value {
            Raw::Null => Some(&[]),
            Raw::List(items) if items.len() <= most => Some(items),
            Raw::List(items) => {
                let message = format!("{} entries; at most {most} are possible", items.len());
                self.find(node.referenced, "world::value", message, String::new());
                None
            }
            other => {
                let message = format!("expected a list, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
                None
            }
        }
    }

    /// Degrees under the key `{name}_deg`, or rad (or with a unit) under `name`.
    fn angles<const N: usize>(&mut self, s: &Section<'_>, name: &str, into: &mut [f64; N], most_deg: f64) {
        let in_degrees = format!("{name}_deg");
        self.vector(s.get(&in_degrees), into, Unit::Degree, -most_deg..=most_deg);
        if let Some(node) = s.get(name) {
            let mut rad = into.map(f64::to_radians);
            let most = most_deg.to_radians();
            self.vector(Some(node), &mut rad, Unit::Radian, -most..=most);
            *into = rad.map(f64::to_degrees);
        }
    }

    fn world(&mut self, root: &Node, world: &mut World) {
        let keys = ["world", "robot", "camera", "table", "objects", "coach", "faults", "disturbances"];
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
        if self.findings.is_empty() {
            self.together(root, world, &places);
        }
    }

    fn robot(&mut self, node: &Node, world: &mut World) {
        let Some(s) = self.section(node, &["model", "arm", "noise"]) else { return };
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

    fn coach(&mut self, node: &Node, coach: &mut CoachSpec) {
        let Some(s) = self.section(node, &["tool", "demonstration", "coaching", "ends"]) else { return };
        if let Some(t) = s.get("tool").and_then(|n| self.section(n, &["color"])) {
            self.color(t.get("color"), &mut coach.tool.color);
        }
        if let Some(n) = s.get("demonstration") {
            coach.demonstration = self.demonstration(n);
        }
        if let Some(items) = s.get("coaching").and_then(|n| self.list(n, MAX_LIST)) {
            coach.coaching = items.iter().filter_map(|n| self.step(n)).collect();
        }
        self.number(s.get("ends"), &mut coach.ends, Unit::Second, 0.0..=3600.0);
    }

    fn demonstration(&mut self, node: &Node) -> Option<Demonstration> {
        match &node.value {
            Raw::Null => return None,
            Raw::Text(t) if t == "none" => return None,
            _ => {}
        }
        let mut d = Demonstration::default();
        let keys = ["shape", "size", "frequency", "swipe", "height", "periods", "jitter"];
        let s = self.section(node, &keys)?;
        let shapes = [("ellipse", Shape::Ellipse), ("eight", Shape::Eight), ("line", Shape::Line)];
        self.choice(s.get("shape"), &mut d.shape, &shapes);
        self.vector(s.get("size"), &mut d.size, Unit::Metre, 0.0..=1.0);
        self.number(s.get("frequency"), &mut d.frequency, Unit::Hertz, 0.05..=5.0);
        self.number(s.get("height"), &mut d.height, Unit::Metre, 0.05..=0.8);
        self.whole(s.get("periods"), &mut d.periods, Unit::None, 0..=1000);
        self.number(s.get("jitter"), &mut d.jitter, Unit::None, 0.0..=0.3);
        if let Some(n) = s.get("swipe") {
            self.swipe(n, &mut d.swipe);
        }
        Some(d)
    }

    fn swipe(&mut self, node: &Node, swipe: &mut Swipe) {
        let Some(s) = self.section(node, &["from", "to"]) else { return };
        self.vector(s.get("from"), &mut swipe.from, Unit::Metre, -3.0..=3.0);
        self.vector(s.get("to"), &mut swipe.to, Unit::Metre, -3.0..=3.0);
        let [dx, dy] = [swipe.to[0] - swipe.from[0], swipe.to[1] - swipe.from[1]];
        if dx.hypot(dy) < 0.02 {
            let message = "the swipe goes nowhere".into();
            self.find(
                node.referenced,
                "world::value",
                message,
                "`from` and `to` differ by 2 cm or more".into(),
            );
        }
    }

    fn step(&mut self, node: &Node) -> Option<CoachingStep> {
        let keys = ["at", "push", "gesture", "phase", "offset", "for", "direction"];
        let s = self.section(node, &keys)?;
        let mut at = 0.0;
        self.number(s.get("at"), &mut at, Unit::Second, 0.0..=3600.0);
        let action = match (s.get("push"), s.get("gesture")) {
            (Some(push), None) => {
                for (key, _) in s.entries.iter().filter(|(k, _)| !matches!(k.value.as_str(), "at" | "push")) {
                    let message = format!("`{}` belongs to a gesture, not to a push", key.value);
                    self.find(key.referenced, "world::unknown_key", message, String::new());
                }
                self.push(push)
            }
            (None, Some(_)) => self.show(node, &s),
            _ => {
                let message = "a coaching step has either `push` or `gesture`".into();
                self.find(node.referenced, "world::value", message, String::new());
                return None;
            }
        };
        action.map(|action| CoachingStep { at, action })
    }

    fn push(&mut self, node: &Node) -> Option<CoachingAction> {
        let mut push = Push::default();
        let s = self.section(node, &["phase", "arc", "force", "cycles"])?;
        self.number(s.get("phase"), &mut push.phase, Unit::None, 0.0..=1.0);
        self.number(s.get("arc"), &mut push.arc, Unit::None, 0.01..=0.5);
        self.vector(s.get("force"), &mut push.force, Unit::Newton, -500.0..=500.0);
        self.whole(s.get("cycles"), &mut push.cycles, Unit::None, 1..=1000);
        Some(CoachingAction::Push { push })
    }

    fn show(&mut self, node: &Node, s: &Section<'_>) -> Option<CoachingAction> {
        let mut show = Show {
            gesture: Gesture::Fist,
            phase: 0.0,
            offset: [0.0, 0.0, 0.0],
            duration: 10.0,
            direction: None,
        };
        let gestures = [
            ("fist", Gesture::Fist),
            ("point_one", Gesture::PointOne),
            ("point_two", Gesture::PointTwo),
            ("open_hand", Gesture::OpenHand),
        ];
        self.choice(s.get("gesture"), &mut show.gesture, &gestures);
        self.number(s.get("phase"), &mut show.phase, Unit::None, 0.0..=1.0);
        self.number(s.get("for"), &mut show.duration, Unit::Second, 0.1..=600.0);
        match s.get("offset") {
            None => {
                let message = "a gesture needs its `offset` from the path".into();
                self.find(node.referenced, "world::missing", message, "offset: [0.0, 0.12, 0.0]".into());
            }
            n => self.vector(n, &mut show.offset, Unit::Metre, -1.0..=1.0),
        }
        match (show.gesture, s.get("direction")) {
            (Gesture::PointOne, Some(n)) => {
                let mut direction = [0.0; 3];
                self.vector(Some(n), &mut direction, Unit::Metre, -1.0..=1.0);
                if direction == [0.0; 3] {
                    let message = "the direction has no length".into();
                    self.find(n.referenced, "world::value", message, String::new());
                }
                show.direction = Some(direction);
            }
            (Gesture::PointOne, None) => {
                let message = "`point_one` needs a `direction`".into();
                self.find(node.referenced, "world::missing", message, "direction: [0.0, 0.04, 0.0]".into());
            }
            (_, Some(n)) => {
                let message = "only `point_one` has a direction".into();
                self.find(n.referenced, "world::unknown_key", message, String::new());
            }
            (_, None) => {}
        }
        Some(CoachingAction::Show(show))
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
            if object.mass * crate::physics::GRAVITY > 0.25 * object.stiffness * object.size[2] {
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

/// The candidate that is nearest to a misspelt word, if it is near.
fn nearest<'c>(word: &str, candidates: &[&'c str]) -> Option<&'c str> {
    candidates
        .iter()
        .map(|c| (distance(word, c), *c))
        .filter(|(d, c)| *d <= 1 + c.chars().count() / 4)
        .min()
        .map(|(_, c)| c)
}

/// Levenshtein's edit distance.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().take(100).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}
