//! `KeepMotion`: stores the newest version of a motion in memory under a name.
//!
//! The long-term store follows the memory's `Motions` segment; this skill does not access it.

use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;

use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, reference};
use crate::motions;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest =
        SkillManifest::new("KeepMotion", "Keeps the newest version of a motion in memory under a name.")
            .input("motion", Type::motion(), "The motion.")
            .input("name", Type::String, "The name to keep it under.")
            .output("motion", Type::motion(), "The kept motion.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let newest = equipment.memory.latest(&context.entity("motion")?).await.map_err(motions::failed)?;
    let motion = motions::kept_in(&newest)?;
    let id = motions::address(&equipment.agent, context.text("name")?)?;
    let stamp_ns = equipment.robot.sensed().borrow().stamp_ns;
    motions::keep(&*equipment.memory, &id, &motion, stamp_ns).await?;
    Ok(Outcome::success().with("motion", reference("Motion", &id)))
}
