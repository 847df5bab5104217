//! Writes the robot file of a URDF, with what can be told from it: arms, hands, torso, head, sensors, cameras.
//!
//! A chain of joints that reaches far is an arm (or, by its name, a leg); what moves beyond it is its hand; what several of
//! them hang on helps them. Names decide between left and right. Each line that was guessed says so; nothing is guessed that a
//! robot could be damaged by.

use std::fmt::Write as _;

use nalgebra::Vector3;

use super::urdf::LinkTree;
use crate::model::LinkId;

/// Fewest joints of an arm.
const MIN_JOINTS: usize = 4;
/// Words in the names of heads.
const HEAD: [&str; 4] = ["head", "neck", "eye", "gaze"];
/// Shortest arm from its first joint to its end, m.
const MIN_REACH: f64 = 0.3;

/// A chain of joints, from the one nearest to the root.
#[derive(Debug, Default)]
struct Chain {
    joints: Vec<usize>,
    /// The joints beyond it.
    beyond: Vec<usize>,
}

/// What was found.
#[derive(Debug, Default)]
struct FoundLimbs {
    /// The joints that all limbs hang on, and how many limbs hang on each of these trunks.
    trunks: Vec<Vec<usize>>,
    /// Each limb with the index of its trunk.
    limbs: Vec<(Chain, Option<usize>)>,
    /// Joints of no limb.
    rest: Vec<usize>,
}

struct Guesser<'a> {
    tree: &'a LinkTree,
    /// For each joint, the joints that move next beyond it.
    next: Vec<Vec<usize>>,
    /// For each joint, the number of joints of the longest chain from it, itself included, and its reach, m.
    longest: Vec<(usize, f64)>,
}

/// The text of a robot file.
pub(super) fn robot_file(name: &str, urdf: &str, packages: &[String], tree: &LinkTree) -> String {
    let guesser = Guesser::new(tree);
    let mut found = FoundLimbs::default();
    for first in (0..tree.joints.len()).filter(|&joint| guesser.before(joint).is_none()) {
        guesser.walk(first, Vec::new(), None, &mut found);
    }
    guesser.write((name, urdf, packages), &found)
}

/// The text of a robot file whose groups an SRDF says.
pub(super) fn with_semantics(name: &str, urdf: &str, srdf: &str, packages: &[String]) -> String {
    head(name, urdf, packages) + &format!("semantics: {}\n", quoted(srdf))
}

/// The lines with which a robot file begins.
fn head(name: &str, urdf: &str, packages: &[String]) -> String {
    let mut text = format!("robot: {}\ndescription: {}\n", quoted(name), quoted(urdf));
    if !packages.is_empty() {
        let packages: Vec<String> = packages.iter().map(|folder| quoted(folder)).collect();
        let _ = writeln!(text, "packages: [{}]", packages.join(", "));
    }
    text
}

/// A text as a YAML scalar.
fn quoted(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '/');
    let first = text.chars().next().is_some_and(|c| c.is_ascii_alphabetic());
    if first
        && text.chars().all(|c| plain(c) || c == '.')
        && !matches!(text, "true" | "false" | "null" | "none")
    {
        return text.to_owned();
    }
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

impl<'a> Guesser<'a> {
    fn new(tree: &'a LinkTree) -> Self {
        let count = tree.joints.len();
        let mut guesser = Self { tree, next: vec![Vec::new(); count], longest: vec![(1, 0.0); count] };
        for joint in 0..count {
            if let Some(before) = guesser.before(joint) {
                guesser.next[before].push(joint);
            }
        }
        // Joints are in the order of the walk: those beyond come later.
        for joint in (0..count).rev() {
            let own = guesser.reach_of(joint);
            let beyond = guesser.next[joint].iter().map(|&next| {
                let (joints, reach) = guesser.longest[next];
                (joints + 1, reach + guesser.distance(joint, next))
            });
            let most =
                beyond.fold((1, own), |a, b| if b.0 > a.0 || (b.0 == a.0 && b.1 > a.1) { b } else { a });
            guesser.longest[joint] = most;
        }
        guesser
    }

