//! `ImitateMotion`: performs a learned motion in free space, over the table.

use armarium_runtime::skill::{Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};

use crate::arm::{Senses, moves_the_arm};
use crate::equipment::{self, Equipment};
use crate::reach::required_speed;
use crate::wiper::{GraspedTool, Height, Wiper};

/// Raised when the motion has been at its full frequency for a while.
const STEADY: &str = "imitation.steady";
/// Raised at the end of the last whole period, before the hand comes to rest.
const OVER: &str = "imitation.over";
/// The motion counts as steady after this share of a period at full frequency.
const SETTLING: f64 = 0.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest =
        SkillManifest::new("ImitateMotion", "Performs a learned motion in free space over the table.")
            .input("motion", Type::motion(), "The motion.")
            .input("grasp", Type::map(Type::Any), "How the tool was grasped.")
            .optional(
                "height",
                Type::quantity(Unit::M),
                0.05,
                "Height of the tool over the highest place of the table under its path.",
            )
            .optional("periods", Type::Int, 3_i64, "Whole periods to perform.")
            .output("frequency", Type::quantity(Unit::HZ), "Frequency of the motion.")
            .publishes("motion")
            .event(STEADY)
            .event(OVER)
            .mark(Mark::at_event(STEADY, "free_space_steady"))
            .mark(Mark::at_event(OVER, "adaptation_started"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let tool = GraspedTool::of(&context)?;
    let periods = context.value("periods")?.as_int().unwrap_or(3).max(1);
    let over = context.number("height")?;
    let mut wiper = Wiper::take_free(&equipment, &context, &tool).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    required_speed(&equipment, &wiper, over)?;
    wiper.start_nearest(&senses.newest())?;
    wiper.approach(&mut senses, over, 0.2).await?;
    let wanted = SETTLING + f64::from(i32::try_from(periods).unwrap_or(i32::MAX));
    let (mut turned, mut pace) = (0.0, 1.0);
    loop {
        let (sample, dt) = senses.next().await?;
        let omega = wiper.step(&sample, dt, pace, Height { over, rate: 0.0 })?;
        // Periods are counted from the moment at which the motion has its full frequency.
        let before = turned;
        if wiper.pace() >= 1.0 {
            turned += omega * dt / std::f64::consts::TAU;
        }
        if before < SETTLING && turned >= SETTLING {
            context.events.raise(STEADY, Value::Null);
        }
        if before < wanted && turned >= wanted {
            context.events.raise(OVER, Value::Null);
            pace = 0.0;
        }
        if pace == 0.0 && wiper.pace() == 0.0 {
            let frequency = wiper.motion().frequency_hz();
            wiper.finish(None, None).await?;
            return Ok(Outcome::success().with("frequency", frequency));
        }
    }
}
