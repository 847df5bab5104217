//! `RecallMotion`: finds a motion of an earlier run in memory.

use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::equipment::{self, Equipment};
use crate::inputs::reference;
use crate::motions::{self, StoredMotion};

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new("RecallMotion", "Finds a kept motion in memory by its name.")
        .input("name", Type::String, "The name that it was kept under.")
        .output("motion", Type::motion(), "The motion.")
        .output("frequency", Type::quantity(Unit::HZ), "Its frequency; 0 of one that goes to a goal.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let snapshot = motions::find(&*equipment.memory, context.text("name")?).await?;
    let frequency = match motions::kept_in(&snapshot)? {
        StoredMotion::Motion(motion) => motion.frequency_hz(),
        StoredMotion::Movement(_) => 0.0,
    };
    Ok(Outcome::success().with("motion", reference("Motion", &snapshot.id)).with("frequency", frequency))
}
