//! `ExecuteMotion`: the loop that integrates the learned motion. It alone commands the arm; coaches send it edits.
//! It controls the force, continues to learn the surface, and slows down when the coach's hand comes near. It runs
//! until it is cancelled, and then stores the changed motion in memory, with the learned surface.

use std::convert::Infallible;

use armarium_motion::{SlowDown, SurfaceAdaptation, SurfaceConfig};
use armarium_runtime::channels::Channels;
use armarium_runtime::skill::{Failure, Mark, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};

use crate::arm::{Senses, moves_the_arm};
use crate::equipment::{self, Equipment};
use crate::motions::failed;
use crate::wiper::{ContactWatch, GraspedTool, Height, Wiper};

/// The robot's announcement at the start, so that the coach may come.
const ANNOUNCEMENT: &str = "I am wiping now.";
/// A detection of the coach's hand older than this does not slow the motion any more, s.
const MAX_DETECTION_AGE: f64 = 0.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ExecuteMotion",
        "Wipes with a motion that was fitted to the surface, until it is cancelled.",
    )
    .input("motion", Type::motion(), "The motion; changes to it are executed at once.")
    .input("force", Type::quantity(Unit::N), "Desired normal force.")
    .input("grasp", Type::map(Type::Any), "How the tool was grasped.")
    .optional(
        "stiffness",
        Type::quantity(Unit::N_M),
        4000.0,
        "Stiffness of the contact, as force adaptation found it.",
    )
    .mark(Mark::at_start("wiping_started"))
    .reads("hand")
    .attends("motion", 0.05, 1.0)
    .publishes("motion");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let tool = GraspedTool::of(&context)?;
    let force = context.number("force")?;
    let (mut wiper, correction) = Wiper::take_fitted(&equipment, &context, &tool).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    wiper.start_nearest(&senses.newest())?;
    // The coach changes the motion, so the stiffness cannot be estimated from cycle to cycle any more.
    let stiffness = context.number("stiffness")?;
    let config = SurfaceConfig { force, stiffness, identify: false, ..SurfaceConfig::default() };
    let mut surface = SurfaceAdaptation::resume(config, correction, wiper.phase()).map_err(failed)?;
    equipment.robot.say(ANNOUNCEMENT);
    let Err(end) = wipe(&context, &mut wiper, &mut senses, &mut surface).await;
    // After a failure (a lost contact), the learned surface is not worth keeping.
    let learned = context.cancel.is_cancelled().then(|| surface.correction());
    // Coaches may have moved the middle.
    wiper.set_height(0.0)?;
    wiper.finish(learned, None).await?;
    Err(end)
}

/// Wipes until it is cancelled or fails.
async fn wipe(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    surface: &mut SurfaceAdaptation,
) -> Result<Infallible, Failure> {
    let slow_down = SlowDown::default();
    let mut contact = ContactWatch::default();
    let _frames_are_wanted = context.channels.demand("hand");
    let mut omega = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        let pressing = wiper.pressing(&sample)?;
        contact.check(dt, pressing)?;
        let command = surface.step(dt, wiper.phase(), omega, pressing).map_err(failed)?;
        let pace = surface.pace().min(slow_down.factor(distance_of_hand(&context.channels)));
        let height = Height { over: command.offset, rate: command.velocity };
        omega = wiper.step(&sample, dt, pace, height)?;
    }
}

/// Distance of the coach's hand from the TCP, m; infinite when no hand is detected.
fn distance_of_hand(channels: &Channels) -> f64 {
    let seen = channels.newest("hand").filter(|s| s.at.elapsed().as_secs_f64() < MAX_DETECTION_AGE);
    seen.and_then(|s| s.value.get("distance").and_then(Value::as_f64)).unwrap_or(f64::INFINITY)
}
