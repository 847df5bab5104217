//! `VisionCoaching`: the coach's gestures change the running motion. A fist draws the near part of the path towards
//! the hand, two fingers push it away, one finger moves the whole motion.

use armarium_motion::CoachInput;
use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};

use crate::coaching::Coaching;
use crate::equipment::{self, Equipment};
use crate::inputs::as_vector;

/// What the robot says when two passes are about as near to a hand that it did not see come.
const AMBIGUOUS: &str =
    "I pass there twice, and do not know which pass you mean. Please come again as I pass.";
/// What it says when a gesture has moved the path by less than this, m, for so long, s.
const WITHOUT_EFFECT: &str =
    "Your gesture moves nothing: you may be too near to my path, or too far from it.";
const NO_EFFECT: f64 = 0.005;
const NO_EFFECT_FOR: f64 = 6.0;
/// A hand of which no picture has come for this long shows nothing any more, s.
const WITHOUT_PICTURES: f64 = 0.7;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new("VisionCoaching", "Changes the running motion as the coach's gestures say: fist draws, two fingers push away, one finger moves all.")
        .input("motion", Type::motion(), "The running motion.")
        .optional("patience", Type::Duration, 0.8, "Ends when no such gesture has been seen for this long.")
        .output("displacement", Type::FLOAT, "How far the path has moved where it moved most, m.")
        .reads("hand")
        .attends_pattern("HumanHands/*/*", 0.05, 1.0);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let patience = context.number("patience")?;
    let mut coaching = Coaching::begin(&equipment, &context)?;
    let _frames_are_wanted = context.channels.demand("hand");
    let (mut shown, mut told) = (0.0, false);
    loop {
        let dt = coaching.next().await?;
        let seen = context.channels.newest("hand");
        let seen = seen.filter(|s| s.at.elapsed().as_secs_f64() < WITHOUT_PICTURES).map(|s| s.value);
        let field = |name: &str| seen.as_ref().and_then(|hand| hand.get(name));
        let input = field("shown").map_or(CoachInput::None, input_of);
        if input != CoachInput::None {
            coaching.set_arrival(field("came_at").and_then(Value::as_f64));
        }
        let report = coaching.apply(dt, input)?;
        shown = if input == CoachInput::None { 0.0 } else { shown + dt };
        let without_effect = shown > NO_EFFECT_FOR && coaching.displacement() < NO_EFFECT;
        let said = match () {
            () if report.ambiguous => Some(AMBIGUOUS),
            () if without_effect => Some(WITHOUT_EFFECT),
            () => None,
        };
        if let Some(said) = said.filter(|_| !told) {
            told = true;
            equipment.robot.say(said);
        }
        if let Some(outcome) = coaching.ended(patience) {
            return Ok(outcome);
        }
    }
}

/// The coaching input for what the coach's hand shows.
fn input_of(shown: &Value) -> CoachInput {
    let vector = |name: &str| shown.get(name).and_then(as_vector);
    let gesture = shown.get("gesture").and_then(Value::as_str).unwrap_or_default();
    match (gesture, vector("position"), vector("direction")) {
        ("fist", Some(hand), _) => CoachInput::Attract { hand },
        ("point_two", Some(hand), _) => CoachInput::Repel { hand },
        ("point_one", _, Some(direction)) if direction.norm() > 0.5 => CoachInput::Shift { direction },
        _ => CoachInput::None,
    }
}