    /// The joint that moves next before a joint, towards the root.
    fn before(&self, joint: usize) -> Option<usize> {
        let link = self.tree.joints[joint].link;
        let movers = self.tree.movers[link.0].iter().rev().skip(1);
        movers
            .filter_map(|mover| self.tree.links[mover.0].motion)
            .map(|motion| motion.joint)
            .find(|&j| j != joint)
    }

    /// Where a link is with all joints at 0, in the root frame.
    fn at(&self, link: LinkId) -> Vector3<f64> {
        let mut pose = nalgebra::Isometry3::identity();
        let mut next = Some(link);
        while let Some(id) = next {
            let link = &self.tree.links[id.0];
            pose = link.parent_from_link * pose;
            next = link.parent;
        }
        pose.translation.vector
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        (self.at(self.tree.joints[a].link) - self.at(self.tree.joints[b].link)).norm()
    }

    /// The largest distance of a frame that a joint moves, and no further joint, from the joint, m.
    fn reach_of(&self, joint: usize) -> f64 {
        let here = self.at(self.tree.joints[joint].link);
        self.carried(joint).iter().map(|&link| (self.at(link) - here).norm()).fold(0.0, f64::max)
    }

    /// The links that a joint carries, and no further joint.
    fn carried(&self, joint: usize) -> Vec<LinkId> {
        let of = self.tree.joints[joint].link;
        let links = (0..self.tree.links.len()).map(LinkId);
        links.filter(|link| self.tree.movers[link.0].last() == Some(&of)).collect()
    }

    fn is_long(&self, joint: usize) -> bool {
        let (joints, reach) = self.longest[joint];
        joints >= MIN_JOINTS && reach >= MIN_REACH
    }

    /// All joints beyond a joint, itself included.
    fn all_from(&self, joint: usize) -> Vec<usize> {
        let mut all = vec![joint];
        let mut at = 0;
        while at < all.len() {
            all.extend(&self.next[all[at]]);
            at += 1;
        }
        all
    }

    fn walk(&self, joint: usize, mut chain: Vec<usize>, trunk: Option<usize>, found: &mut FoundLimbs) {
        chain.push(joint);
        let long: Vec<usize> = self.next[joint].iter().copied().filter(|&next| self.is_long(next)).collect();
        if long.len() >= 2 {
            found.trunks.push(chain);
            let trunk = Some(found.trunks.len() - 1);
            for &next in &self.next[joint] {
                if long.contains(&next) {
                    self.walk(next, Vec::new(), trunk, found);
                } else {
                    found.rest.extend(self.all_from(next));
                }
            }
            return;
        }
        let slides = |j: usize| self.tree.joints[j].kind == crate::JointKind::Prismatic;
        let goes_on = match (long.as_slice(), self.next[joint].as_slice()) {
            ([next], _) => Some(*next),
            ([], [next]) if !(self.has_followers(*next) || slides(*next) && chain.len() >= MIN_JOINTS) => {
                Some(*next)
            }
            _ => None,
        };
        if let Some(next) = goes_on {
            let others = self.next[joint].iter().filter(|&&other| other != next);
            found.rest.extend(others.flat_map(|&other| self.all_from(other)));
            return self.walk(next, chain, trunk, found);
        }
        let beyond: Vec<usize> = self.next[joint].iter().flat_map(|&next| self.all_from(next)).collect();
        let reach = chain.iter().zip(chain.iter().skip(1)).map(|(&a, &b)| self.distance(a, b)).sum::<f64>();
        if chain.len() >= MIN_JOINTS && reach + self.reach_of(joint) >= MIN_REACH {
            found.limbs.push((Chain { joints: chain, beyond }, trunk));
        } else {
            found.rest.extend(chain.into_iter().chain(beyond));
        }
    }

