//! Reads SRDF: groups, end effectors and group states become groups, hands and postures of the robot file, where it does not
//! have them under the same name. Pairs of links whose collisions are disabled go straight into the model.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_source::{Finding, Findings, Severity, Source, Span, code};
use roxmltree::{Document, Node};

use super::file::{GroupFile, HandFile, Position, RobotFile};
use super::urdf::{LinkTree, span};
use crate::model::LinkId;

/// Pairs of links, the first one before the second one.
pub(super) type Pairs = BTreeSet<[LinkId; 2]>;

/// Adds what an SRDF says to a robot file. Returns the pairs of links that need not keep their distance, and what is wrong
/// with the SRDF.
pub(super) fn merge(source: &Arc<Source>, tree: &LinkTree, file: &mut RobotFile) -> (Pairs, Vec<Finding>) {
    let mut findings = Findings::new(Arc::clone(source));
    let mut pairs = Pairs::new();
    match Document::parse(&source.text) {
        Ok(document) if document.root_element().has_tag_name("robot") => {
            let mut reader = SrdfReader { root: document.root_element(), tree, findings: &mut findings };
            reader.merge(file);
            pairs = reader.disabled();
        }
        Ok(_) => {
            findings.error(code::FORM, Span { start: 0, end: 1 }, "cannot read SRDF: its root is not <robot>")
        }
        Err(error) => {
            findings.error(code::FORM, Span { start: 0, end: 1 }, format!("cannot read SRDF: {error}"))
        }
    }
    (pairs, findings.list)
}

struct SrdfReader<'a, 'f> {
    root: Node<'a, 'a>,
    tree: &'a LinkTree,
    findings: &'f mut Findings,
}

