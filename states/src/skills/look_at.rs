//! `LookAt`: turns the head until the cameras look at a point.

use std::sync::Arc;

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};
use crate::inputs::as_point;

/// Largest speed of a joint, rad/s.
const SPEED: f64 = 1.0;
/// How long the gaze must rest on the point, s.
const REST_TIME: f64 = 0.3;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
    let manifest = SkillManifest::new("LookAt", "Turns the head until the eyes look at a point.")
        .input("point", Type::list(Type::FLOAT), "Where to look: x, y, z in the root frame, m.")
        .optional("tolerance", Type::quantity(Unit::RAD), 0.03, "How near the gaze must be.")
        .optional("timeout", Type::Duration, 5.0, "Longest time it may take.");
    equipment::skill(equipment, moves_the_head(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let point =
        as_point(context.value("point")?).ok_or_else(|| Failure::new("`point` needs three numbers"))?;
    let (tolerance, timeout) = (context.number("tolerance")?, context.number("timeout")?);
    let mut head = Head::take(&equipment, &context)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut elapsed, mut reached_for) = (0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let angle = head.look(&sample, dt, &point, SPEED)?;
        reached_for = if angle < tolerance { reached_for + dt } else { 0.0 };
        if reached_for > REST_TIME {
            return Ok(Outcome::success());
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the eyes are still {angle:.2} rad off the point after {timeout:.0} s: it is out of the head's range"
            )));
        }
    }
}
