//! `Tare`: takes what the wrist sensor feels of the resting hand as zero.

use std::sync::Arc;
use std::time::Duration;

use armarium_robot::Sensed;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};

use crate::arm::{ArmLeases, Senses, chosen, force_at, moves_the_arm, sensor_of};
use crate::equipment::{self, Equipment};
use crate::motions::failed;

/// How long the arm must rest before, s: the robot averages the last 0.1 s, behind a low-pass of 5 ms.
const REST: f64 = 0.15;
/// How long the arm must rest afterwards, s, so that the next skill sees the new zero.
const SETTLE: f64 = 0.05;
/// A joint that is faster than this moves, rad/s: 50 times the noise of the joint sensors.
const STANDING: f64 = 0.01;
/// A robot that sends no sample for this long is silent.
const SILENT_AFTER: Duration = Duration::from_millis(500);

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "Tare",
        "Takes what the wrist sensor feels of the resting hand as zero; nothing may touch the hand.",
    )
    .optional("timeout", Type::Duration, 2.0, "How long to wait until the arm rests.")
    .output(
        "force",
        Type::list(Type::quantity(Unit::N)),
        "What was felt before and is zero now, root frame.",
    );
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let timeout = context.number("timeout")?;
    let model = equipment.robot.model();
    let arm = chosen(&equipment, &context)?;
    let sensor = sensor_of(arm)?;
    let joints = model.reaching_joints(&arm.name);
    // Limbs that are held without a command stand still.
    let held = ArmLeases::take(&equipment, &context, arm, (&arm.helped_by, &[])).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut waited, mut rested) = (0.0, 0.0);
    let felt = loop {
        let (sample, dt) = next(&mut senses, &held).await?;
        let fastest = fastest_of(&joints, &sample);
        waited += dt;
        rested = if fastest < STANDING { rested + dt } else { 0.0 };
        if rested > REST {
            break force_at(sensor, &sample);
        }
        if waited > timeout {
            return Err(Failure::new(format!(
                "the arm still moves after {timeout:.1} s, a joint at {fastest:.2} rad/s: does something push it?"
            )));
        }
    };
    equipment.robot.tare(&model.wrenches()[sensor].name).map_err(failed)?;
    let mut settled = 0.0;
    while settled < SETTLE {
        let (sample, dt) = next(&mut senses, &held).await?;
        settled += dt;
        let fastest = fastest_of(&joints, &sample);
        if fastest >= STANDING {
            return Err(Failure::new(format!(
                "the arm moved while it was tared, a joint at {fastest:.2} rad/s: tare again when it rests"
            )));
        }
    }
    Ok(Outcome::success().with("force", Value::from([felt.x, felt.y, felt.z])))
}

/// The next sample of a robot that is not silent, with the time since the one before, s.
async fn next(senses: &mut Senses, held: &ArmLeases) -> Result<(Arc<Sensed>, f64), Failure> {
    let next = tokio::time::timeout(SILENT_AFTER, senses.next()).await.map_err(|_| {
        Failure::new(format!("the robot has sent no sample for {} ms", SILENT_AFTER.as_millis()))
    })??;
    held.lease.fault().map_or(Ok(next), |fault| Err(failed(fault)))
}

/// Speed of the fastest joint that moves the hand, rad/s.
fn fastest_of(joints: &[usize], sample: &Sensed) -> f64 {
    joints.iter().map(|&joint| sample.velocity[joint].abs()).fold(0.0, f64::max)
}
