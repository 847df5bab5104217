//! `SqueezeTogether`: takes an object between both hands. They go beside it, come nearer until each has felt it, and squeeze.

use armarium_motion::{Holding, LinePoint, LoadStatus, SharedLoad, SharedLoadConfig, StraightLine};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit as UnitVector, UnitQuaternion, Vector3};

use crate::arm::{Senses, tcp_of};
use crate::both::{BothArms, STIFFNESS, arms, at_rest, config, moves_both, squeezes};
use crate::equipment::{self, Equipment};
use crate::inputs::Inputs;
use crate::motions::failed;

/// How far beside the object the hands wait before they come nearer, m.
const BESIDE: f64 = 0.06;
/// How far beyond where the object's side is believed to be a hand looks for it, m.
const BEYOND: f64 = 0.06;
/// The speed on the way there, and with which the hands come nearer, m/s.
const SPEED: f64 = 0.15;
const APPROACH: f64 = 0.03;
/// A hand that feels this for so long touches, N and s.
const TOUCHES: (f64, f64) = (2.5, 0.01);
/// How near the hands have to be to where they wait, m.
const NEAR: f64 = 0.01;
/// The squeeze is right within this share, for so long, s; it takes no longer than that, s.
const SQUEEZED: (f64, f64, f64) = (0.1, 0.3, 15.0);
/// How stiff the contacts are is measured from this share of the squeeze on: before, a face does not lie flat yet. A force of less than
/// this tells nothing of it, N, and a way of less than this is not told from none, m.
const FROM: f64 = 0.4;
const RISE: f64 = 3.0;
const RESOLVED: f64 = 2e-4;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "SqueezeTogether",
        "Takes an object between both hands: from beside it nearer until each hand feels it, and then with the squeeze. Tare both before.",
    )
    .input("object", Type::object(), "The object in memory; a box.");
    let manifest = squeezes(manifest)
        .output("force", Type::quantity(Unit::N), "With what the hands press against each other.")
        .output(STIFFNESS, Type::quantity(Unit::N_M), "How stiff the contacts are: by how much more the hands press for a metre by which each comes nearer; 0 where they hardly pressed more.")
        .mark(Mark::at_success("load_taken"));
    equipment::skill(equipment, moves_both(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let config = config(&equipment, &context)?;
    let (class, object) = equipment.remembered().thing(&context.entity("object")?).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let model = equipment.robot.model();
    let mut motions = Vec::new();
    for arm in arms(model)? {
        let now = model.link_pose(&senses.newest().position, tcp_of(arm)?);
        motions.push(object.translation.vector - now.translation.vector);
    }
    let mut both = BothArms::take(&equipment, &context, &motions, Holding::Pressing).await?;
    let sides = sides(&object, &class.size.into(), &both.faces(&senses.newest()));
    for (hand, side) in sides.iter().enumerate() {
        let pressing = both.tcp_at(hand, side);
        both.arm(hand).pull_towards_pose(&senses.newest(), &pressing);
    }
    go_beside(&mut both, &mut senses, &sides).await?;
    touch(&mut both, &mut senses, &sides).await?;
    let (force, stiffness) = squeeze(&mut both, &mut senses, config).await?;
    Ok(Outcome::success().with("force", force).with(STIFFNESS, stiffness))
}

/// The faces of both hands on two opposite sides of a box: those across which the hands are.
fn sides(
    root_from_box: &Isometry3<f64>,
    size: &Vector3<f64>,
    faces: &[Isometry3<f64>; 2],
) -> [Isometry3<f64>; 2] {
    let apart = faces[0].translation.vector - faces[1].translation.vector;
    let axes = [0, 1].map(|k| root_from_box.rotation * Vector3::ith(k, 1.0));
    let k = usize::from(axes[1].dot(&apart).abs() > axes[0].dot(&apart).abs());
    let outwards = axes[k] * axes[k].dot(&apart).signum();
    let side = |hand: usize, out: Vector3<f64>| {
        let at = root_from_box.translation.vector + out * (size[k] / 2.0);
        Isometry3::from_parts(at.into(), pressing(&-out, &faces[hand].rotation))
    };
    [side(0, outwards), side(1, -outwards)]
}

/// The orientation of a face that presses in a direction, turned from its present one as little as can be.
fn pressing(direction: &Vector3<f64>, now: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let x = UnitVector::new_normalize(*direction);
    let along = now * Vector3::y();
    let along = (along - x.into_inner() * x.dot(&along)).normalize();
    let axes = Matrix3::from_columns(&[x.into_inner(), along, x.cross(&along)]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// A face, so far back from its side, m.
fn back(side: &Isometry3<f64>, way: f64) -> Isometry3<f64> {
    Translation3::from(side.rotation * Vector3::x() * -way) * side
}

async fn go_beside(
    both: &mut BothArms,
    senses: &mut Senses,
    sides: &[Isometry3<f64>; 2],
) -> Result<(), Failure> {
    let start = both.resting(&senses.newest());
    let line = |hand: usize| {
        let goal = both.tcp_at(hand, &back(&sides[hand], BESIDE));
        StraightLine::new(start[hand].pose, goal, SPEED).map_err(failed)
    };
    let mut lines = [line(0)?, line(1)?];
    let longest = 2.0 + lines.iter().map(StraightLine::duration).fold(0.0, f64::max);
    loop {
        let (sample, dt) = senses.next().await?;
        let [first, second] = &mut lines;
        let goals = [first.step(dt).map_err(failed)?, second.step(dt).map_err(failed)?];
        let far = both.track(&sample, &goals)?;
        if lines.iter().all(|line| line.rested(0.3)) && far < NEAR {
            return Ok(());
        }
        if lines.iter().all(|line| line.rested(longest)) {
            return Err(Failure::new(format!(
                "the hands do not come beside the object: {:.0} mm are missing; is it where both arms reach?",
                far * 1e3
            )));
        }
    }
}

/// Comes nearer until both hands feel the object. One that does waits for the other.
async fn touch(both: &mut BothArms, senses: &mut Senses, sides: &[Isometry3<f64>; 2]) -> Result<(), Failure> {
    let mut way = [0.0; 2];
    let mut felt = [0.0; 2];
    let mut stays: [Option<LinePoint>; 2] = [None; 2];
    while stays.iter().any(Option::is_none) {
        let (sample, dt) = senses.next().await?;
        let hands = both.on_load(&sample)?;
        let mut goals = both.resting(&sample);
        for i in 0..2 {
            let inwards = sides[i].rotation * Vector3::x();
            let pressed = -hands[i].wrench.fixed_rows::<3>(0).dot(&inwards);
            felt[i] = if pressed > TOUCHES.0 { felt[i] + dt } else { 0.0 };
            if felt[i] > TOUCHES.1 {
                stays[i].get_or_insert(goals[i]);
            }
            if let Some(stay) = stays[i] {
                goals[i] = stay;
                continue;
            }
            way[i] += APPROACH * dt;
            if way[i] > BESIDE + BEYOND {
                return Err(Failure::new("a hand does not feel the object where it was seen"));
            }
            let pose = both.tcp_at(i, &back(&sides[i], BESIDE - way[i]));
            goals[i] = LinePoint { pose, linear: inwards * APPROACH, angular: Vector3::zeros() };
        }
        both.track(&sample, &goals)?;
    }
    Ok(())
}

/// Squeezes until that is right and steady; returns the force, N, and how stiff the contacts are, N/m, or 0 where that is not known.
async fn squeeze(
    both: &mut BothArms,
    senses: &mut Senses,
    config: SharedLoadConfig,
) -> Result<(f64, f64), Failure> {
    let least = config.squeeze;
    let mut law = SharedLoad::new(config, &both.on_load(&senses.newest())?).map_err(failed)?;
    let rest = at_rest(*law.taken());
    let (mut right, mut waited) = (0.0, 0.0);
    let (near, long, longest) = SQUEEZED;
    let mut first = None;
    loop {
        let (sample, dt) = senses.next().await?;
        let hands = both.on_load(&sample)?;
        let apart = (hands[1].contact - hands[0].contact).norm();
        let step = law.step(dt, &hands, &rest).map_err(failed)?;
        both.track(&sample, &step.hands)?;
        let squeeze = step.forces.squeeze;
        if squeeze > least * FROM {
            first.get_or_insert((squeeze, apart));
        }
        let is_right = step.wanted >= least && (squeeze - step.wanted).abs() < near * step.wanted;
        right = if is_right { right + dt } else { 0.0 };
        waited += dt;
        if right > long && step.status == LoadStatus::Held {
            let (before, was_apart) = first.unwrap_or((squeeze, apart));
            let closed = ((was_apart - apart) / 2.0).max(RESOLVED);
            let rise = squeeze - before;
            return Ok((squeeze, if rise > RISE { rise / closed } else { 0.0 }));
        }
        if waited > longest {
            return Err(Failure::new(format!(
                "the hands press with {squeeze:.0} N against each other, and {:.0} N are wanted",
                step.wanted
            )));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_go_to_the_sides_that_are_across_them() {
        let face = |x: f64| {
            let inwards = Vector3::x() * -x.signum();
            let now = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), if x > 0.0 { 3.1 } else { 0.05 });
            Isometry3::from_parts(Vector3::new(x, 0.45, 1.0).into(), pressing(&inwards, &now))
        };
        let faces = [face(0.3), face(-0.3)];
        let turned = |yaw: f64| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            Isometry3::from_parts(Vector3::new(0.05, 0.5, 1.05).into(), rotation)
        };
        let size = Vector3::new(0.4, 0.3, 0.2);
        for (yaw, half) in [(0.1, 0.2), (1.4, 0.15), (-0.2, 0.2)] {
            let at = turned(yaw);
            let [first, second] = sides(&at, &size, &faces);
            let off = first.translation.vector - at.translation.vector;
            assert!((off.norm() - half).abs() < 1e-12 && off.x > 0.1, "{yaw}: {off}");
            assert!((second.translation.vector - at.translation.vector + off).norm() < 1e-12);
            for (side, face) in [(first, faces[0]), (second, faces[1])] {
                let inwards = side.rotation * Vector3::x();
                assert!(inwards.dot(&(at.translation.vector - side.translation.vector)) > 0.99 * half);
                assert!(side.rotation.angle_to(&face.rotation) < 0.3, "{yaw}");
            }
        }
    }
}
