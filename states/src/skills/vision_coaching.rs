//! `VisionCoaching`: the coach's gestures change the running motion. A fist draws the near part of the path towards
//! the hand, two fingers push it away, one finger moves the whole motion.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_motion::CoachInput;
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use armarium_visionx::HandObservation;

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

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
    let manifest = SkillManifest::new("VisionCoaching", "Changes the running motion as the coach's gestures say: fist draws, two fingers push away, one finger moves all.")
        .input("motion", Type::motion(), "The running motion.")
        .optional("patience", Type::Duration, 0.8, "Ends when no such gesture has been seen for this long.")
        .output("displacement", Type::FLOAT, "How far the path has moved where it moved most, m.")
        .reads("hand");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let patience = context.number("patience")?;
    let mut coaching = Coaching::begin(&equipment, &context)?;
    let _frames_are_wanted = context.channels.demand("hand");
    let mut displacement = 0.0_f64;
    let mut filter = GestureFilter::default();
    let (mut shown, mut told) = (0.0, false);
    loop {
        let dt = coaching.next().await?;
        let seen = context.channels.newest("hand");
        let seen = seen.filter(|s| s.at.elapsed().as_secs_f64() < 0.3);
        let input = filter.update(dt, seen.map(|s| s.value));
        coaching.set_arrival(filter.hand.get("came_at").and_then(Value::as_f64));
        let report = coaching.apply(dt, input)?;
        if report.active {
            displacement = displacement.max(report.displacement);
        }
        shown = if input == CoachInput::None { 0.0 } else { shown + dt };
        let without_effect = shown > NO_EFFECT_FOR && displacement < NO_EFFECT;
        let said = match () {
            () if report.ambiguous => Some(AMBIGUOUS),
            () if without_effect => Some(WITHOUT_EFFECT),
            () => None,
        };
        if let Some(said) = said.filter(|_| !told) {
            told = true;
            equipment.robot.say(said);
        }
        if coaching.idle() > patience {
            return Ok(Outcome::success().with("displacement", displacement));
        }
    }
}

/// The coaching input for a gesture, with the newest detection of the hand.
fn input_of(gesture: &str, hand: &Value) -> CoachInput {
    let vector = |name: &str| hand.get(name).and_then(as_vector);
    match (gesture, vector("position"), vector("direction")) {
        ("fist", Some(hand), _) => CoachInput::Attract { hand },
        ("point_two", Some(hand), _) => CoachInput::Repel { hand },
        ("point_one", _, Some(direction)) if direction.norm() > 0.5 => CoachInput::Shift { direction },
        _ => CoachInput::None,
    }
}

/// Filters gestures: selects the gesture that was clearly visible for longest in the last seconds, with the newest
/// detection of the hand.
///
/// The robot's own arm passes between its cameras and the coach's hand in each cycle and hides a part of it.
/// Detections of the visible rest have a wrong gesture and place, and get little weight.
struct GestureFilter {
    gesture: String,
    hand: Value,
    /// How long each gesture has been clearly visible, s; decays over time.
    seen: BTreeMap<String, f64>,
    /// How long there has been no hand, s.
    gone: f64,
}

impl Default for GestureFilter {
    fn default() -> Self {
        Self { gesture: NO_HAND.into(), hand: Value::Null, seen: BTreeMap::new(), gone: 0.0 }
    }
}

/// The channel's value for a frame without a hand.
const NO_HAND: &str = "none";

impl GestureFilter {
    /// How long a gesture must be visible before it is accepted, and how long a hand must be out of sight before it
    /// is gone, s.
    const MIN_VISIBLE: f64 = 0.4;
    /// The time constant of the decay, s, and the largest accumulated time, s. A change of the gesture is accepted
    /// after 1.5 s.
    const DECAY: f64 = 4.0;
    const MAX_ACCUMULATED: f64 = 2.0;
    /// The least confidence of a gesture that counts, as a probability.
    const MIN_CONFIDENCE: f64 = 0.6;
    /// The weight of a partly hidden hand, relative to a fully visible one.
    const HIDDEN_COUNTS: f64 = 0.1;

