//! `OpenHand`: opens the hand, or closes it as far as it is to be open.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{Senses, moves_the_hand};
use crate::equipment::{self, Equipment};
use crate::hand::LeasedHand;
use crate::held::let_go;
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "OpenHand",
        "Opens the hand, or closes it, to an aperture, and lets go of what it holds.",
    )
    .optional("aperture", Type::quantity(Unit::M), 0.125, "Distance of the finger pads.")
    .optional("timeout", Type::Duration, 5.0, "Longest time it may take.")
    .output("aperture", Type::quantity(Unit::M), "Distance of the finger pads at the end.");
    equipment::skill(equipment, moves_the_hand(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let aperture = context.number("aperture")?;
    let timeout = context.number("timeout")?;
    let hand = LeasedHand::take(&equipment, &context).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut elapsed = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let missing = aperture - hand.aperture(&sample);
        if missing.abs() < 0.002 {
            equipment.robot.set_load(hand.name(), None).map_err(failed)?;
            let_go(&equipment, hand.name()).await?;
            return Ok(Outcome::success().with("aperture", hand.aperture(&sample)));
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the hand was not open to {:.0} mm within {timeout:.0} s: it is {:.0} mm off",
                aperture * 1e3,
                missing.abs() * 1e3
            )));
        }
        hand.close_at(&sample, -(4.0 * missing.abs()).clamp(0.005, 0.06).copysign(missing))?;
    }
}
