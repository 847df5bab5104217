//! `VisionCoaching`: the coach's gestures change the running motion. A fist draws the near part of the path towards
//! the hand, two fingers push it away, one finger moves the whole motion.

use std::sync::Arc;

use armarium_motion::CoachInput;
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use nalgebra::Vector3;

use crate::coaching::Coaching;
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, as_vector};

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
    let manifest = SkillManifest::new("VisionCoaching", "Changes the running motion as the coach's gestures say: fist draws, two fingers push away, one finger moves all.")
        .input("motion", Type::motion(), "The running motion.")
        .optional("patience", Type::Duration, 0.8, "Ends when no such gesture has been seen for this long.")
        .output("displacement", Type::FLOAT, "How far the path has moved where it moved most, m.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let patience = context.number("patience")?;
    let mut coaching = Coaching::begin(&equipment, &context).await?;
    let _frames_are_wanted = context.channels.demand("hand");
    let mut displacement = 0.0_f64;
    loop {
        let step = coaching.next().await?;
        let seen = context.channels.newest("hand");
        let seen = seen.filter(|s| s.at.elapsed().as_secs_f64() < 0.3);
        let input = seen.map_or(CoachInput::None, |s| gesture(&s.value));
        let report = coaching.apply(&step, input).await?;
        if report.active {
            displacement = displacement.max(report.displacement);
        }
        if coaching.idle() > patience {
            coaching.keep().await?;
            return Ok(Outcome::success().with("displacement", displacement));
        }
    }
}

/// What the gesture on the channel asks of the motion.
fn gesture(hand: &Value) -> CoachInput {
    let vector = |name: &str| hand.get(name).and_then(as_vector).unwrap_or_else(Vector3::zeros);
    match hand.get("gesture").and_then(Value::as_str) {
        Some("fist") => CoachInput::Attract { hand: vector("position") },
        Some("point_two") => CoachInput::Repel { hand: vector("position") },
        Some("point_one") if vector("direction").norm() > 0.5 => {
            CoachInput::Shift { direction: vector("direction") }
        }
        _ => CoachInput::None,
    }
}
