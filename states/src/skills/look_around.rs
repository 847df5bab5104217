//! `LookAround`: turns the head so that the eyes pass over what is around the robot.

use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};

/// Largest speed of a joint, rad/s.
const SPEED: f64 = 0.8;
/// How far away the points are that are looked at, m.
const DISTANCE: f64 = 2.0;
/// Views beside each other are at most so far apart, rad: less than a camera sees at once.
const STEP: f64 = 0.5;
/// The gaze rests on a view when it is so near, rad, or comes nearer no more within so long, s.
const NEAR: f64 = 0.05;
const LONGEST: f64 = 2.0;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "LookAround",
        "Turns the head from one side to the other and back lower down, so that the eyes pass over what is around the robot.",
    )
    .optional("side", Type::quantity(Unit::RAD), 0.9, "How far to each side of straight ahead it looks.")
    .optional("down", Type::quantity(Unit::RAD), 0.7, "How far below the horizon it looks at most; the neck may reach less.")
    .optional("dwell", Type::Duration, 0.4, "How long it rests on each view.");
    equipment::skill(equipment, moves_the_head(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let mut head = Head::take(&equipment, &context)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let views = views(context.number("side")?.abs(), context.number("down")?);
    look_at_each(&mut head, &mut senses, &views, context.number("dwell")?, |_| Ok(())).await?;
    Ok(Outcome::success())
}

/// Turns the head to each of these views, as [`views`] gives them, and rests there for `dwell` s; `rests` is called at each sample while it
/// does, with the number of the view. A head that nothing turns looks where it looks, once.
pub(crate) async fn look_at_each(
    head: &mut Head,
    senses: &mut Senses,
    views: &[(f64, f64)],
    dwell: f64,
    mut rests: impl FnMut(usize) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let count = if head.turns() { views.len() } else { 1 };
    for (view, (turn, lower)) in views.iter().take(count).enumerate() {
        let (mut elapsed, mut rested) = (0.0, 0.0);
        while rested < dwell && elapsed < LONGEST + dwell {
            let (sample, dt) = senses.next().await?;
            let (eye, ahead) = head.straight(&sample);
            let angle = head.look(&sample, dt, &point(&eye, &ahead, *turn, *lower), SPEED)?;
            elapsed += dt;
            let there = angle < NEAR || !head.turns();
            rested = if there { rested + dt } else { 0.0 };
            if there {
                rests(view)?;
            }
        }
    }
    Ok(())
}

/// How far to the left and below the horizon each view is, rad: a row from one side to the other, and one back lower down.
pub(crate) fn views(side: f64, down: f64) -> Vec<(f64, f64)> {
    let count = (2.0 * side / STEP).ceil().clamp(1.0, 30.0);
    let turn = |i: u32| side * (2.0 * f64::from(i) / count - 1.0);
    let upper = (0..=count as u32).map(|i| (turn(i), 0.4 * down));
    let lower = (0..=count as u32).rev().map(|i| (turn(i), down));
    upper.chain(lower).collect()
}

/// A point to look at, root frame, m.
fn point(eye: &Point3<f64>, ahead: &Vector3<f64>, turn: f64, down: f64) -> Point3<f64> {
    let level = Vector3::new(ahead.x, ahead.y, 0.0).try_normalize(1e-6).unwrap_or_else(Vector3::y);
    let level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * level;
    eye + (level * libm::cos(down) - Vector3::z() * libm::sin(down)) * DISTANCE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_nearer_to_each_other_than_a_camera_sees() {
        let views = views(0.9, 0.7);
        assert_eq!(views.len(), 10);
        assert!(views.windows(2).all(|pair| (pair[0].0 - pair[1].0).abs() < STEP));
        assert!(views.contains(&(-0.9, 0.7)) && views.contains(&(0.9, 0.7)));
        let at = point(&Point3::new(0.0, 0.0, 1.6), &Vector3::new(0.0, 0.9, -0.4), 0.0, 0.7);
        assert!(at.x.abs() < 1e-9 && at.y > 0.0 && (at.z - (1.6 - 2.0 * libm::sin(0.7_f64))).abs() < 1e-9);
    }
}
