//! `PutDownTogether`: both hands lower what is between them until something else bears it, and let go.

use armarium_motion::{Holding, LinePoint, StraightLine};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Translation3, Vector3};

use crate::arm::Senses;
use crate::both::{BothArms, at_rest, config_held, holding, holds, moves_both};
use crate::equipment::{self, Equipment};
use crate::motions::failed;

/// The outcome besides `success`.
const LOST: &str = "lost";
/// How long the weight is averaged before, s.
const WEIGHING: f64 = 0.3;
/// A load that is lighter than this cannot be felt to be put down, N.
const FELT: f64 = 2.0;
/// What bears the load when the hands carry less than this share of it, for so long, s.
const BORNE: (f64, f64) = (0.03, 0.02);
/// Largest speed on the way to where the load is expected to be borne, m/s, and how far before that it ends, m.
const LOWERING: f64 = 0.1;
const BEFORE: f64 = 0.02;
/// Speed of the hands when they let go, m/s, and how far they go, m.
const LETTING_GO: f64 = 0.03;
const APART: f64 = 0.06;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "PutDownTogether",
        "Lowers what both hands hold between them until something else bears it, and lets go of it; of what they grip, \
         opening them does.",
    )
    .optional(
        "expected",
        Type::quantity(Unit::M),
        0.0,
        "How far down it is expected to be borne: until 20 mm before that it goes at 0.1 m/s.",
    )
    .optional("farthest", Type::quantity(Unit::M), 0.3, "How far down it looks for what bears the load.")
    .optional(
        "speed",
        Type::quantity(Unit::M_S),
        0.01,
        "Speed at which the load comes down on what bears it.",
    );
    let manifest = holds(manifest)
        .output("depth", Type::quantity(Unit::M), "How far down it was borne.")
        .outcome(LOST)
        .mark(Mark::at_start("put_down_started"))
        .mark(Mark::at_success("put_down_ended"));
    equipment::skill(equipment, moves_both(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (farthest, speed) = (context.number("farthest")?, context.number("speed")?);
    let (down, holding) = (Vector3::z() * -farthest, holding(&context)?);
    let mut both = BothArms::take(&equipment, &context, &[down], holding).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut law = both.take_load(&senses.newest(), config_held(&equipment, &context)?)?;
    let above = (context.number("expected")?.min(farthest) - BEFORE).max(0.0);
    let low = Translation3::from(Vector3::z() * -above) * law.taken();
    let mut line = StraightLine::new(*law.taken(), low, LOWERING).map_err(failed)?;
    let (mut weight, mut weighed, mut depth, mut borne) = (0.0, 0.0, 0.0, 0.0);
    let forces = loop {
        let (sample, dt) = senses.next().await?;
        let goal = if weighed < WEIGHING {
            at_rest(*law.taken())
        } else if !line.rested(0.0) {
            line.step(dt).map_err(failed)?
        } else {
            depth += speed * dt;
            let down = -Vector3::z();
            LinePoint { linear: down * speed, ..at_rest(Translation3::from(down * depth) * low) }
        };
        let Some(step) = both.carry((&sample, dt), &mut law, &goal)? else {
            return Ok(Outcome::named(LOST).with("depth", above + depth));
        };
        let carried = step.forces.external.z;
        if weighed < WEIGHING {
            weight += (carried - weight) * dt / (weighed + dt);
            weighed += dt;
            continue;
        }
        if weight < FELT {
            return Err(Failure::new(format!("the hands carry {weight:.1} N: nothing to put down")));
        }
        borne = if carried < BORNE.0 * weight { borne + dt } else { 0.0 };
        if borne > BORNE.1 {
            break step.forces;
        }
        if above + depth > farthest {
            return Err(Failure::new(format!("nothing bears the load within {farthest:.2} m below it")));
        }
    };
    let borne = Outcome::success().with("depth", above + depth);
    if holding == Holding::Gripping {
        return Ok(borne);
    }
    let line = forces.line.into_inner();
    let stand = both.resting(&senses.newest());
    let mut way = 0.0;
    while way < APART {
        let (sample, dt) = senses.next().await?;
        way += LETTING_GO * dt;
        let apart = |hand: LinePoint, sign: f64| LinePoint {
            pose: Translation3::from(line * (sign * way)) * hand.pose,
            linear: line * (sign * LETTING_GO),
            ..hand
        };
        both.track(&sample, &[apart(stand[0], -1.0), apart(stand[1], 1.0)])?;
    }
    Ok(borne)
}