impl<'a> SrdfReader<'a, '_> {
    fn all(&self, name: &'static str) -> Vec<Node<'a, 'a>> {
        self.root.children().filter(|node| node.has_tag_name(name)).collect()
    }

    fn merge(&mut self, file: &mut RobotFile) {
        let mut groups: BTreeMap<&str, (Vec<usize>, Option<LinkId>)> = BTreeMap::new();
        let elements = self.all("group");
        for &group in &elements {
            let name = group.attribute("name").unwrap_or("");
            let members = self.members(group, &elements, 0);
            groups.insert(name, members);
        }
        let mut hand_of: BTreeMap<&str, &str> = BTreeMap::new();
        for effector in self.all("end_effector") {
            let Some(group) = effector.attribute("group").filter(|group| groups.contains_key(group)) else {
                continue;
            };
            let parent =
                effector.attribute("parent_link").and_then(|link| self.tree.link_ids.get(link).copied());
            let Some(parent) = parent else { continue };
            // Where its own joints move the parent, the group ends there; otherwise it is the hand of what moves it.
            if self.moves(&groups[group].0, parent) {
                groups.entry(group).and_modify(|(_, tip)| *tip = tip.or(Some(parent)));
                continue;
            }
            let named = effector.attribute("parent_group").filter(|arm| groups.contains_key(arm));
            let carrying = groups.iter().filter(|(_, (joints, _))| self.moves(joints, parent));
            let fewest = carrying.min_by_key(|(_, (joints, tip))| (tip.is_none(), joints.len()));
            if let Some(arm) = named.or(fewest.map(|(name, _)| *name)) {
                hand_of.insert(arm, group);
                groups.entry(arm).and_modify(|(_, tip)| *tip = tip.or(Some(parent)));
            }
        }
        let name = |joint: &usize| self.tree.joints[*joint].name.clone();
        for &group in &elements {
            let group = group.attribute("name").unwrap_or("");
            let (joints, tip) = &groups[group];
            if joints.is_empty() || file.groups.contains_key(group) || file.hands.contains_key(group) {
                continue;
            }
            let joints: Vec<String> = joints.iter().map(name).collect();
            if hand_of.values().any(|hand| *hand == group) {
                file.hands.insert(group.to_owned(), HandFile { joints, ..HandFile::default() });
                continue;
            }
            let tcp = tip.map(|tip| self.tree.links[tip.0].name.clone());
            let hand =
                hand_of.get(group).filter(|hand| !groups[**hand].0.is_empty()).map(|hand| (*hand).to_owned());
            file.groups.insert(group.to_owned(), GroupFile { joints, tcp, hand, ..GroupFile::default() });
        }
        let known = file.postures.keys().cloned().collect::<Vec<_>>();
        for state in self.all("group_state") {
            let posture = state.attribute("name").unwrap_or("");
            if !known.iter().any(|name| name == posture) {
                let positions = self.state(state);
                file.postures.entry(posture.to_owned()).or_default().extend(positions);
            }
        }
    }

    /// The pairs of `disable_collisions`. SRDFs are shared between variants of a robot: a link that is not there is none
    /// of this robot's.
    fn disabled(&self) -> Pairs {
        let link = |pair: &Node<'a, 'a>, key: &str| self.tree.link_ids.get(pair.attribute(key)?).copied();
        let pairs = self.all("disable_collisions").into_iter();
        pairs
            .filter_map(|pair| {
                let (a, b) = (link(&pair, "link1")?, link(&pair, "link2")?);
                Some([a.min(b), a.max(b)])
            })
            .collect()
    }

    /// The joints of a group, in the order of the description for a chain, and the chain's last link.
    fn members(
        &mut self,
        group: Node<'a, 'a>,
        groups: &[Node<'a, 'a>],
        depth: usize,
    ) -> (Vec<usize>, Option<LinkId>) {
        let (mut joints, mut tip) = (Vec::new(), None);
        for member in group.children().filter(Node::is_element) {
            let named = |key: &str| member.attribute(key).unwrap_or("");
            match member.tag_name().name() {
                "chain" => {
                    let ends =
                        ["base_link", "tip_link"].map(|end| self.tree.link_ids.get(named(end)).copied());
                    let [Some(base), Some(last)] = ends else {
                        let (base, tip) = (named("base_link"), named("tip_link"));
                        let message = format!("the chain from `{base}` to `{tip}` is not there");
                        self.findings.error(code::REFERENCE, span(member), message);
                        continue;
                    };
                    joints.extend(self.between(base, last));
                    tip = Some(last);
                }
                "joint" => joints.extend(self.tree.joint_ids.get(named("name"))),
                "link" => {
                    let link = self.tree.link_ids.get(named("name")).copied();
                    joints.extend(link.and_then(|link| Some(self.tree.links[link.0].motion?.joint)));
                }
                // Groups of groups; one that contains itself ends at some depth.
                "group" if depth < 10 => {
                    let other =
                        groups.iter().find(|other| other.attribute("name") == member.attribute("name"));
                    joints.extend(
                        other.map(|other| self.members(*other, groups, depth + 1).0).into_iter().flatten(),
                    );
                }
                _ => {}
            }
        }
        let mut seen = Vec::new();
        joints.retain(|joint| {
            let new = !seen.contains(joint);
            seen.push(*joint);
            new
        });
        (joints, tip)
    }

    /// Whether the last joint of a group moves a link.
    fn moves(&self, joints: &[usize], link: LinkId) -> bool {
        let motions = self.tree.movers[link.0].iter().filter_map(|mover| self.tree.links[mover.0].motion);
        joints.last().is_some_and(|last| motions.into_iter().any(|motion| motion.joint == *last))
    }

    fn between(&self, base: LinkId, last: LinkId) -> Vec<usize> {
        let before = &self.tree.movers[base.0];
        let movers = self.tree.movers[last.0].iter().filter(|mover| !before.contains(mover));
        movers.filter_map(|mover| Some(self.tree.links[mover.0].motion?.joint)).collect()
    }

    /// The positions of a state's joints that move and are led by no other.
    fn state(&mut self, state: Node<'a, 'a>) -> Vec<(String, Position)> {
        let mut positions = Vec::new();
        for joint in state.children().filter(|node| node.has_tag_name("joint")) {
            let name = joint.attribute("name").unwrap_or("");
            let Some(index) = self.tree.joint_ids.get(name) else { continue };
            let value = joint.attribute("value").and_then(|value| value.trim().parse::<f64>().ok());
            let Some(value) = value.filter(|value| value.is_finite()) else {
                let message = format!("the joint `{name}` has no single number here");
                self.findings.error(code::VALUE, span(joint), message);
                continue;
            };
            let limits = &self.tree.joints[*index];
            let within = value.max(limits.lower).min(limits.upper);
            if within != value {
                let message =
                    format!("{value} is beyond the limits of the joint `{name}`, taken for {within}");
                self.findings.add(Severity::Warning, code::ASSUMED, span(joint), message, None);
            }
            positions.push((name.to_owned(), Position { value: within, is_length: None }));
        }
        positions
    }
}
