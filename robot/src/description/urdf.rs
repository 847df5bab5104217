//! Reads URDF (up to version 1.2, whose `<limit>` has an acceleration) into the links and joints of a model.
//!
//! It reads links, forms with their colours, inertials, and joints of every kind. Files in the wild leave things
//! out: what is not stated is assumed, and a warning says so. What cannot be meant (loops, several roots, numbers that
//! are not finite) is an error. A `floating` or `planar` joint on which all of the robot hangs becomes a platform (`platform.rs`); others
//! are not driven: their link stands still.
//! Every finding has its place in the text. Groups, hands and sensors are no part of URDF (see `file.rs`).

use std::collections::BTreeMap;
use std::str::FromStr;
use std::sync::Arc;

use armarium_source::{Finding, Findings, Source, Span, code};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};

use super::meshes::Meshes;
use crate::model::{Collision, Geometry, Inertial, Joint, JointKind, JointMotion, Link, LinkId, Visual};

/// Most elements of a file.
const MAX_NODES: u32 = 1_000_000;
/// Acceleration of joints whose description states none, rad/s² (m/s²).
const DEFAULT_ACCELERATION: f64 = 10.0;
/// Speed of joints whose description states none, rad/s and m/s.
const DEFAULT_SPEED: [f64; 2] = [1.0, 0.1];
/// Range of joints whose description states none, to both sides, rad and m.
const DEFAULT_RANGE: [f64; 2] = [std::f64::consts::PI, 0.1];
/// A link that moves and has no inertia is taken for a ball of this mass, kg, and radius, m.
const DEFAULT_BODY: (f64, f64) = (0.1, 0.05);
/// Colour of what has none.
const GREY: [u8; 3] = [150; 3];

/// The links and joints of a robot.
#[derive(Debug, Default)]
pub(super) struct LinkTree {
    pub(super) links: Vec<Link>,
    pub(super) joints: Vec<Joint>,
    pub(super) link_ids: BTreeMap<String, LinkId>,
    pub(super) joint_ids: BTreeMap<String, usize>,
    /// For each link, those that a joint moves, from the root to it.
    pub(super) movers: Vec<Vec<LinkId>>,
    /// Whether all of it hangs on one planar or floating joint.
    pub(super) floats: bool,
}

/// Reads a description. Adds findings; `None` where the text is no robot at all.
pub(super) fn read(source: &Arc<Source>, meshes: &mut Meshes<'_>) -> (Option<LinkTree>, Vec<Finding>) {
    let mut findings = Findings::new(Arc::clone(source));
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = match Document::parse_with_options(&source.text, options) {
        Ok(document) => document,
        Err(error) => {
            let at = byte_of(&source.text, error.pos());
            let message = format!("cannot read URDF: {error}");
            findings.error(code::FORM, Span { start: at, end: at + 1 }, message);
            return (None, findings.list);
        }
    };
    let tree = UrdfReader::new(&document, &mut findings, meshes).and_then(UrdfReader::read);
    (tree, findings.list)
}

fn byte_of(text: &str, at: roxmltree::TextPos) -> usize {
    let line = at.row.saturating_sub(1) as usize;
    let start: usize = text.split_inclusive('\n').take(line).map(str::len).sum();
    let column = at.col.saturating_sub(1) as usize;
    start + text[start..].chars().take(column).map(char::len_utf8).sum::<usize>()
}

type Element<'a> = Node<'a, 'a>;

fn child<'a>(of: Element<'a>, name: &str) -> Option<Element<'a>> {
    of.children().find(|node| node.has_tag_name(name))
}

fn children<'a>(of: Element<'a>, name: &'static str) -> impl Iterator<Item = Element<'a>> {
    of.children().filter(move |node| node.has_tag_name(name))
}

/// The start tag of an element, without what is inside.
pub(super) fn span(node: Node<'_, '_>) -> Span {
    let range = node.range();
    let text = &node.document().input_text()[range.clone()];
    Span { start: range.start, end: range.start + text.find('>').map_or(text.len(), |end| end + 1) }
}

