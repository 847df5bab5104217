//! Where the own hand and the own body are at a time, as boxes around the parts that the robot's description draws: what a processor of
//! pictures needs to leave them out.

use armarium_robot::{Limb, LinkId};
use armarium_runtime::skill::Failure;
use armarium_visionx::{OwnFinger, OwnHand, OwnPart};
use nalgebra::{Isometry3, Translation3, Vector3};

use crate::arm::tcp_of;
use crate::equipment::Equipment;
use crate::grasp::hand;

/// A box fixed to a link.
struct LinkBox {
    link: LinkId,
    link_from_box: Isometry3<f64>,
    size: Vector3<f64>,
}

impl LinkBox {
    fn at(&self, equipment: &Equipment, stamp_ns: u64) -> Option<OwnPart> {
        let root_from_box = equipment.link_at(self.link, stamp_ns).ok()? * self.link_from_box;
        Some(OwnPart { root_from_box, size: self.size })
    }
}

/// Where the hand of an arm is at a time (ns) of the robot's samples, with the boxes around all parts of the arm; `None` for a time that is not
/// known.
pub(crate) fn own_hand(
    equipment: &Equipment,
    arm: &Limb,
) -> Result<impl Fn(u64) -> Option<OwnHand> + Send + use<>, Failure> {
    let model = equipment.robot.model();
    let (tcp, pads) = (tcp_of(arm)?, &hand(model, arm)?.pads);
    let shoulder = arm.joints.first().map(|&joint| model.joints()[joint].link);
    let links = shoulder.into_iter().flat_map(|link| model.subtree(link));
    let parts: Vec<LinkBox> = links.flat_map(|link| boxes(equipment, link)).collect();
    let fingers = pads.iter().filter_map(|&pad| {
        Some((model.links()[pad.index()].name.clone(), boxes(equipment, pad).into_iter().next()?))
    });
    let fingers: Vec<(String, LinkBox)> = fingers.collect();
    let equipment = equipment.clone();
    Ok(move |stamp_ns| {
        let finger = |(name, shape): &(String, LinkBox)| {
            Some(OwnFinger { name: name.clone(), part: shape.at(&equipment, stamp_ns)? })
        };
        Some(OwnHand {
            root_from_hand: equipment.link_at(tcp, stamp_ns).ok()?,
            fingers: fingers.iter().map(finger).collect::<Option<_>>()?,
            parts: parts.iter().map(|part| part.at(&equipment, stamp_ns)).collect::<Option<_>>()?,
        })
    })
}

/// Where all parts of the own body are at a time (ns) of the robot's samples; none for a time that is not known.
pub(crate) fn own_body(equipment: &Equipment) -> impl Fn(u64) -> Vec<OwnPart> + Send + use<> {
    let links = equipment.robot.model().links().iter();
    let links = links.filter_map(|link| equipment.robot.model().link(&link.name));
    let parts: Vec<LinkBox> = links.flat_map(|link| boxes(equipment, link)).collect();
    let equipment = equipment.clone();
    move |stamp_ns| parts.iter().filter_map(|part| part.at(&equipment, stamp_ns)).collect()
}

/// The boxes around the visible parts of a link.
fn boxes(equipment: &Equipment, link: LinkId) -> Vec<LinkBox> {
    let visuals = &equipment.robot.model().links()[link.index()].visuals;
    let around = visuals.iter().map(|visual| {
        let (middle, half) = visual.shape.surrounding_box();
        let link_from_box = visual.link_from_shape * Translation3::from(middle);
        LinkBox { link, link_from_box, size: 2.0 * half }
    });
    around.collect()
}
