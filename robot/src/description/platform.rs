//! A platform under a robot: a planar joint between the root frame and what was the root of the description, as three joints
//! (SRDF's virtual joint of the type `planar`).

use nalgebra::{Isometry3, Vector3};

use super::file::PlatformFile;
use super::urdf::LinkTree;
use crate::model::{Joint, JointKind, JointMotion, Link, LinkId, Platform};

/// The links and joints that are added, before all others: the frame in which the odometry began, and one for each direction.
pub(super) const LINKS: [&str; 3] = ["odometry", "platform_along_x", "platform_along_y"];
pub(super) const JOINTS: [&str; 3] = ["platform_x", "platform_y", "platform_yaw"];
/// Largest force, N, and torque, N m.
const EFFORT: f64 = 2000.0;

/// Puts a robot on a platform. The names of [`LINKS`] and [`JOINTS`] are free.
pub(super) fn put_on(tree: &mut LinkTree, platform: &PlatformFile) -> Platform {
    let added = LINKS.len();
    let up = |LinkId(index): LinkId| LinkId(index + added);
    for joint in &mut tree.joints {
        joint.link = up(joint.link);
    }
    for link in &mut tree.links {
        link.parent = link.parent.map(up);
        link.motion.iter_mut().for_each(|motion| motion.joint += JOINTS.len());
    }
    tree.link_ids.values_mut().for_each(|id| *id = up(*id));
    tree.joint_ids.values_mut().for_each(|joint| *joint += JOINTS.len());
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let kinds = [JointKind::Prismatic, JointKind::Prismatic, JointKind::Revolute];
    // The first link stands; each joint moves the next one, the last joint what was the root.
    let motion = |joint: usize| {
        let (kind, axis) = (kinds[joint], axes[joint]);
        JointMotion { joint, kind, axis, multiplier: 1.0, offset: 0.0 }
    };
    let link = |index: usize| Link {
        name: LINKS[index].to_owned(),
        parent: index.checked_sub(1).map(LinkId),
        motion: index.checked_sub(1).map(motion),
        parent_from_link: Isometry3::identity(),
        inertial: None,
        visuals: Vec::new(),
        collisions: Vec::new(),
    };
    if let Some(root) = tree.links.first_mut() {
        (root.parent, root.motion) = (Some(LinkId(added - 1)), Some(motion(added - 1)));
    }
    tree.links.splice(0..0, (0..added).map(link));
    let joint = |index: usize| Joint {
        name: JOINTS[index].to_owned(),
        kind: kinds[index],
        link: LinkId(index + 1),
        axis: axes[index],
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: if index < 2 { platform.speed } else { platform.turn },
        acceleration: platform.acceleration,
        effort: EFFORT,
    };
    tree.joints.splice(0..0, (0..JOINTS.len()).map(joint));
    tree.link_ids.extend(LINKS.iter().enumerate().map(|(index, name)| ((*name).to_owned(), LinkId(index))));
    tree.joint_ids.extend(JOINTS.iter().enumerate().map(|(index, name)| ((*name).to_owned(), index)));
    let own = |movers: &Vec<LinkId>| (1..=added).map(LinkId).chain(movers.iter().copied().map(up)).collect();
    let before = std::mem::take(&mut tree.movers);
    let stands = vec![Vec::new(), vec![LinkId(1)], vec![LinkId(1), LinkId(2)]];
    tree.movers = stands.into_iter().chain(before.iter().map(own)).collect();
    Platform { kind: platform.kind, joints: [0, 1, 2], link: LinkId(added) }
}
