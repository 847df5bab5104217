//! `ApproachObject`: moves the open hand straight along its fingers to a thing on a surface, and stops as soon as it touches something: seen by
//! what begins to move with the hand, or felt at the wrist.

use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_motion::StraightLine;
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Observation, Type, Unit};
use armarium_visionx::{Sight, TouchStep, TouchedTable};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp};
use crate::inputs::{Inputs, pose_value, seen_at};
use crate::motions::failed;
use crate::own_hand::own_hand;
use crate::surface::ContactPlane;

/// The outcome when something is touched.
const TOUCHED: &str = "touched";
/// How far from its line the TCP may be, m.
const OFF: f64 = 0.04;
/// How long the hand rests at the end of its way, and after a touch, s.
const RESTS: f64 = 0.2;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ApproachObject",
        "Moves the open hand straight along its fingers, and stops as soon as it sees or feels that it touches something.",
    )
    .input("way", Type::quantity(Unit::M), "How far, if nothing is touched.")
    .optional("speed", Type::quantity(Unit::M_S), 0.05, "Speed of the hand.")
    .optional("force", Type::quantity(Unit::N), 3.0, "A force that differs by so much from that at the start is a touch.")
    .optional("look", Type::Bool, true, "Whether it looks; without it, it only feels.")
    .output("gone", Type::quantity(Unit::M), "How far the hand went.")
    .output("finger", Type::String, "The finger that touched; empty where that is not known.")
    .output("beside", Type::quantity(Unit::M), "How far beside the middle of the hand the touched thing is, along the TCP's y; 0 where that is not known.")
    .output("tcp", Type::Pose, "Pose of the TCP at the end.")
    .outcome(TOUCHED)
    .mark(Mark::at_start("approach_started"))
    .mark(Mark::at_success("approach_ended"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let mut arm = LeasedArm::take(&equipment, &context, &[]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let begin = arm.tcp(&senses.newest());
    let mut eyes = match context.flag("look")? {
        true => Some(eyes(&equipment, &arm, &begin).await?),
        false => None,
    };
    let touch = approach(&mut arm, &mut senses, begin, &context, eyes.as_mut()).await?;
    let here = arm.tcp(&senses.newest());
    let ended = |outcome: Outcome, finger: &str, beside: f64| {
        let gone = (here.translation.vector - begin.translation.vector).norm();
        outcome
            .with("gone", gone)
            .with("finger", finger)
            .with("beside", beside)
            .with("tcp", pose_value(&here))
    };
    let Some(touch) = touch else { return Ok(ended(Outcome::success(), "", 0.0)) };
    let beside = seen_at(&touch).map_or(0.0, |at| (here.inverse() * at).y);
    let finger = touch.attributes.get("finger").and_then(|name| name.as_str()).unwrap_or_default();
    let outcome = ended(Outcome::named(TOUCHED), finger, beside);
    let updater = Updater::new(Arc::clone(&equipment.memory), &equipment.agent).map_err(failed)?;
    updater.update(&[touch]).await.map_err(failed)?;
    // The hand comes to rest before anybody else moves it.
    let mut waited = 0.0;
    while waited < RESTS {
        let (_, dt) = senses.next().await?;
        arm.stand()?;
        waited += dt;
    }
    Ok(outcome)
}

/// Looks for what begins to move with the hand.
async fn eyes(equipment: &Equipment, arm: &LeasedArm, tcp: &Isometry3<f64>) -> Result<Sight, Failure> {
    let hand = hand(equipment.robot.model(), &arm.limb)?;
    let table = table_under(equipment, &(tcp * held_in_tcp(hand))).await?.ok_or_else(|| {
        Failure::new("memory knows no table under the hand; LocateObject or ModelEnvironment finds it where the cameras give depth")
    })?;
    let own = own_hand(equipment, &arm.limb)?;
    let camera = equipment.images.calibration().camera;
    Ok(equipment.look(TouchStep::new(camera, &hand.name, table, own)))
}

/// The table that memory knows under a place (root frame), if any.
pub(crate) async fn table_under(
    equipment: &Equipment,
    place: &Point3<f64>,
) -> Result<Option<TouchedTable>, Failure> {
    let known = ContactPlane::known_under(equipment.remembered(), place).await?;
    Ok(known.map(|table| TouchedTable { at: table.at(place.x, place.y), normal: table.normal() }))
}

/// Moves along the fingers until the way is done or something is touched.
async fn approach(
    arm: &mut LeasedArm,
    senses: &mut Senses,
    begin: Isometry3<f64>,
    context: &SkillContext,
    mut eyes: Option<&mut Sight>,
) -> Result<Option<Observation>, Failure> {
    let (way, speed, most) = (context.number("way")?, context.number("speed")?, context.number("force")?);
    let end = begin * Translation3::new(0.0, 0.0, way);
    let free = arm.force(&senses.newest())?;
    let mut line = StraightLine::new(begin, end, speed).map_err(failed)?;
    while !line.rested(RESTS) {
        let (sample, dt) = senses.next().await?;
        let seen = match &mut eyes {
            Some(eyes) => eyes.newest().map_err(failed)?,
            None => None,
        };
        let seen = seen.and_then(|seen| seen.of_class("touch").cloned());
        let force: Vector3<f64> = arm.force(&sample)? - free;
        let felt =
            || Observation::new("Touches", "touch", sample.stamp_ns).with("finger", "").with("by", "felt");
        if let Some(touch) = seen.or_else(|| (force.norm() > most).then(felt)) {
            arm.stand()?;
            return Ok(Some(touch));
        }
        let point = line.step(dt).map_err(failed)?;
        let off = arm.track(&sample, &point.pose, point.linear, point.angular)?;
        if off > OFF {
            let mm = off * 1e3;
            return Err(Failure::new(format!(
                "the hand is {mm:.0} mm from its line; is its end within reach?"
            )));
        }
    }
    Ok(None)
}
