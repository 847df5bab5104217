//! `ResetStop`: ends a stop of the robot.

use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};

use crate::equipment::{self, Equipment};

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ResetStop",
        "Ends a stop of the robot, so that its limbs can be commanded again; who uses it has seen to it that this is safe.",
    );
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, _: SkillContext) -> SkillResult {
    equipment.robot.reset();
    Ok(Outcome::success())
}
