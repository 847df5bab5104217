//! `LookAt`: turns the head until the cameras look at a point, and keeps it so for a time while the body moves.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Point3, Vector3};

use crate::arm::{Senses, chosen, names_the_arm, workspace};
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};
use crate::inputs::Inputs;

/// Largest speed of a joint, rad/s.
const SPEED: f64 = 1.0;
/// How long the gaze must rest on the point, s.
const REST_TIME: f64 = 0.3;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "LookAt",
        "Turns the head until the eyes look at a point; cameras that nothing turns have to have it in view.",
    )
    .optional(
        "point",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "Where to look: x, y, z in the root frame, m; empty: where the arm works.",
    )
    .optional(
        "offset",
        Type::list(Type::FLOAT),
        vec![0.0, 0.0, 0.0],
        "How far beside the point, m: away from the robot's middle to the arm's side, forward, up.",
    )
    .optional("tolerance", Type::quantity(Unit::RAD), 0.03, "How near the gaze must be.")
    .optional("timeout", Type::Duration, 5.0, "Longest time until the gaze rests there.")
    .optional(
        "keep",
        Type::Duration,
        0.0,
        "How long it goes on looking there, also while the body moves.",
    );
    equipment::skill(equipment, moves_the_head(names_the_arm(manifest), equipment), run)
}

/// The place that the inputs `point` and `offset` name, or where the arm works; root frame, m.
pub(crate) fn point(equipment: &Equipment, context: &SkillContext) -> Result<Point3<f64>, Failure> {
    let arm = chosen(equipment, context);
    let model = equipment.robot.model();
    let point = match context.vector_if_given("point")? {
        Some(point) => point,
        None => {
            let now = equipment.robot.sensed().borrow();
            workspace(model, arm.clone()?, &now.position)?.translation.vector
        }
    };
    let outwards = arm.map_or(1.0, |arm| model.side_of(arm));
    let offset = context.vector("offset")?.component_mul(&Vector3::new(outwards, 1.0, 1.0));
    Ok(Point3::from(point + offset))
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let point = point(&equipment, &context)?;
    let (timeout, keep) = (context.number("timeout")?, context.number("keep")?.max(0.0));
    let mut head = Head::take(&equipment, &context)?;
    // Cameras that nothing turns look at what is inside of the cone that their pictures hold.
    let (turns, cone) = (head.turns(), equipment.images.calibration().camera.cone());
    let tolerance = if turns { context.number("tolerance")? } else { cone };
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut elapsed, mut reached_for) = (0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let angle = head.look(&sample, dt, &point, SPEED)?;
        let has_rested = reached_for > REST_TIME;
        let looks = angle < tolerance || has_rested;
        reached_for = if looks { reached_for + dt } else { 0.0 };
        if reached_for > REST_TIME + keep {
            return Ok(Outcome::success());
        }
        if !turns && !looks {
            return Err(Failure::new(format!(
                "nothing turns the cameras, and the point is {angle:.2} rad off their axis; they see {cone:.2} rad to each side"
            )));
        }
        if elapsed > timeout && !has_rested {
            return Err(Failure::new(format!(
                "the eyes are still {angle:.2} rad off the point after {timeout:.0} s: it is out of the head's range"
            )));
        }
    }
}
