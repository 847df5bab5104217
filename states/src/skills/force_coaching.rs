//! `ForceCoaching`: the coach's pushes on the hand change the running motion at the phases where they act.

use armarium_motion::CoachInput;
use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::Vector3;

use crate::coaching::Coaching;
use crate::equipment::{self, Equipment};
use crate::inputs::as_vector;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest =
        SkillManifest::new("ForceCoaching", "Changes the running motion by the coach's pushes on the hand.")
            .input("motion", Type::motion(), "The running motion.")
            .optional("threshold", Type::quantity(Unit::N), 4.0, "Force that counts as a push.")
            .optional(
                "hold",
                Type::Duration,
                0.06,
                "A push lasts at least this long; shorter ones are not followed.",
            )
            .optional("patience", Type::Duration, 4.0, "Ends when no push has been felt for this long.")
            .output("displacement", Type::FLOAT, "How far the path has moved where it moved most, m.")
            .reads("wrist")
            .attends_pattern("HumanHands/*/*", 0.05, 1.0);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (threshold, patience) = (context.number("threshold")?, context.number("patience")?);
    let hold = context.number("hold")?;
    let mut coaching = Coaching::begin(&equipment, &context)?;
    let _wrist_is_wanted = context.channels.demand("wrist");
    let mut pushed_for = 0.0;
    loop {
        let dt = coaching.next().await?;
        let push = context.channels.newest("wrist").and_then(|s| s.value.get("push").and_then(as_vector));
        let force = push.unwrap_or_else(Vector3::zeros);
        pushed_for = if force.norm() > threshold { pushed_for + dt } else { 0.0 };
        let input = if pushed_for > hold { CoachInput::Push { force } } else { CoachInput::None };
        coaching.apply(dt, input)?;
        if let Some(outcome) = coaching.ended(patience) {
            return Ok(outcome);
        }
    }
}
