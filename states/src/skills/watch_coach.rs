//! `WatchCoach`: keeps the motion and the coach's hand in the cameras' view until it is cancelled.

use armarium_runtime::channels::Channels;
use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;
use nalgebra::{Point3, Vector3};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};
use crate::inputs::{Inputs, as_vector};
use crate::motions;

/// Largest speed of a joint, rad/s: slow, so that images stay usable meanwhile.
const SPEED: f64 = 0.3;
/// Time constant with which the gaze follows its target, s.
const GAZE_TIME_CONSTANT: f64 = 0.5;
/// A hand of which no picture has come for this long is gone, s.
const GONE_AFTER: f64 = 1.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "WatchCoach",
        "Looks at the middle of the motion, and between it and the coach's hand while there is one, until it is cancelled.",
    )
    .input("motion", Type::motion(), "The motion that runs.")
    .reads("hand");
    equipment::skill(equipment, moves_the_head(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (motion, _) = motions::load(&*equipment.memory, &context.entity("motion")?).await?;
    let centre = motion.primitive().centre();
    let middle = Vector3::new(centre[0], centre[1], centre[2]);
    let mut head = Head::take(&equipment, &context)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let _frames_are_wanted = context.channels.demand("hand");
    let mut looked_at = middle;
    loop {
        let (sample, dt) = senses.next().await?;
        let wanted = hand(&context.channels).map_or(middle, |hand| (middle + hand) / 2.0);
        looked_at += (wanted - looked_at) * (dt / GAZE_TIME_CONSTANT).min(1.0);
        head.look(&sample, dt, &Point3::from(looked_at), SPEED)?;
    }
}

/// Where the coach's hand was last seen, if that is not long ago (root frame, m).
fn hand(channels: &Channels) -> Option<Vector3<f64>> {
    let newest = channels.newest("hand").filter(|s| s.at.elapsed().as_secs_f64() < GONE_AFTER)?;
    newest.value.get("shown")?.get("seen_at").and_then(as_vector)
}