    /// Whether other links follow a joint: a gripper's fingers do.
    fn has_followers(&self, joint: usize) -> bool {
        let own = self.tree.joints[joint].link;
        let follows =
            |(i, link): (usize, &crate::Link)| i != own.0 && link.motion.is_some_and(|m| m.joint == joint);
        self.tree.links.iter().enumerate().any(follows)
    }

    /// The names of a chain's joints and of the links at its end, in small letters.
    fn words(&self, chain: &Chain) -> String {
        let joints = chain.joints.iter().map(|&joint| self.tree.joints[joint].name.to_lowercase());
        let last = chain.joints.last().map_or_else(Vec::new, |&joint| self.carried(joint));
        let links = last.into_iter().map(|link| self.tree.links[link.0].name.to_lowercase());
        joints.chain(links).map(|name| format!("_{name}_")).collect()
    }

    /// `right`, `left` or nothing: by names, else by the side on which the chain begins (y to the left, as in ROS).
    fn side(&self, chain: &Chain) -> &'static str {
        let words = self.words(chain);
        let count = |wanted: &[&str]| wanted.iter().map(|word| words.matches(word).count()).sum::<usize>();
        let left = count(&["left", "_l_", "_fl_", "_lh_", "_lf_"]);
        let right = count(&["right", "_r_", "_fr_", "_rh_", "_rf_"]);
        if left != right {
            return if left > right { "left" } else { "right" };
        }
        match chain.joints.first().map_or(0.0, |&joint| self.at(self.tree.joints[joint].link).y) {
            y if y > 0.02 => "left",
            y if y < -0.02 => "right",
            _ => "",
        }
    }

    /// `arm`, `leg` or `head`, by names.
    fn kind(&self, chain: &Chain) -> &'static str {
        let words = self.words(chain);
        let has = |wanted: &[&str]| wanted.iter().any(|word| words.contains(word));
        if has(&["leg", "knee", "ankle", "foot", "hip_", "thigh", "calf"]) {
            "leg"
        } else if has(&HEAD) {
            "head"
        } else {
            "arm"
        }
    }

    /// The middle of the range of each of a limb's joints that 0 is not the middle of: from there it moves in all directions.
    fn write_home(&self, joints: impl Iterator<Item = usize>, text: &mut String) {
        let middle = |joint: usize| {
            let joint = &self.tree.joints[joint];
            let middle = (joint.lower + joint.upper) / 2.0;
            (middle.is_finite() && middle.abs() > 0.01)
                .then(|| format!("{}: {middle:.3}", quoted(&joint.name)))
        };
        let middles: Vec<String> = joints.filter_map(middle).collect();
        if !middles.is_empty() {
            let _ = writeln!(
                text,
                "\nstart: home\npostures:\n  # guessed: the middle of each joint's range\n  home: {{{}}}",
                middles.join(", ")
            );
        }
    }

    /// The frame at the end of a chain: the one that is named so, else the farthest.
    fn tip(&self, chain: &Chain) -> Option<LinkId> {
        let last = *chain.joints.last()?;
        let here = self.at(self.tree.joints[last].link);
        let carried = self.carried(last);
        let named = |link: &LinkId| {
            let name = self.tree.links[link.0].name.to_lowercase();
            let ends = ["tcp", "tool", "_ee", "ee_", "effector", "grasp", "gripper", "hand", "palm"];
            ends.iter().position(|word| name.contains(word))
        };
        let by_name =
            carried.iter().filter_map(|link| Some((named(link)?, *link))).min_by_key(|(rank, _)| *rank);
        let farthest = carried.iter().max_by(|a, b| {
            let away = |link: LinkId| (self.at(link) - here).norm();
            away(**a).total_cmp(&away(**b))
        });
        by_name.map(|(_, link)| link).or(farthest.copied())
    }

    fn names(&self, joints: &[usize]) -> String {
        joints.iter().map(|&joint| quoted(&self.tree.joints[joint].name)).collect::<Vec<_>>().join(", ")
    }

    fn write(&self, (name, urdf, packages): (&str, &str, &[String]), found: &FoundLimbs) -> String {
        let mut text =
            "# Written by `armarium robot new`. What it guessed is marked: look at it.\n".to_owned();
        text += &head(name, urdf, packages);
        let mut limbs: Vec<(String, &Chain, Option<usize>, bool)> = found
            .limbs
            .iter()
            .map(|(chain, trunk)| {
                let (side, kind) = (self.side(chain), self.kind(chain));
                let plain = side.is_empty() || kind == "head";
                let name = if plain { kind.to_owned() } else { format!("{side}_{kind}") };
                (name, chain, *trunk, kind != "arm")
            })
            .collect();
        limbs.sort_by_key(|(name, _, _, leg)| (*leg, !name.starts_with("right")));
        for i in 1..limbs.len() {
            let (named, number) = (&limbs[i].0, |c: char| c.is_ascii_digit() || c == '_');
            let same = limbs[..i].iter().filter(|limb| limb.0.trim_end_matches(number) == *named).count();
            if same > 0 {
                limbs[i].0 = format!("{}_{}", limbs[i].0, same + 1);
            }
        }
        let trunk_name =
            |index: usize| if index == 0 { "torso".to_owned() } else { format!("torso_{}", index + 1) };
        let (heads, rest): (Vec<usize>, Vec<usize>) = found.rest.iter().partition(|&&joint| {
            let name = self.tree.joints[joint].name.to_lowercase();
            HEAD.iter().any(|word| name.contains(word))
        });
        if !limbs.is_empty() || !found.trunks.is_empty() || !found.rest.is_empty() {
            let _ = writeln!(text, "\ngroups:");
        }
        for (i, trunk) in found.trunks.iter().enumerate() {
            let (name, joints) = (trunk_name(i), self.names(trunk));
            let _ = writeln!(text, "  {name}: {{joints: [{joints}]}}   # guessed: several limbs hang on it");
        }
        for (name, chain, trunk, leg) in &limbs {
            let [first, last] = [chain.joints.first(), chain.joints.last()]
                .map(|j| j.map_or_else(String::new, |&j| self.names(&[j])));
            let count = chain.joints.len();
            let _ = write!(
                text,
                "  {name}:\n    chain: [{first}, {last}]   # guessed: a chain of {count} joints"
            );
            let tip = self.tip(chain).filter(|_| !leg);
            if let Some(tip) = tip {
                let frame = quoted(&self.tree.links[tip.0].name);
                let _ = write!(text, "\n    tcp: {frame}   # guessed: the frame at its end");
            }
            if !chain.beyond.is_empty() && !leg {
                let hand = name.replace("arm", "hand");
                let _ = write!(text, "\n    hand: {hand}   # guessed: what moves beyond it");
            }
            if let (Some(trunk), false) = (trunk, leg) {
                let _ = write!(text, "\n    helped_by: [{}]   # guessed", trunk_name(*trunk));
            }
            let _ = writeln!(text);
        }
        if !heads.is_empty() && limbs.iter().all(|(name, ..)| name != "head") {
            let _ = writeln!(text, "  head: {{joints: [{}]}}   # guessed: by names", self.names(&heads));
        }
        if !rest.is_empty() {
            let rest = self.names(&rest);
            let _ = writeln!(text, "  others: {{joints: [{rest}]}}   # guessed: what is in no other group");
        }
        self.write_home(limbs.iter().flat_map(|(_, chain, ..)| chain.joints.iter().copied()), &mut text);
        let hands: Vec<_> =
            limbs.iter().filter(|(_, chain, _, leg)| !leg && !chain.beyond.is_empty()).collect();
        if !hands.is_empty() {
            let _ = writeln!(text, "\nhands:");
        }
        for (name, chain, ..) in hands {
            let (hand, joints) = (name.replace("arm", "hand"), self.names(&chain.beyond));
            let _ = writeln!(
                text,
                "  {hand}:\n    joints: [{joints}]   # guessed; open is at their upper limits, closed at their lower\n    \
                 grasp_in_tcp: {{position: [0, 0, 0]}}   # guessed: at the TCP, x along the approach"
            );
        }
        text
    }
}
