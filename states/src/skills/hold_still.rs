//! `HoldStill`: keeps a limb where it is, so that nobody else moves it, until it is cancelled.

use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;

use crate::arm::{Senses, lease};
use crate::equipment::{self, Equipment};
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "HoldStill",
        "Keeps a limb where it is until it is cancelled; what it would help moves without it.",
    )
    .input("limb", Type::String, "The limb, a group of the robot.");
    let limbs = equipment.robot.model().limbs().keys();
    let manifest = limbs.fold(manifest, |manifest, limb| manifest.limb_by_input("limb", limb, limb));
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let limb = context.text("limb")?;
    let lease = lease(&equipment, &context, limb, &[])?;
    let still = vec![0.0; equipment.robot.model().limb(limb).len()];
    let mut senses = Senses::new(&*equipment.robot, &context);
    loop {
        senses.next().await?;
        lease.command(&still).map_err(failed)?;
    }
}
