//! `SegmentScene`: tells apart what stands on a table, by height and colour, and after a push by what has moved together.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Observation, Type};
use armarium_visionx::segmentation::SegmentationStep;

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::hypotheses::{hypotheses, newest, write};
use crate::inputs::Inputs;
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "SegmentScene",
        "Tells apart what stands on the table in view and puts it into memory; after a push, what has moved together is one thing. The arms must be aside.",
    )
    .optional("anew", Type::Bool, false, "Whether it forgets what it told apart before.")
    .optional("pushed", Type::String, "", "What was pushed since the last look, by its name among them.")
    .optional("timeout", Type::Duration, 5.0, "How long to look.")
    .output("things", Type::Int, "How many it tells apart.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let pushed = Some(context.text("pushed")?).filter(|name| !name.is_empty()).map(str::to_owned);
    let before = hypotheses(&equipment).await?;
    let known = match context.flag("anew")? {
        true => Vec::new(),
        false => before.iter().map(|known| known.hypothesis.clone()).collect(),
    };
    let names = before.iter().map(|known| known.hypothesis.name.as_str());
    let camera = equipment.images.calibration().camera;
    let step = SegmentationStep::new(camera).remembering(known, pushed, newest(names));
    let (seen, stamp_ns) = look(&equipment, &context, step).await?;
    write(&equipment, &before, &seen, stamp_ns).await?;
    Ok(Outcome::success().with("things", seen.len() as i64))
}

/// What the step told apart, and the time of the picture, ns.
async fn look(
    equipment: &Equipment,
    context: &SkillContext,
    step: SegmentationStep,
) -> Result<(Vec<Observation>, u64), Failure> {
    let timeout = context.number("timeout")?;
    let mut sight = equipment.look(step);
    let mut senses = Senses::new(&*equipment.robot, context);
    let mut waited = 0.0;
    loop {
        let (_, dt) = senses.next().await?;
        waited += dt;
        if waited > timeout {
            return Err(Failure::new(format!(
                "nothing was told apart within {timeout:.0} s; do the cameras give depth, and is a table in view with something on it?"
            )));
        }
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        if !frame.observations.is_empty() {
            return Ok((frame.observations.clone(), frame.stamp_ns));
        }
    }
}
