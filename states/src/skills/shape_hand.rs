//! `ShapeHand`: gives the hand one of its named shapes.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;

use crate::arm::{Senses, chosen, moves_the_hand};
use crate::equipment::{self, Equipment};
use crate::grasp::hand;
use crate::hand::LeasedHand;

/// How near each joint comes to its place in the shape, rad (m).
const REACHED: f64 = 0.002;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ShapeHand",
        "Gives the hand one of the shapes that the robot file names, for instance `pinch` or `flat`; it lets go of nothing.",
    )
    .input("shape", Type::String, "A shape of the hand; `open` and `closed` are two.")
    .optional("timeout", Type::Duration, 5.0, "Longest time it may take.");
    equipment::skill(equipment, moves_the_hand(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (name, timeout) = (context.text("shape")?, context.number("timeout")?);
    let shapes = &hand(equipment.robot.model(), chosen(&equipment, &context)?)?.shapes;
    let shape = shapes.get(name).ok_or_else(|| {
        let known = shapes.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        Failure::new(format!("the hand has no shape `{name}`; it has {known}"))
    })?;
    let hand = LeasedHand::take(&equipment, &context).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut elapsed = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let missing = hand.towards(&sample, shape)?;
        if missing < REACHED {
            return Ok(Outcome::success());
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the hand had not the shape `{name}` within {timeout:.0} s: a joint is {missing:.3} rad or m away; is \
                 something in the hand?"
            )));
        }
    }
}
