//! `PlanGrasp`: chooses a grasp of an object straight against the surface on which it stands: the yaw of the hand for which the
//! arm has the most margin to its joint limits and its own body, and how wide the hand opens: as wide as it can without a finger that comes down on another
//! thing that memory knows.

use std::f64::consts::FRAC_PI_2;

use armarium_robot::planning::KnownBox;
use armarium_robot::{Hand, Model};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use crate::arm::{chosen, free_joints, names_the_arm, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, tcp_at, towards_wrist};
use crate::inputs::{Inputs, pose_value};
use crate::places::{distance, known};
use crate::reach::Reach;
use crate::surface::ContactPlane;

/// Possible rotations of the hand against the object's sides, rad; the closing pads align the object. Each radian
/// costs [`MISALIGNMENT_COST`].
const MISALIGNMENTS: [f64; 7] = [0.0, 0.14, -0.14, 0.28, -0.28, 0.42, -0.42];
/// Additional margin (rad) that one radian of misalignment must bring.
const MISALIGNMENT_COST: f64 = 1.0;
/// What it costs, as margin in rad, that a finger would come down on another thing, and how near to one the middle of a pad may come, m.
const MEETING_COST: f64 = 1.0;
const BESIDE: f64 = 0.012;
/// Steps by which the hand is less open than it can be, m, and what each metre of that costs, as margin in rad.
const NARROWER: f64 = 0.01;
const NARROW_COST: f64 = 5.0;
/// How far the hand stays from its widest opening, m.
const FROM_WIDEST: f64 = 0.005;
/// How far over the surface the fingers end, m.
const FINGERS_END: f64 = 0.005;
/// Clearance of each open pad beside the object on its way down, m: more than the error of servoing.
const CLEARANCE: f64 = 0.01;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "PlanGrasp",
        "Chooses the pose of the hand for a grasp against the surface on which the object stands, by the arm's margin, and how far it opens.",
    )
    .input("object", Type::object(), "The object in memory.")
    .optional("height", Type::quantity(Unit::M), 0.12, "Height of the pre-pose over the grasp, along the surface's normal.")
    .optional(
        "along",
        Type::quantity(Unit::M),
        0.0,
        "From how far back along its fingers the hand is to come, as `ApproachAlong` does, if it does not come from above.",
    )
    .output("grasp_pose", Type::Pose, "Pose of the TCP that grasps the object.")
    .output("pre_pose", Type::Pose, "Pose of the TCP over it.")
    .output("aperture", Type::quantity(Unit::M), "Distance of the open finger pads, so that none comes down on something else.")
    .output("object_pose", Type::Pose, "Where memory believes the object to be.");
    equipment::skill(equipment, names_the_arm(manifest), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let id = context.entity("object")?;
    let (height, along) = (context.number("height")?, context.number("along")?);
    let (class, object) = equipment.remembered().thing(&id).await?;
    let [length, width, _] = class.size;
    let center = Point3::from(object.translation.vector);
    let surface = ContactPlane::under(equipment.remembered(), &center).await?;
    let others: Vec<KnownBox> = known(equipment.remembered())
        .await?
        .into_iter()
        .filter(|other| other.thing.as_ref().is_some_and(|thing| *thing != id))
        .map(|other| other.shape)
        .collect();
    let yaw = (surface.rotation().inverse() * object.rotation).euler_angles().2;
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let hand = hand(model, arm)?;
    let mut random = equipment.random();
    let now = equipment.robot.sensed().borrow();
    let joints = free_joints(&equipment, &context, arm);
    let mut ready = model.taken_at(model.ready(&arm.name), &now.position);
    for joint in model.reaching_joints(&arm.name).into_iter().filter(|joint| !joints.contains(joint)) {
        ready[joint] = now.position[joint];
    }
    let opening = widest_opening(model, hand);
    let mut reach = Reach::new(model, &joints, tcp_of(arm)?, &ready);
    let down = surface.normal().scale((class.size[2] / 2.0 - FINGERS_END).max(0.0));
    let mut best: Option<(f64, Grasp)> = None;
    let mut nearest = f64::INFINITY;
    for quarter in -2..=2 {
        let across = if quarter % 2 == 0 { length } else { width };
        for misalignment in MISALIGNMENTS {
            let needed = needed_opening(across, misalignment, hand.pad_width) + 2.0 * CLEARANCE;
            if needed > opening {
                continue;
            }
            let hand_yaw = yaw + f64::from(quarter) * FRAC_PI_2 + misalignment;
            let grasp = tcp_at(hand, &center, &surface.rotation(), hand_yaw);
            let mut pre = grasp;
            pre.translation.vector += surface.normal().scale(height);
            let mut poses = vec![grasp, pre];
            if along > 0.0 {
                let back = Translation3::from(towards_wrist(model, arm, &grasp.rotation) * along);
                poses.extend([back * pre, back * grasp]);
            }
            match reach.margin(&poses, &mut random) {
                Ok(margin) => {
                    let meets = |aperture: f64| comes_down_on(&others, &pads(hand, &grasp, aperture), &down);
                    let widest = (opening - FROM_WIDEST).max(needed);
                    let free = widest_free(widest, needed, meets);
                    let aperture = free.unwrap_or(widest);
                    let cost = free.map_or(MEETING_COST, |free| NARROW_COST * (widest - free));
                    let score = margin - MISALIGNMENT_COST * misalignment.abs() - cost;
                    if best.is_none_or(|(most, ..)| score > most) {
                        best = Some((score, Grasp { grasp, pre, aperture }));
                    }
                }
                Err(missing) => nearest = nearest.min(missing),
            }
        }
    }
    let Some((_, Grasp { grasp, pre, aperture })) = best else {
        if nearest.is_infinite() {
            return Err(Failure::new(format!(
                "the object `{id}` is {:.0} mm wide; the hand opens to {:.0} mm",
                length.min(width) * 1e3,
                opening * 1e3
            )));
        }
        let lack = match nearest {
            n if n > 0.0 => format!("at best {:.0} mm are missing", n * 1e3),
            _ => "a joint would stand at its limit".into(),
        };
        return Err(Failure::new(format!(
            "the object at x {:.2}, y {:.2}, z {:.2} m is out of the arm's reach from over it: {lack}",
            center.x, center.y, center.z
        )));
    };
    let planned =
        Outcome::success().with("grasp_pose", pose_value(&grasp)).with("pre_pose", pose_value(&pre));
    Ok(planned.with("aperture", aperture).with("object_pose", pose_value(&object)))
}

