//! `VisionCoaching`: the coach's gestures change the running motion. A fist draws the near part of the path towards
//! the hand, two fingers push it away, one finger moves the whole motion.

use std::sync::Arc;

use armarium_motion::CoachInput;
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};

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
    let mut steady = Steady::default();
    loop {
        let step = coaching.next().await?;
        let seen = context.channels.newest("hand");
        let seen = seen.filter(|s| s.at.elapsed().as_secs_f64() < 0.3);
        let shown = seen.as_ref().and_then(|s| s.value.get("gesture")).and_then(Value::as_str);
        let shown = steady.update(step.dt(), shown.unwrap_or("none"));
        let input = seen.as_ref().map_or(CoachInput::None, |s| ask(shown, &s.value));
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

/// What a gesture asks of the motion, with the hand as it was seen last.
fn ask(gesture: &str, hand: &Value) -> CoachInput {
    let vector = |name: &str| hand.get(name).and_then(as_vector);
    match (gesture, vector("position"), vector("direction")) {
        ("fist", Some(hand), _) => CoachInput::Attract { hand },
        ("point_two", Some(hand), _) => CoachInput::Repel { hand },
        ("point_one", _, Some(direction)) if direction.norm() > 0.5 => CoachInput::Shift { direction },
        _ => CoachInput::None,
    }
}

/// The gesture that the coach means: one that has been seen for a while, so that a frame that was misread in between
/// does not make the robot do something else.
struct Steady {
    meant: String,
    seen: String,
    seen_for: f64,
}

impl Default for Steady {
    fn default() -> Self {
        Self { meant: "none".into(), seen: "none".into(), seen_for: 0.0 }
    }
}

impl Steady {
    /// How long a gesture must be seen before it is meant, s.
    const HOLD: f64 = 0.4;

    /// `dt` s later, with the gesture that is seen now: the one that is meant.
    fn update(&mut self, dt: f64, seen: &str) -> &str {
        if seen == self.seen {
            self.seen_for += dt;
        } else {
            (self.seen, self.seen_for) = (seen.to_owned(), 0.0);
        }
        if self.seen_for >= Self::HOLD && self.seen != self.meant {
            self.meant = self.seen.clone();
        }
        &self.meant
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misread_frame_does_not_change_what_is_meant() {
        let mut steady = Steady::default();
        let mut after = |seconds: f64, seen: &str| {
            let steps = (seconds * 1e3) as usize;
            (0..steps).map(|_| steady.update(1e-3, seen).to_owned()).last()
        };
        assert_eq!(after(0.3, "fist").as_deref(), Some("none"));
        assert_eq!(after(0.2, "fist").as_deref(), Some("fist"));
        assert_eq!(after(0.2, "point_one").as_deref(), Some("fist"), "three frames are not enough");
        assert_eq!(after(0.5, "point_two").as_deref(), Some("point_two"));
    }
}
