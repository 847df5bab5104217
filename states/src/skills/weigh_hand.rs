//! `WeighHand`: takes the wrist force of the hand in its present state as zero.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::Vector3;

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::equipment::{self, Equipment};

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "WeighHand",
        "Measures the upward force on the resting hand; weights are compared at equal posture.",
    )
    .optional("duration", Type::Duration, 0.5, "How long to average.")
    .output("force", Type::quantity(Unit::N), "Mean upward force on the hand.");
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let duration = context.number("duration")?;
    let mut arm = LeasedArm::take(&equipment, &context, &[]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let force = mean_force(&mut arm, &mut senses, duration).await?;
    Ok(Outcome::success().with("force", force.z))
}

/// The mean compensated wrist force over `duration` s with the arm at rest, root frame, N.
pub(crate) async fn mean_force(
    arm: &mut LeasedArm,
    senses: &mut Senses,
    duration: f64,
) -> Result<Vector3<f64>, Failure> {
    let (mut elapsed, mut samples, mut sum) = (-0.2, 0.0, Vector3::zeros());
    while elapsed < duration {
        let (sample, dt) = senses.next().await?;
        arm.hold(&sample)?;
        elapsed += dt;
        if elapsed > 0.0 {
            sum += arm.force(&sample)?;
            samples += 1.0;
        }
    }
    Ok(sum / f64::max(samples, 1.0))
}