/// An element of the description under a joint or link, for messages.
fn called(node: Element<'_>) -> String {
    let named = node.ancestors().find(|node| node.has_tag_name("joint") || node.has_tag_name("link"));
    let named = named.unwrap_or(node);
    format!("{} `{}`", named.tag_name().name(), named.attribute("name").unwrap_or(""))
}

/// The URDF tree during the walk.
struct UrdfReader<'a, 'f, 'm> {
    root: Element<'a>,
    meshes: &'f mut Meshes<'m>,
    findings: &'f mut Findings,
    links: BTreeMap<&'a str, Element<'a>>,
    joints: BTreeMap<&'a str, Element<'a>>,
    /// The joints below each link, in the order of the text.
    below: BTreeMap<&'a str, Vec<Element<'a>>>,
    materials: BTreeMap<&'a str, [u8; 3]>,
    tree: LinkTree,
    /// What was assumed, with those of which it was assumed, in the order in which they were found.
    assumed: Vec<(String, Span, Vec<String>)>,
}

impl<'a, 'f, 'm> UrdfReader<'a, 'f, 'm> {
    /// `None` after a finding that leaves no tree to walk.
    fn new(
        document: &'a Document<'a>,
        findings: &'f mut Findings,
        meshes: &'f mut Meshes<'m>,
    ) -> Option<Self> {
        let root = document.root_element();
        let macros = root.descendants().find(|node| {
            node.is_element() && node.tag_name().namespace().is_some_and(|space| space.contains("xacro"))
        });
        if let Some(node) = macros {
            let path = findings.source.path.clone();
            let into = path.with_extension("").with_extension("urdf");
            let help = format!("expand it: xacro {} > {}", path.display(), into.display());
            let message = "this is an xacro file, not URDF: it holds macros";
            findings.error_help(code::FORM, span(node), message, Some(help));
            return None;
        }
        if !root.has_tag_name("robot") {
            let message = format!("cannot read URDF: its root is <{}>, not <robot>", root.tag_name().name());
            findings.error(code::FORM, span(root), message);
            return None;
        }
        let mut reader = Self {
            root,
            meshes,
            findings,
            links: BTreeMap::new(),
            joints: BTreeMap::new(),
            below: BTreeMap::new(),
            materials: BTreeMap::new(),
            tree: LinkTree::default(),
            assumed: Vec::new(),
        };
        reader.index_links()?;
        reader.index_joints()?;
        for material in root.descendants().filter(|node| node.has_tag_name("material")) {
            if let (Some(name), Some(color)) = (material.attribute("name"), reader.color(material)) {
                reader.materials.entry(name).or_insert(color);
            }
        }
        Some(reader)
    }

    fn refuse<T>(&mut self, code: &'static str, node: Element<'_>, message: impl Into<String>) -> Option<T> {
        self.findings.error(code, span(node), message);
        None
    }

