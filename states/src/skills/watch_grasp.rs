//! `WatchGrasp`: watches what a hand holds while others move it, until it slips: seen by what no longer goes with the hand, or felt by fingers
//! that close.

use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_runtime::skill::{Failure, Mark, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Frame, Observation, ObservedPlace};
use armarium_visionx::SlipStep;
use nalgebra::Matrix3;

use crate::arm::{Senses, chosen, names_the_arm, tcp_of};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp};
use crate::hand::aperture;
use crate::motions::failed;
use crate::own_hand::own_hand;
use crate::skills::approach_object::table_under;

/// Fingers that close by so much more, m, have nothing between them any more.
const CLOSED: f64 = 0.01;
/// Standard deviation of where something slips that is felt, m.
const PLACE: f64 = 0.03;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "WatchGrasp",
        "Watches what the hand holds, beside the skills that move it, until it is cancelled; fails when that slips. It sees a slip only while the hand moves.",
    );
    let manifest =
        names_the_arm(manifest).mark(Mark::at_start("grasp_watched")).mark(Mark::at_end("watch_ended"));
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (model, arm) = (equipment.robot.model(), chosen(&equipment, &context)?);
    let hand = hand(model, arm)?;
    let camera = equipment.images.calibration().camera;
    let own = own_hand(&equipment, arm)?;
    let (fingers, held, tcp) = (model.limb(&hand.name), held_in_tcp(hand), tcp_of(arm)?);
    let mut senses = Senses::new(&*equipment.robot, &context);
    let begin = senses.newest();
    let table = table_under(&equipment, &(model.link_pose(&begin.position, tcp) * held)).await?;
    let mut eyes = equipment.look(SlipStep::new(camera, &hand.name, held, table, own));
    let open = aperture(fingers, &begin);
    loop {
        let (sample, _) = senses.next().await?;
        let seen = eyes.newest().map_err(failed)?.and_then(|seen| seen.of_class("slip").cloned());
        let closed = open - aperture(fingers, &sample) > CLOSED;
        let felt = || {
            let here = model.link_pose(&sample.position, tcp) * held;
            let place =
                ObservedPlace::new(&Frame::root(), &here.coords, &(Matrix3::identity() * PLACE * PLACE));
            Observation::new("Slips", "slip", sample.stamp_ns).named(&hand.name).at(place).with("by", "felt")
        };
        let how = if seen.is_some() { "it stays behind, as is seen" } else { "its fingers close" };
        if let Some(slip) = seen.or_else(|| closed.then(felt)) {
            let updater = Updater::new(Arc::clone(&equipment.memory), &equipment.agent).map_err(failed)?;
            updater.update(&[slip]).await.map_err(failed)?;
            return Err(Failure::new(format!("what `{}` holds slips: {how}", hand.name)));
        }
    }
}
