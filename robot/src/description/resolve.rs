//! From a robot file and the tree of its URDF to a model: finds every name, and says which ones are not there.

use std::collections::{BTreeMap, BTreeSet};

use armarium_source::yaml::Node;
use armarium_source::{Findings, Span, code};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::file::{GroupFile, HandFile, LimitsFile, PlatformFile, PoseFile, Position, RobotFile};
use super::platform::{self, JOINTS, LINKS};
use super::urdf::LinkTree;
use crate::model::{
    Hand, JointKind, Limb, LinkId, Marker, Model, Platform, PlatformKind, RobotLimits, StereoCamera,
    WrenchSensor,
};

/// The model of a robot file whose text is `node`. Names that are not there add findings and are left out.
pub(super) fn model(file: &RobotFile, node: &Node, mut tree: LinkTree, findings: &mut Findings) -> Model {
    let platform = platform_under(file, node, &mut tree, findings);
    let mut resolver = Resolver { file, node, tree: &tree, findings };
    let wrenches = resolver.wrenches();
    let hands = resolver.hands();
    let (mut limbs, arms) = resolver.limbs(&wrenches, &hands);
    for hand in hands.values() {
        let joints = resolver.joints_of(&["hands", &hand.name, "joints"], &file.hands[&hand.name].joints);
        limbs.entry(hand.name.clone()).or_insert_with(|| bare_limb(&hand.name, joints));
    }
    if let Some(platform) = &platform {
        limbs.insert(Platform::LIMB.to_owned(), bare_limb(Platform::LIMB, platform.joints.to_vec()));
    }
    let camera = resolver.camera(&limbs);
    let postures = resolver.postures();
    let start = resolver.posture_named(&["start"], file.start.as_deref(), &postures);
    let start = start.unwrap_or_else(|| zero(&tree));
    for (name, group) in &file.groups {
        resolver.posture_named(&["groups", name, "ready"], group.ready.as_deref(), &postures);
        for (usual, own) in &group.postures {
            resolver.posture_named(&["groups", name, "postures"], Some(usual), &postures);
            resolver.posture_named(&["groups", name, "postures", usual], Some(own), &postures);
        }
    }
    let LimitsFile { force: force_n, most_force, speed: speed_m_s } = file.limits;
    let limits = RobotLimits { force_n, most_force_n: most_force.unwrap_or(force_n).max(force_n), speed_m_s };
    let LinkTree { links, joints, link_ids, joint_ids, movers, .. } = tree;
    Model {
        name: file.name.clone(),
        links,
        joints,
        link_ids,
        joint_ids,
        movers,
        limbs,
        arms,
        hands,
        wrenches,
        camera,
        postures,
        start_posture: file.start.clone(),
        start,
        limits,
        platform,
        may_touch: BTreeSet::new(),
    }
}

/// Puts the robot on the platform that its file says, or that its description has.
fn platform_under(
    file: &RobotFile,
    node: &Node,
    tree: &mut LinkTree,
    findings: &mut Findings,
) -> Option<Platform> {
    let said = file.platform.clone().or_else(|| tree.floats.then(PlatformFile::default))?;
    if said.kind == PlatformKind::None {
        return None;
    }
    let mut taken = LINKS.iter().filter(|name| tree.link_ids.contains_key(**name));
    let mut taken_too = JOINTS.iter().filter(|name| tree.joint_ids.contains_key(**name));
    let limb = [Platform::LIMB];
    let mut limb = limb.iter().filter(|name| file.groups.contains_key(**name));
    if let Some(name) = taken.next().or(taken_too.next()).or(limb.next()) {
        let at = node.place("platform");
        let message = format!("the robot has a `{name}` already, which is a name of the platform's");
        let help = Some("rename it, or say `platform: {kind: none}`".into());
        findings.error_help(code::DUPLICATE, at, message, help);
        return None;
    }
    Some(platform::put_on(tree, &said))
}

fn bare_limb(name: &str, joints: Vec<usize>) -> Limb {
    let name = name.to_owned();
    Limb {
        name,
        joints,
        tcp: None,
        hand: None,
        wrench: None,
        helped_by: Vec::new(),
        ready: None,
        postures: BTreeMap::new(),
    }
}

