//! `CloseHand`: closes the hand until an object stops both pads.

use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{Senses, moves_the_hand};
use crate::equipment::{self, Equipment};
use crate::hand::LeasedHand;

/// The pads count as stopped below this speed, m/s.
const STOPPED: f64 = 0.002;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "CloseHand",
        "Closes the hand until both pads are stopped by what is between them.",
    )
    .optional("speed", Type::quantity(Unit::M_S), 0.03, "Speed of each pad.")
    .optional(
        "empty_below",
        Type::quantity(Unit::M),
        0.015,
        "Under this aperture there is nothing in the hand.",
    )
    .optional("timeout", Type::Duration, 6.0, "Longest time it may take.")
    .output("aperture", Type::quantity(Unit::M), "Distance of the finger pads at the end.")
    .mark(Mark::at_success("grasp_closed"));
    equipment::skill(equipment, moves_the_hand(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let speed = context.number("speed")?;
    let (empty_below, timeout) = (context.number("empty_below")?, context.number("timeout")?);
    let hand = LeasedHand::take(&equipment, &context).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut elapsed, mut stopped_for) = (0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        hand.close_at(&sample, speed)?;
        let aperture = hand.aperture(&sample);
        let still = hand.opening_speed(&sample).abs() < STOPPED && elapsed > 0.3;
        stopped_for = if still { stopped_for + dt } else { 0.0 };
        if aperture < empty_below {
            return Err(Failure::new(format!(
                "the hand closed to {:.0} mm: there is nothing between its pads",
                aperture * 1e3
            )));
        }
        if stopped_for > 0.3 {
            return Ok(Outcome::success().with("aperture", aperture));
        }
        if elapsed > timeout {
            return Err(Failure::new(format!("the hand was still closing after {timeout:.0} s")));
        }
    }
}