/// The TCP's poses at a grasp and over it (root frame), and the aperture of the hand, m.
#[derive(Clone, Copy)]
struct Grasp {
    grasp: Isometry3<f64>,
    pre: Isometry3<f64>,
    aperture: f64,
}

/// The widest aperture from `widest` down to `needed`, m, with which no finger meets anything; `None` if there is none.
fn widest_free(widest: f64, needed: f64, meets: impl Fn(f64) -> bool) -> Option<f64> {
    let steps = ((widest - needed) / NARROWER) as u32;
    (0..=steps).map(|step| widest - f64::from(step) * NARROWER).find(|aperture| !meets(*aperture))
}

/// Where the middles and the edges of the open pads are at a grasp, root frame, m.
fn pads(hand: &Hand, grasp: &Isometry3<f64>, opening: f64) -> Vec<Point3<f64>> {
    let root_from_held = grasp * hand.grasp_in_tcp;
    let place = |side: f64, edge: f64| {
        root_from_held * Point3::new(0.0, side * opening / 2.0, edge * hand.pad_width / 2.0)
    };
    [-1.0, 1.0].into_iter().flat_map(|side| [-1.0, 0.0, 1.0].map(|edge| place(side, edge))).collect()
}

/// Whether a finger whose pad is at one of these places (root frame, m) would come down on something; it ends lower by `down`, m.
fn comes_down_on(others: &[KnownBox], pads: &[Point3<f64>], down: &Vector3<f64>) -> bool {
    let near = |other: &KnownBox, end: &Point3<f64>| distance(other, end) < BESIDE;
    others.iter().any(|other| pads.iter().any(|pad| near(other, pad) || near(other, &(pad - down))))
}

/// The largest distance of the finger pads, m.
fn widest_opening(model: &Model, hand: &Hand) -> f64 {
    model.limb(&hand.name).iter().map(|&j| model.joints()[j].upper).sum()
}

/// The distance between the pads that lets them pass an object that is `across` m wide between them and rotated by
/// `misalignment`. The object's side comes nearest to a pad at the pad's edge.
fn needed_opening(across: f64, misalignment: f64, pad_width: f64) -> f64 {
    let (sin, cos) = libm::sincos(misalignment.abs());
    (across + pad_width * sin) / cos
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn a_turned_object_needs_a_wider_hand() {
        assert!((needed_opening(0.07, 0.0, 0.05) - 0.07).abs() < 1e-12);
        let turned = needed_opening(0.1, -0.42, 0.05);
        assert!((turned - needed_opening(0.1, 0.42, 0.05)).abs() < 1e-12);
        // At the far edge of the pad, the side is 25 mm tan 0.42 further out than at the pad's middle.
        assert!((turned / 2.0 - (0.05 / libm::cos(0.42f64) + 0.025 * libm::tan(0.42f64))).abs() < 1e-12);
    }

    #[test]
    fn a_finger_that_would_come_down_on_something_beside_is_noticed() {
        let model = Model::shipped("armar3").unwrap();
        let (hand, center) = (&model.hands()["right_hand"], Point3::new(0.3, 0.5, 0.98));
        let level = UnitQuaternion::identity();
        // A flat board of which the edge is 40 mm beside the middle of the object, along y.
        let board = KnownBox {
            name: "board".into(),
            root_from_box: Isometry3::translation(0.3, 0.61, 0.96),
            size: Vector3::new(0.14, 0.14, 0.02),
        };
        let meets = |yaw: f64| {
            let grasp = tcp_at(hand, &center, &level, yaw);
            comes_down_on(
                std::slice::from_ref(&board),
                &pads(hand, &grasp, 0.13),
                &Vector3::new(0.0, 0.0, 0.025),
            )
        };
        let either_way = [0.0, FRAC_PI_2].map(meets);
        assert!(either_way.contains(&true) && either_way.contains(&false), "{either_way:?}");
    }

    #[test]
    fn the_hand_is_as_open_as_what_is_beside_lets_it() {
        let free = |most: f64| widest_free(0.125, 0.08, |aperture| aperture > most);
        assert_eq!(free(0.2), Some(0.125));
        assert!((free(0.11).unwrap() - 0.105).abs() < 1e-9);
        assert_eq!(free(0.07), None);
    }

    #[test]
    fn the_hand_opens_to_thirteen_centimetres() {
        let model = Model::shipped("armar3").unwrap();
        assert!((widest_opening(&model, &model.hands()["right_hand"]) - 0.13).abs() < 1e-12);
    }
}