/// All joints at 0, or at the limit nearest to it.
fn zero(tree: &LinkTree) -> Vec<f64> {
    tree.joints.iter().map(|j| 0.0_f64.max(j.lower).min(j.upper)).collect()
}

struct Resolver<'a> {
    file: &'a RobotFile,
    node: &'a Node,
    tree: &'a LinkTree,
    findings: &'a mut Findings,
}

impl Resolver<'_> {
    /// The place of what stands under these keys, as far as they are there.
    fn at(&self, path: &[&str]) -> Span {
        path.iter().fold(self.node, |node, key| node.get(key).unwrap_or(node)).span
    }

    fn unknown<'n>(
        &mut self,
        path: &[&str],
        what: &str,
        name: &str,
        known: impl Iterator<Item = &'n str> + Clone,
    ) {
        let at = self.at(path);
        let all = known.clone().collect::<Vec<_>>().join(", ");
        let help = Some(if all.is_empty() { "there is none".to_owned() } else { format!("known: {all}") });
        let message = format!("the robot has no {what} `{name}`");
        self.findings.unknown(code::REFERENCE, (at, name), message, known, help);
    }

    fn link(&mut self, path: &[&str], name: &str) -> Option<LinkId> {
        let tree = self.tree;
        let found = tree.link_ids.get(name).copied();
        if found.is_none() {
            self.unknown(path, "link", name, tree.link_ids.keys().map(String::as_str));
        }
        found
    }

    fn joint(&mut self, path: &[&str], name: &str) -> Option<usize> {
        let tree = self.tree;
        let found = tree.joint_ids.get(name).copied();
        if found.is_none() {
            self.unknown(path, "joint", name, tree.joint_ids.keys().map(String::as_str));
        }
        found
    }

    fn joints_of(&mut self, path: &[&str], names: &[String]) -> Vec<usize> {
        let mut joints = Vec::new();
        for name in names {
            let Some(joint) = self.joint(path, name) else { continue };
            if joints.contains(&joint) {
                let at = self.at(path);
                self.findings.error(code::DUPLICATE, at, format!("the joint `{name}` is there twice"));
            } else {
                joints.push(joint);
            }
        }
        joints
    }

    /// The joints from one to another, both included, in the order from the root.
    fn chain(&mut self, path: &[&str], [first, last]: &[String; 2]) -> Vec<usize> {
        let (Some(first_joint), Some(last_joint)) = (self.joint(path, first), self.joint(path, last)) else {
            return Vec::new();
        };
        let end = self.tree.joints[last_joint].link;
        let motions = self.tree.movers[end.0].iter().filter_map(|link| self.tree.links[link.0].motion);
        let mut joints: Vec<usize> = motions.map(|motion| motion.joint).collect();
        joints.dedup();
        let Some(begin) = joints.iter().position(|joint| *joint == first_joint) else {
            let at = self.at(path);
            let message = format!("the joint `{first}` is not between the root and `{last}`");
            let help = Some("the first joint is the one nearer to the root".into());
            self.findings.error_help(code::VALUE, at, message, help);
            return Vec::new();
        };
        joints.split_off(begin)
    }

    fn wrenches(&mut self) -> Vec<WrenchSensor> {
        let mut sensors = Vec::new();
        for (name, wrench) in &self.file.wrenches {
            if let Some(frame) = self.link(&["wrenches", name, "frame"], &wrench.frame) {
                sensors.push(WrenchSensor { name: name.clone(), frame });
            }
        }
        sensors
    }

    fn hands(&mut self) -> BTreeMap<String, Hand> {
        let file = self.file;
        file.hands.iter().map(|(name, hand)| (name.clone(), self.hand(name, hand))).collect()
    }

    fn hand(&mut self, name: &str, hand: &HandFile) -> Hand {
        let path = ["hands", name, "joints"];
        let joints = self.joints_of(&path, &hand.joints);
        if hand.joints.is_empty() {
            let at = self.at(&path);
            self.findings.error(code::VALUE, at, format!("the hand `{name}` has no joints"));
        }
        let of = |resolver: &mut Self, key: &str, given: &Option<super::file::Positions>, limit: Vec<f64>| {
            match given {
                None => limit,
                Some(given) => resolver.positions(&["hands", name, key], &given.0, &joints),
            }
        };
        let all = &self.tree.joints;
        let (lower, upper) =
            (joints.iter().map(|&j| all[j].lower).collect(), joints.iter().map(|&j| all[j].upper).collect());
        let open = of(self, "open", &hand.open, upper);
        let closed = of(self, "closed", &hand.closed, lower);
        let marker = hand.marker.as_ref().and_then(|marker| {
            let link = self.link(&["hands", name, "marker", "link"], &marker.link)?;
            Some(Marker { link, color: marker.color, diameter: marker.diameter })
        });
        let mut shapes =
            BTreeMap::from([("open".to_owned(), open.clone()), ("closed".to_owned(), closed.clone())]);
        for (shape, positions) in &hand.shapes {
            let positions = self.positions(&["hands", name, "shapes", shape], &positions.0, &joints);
            shapes.insert(shape.clone(), positions);
        }
        let pads = match hand.pads.is_empty() {
            true => self.moved_by(&joints),
            false => hand.pads.iter().filter_map(|pad| self.link(&["hands", name, "pads"], pad)).collect(),
        };
        Hand {
            name: name.to_owned(),
            open,
            closed,
            shapes,
            pads,
            grasp_in_tcp: pose(&hand.grasp_in_tcp),
            press_in_tcp: hand.press_in_tcp.as_ref().map(pose),
            pad_width: hand.pad_width,
            marker,
        }
    }

    /// The links with a shape to touch with that these joints move.
    fn moved_by(&self, joints: &[usize]) -> Vec<LinkId> {
        let tree = self.tree;
        let moved = |link: &LinkId| {
            let motions = tree.movers[link.0].iter().filter_map(|mover| tree.links[mover.0].motion);
            !tree.links[link.0].collisions.is_empty()
                && motions.into_iter().any(|m| joints.contains(&m.joint))
        };
        (0..tree.links.len()).map(LinkId).filter(moved).collect()
    }

    /// Positions of a hand's joints: one for all, or one for each.
    fn positions(&mut self, path: &[&str], given: &[Position], joints: &[usize]) -> Vec<f64> {
        if given.len() != 1 && given.len() != joints.len() {
            let at = self.at(path);
            let message = format!("{} positions for {} joints", given.len(), joints.len());
            self.findings.error_help(code::VALUE, at, message, Some("one for all, or one for each".into()));
            return vec![0.0; joints.len()];
        }
        let given = given.iter().cycle();
        joints.iter().zip(given).map(|(&joint, position)| self.position(path, joint, position)).collect()
    }

    /// The position of a joint, within its limits.
    fn position(&mut self, path: &[&str], joint: usize, position: &Position) -> f64 {
        let joint = &self.tree.joints[joint];
        let slides = joint.kind == JointKind::Prismatic;
        let at = self.at(path);
        if position.is_length.is_some_and(|length| length != slides) {
            let needed = if slides { "slides: a length is needed" } else { "turns: an angle is needed" };
            self.findings.error(code::UNIT, at, format!("the joint `{}` {needed}", joint.name));
        } else if !(joint.lower..=joint.upper).contains(&position.value) {
            let (name, value, unit) = (&joint.name, position.value, if slides { "m" } else { "rad" });
            let message = format!("{value} is beyond the limits of the joint `{name}`");
            let help = format!("it goes from {} to {} {unit}", joint.lower, joint.upper);
            self.findings.error_help(code::VALUE, at, message, Some(help));
        }
        position.value
    }

    fn limbs(
        &mut self,
        wrenches: &[WrenchSensor],
        hands: &BTreeMap<String, Hand>,
    ) -> (BTreeMap<String, Limb>, Vec<String>) {
        let file = self.file;
        let (mut limbs, mut arms) = (BTreeMap::new(), Vec::new());
        for (name, group) in &file.groups {
            let limb = self.limb(name, group, wrenches, hands);
            if limb.tcp.is_some() {
                arms.push(name.clone());
            }
            limbs.insert(name.clone(), limb);
        }
        (limbs, arms)
    }

    fn limb(
        &mut self,
        name: &str,
        group: &GroupFile,
        wrenches: &[WrenchSensor],
        hands: &BTreeMap<String, Hand>,
    ) -> Limb {
        let file = self.file;
        let joints = match &group.chain {
            Some(chain) if group.joints.is_empty() => self.chain(&["groups", name, "chain"], chain),
            Some(_) => {
                let at = self.at(&["groups", name, "chain"]);
                self.findings.error(code::VALUE, at, "a group has `joints` or a `chain`, not both");
                Vec::new()
            }
            None => self.joints_of(&["groups", name, "joints"], &group.joints),
        };
        if group.joints.is_empty() && group.chain.is_none() {
            let at = self.at(&["groups", name]);
            self.findings.error(code::MISSING_KEY, at, format!("the group `{name}` has no joints"));
        }
        let tcp = group.tcp.as_deref().and_then(|tcp| self.link(&["groups", name, "tcp"], tcp));
        if let Some(hand) = group.hand.as_deref().filter(|hand| !hands.contains_key(*hand)) {
            self.unknown(&["groups", name, "hand"], "hand", hand, hands.keys().map(String::as_str));
        }
        let wrench = group.wrench.as_deref().and_then(|wrench| {
            let found = wrenches.iter().position(|sensor| sensor.name == wrench);
            if found.is_none() && !file.wrenches.contains_key(wrench) {
                let known = file.wrenches.keys().map(String::as_str);
                self.unknown(&["groups", name, "wrench"], "wrench sensor", wrench, known);
            }
            found
        });
        for helper in &group.helped_by {
            if helper == name || !file.groups.contains_key(helper) {
                let known = file.groups.keys().map(String::as_str);
                self.unknown(&["groups", name, "helped_by"], "other group", helper, known);
            }
        }
        Limb {
            name: name.to_owned(),
            joints,
            tcp,
            hand: group.hand.clone(),
            wrench,
            helped_by: group.helped_by.clone(),
            ready: group.ready.clone(),
            postures: group.postures.clone().into_iter().collect(),
        }
    }

    fn camera(&mut self, limbs: &BTreeMap<String, Limb>) -> Option<StereoCamera> {
        let file = self.file;
        if let Some((second, _)) = file.cameras.get_index(1) {
            let at = self.at(&["cameras", second]);
            self.findings.error(code::LIMIT, at, "one pair of cameras is possible");
        }
        let (name, camera) = file.cameras.first()?;
        if let Some(on) = camera.on.as_deref().filter(|on| !limbs.contains_key(*on)) {
            self.unknown(&["cameras", name, "on"], "group", on, file.groups.keys().map(String::as_str));
        }
        let left = self.link(&["cameras", name, "left"], &camera.left)?;
        let right = self.link(&["cameras", name, "right"], &camera.right)?;
        Some(StereoCamera { name: name.clone(), left, right, on: camera.on.clone() })
    }

    fn postures(&mut self) -> BTreeMap<String, Vec<f64>> {
        let file = self.file;
        let mut postures = BTreeMap::new();
        for (name, positions) in &file.postures {
            let mut q = zero(self.tree);
            for (joint, position) in positions {
                let path = ["postures", name, joint];
                if let Some(index) = self.joint(&path, joint) {
                    q[index] = self.position(&path, index, position);
                }
            }
            postures.insert(name.clone(), q);
        }
        postures
    }

    fn posture_named(
        &mut self,
        path: &[&str],
        name: Option<&str>,
        postures: &BTreeMap<String, Vec<f64>>,
    ) -> Option<Vec<f64>> {
        let name = name?;
        let found = postures.get(name).cloned();
        if found.is_none() {
            self.unknown(path, "posture", name, postures.keys().map(String::as_str));
        }
        found
    }
}

fn pose(file: &PoseFile) -> Isometry3<f64> {
    let [roll, pitch, yaw] = file.rpy_deg.map(f64::to_radians);
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Isometry3::from_parts(Vector3::from(file.position).into(), rotation)
}
