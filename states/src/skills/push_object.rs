//! `PushObject`: pushes something on a table with the closed fingers, with little force, and leaves it alone again.
//!
//! The hand keeps the orientation of the posture in which it is ready, with its fingers down. It goes over the place, down beside the thing,
//! straight on as far as it should or until the force is too large, a little back, and up. It sees nothing.

use armarium_motion::StraightLine;
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Vector2, Vector3};

use crate::arm::{LeasedArm, Senses, chosen, moves_the_arm, workspace};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, held_in_tcp};
use crate::inputs::as_flat_point;
use crate::motions::failed;

/// Height of the middle of the grasp over the table during the push, and of the hand on its ways, m.
const LOW: f64 = 0.028;
const HIGH: f64 = 0.16;
/// How far the fingers go back before they rise, m.
const BACK: f64 = 0.015;
/// Speed through the air, m/s, and how far from its line the TCP may be there, m.
const AIR: f64 = 0.15;
const OFF: f64 = 0.08;
/// How long the push may rest at its end, s.
const RESTS: f64 = 0.2;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "PushObject",
        "Pushes something on a table with the closed fingers from one place to another, until that or the largest force is reached, and rises.",
    )
    .input("from", Type::list(Type::FLOAT), "Where the fingers come down (x, y), root frame, m.")
    .input("to", Type::list(Type::FLOAT), "Where the push ends (x, y), root frame, m.")
    .input("table", Type::quantity(Unit::M), "Height of the table there, root frame.")
    .optional("speed", Type::quantity(Unit::M_S), 0.08, "Speed of the push.")
    .optional("force", Type::quantity(Unit::N), 15.0, "At a larger force the push ends.")
    .output("way", Type::quantity(Unit::M), "How far the fingers went.")
    .output("largest", Type::quantity(Unit::N), "The largest force along the table.")
    .mark(Mark::at_success("object_pushed"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let place = |name: &str| {
        let value = context.value(name)?;
        let point = as_flat_point(value).map(|point| point.coords);
        point.ok_or_else(|| Failure::input(name, "two numbers", value))
    };
    let (from, to, table) = (place("from")?, place("to")?, context.number("table")?);
    let limb = chosen(&equipment, &context)?.clone();
    let model = equipment.robot.model();
    let mut senses = Senses::new(&*equipment.robot, &context);
    let rotation = workspace(model, &limb, &senses.newest().position)?.rotation;
    let held = rotation * held_in_tcp(hand(model, &limb)?).coords;
    let tcp = |at: Vector2<f64>, height: f64| {
        Isometry3::from_parts((at.push(table + height) - held).into(), rotation)
    };
    let ways = [tcp(from, HIGH), tcp(from, LOW), tcp(to, LOW)];
    let mut arm = LeasedArm::take(&equipment, &context, &ways).await?;
    let pushed = push(&mut arm, &mut senses, &ways, &context).await;
    // Whatever happened, the hand goes back a little and rises before anybody else moves the arm.
    let mut here = arm.tcp(&senses.newest());
    if pushed.is_ok() {
        here.translation.vector -= (to - from).try_normalize(1e-6).unwrap_or_default().push(0.0) * BACK;
        arm.go(&mut senses, here, AIR / 2.0, near).await?;
    }
    here.translation.z = ways[0].translation.z;
    arm.go(&mut senses, here, AIR, near).await?;
    let (way, largest) = pushed?;
    Ok(Outcome::success().with("way", way).with("largest", largest))
}

/// Goes over the first place, down, and pushes. Returns how far, m, and the largest force along the table, N.
async fn push(
    arm: &mut LeasedArm,
    senses: &mut Senses,
    [over, down, end]: &[Isometry3<f64>; 3],
    context: &SkillContext,
) -> Result<(f64, f64), Failure> {
    let (speed, most) = (context.number("speed")?, context.number("force")?);
    arm.go(senses, *over, AIR, near).await?;
    let free = arm.force(&senses.newest())?;
    let mut line = StraightLine::new(arm.tcp(&senses.newest()), *down, AIR / 2.0).map_err(failed)?;
    while !line.rested(RESTS) {
        let (sample, dt) = senses.next().await?;
        let point = line.step(dt).map_err(failed)?;
        near(arm.track(&sample, &point.pose, point.linear, point.angular)?)?;
        let force = (arm.force(&sample)? - free).norm();
        if force > most {
            return Err(Failure::new(format!(
                "the fingers met something on their way down, with {force:.0} N; nothing may stand where they come down"
            )));
        }
    }
    let begin = arm.tcp(&senses.newest());
    let free = arm.force(&senses.newest())?;
    let mut line = StraightLine::new(begin, *end, speed).map_err(failed)?;
    let mut largest: f64 = 0.0;
    while !line.rested(RESTS) && largest < most {
        let (sample, dt) = senses.next().await?;
        let point = line.step(dt).map_err(failed)?;
        near(arm.track(&sample, &point.pose, point.linear, point.angular)?)?;
        largest = largest.max((arm.force(&sample)? - free).xy().norm());
    }
    arm.stand()?;
    let way: Vector3<f64> = arm.tcp(&senses.newest()).translation.vector - begin.translation.vector;
    Ok((way.norm(), largest))
}

/// That the hand follows its line.
fn near(off: f64) -> Result<(), Failure> {
    let why = || format!("the hand is {:.0} mm from its line; is the place within reach?", off * 1e3);
    if off < OFF { Ok(()) } else { Err(Failure::new(why())) }
}