    /// The coaching input after `dt` s, from the present value of the channel.
    fn update(&mut self, dt: f64, hand: Option<Value>) -> CoachInput {
        let number = |name: &str| hand.as_ref().and_then(|h| h.get(name)).and_then(Value::as_f64);
        let seen = hand.as_ref().and_then(|h| h.get("gesture")).and_then(Value::as_str).unwrap_or(NO_HAND);
        if seen == NO_HAND {
            self.gone += dt;
            if self.gone >= Self::MIN_VISIBLE {
                *self = Self::default();
            }
            return input_of(&self.gesture, &self.hand);
        }
        self.gone = 0.0;
        let hidden = number("hidden").is_some_and(|share| share >= HandObservation::HIDDEN);
        if number("confidence").is_none_or(|c| c >= Self::MIN_CONFIDENCE) {
            let counts = if hidden { Self::HIDDEN_COUNTS } else { 1.0 };
            self.seen.values_mut().for_each(|time| *time *= 1.0 - counts * dt / Self::DECAY);
            let time = self.seen.entry(seen.to_owned()).or_default();
            *time = (*time + counts * dt).min(Self::MAX_ACCUMULATED);
            let longest = self.seen.iter().max_by(|a, b| a.1.total_cmp(b.1));
            if let Some((gesture, _)) = longest.filter(|(_, time)| **time >= Self::MIN_VISIBLE) {
                self.gesture.clone_from(gesture);
            }
        }
        if seen == self.gesture && (!hidden || self.hand == Value::Null) {
            self.hand = hand.unwrap_or(Value::Null);
        }
        input_of(&self.gesture, &self.hand)
    }
}

#[cfg(test)]
mod tests {
    use armarium_values::{Frame, Vector};

    use super::*;

    #[test]
    fn what_is_read_of_a_half_hidden_hand_changes_neither_gesture_nor_place() {
        let at = |gesture: &str, x: f64| {
            let position = Value::Vector(Vector::new(Frame::root(), &nalgebra::Vector3::new(x, 0.0, 0.0)));
            Some(Value::record([("gesture", Value::from(gesture)), ("position", position)]))
        };
        let mut filter = GestureFilter::default();
        let mut after = |seconds: f64, hand: Option<Value>| {
            let steps = (seconds * 1e3) as usize;
            (0..steps).map(|_| filter.update(1e-3, hand.clone())).last()
        };
        let fist = Some(CoachInput::Attract { hand: nalgebra::Vector3::new(0.3, 0.0, 0.0) });
        let with = |hand: Option<Value>, name: &str, value: f64| match hand {
            Some(Value::Map(mut fields)) => {
                fields.insert(name.into(), Value::Float(value));
                Some(Value::Map(fields))
            }
            other => other,
        };
        assert_eq!(after(0.3, at("fist", 0.3)), Some(CoachInput::None), "not yet");
        assert_eq!(after(0.3, at("fist", 0.3)), fist);
        assert_eq!(after(1.0, at("fist", 0.3)), fist);
        assert_eq!(after(1.0, at("point_two", 0.2)), fist, "half hidden by the robot's arm");
        assert_eq!(after(1.0, at("fist", 0.3)), fist);
        assert_eq!(after(0.2, None), fist, "hidden for some frames");
        assert_eq!(after(3.0, with(at("point_two", 0.2), "confidence", 0.5)), fist, "doubtful");
        assert_eq!(after(3.0, with(at("point_two", 0.2), "hidden", 0.2)), fist, "hidden for long");
        let pair = Some(CoachInput::Repel { hand: nalgebra::Vector3::new(0.2, 0.0, 0.0) });
        assert_eq!(after(2.5, at("point_two", 0.2)), pair, "changed");
        assert_eq!(after(0.5, None), Some(CoachInput::None), "gone");
    }
}
