//! `AttendTo`: says that a thing will be needed, until it is cancelled. It moves nothing: whoever turns the eyes looks at the thing, too.

use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::inputs::Inputs;

/// So exactly the thing's place is to be known, m: well enough to reach for it.
const WITHIN: f64 = 0.03;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "AttendTo",
        "Says that a thing will be needed soon, so that the eyes do not lose it, until it is cancelled.",
    )
    .input("object", Type::object(), "The thing in memory.")
    .attends("object", WITHIN, 1.0);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    context.entity("object")?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    loop {
        senses.next().await?;
    }
}
