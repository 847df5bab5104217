//! `ChoosePush`: of what was told apart on a table, chooses the push that tells the most about what is one thing.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use armarium_visionx::segmentation::{Hypothesis, PushChoice};
use nalgebra::{Point2, Vector2, Vector3};

use crate::arm::{chosen, names_the_arm, workspace};
use crate::equipment::{self, Equipment};
use crate::grasp::hand;
use crate::hypotheses::{RememberedHypothesis, hypotheses};
use crate::inputs::{as_flat_point, flat_point_value};

/// The outcome when no push would tell anything.
const SETTLED: &str = "settled";
/// Half the thickness of both closed fingers, m.
const HALF_CLOSED: f64 = 0.008;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ChoosePush",
        "Chooses which of the things that SegmentScene told apart is to be pushed, from where and to where.",
    );
    let manifest = names_the_arm(manifest)
        .input(
            "reach",
            Type::list(Type::list(Type::FLOAT)),
            "Two corners (x, y) of where fingers and things may be, root frame, m.",
        )
        .optional("most", Type::Int, 3, "How often one is pushed at most.")
        .output("of", Type::String, "What is to be pushed, by its name in memory.")
        .output("from", Type::list(Type::FLOAT), "Where the finger comes down (x, y), root frame, m.")
        .output("to", Type::list(Type::FLOAT), "Where the push ends (x, y), root frame, m.")
        .output("table", Type::quantity(Unit::M), "Height of the table there.")
        .outcome(SETTLED);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let now = equipment.robot.sensed().borrow().position.clone();
    // The pads' width is along the TCP's z.
    let longer = workspace(model, arm, &now)?.rotation * Vector3::z();
    let longer = longer.xy().try_normalize(1e-6).unwrap_or_else(Vector2::y);
    let half = [hand(model, arm)?.pad_width / 2.0, HALF_CLOSED];
    let bounds = corners(context.value("reach")?)
        .ok_or_else(|| Failure::new("`reach` needs two corners of two numbers each"))?;
    let choice = PushChoice { bounds, finger: (longer, half), most: context.number("most")? as u32 };
    let known = hypotheses(&equipment).await?;
    let all: Vec<Hypothesis> = known.iter().map(|known| known.hypothesis.clone()).collect();
    let Some(push) = choice.best(&all) else { return Ok(Outcome::named(SETTLED)) };
    let table =
        known.iter().find(|known| known.hypothesis.name == push.of).map_or(0.0, RememberedHypothesis::table);
    Ok(Outcome::success()
        .with("of", push.of.as_str())
        .with("from", flat_point_value(&push.from))
        .with("to", flat_point_value(&push.to))
        .with("table", table))
}

fn corners(value: &Value) -> Option<[Point2<f64>; 2]> {
    let [a, b] = value.as_list()? else { return None };
    Some([as_flat_point(a)?, as_flat_point(b)?])
}
