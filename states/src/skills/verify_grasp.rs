//! `VerifyGrasp`: checks that the hand holds the object: by aperture, vision and weight.

use armarium_knowledge::ObjectClass;
use armarium_robot::{Load, LoadShape};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp};
use crate::hand::aperture;
use crate::inputs::{Inputs, pose_value, seen_at};
use crate::motions::failed;
use crate::prior::class_of;
use crate::skills::weigh_hand::mean_force;
use crate::surface::ContactPlane;

const GRAVITY: f64 = 9.81;
/// The class under which the processor observes what is in the hand.
const HELD: &str = "held";
/// A hand with an aperture below this holds nothing, m.
const MIN_APERTURE: f64 = 0.02;
/// Largest distance of the detected object from its place in the hand, m.
const IN_HAND: f64 = 0.08;
/// What sticks out of the hand by more than this on a side, m, may be all that is seen of the object.
const STICKS_OUT: f64 = 0.05;
/// A detection farther than this from the height at which the object stood is not on the table, m.
const ON_TABLE: f64 = 0.1;
/// The least share of the expected weight that must be measured.
const MIN_WEIGHT_SHARE: f64 = 0.4;
/// The least weight if prior knowledge does not contain the object's mass, N.
const MIN_WEIGHT: f64 = 0.4;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new("VerifyGrasp", "Verifies that the hand holds the object, by aperture, sight and weight, and takes its weight into account.")
        .input("object", Type::object(), "The object in memory.")
        .input("empty", Type::quantity(Unit::N), "Upward force on the empty hand in this posture.")
        .input("tcp_at_grasp", Type::Pose, "Pose of the TCP when the hand closed.")
        .output("mass", Type::quantity(Unit::KG), "Mass of the object, by the difference of weights.")
        .output("grasp", Type::map(Type::Any), "Pose of the TCP at the grasp, the surface that the object stood on (a pose, z its normal), height and mass of the object.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let object = context.entity("object")?;
    let known = equipment.memory.latest(&object).await.map_err(failed)?;
    let class = class_of(&*equipment.memory, &known).await?;
    let mut arm = LeasedArm::take(&equipment, &context, &[]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);

    let model = equipment.robot.model();
    let hand = hand(model, &arm.limb)?;
    let aperture = aperture(model.limb(&hand.name), &senses.newest());
    if aperture < MIN_APERTURE {
        let mm = aperture * 1e3;
        return Err(Failure::new(format!("the hand is closed to {mm:.0} mm: it holds nothing")));
    }
    let force = mean_force(&mut arm, &mut senses, 0.5).await?;
    let weight = context.number("empty")? - force.z;
    let expected = class.mass.map_or(MIN_WEIGHT, |m| MIN_WEIGHT_SHARE * m * GRAVITY);
    if weight < expected {
        return Err(Failure::new(format!(
            "the hand is only {weight:.2} N heavier than empty, at least {expected:.2} N were expected: the object stayed behind"
        )));
    }
    let tcp_at_grasp = context.pose("tcp_at_grasp")?;
    let held = held_in_tcp(hand);
    let stood = tcp_at_grasp * held;
    let surface = ContactPlane::under(equipment.remembered(), &stood).await?;
    let nearest = look(&equipment, &mut arm, &mut senses, &class, (&held, &surface, &stood)).await?;
    judge(nearest, object.entity(), class.mass.is_some())?;

    let mass = weight / GRAVITY;
    let size = Vector3::from(class.size);
    let stood_as = equipment.memory.latest(&object).await.map_err(failed)?;
    let stood_as =
        equipment.remembered().root_pose(&stood_as).map_or(surface.rotation(), |pose| pose.rotation);
    // Its turn in the hand is as it stood; its middle is where the hand holds.
    let tcp_from_box = Isometry3::from_parts(held.coords.into(), tcp_at_grasp.rotation.inverse() * stood_as);
    let shape = Some(LoadShape { tcp_from_box, size });
    let load = Load { name: object.to_string(), mass_kg: mass, center_in_tcp: held, shape };
    equipment.robot.set_load(&hand.name, Some(load)).map_err(failed)?;
    let grasp = Value::record([
        ("tcp", pose_value(&tcp_at_grasp)),
        ("surface", pose_value(&surface.pose())),
        ("height", class.size[2].into()),
        ("mass", mass.into()),
    ]);
    Ok(Outcome::success().with("mass", mass).with("grasp", grasp))
}

/// A detected object must be in the hand, at most so far from its place, m. An object that is not detected may be hidden by the hand that
/// holds it: then its known weight is sufficient.
fn judge(nearest: f64, name: &str, weight_is_known: bool) -> Result<(), Failure> {
    if nearest < IN_HAND {
        return Ok(());
    }
    if nearest.is_finite() {
        let mm = nearest * 1e3;
        return Err(Failure::new(format!("`{name}` is seen {mm:.0} mm away from the hand, not in it")));
    }
    if weight_is_known {
        tracing::info!("the hand hides `{name}`; it has the right weight");
        return Ok(());
    }
    Err(Failure::new(format!("`{name}` is not seen in the hand")))
}

/// Looks for the object's colour in the hand, and elsewhere for an object that was left behind at the height of `stood`
/// over the surface on which it stood. Detections above or below that are ignored: they are the arm, or two parts of the object
/// matched as one. Returns the least distance from its place in the hand, m, less what may stick out of the hand on a side; infinite
/// if it was not detected.
async fn look(
    equipment: &Equipment,
    arm: &mut LeasedArm,
    senses: &mut Senses,
    class: &ObjectClass,
    (held_in_tcp, surface, stood): (&Point3<f64>, &ContactPlane, &Point3<f64>),
) -> Result<f64, Failure> {
    let (hand, held) = (equipment.clone(), *held_in_tcp);
    let tcp = tcp_of(&arm.limb)?;
    let in_hand = move |stamp_ns| Some(hand.link_at(tcp, stamp_ns).ok()? * held);
    let mut sight = equipment.look(equipment.track(class.color, None, HELD).expected_at(in_hand.clone()));
    let ends = (class.size[0].max(class.size[1]) / 2.0 - STICKS_OUT).max(0.0);
    let (mut waited, mut nearest) = (0.0, f64::INFINITY);
    while waited < 2.0 {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        arm.hold(&sample)?;
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        let Some((at, held)) = frame.of_class(HELD).and_then(seen_at).zip(in_hand(frame.stamp_ns)) else {
            continue;
        };
        let up = surface.above(&at) - surface.above(&held);
        let beside = ((at - held).norm_squared() - up * up).max(0.0).sqrt();
        let away = libm::hypot((beside - ends).max(0.0), up);
        if away < IN_HAND || (surface.above(&at) - surface.above(stood)).abs() < ON_TABLE {
            nearest = nearest.min(away);
        }
        if nearest < IN_HAND {
            break;
        }
    }
    Ok(nearest)
}