    fn name(&mut self, node: Element<'a>) -> Option<&'a str> {
        match node.attribute("name") {
            Some(name) => Some(name),
            None => {
                self.refuse(code::MISSING_KEY, node, format!("a {} without a name", node.tag_name().name()))
            }
        }
    }

    fn index_links(&mut self) -> Option<()> {
        for link in children(self.root, "link") {
            let name = self.name(link)?;
            if self.links.insert(name, link).is_some() {
                return self.refuse(code::DUPLICATE, link, format!("two links are named `{name}`"));
            }
        }
        Some(())
    }

    fn index_joints(&mut self) -> Option<()> {
        let mut parent_of: BTreeMap<&str, &str> = BTreeMap::new();
        for joint in children(self.root, "joint") {
            let name = self.name(joint)?;
            if self.joints.insert(name, joint).is_some() {
                return self.refuse(code::DUPLICATE, joint, format!("two joints are named `{name}`"));
            }
            let mut ends = [""; 2];
            for (end, which) in ends.iter_mut().zip(["parent", "child"]) {
                let link = child(joint, which).and_then(|end| end.attribute("link"));
                let Some(link) = link else {
                    let message = format!("joint `{name}` names no {which} link");
                    return self.refuse(code::MISSING_KEY, joint, message);
                };
                if !self.links.contains_key(link) {
                    let message = format!("joint `{name}` names the link `{link}`, which is missing");
                    return self.refuse(code::REFERENCE, joint, message);
                }
                *end = link;
            }
            if parent_of.insert(ends[1], name).is_some() {
                let message = format!("the link `{}` has two parents", ends[1]);
                return self.refuse(code::DUPLICATE, joint, message);
            }
            self.below.entry(ends[0]).or_default().push(joint);
        }
        let mut roots = self.links.keys().filter(|name| !parent_of.contains_key(*name));
        match (roots.next().copied(), roots.next().copied()) {
            (Some(root), None) => {
                self.root = self.links[root];
                Some(())
            }
            (Some(a), Some(b)) => {
                let second = self.links[b];
                self.refuse(code::VALUE, second, format!("there are two roots, `{a}` and `{b}`"))
            }
            (None, _) => self.refuse(code::VALUE, self.root, "there is no root link"),
        }
    }

    fn read(mut self) -> Option<LinkTree> {
        let mut waiting: Vec<(Option<LinkId>, Option<Element<'a>>, Element<'a>)> =
            vec![(None, None, self.root)];
        let mut followers = Vec::new();
        while let Some((parent, via, link)) = waiting.pop() {
            let id = self.add(parent, via, link, &mut followers)?;
            let below = self.below.get(link.attribute("name").unwrap_or("")).cloned().unwrap_or_default();
            for joint in below.into_iter().rev() {
                let name = child(joint, "child").and_then(|child| child.attribute("link"));
                waiting.push((Some(id), Some(joint), self.links[name?]));
            }
        }
        if self.tree.links.len() < self.links.len() {
            return self.refuse(code::VALUE, self.root, "some links hang in a loop and not on the root");
        }
        for (link, joint) in followers {
            self.follow(link, joint)?;
        }
        self.find_movers();
        self.give_mass();
        for (what, at, of) in std::mem::take(&mut self.assumed) {
            let (count, most) = (of.len(), 6);
            let more = if count > most { format!(" and {} more", count - most) } else { String::new() };
            let message = format!("{what}: {}{more}", of[..count.min(most)].join(", "));
            self.findings.add(armarium_source::Severity::Warning, code::ASSUMED, at, message, None);
        }
        let refused = self.findings.list.iter().any(Finding::is_error);
        (!refused).then_some(self.tree)
    }

    /// Notes what is assumed of a joint or link.
    fn assume(&mut self, what: &str, node: Element<'_>, of: &str) {
        match self.assumed.iter_mut().find(|(known, ..)| known == what) {
            Some((.., all)) => all.push(of.to_owned()),
            None => self.assumed.push((what.to_owned(), span(node), vec![of.to_owned()])),
        }
    }

    fn add(
        &mut self,
        parent: Option<LinkId>,
        via: Option<Element<'a>>,
        element: Element<'a>,
        followers: &mut Vec<(LinkId, Element<'a>)>,
    ) -> Option<LinkId> {
        let id = LinkId(self.tree.links.len());
        let mut motion = None;
        if let Some(joint) = via
            && let Some(read) = self.joint(joint, id)?
        {
            if child(joint, "mimic").is_some() {
                followers.push((id, joint));
            }
            // A follower's own position comes with its leader, see `follow`.
            let (number, kind, axis) = (self.tree.joints.len(), read.kind, read.axis);
            motion = Some(JointMotion { joint: number, kind, axis, multiplier: 1.0, offset: 0.0 });
            if child(joint, "mimic").is_none() {
                self.tree.joint_ids.insert(read.name.clone(), self.tree.joints.len());
                self.tree.joints.push(read);
            }
        }
        let parent_from_link = match via {
            Some(joint) => self.origin(joint)?,
            None => Isometry3::identity(),
        };
        let (visuals, collisions) = (self.visuals(element)?, self.collisions(element)?);
        let inertial = self.inertial(element)?;
        let name = element.attribute("name").unwrap_or("").to_owned();
        self.tree.link_ids.insert(name.clone(), id);
        self.tree.links.push(Link { name, parent, motion, parent_from_link, inertial, visuals, collisions });
        Some(id)
    }

    /// Whether a joint is the only one below the root.
    fn is_root_joint(&self, joint: Element<'a>) -> bool {
        let root = self.root.attribute("name").unwrap_or("");
        self.below.get(root).is_some_and(|joints| joints.as_slice() == [joint])
    }

    /// The joint of an element; `None` inside where it does not move.
    #[expect(clippy::option_option, reason = "an error, a fixed joint, a joint")]
    fn joint(&mut self, joint: Element<'a>, link: LinkId) -> Option<Option<Joint>> {
        let name = joint.attribute("name").unwrap_or("").to_owned();
        let (kind, endless) = match joint.attribute("type") {
            Some("fixed") => return Some(None),
            Some("revolute") => (JointKind::Revolute, false),
            Some("continuous") => (JointKind::Revolute, true),
            Some("prismatic") => (JointKind::Prismatic, false),
            Some("floating" | "planar") if self.is_root_joint(joint) => {
                self.tree.floats = true;
                return Some(None);
            }
            Some("floating" | "planar") => {
                let what = "floating and planar joints are not driven; what they carry stands still";
                self.assume(what, joint, &name);
                return Some(None);
            }
            other => {
                let other = other.unwrap_or("none");
                let message = format!("joint `{name}` is of the type `{other}`, which is not known");
                return self.refuse(code::VALUE, joint, message);
            }
        };
        let axis = match child(joint, "axis") {
            Some(axis) => self.numbers(axis, "xyz", [1.0, 0.0, 0.0])?,
            None => [1.0, 0.0, 0.0],
        };
        let Some(axis) = Unit::try_new(Vector3::from(axis), 1e-9) else {
            return self.refuse(code::VALUE, joint, format!("joint `{name}` has no axis"));
        };
        let which = usize::from(kind == JointKind::Prismatic);
        let unit = ["rad", "m"][which];
        let limit = child(joint, "limit");
        let stated = |key: &str| limit.is_some_and(|limit| limit.has_attribute(key));
        let (lower, upper) = if endless {
            (f64::NEG_INFINITY, f64::INFINITY)
        } else if stated("lower") || stated("upper") {
            (self.limit(limit, "lower", 0.0)?, self.limit(limit, "upper", 0.0)?)
        } else {
            let range = DEFAULT_RANGE[which];
            self.assume(&format!("without limits, taken for {range:.2} {unit} to both sides"), joint, &name);
            (-range, range)
        };
        if lower > upper {
            return self.refuse(code::VALUE, joint, format!("joint `{name}` needs lower <= upper"));
        }
        let mut velocity = self.limit(limit, "velocity", 0.0)?.abs();
        if velocity == 0.0 {
            velocity = DEFAULT_SPEED[which];
            self.assume(&format!("without a speed limit, taken for {velocity} {unit}/s"), joint, &name);
        }
        let acceleration = self.limit(limit, "acceleration", DEFAULT_ACCELERATION)?.abs();
        let acceleration = if acceleration > 0.0 { acceleration } else { DEFAULT_ACCELERATION };
        let effort = self.limit(limit, "effort", 0.0)?.abs();
        Some(Some(Joint { name, kind, link, axis, lower, upper, velocity, acceleration, effort }))
    }

    fn limit(&mut self, limit: Option<Element<'a>>, key: &'static str, default: f64) -> Option<f64> {
        limit.map_or(Some(default), |limit| self.numbers(limit, key, [default]).map(|[value]| value))
    }

    /// Lets a link follow the leader of its joint. A leader may itself be a follower.
    fn follow(&mut self, link: LinkId, joint: Element<'a>) -> Option<()> {
        let (mut multiplier, mut offset) = (1.0, 0.0);
        let mut at = joint;
        for _ in 0..=self.joints.len() {
            let Some(mimic) = child(at, "mimic") else {
                let leader = at.attribute("name").unwrap_or("");
                let Some(&leader) = self.tree.joint_ids.get(leader) else {
                    // The leader stands still, and so does the follower.
                    self.tree.links[link.0].motion = None;
                    return Some(());
                };
                if let Some(motion) = &mut self.tree.links[link.0].motion {
                    *motion = JointMotion { joint: leader, multiplier, offset, ..*motion };
                }
                return Some(());
            };
            let [own] = self.numbers(mimic, "multiplier", [1.0])?;
            let [shift] = self.numbers(mimic, "offset", [0.0])?;
            (multiplier, offset) = (multiplier * own, offset + multiplier * shift);
            let leader = mimic.attribute("joint").unwrap_or("");
            let Some(&next) = self.joints.get(leader) else {
                let message = format!("{} mimics the joint `{leader}`, which is missing", called(at));
                return self.refuse(code::REFERENCE, mimic, message);
            };
            at = next;
        }
        self.refuse(code::CYCLE, joint, format!("{} mimics itself", called(joint)))
    }

    fn find_movers(&mut self) {
        for (i, link) in self.tree.links.iter().enumerate() {
            let mut movers = link.parent.map_or_else(Vec::new, |p| self.tree.movers[p.0].clone());
            movers.extend(link.motion.map(|_| LinkId(i)));
            self.tree.movers.push(movers);
        }
    }

    /// A moving part without any mass cannot be simulated: its link is taken for a small ball.
    fn give_mass(&mut self) {
        let links = &self.tree.links;
        let mut part: Vec<usize> = Vec::new();
        let mut has_mass = vec![false; links.len()];
        for (i, link) in links.iter().enumerate() {
            part.push(link.parent.filter(|_| link.motion.is_none()).map_or(i, |p| part[p.0]));
            has_mass[part[i]] |= link.inertial.is_some();
        }
        let bare = (0..links.len()).filter(|&i| links[i].motion.is_some() && !has_mass[i]);
        for i in bare.collect::<Vec<_>>() {
            let (mass, radius) = DEFAULT_BODY;
            let inertia = Matrix3::identity() * (0.4 * mass * radius * radius);
            let link = &mut self.tree.links[i];
            link.inertial = Some(Inertial { mass, center: Point3::origin(), inertia });
            let name = link.name.clone();
            let what = format!("without mass, taken for {mass} kg");
            let node = self.links[name.as_str()];
            self.assume(&what, node, &name);
        }
    }

    /// Numbers of an attribute; the default where it is not there.
    fn numbers<const N: usize>(
        &mut self,
        node: Element<'a>,
        key: &'static str,
        default: [f64; N],
    ) -> Option<[f64; N]> {
        let Some(text) = node.attribute(key) else { return Some(default) };
        let read: Option<Vec<f64>> =
            text.split_whitespace().map(|word| f64::from_str(word).ok().filter(|v| v.is_finite())).collect();
        match read.and_then(|read| <[f64; N]>::try_from(read).ok()) {
            Some(read) => Some(read),
            None => {
                let message = format!("`{key}=\"{text}\"` of {} is not {N} finite numbers", called(node));
                self.refuse(code::VALUE, node, message)
            }
        }
    }

    /// The pose in an element's `<origin>`.
    fn origin(&mut self, of: Element<'a>) -> Option<Isometry3<f64>> {
        let Some(origin) = child(of, "origin") else { return Some(Isometry3::identity()) };
        let xyz = self.numbers(origin, "xyz", [0.0; 3])?;
        let rpy = self.numbers(origin, "rpy", [0.0; 3])?;
        let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
        Some(Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation))
    }

    fn visuals(&mut self, link: Element<'a>) -> Option<Vec<Visual>> {
        let mut visuals = Vec::new();
        for visual in children(link, "visual") {
            let Some(shape) = self.shape(visual)? else { continue };
            let material = child(visual, "material");
            let color = material.and_then(|material| {
                let named = || self.materials.get(material.attribute("name")?).copied();
                self.color(material).or_else(named)
            });
            let link_from_shape = self.origin(visual)?;
            visuals.push(Visual { shape, link_from_shape, color: color.unwrap_or(GREY) });
        }
        Some(visuals)
    }

    fn collisions(&mut self, link: Element<'a>) -> Option<Vec<Collision>> {
        let mut collisions = Vec::new();
        for collision in children(link, "collision") {
            let Some(shape) = self.shape(collision)? else { continue };
            collisions.push(Collision { shape, link_from_shape: self.origin(collision)? });
        }
        Some(collisions)
    }

    /// A material's own colour.
    fn color(&self, material: Element<'a>) -> Option<[u8; 3]> {
        let rgba = child(material, "color")?.attribute("rgba")?;
        let channels: Vec<f64> = rgba.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..=255")]
        let byte = |c: f64| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
        match channels.as_slice() {
            [r, g, b, ..] => Some([byte(*r), byte(*g), byte(*b)]),
            _ => None,
        }
    }

    /// The shape in an element's `<geometry>`; `None` inside where there is nothing that can be used.
    #[expect(clippy::option_option, reason = "an error, nothing, a shape")]
    fn shape(&mut self, of: Element<'a>) -> Option<Option<Geometry>> {
        let geometry =
            child(of, "geometry").and_then(|geometry| geometry.children().find(Element::is_element));
        let Some(geometry) = geometry else { return Some(None) };
        let (shape, sizes) = match geometry.tag_name().name() {
            "box" => {
                let size = self.numbers(geometry, "size", [0.0; 3])?;
                (Geometry::Box { size: Vector3::from(size) }, size)
            }
            "sphere" => {
                let [radius] = self.numbers(geometry, "radius", [0.0])?;
                (Geometry::Sphere { radius }, [radius; 3])
            }
            which @ ("cylinder" | "capsule") => {
                let [radius] = self.numbers(geometry, "radius", [0.0])?;
                let [length] = self.numbers(geometry, "length", [0.0])?;
                let cylinder = which == "cylinder";
                let shape = if cylinder {
                    Geometry::Cylinder { radius, length }
                } else {
                    Geometry::Capsule { radius, length }
                };
                (shape, [radius, radius, length])
            }
            "mesh" => {
                let scale = self.numbers(geometry, "scale", [1.0; 3])?;
                let file = geometry.attribute("filename").unwrap_or("");
                return match self.meshes.get(file, scale) {
                    Ok(mesh) => Some(Some(Geometry::Mesh(mesh))),
                    Err(error) => {
                        self.assume(&error.to_string(), geometry, file);
                        Some(None)
                    }
                };
            }
            other => {
                let message = format!("`<{other}>` of {} is no shape that is known", called(of));
                return self.refuse(code::VALUE, geometry, message);
            }
        };
        if sizes.iter().all(|s| *s > 0.0) {
            return Some(Some(shape));
        }
        let message = format!("a shape of {} has a size that is not a length", called(of));
        self.refuse(code::VALUE, geometry, message)
    }

    #[expect(clippy::option_option, reason = "an error, no mass, a mass")]
    fn inertial(&mut self, link: Element<'a>) -> Option<Option<Inertial>> {
        let Some(inertial) = child(link, "inertial") else { return Some(None) };
        let mass = child(inertial, "mass");
        let [mass] = mass.map_or(Some([0.0]), |mass| self.numbers(mass, "value", [0.0]))?;
        if mass == 0.0 {
            return Some(None);
        }
        let mut of = [0.0; 6];
        if let Some(inertia) = child(inertial, "inertia") {
            for (value, key) in of.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
                [*value] = self.numbers(inertia, key, [0.0])?;
            }
        }
        let [xx, xy, xz, yy, yz, zz] = of;
        if mass < 0.0 || xx < 0.0 || yy < 0.0 || zz < 0.0 {
            let name = link.attribute("name").unwrap_or("");
            self.assume("with an inertia that is not physical, taken for none", inertial, name);
            return Some(None);
        }
        let in_inertial = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let link_from_inertial = self.origin(inertial)?;
        let rotation = link_from_inertial.rotation.to_rotation_matrix();
        let inertia = rotation.matrix() * in_inertial * rotation.matrix().transpose();
        let center = Point3::from(link_from_inertial.translation.vector);
        Some(Some(Inertial { mass, center, inertia }))
    }
}
