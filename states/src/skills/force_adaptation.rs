//! `ForceAdaptation`: lowers the tool until it touches, then learns, cycle by cycle, the motion along the surface
//! that keeps the desired force. The robot does not know the surface's height, tilt or bumps beforehand. If the
//! motion was fitted before, learning starts from the stored surface.

use armarium_motion::{
    MotionError, SurfaceAdaptation, SurfaceConfig, SurfaceCorrection, Touchdown, TouchdownConfig,
    TouchdownStatus,
};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::{Senses, moves_the_arm, sensor_of};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, reference};
use crate::motions::failed;
use crate::reach::required_speed;
use crate::wiper::{ContactWatch, GraspedTool, Height, Wiper};

/// Least number of cycles before the force can count as settled.
const MIN_CYCLES: u32 = 4;
/// How far the surface may be below the tool's height at the grasp, m.
const MAX_DEPTH: f64 = 0.05;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ForceAdaptation",
        "Lowers the tool until it touches, then learns the motion towards the surface that keeps the force.",
    )
    .input("motion", Type::motion(), "The motion to fit to the surface.")
    .input("force", Type::quantity(Unit::N), "Desired normal force.")
    .input("grasp", Type::map(Type::Any), "How the tool was grasped.")
    .optional(
        "tolerance",
        Type::quantity(Unit::N),
        0.7,
        "Root mean square force error of two cycles that is good enough.",
    )
    .optional("cycles", Type::Int, 30_i64, "Cycles after which it is given up.")
    .optional(
        "hover",
        Type::quantity(Unit::M),
        0.03,
        "Height over the surface from which the tool is lowered.",
    )
    .output("motion", Type::motion(), "The motion, with what was learned of the surface.")
    .output("cycles", Type::Int, "Cycles that were needed.")
    .output("rms", Type::quantity(Unit::N), "Root mean square force error of the last cycle.")
    .output("stiffness", Type::quantity(Unit::N_M), "Stiffness of the contact.")
    .publishes("motion")
    .mark(Mark::at_start("adaptation_started"))
    .mark(
        Mark::at_success("adaptation_ended").with_input("desired_n", "force").with_output("cycles", "cycles"),
    );
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let tool = GraspedTool::of(&context)?;
    let force = context.number("force")?;
    let mut wiper = Wiper::take(&equipment, &context, &tool).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    required_speed(&equipment, &wiper, 0.0)?;

    wiper.start_nearest(&senses.newest())?;
    let rise = wiper.rise_from(&tool);
    let above = context.number("hover")? + rise;
    wiper.approach(&mut senses, above, 0.2).await?;
    let sensor = sensor_of(&wiper.arm.limb)?;
    equipment.robot.tare(&equipment.robot.model().wrenches()[sensor].name).map_err(failed)?;
    let fitted = fit(&context, &mut wiper, &mut senses, (force, rise)).await;
    // Changes by coaches meanwhile are kept even after a failure.
    let learned = fitted.as_ref().ok().map(|surface| (surface.correction(), "force adaptation"));
    let (correction, learned_from) = learned.unzip();
    wiper.finish(correction, learned_from).await?;
    let surface = fitted?;
    Ok(Outcome::success()
        .with("motion", reference("Motion", &context.entity("motion")?))
        .with("cycles", i64::from(surface.cycles()))
        .with("rms", surface.rms().last().copied().unwrap_or(f64::NAN))
        .with("stiffness", surface.stiffness()))
}

/// Touches down and learns the surface; the motion's height becomes that of its path over the surface.
async fn fit(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    (force, rise): (f64, f64),
) -> Result<SurfaceAdaptation, Failure> {
    let touched = touch_down(context, wiper, senses, (force, rise)).await?;
    let normal = wiper.normal().into_inner().into();
    let config = SurfaceConfig { force, normal, ..SurfaceConfig::default() };
    let (surface, over) = begin(config, wiper.motion().surface(), touched, wiper.phase()).map_err(failed)?;
    let surface = learn(context, wiper, senses, surface, over).await?;
    wiper.set_height(over)?;
    Ok(surface)
}

/// The adaptation at the start, where the tool touches the surface at the height `touched` (m) and `phase`,
/// initialised with the `known` surface. Also returns the height to which its offsets are added.
fn begin(
    config: SurfaceConfig,
    known: Option<&SurfaceCorrection>,
    touched: f64,
    phase: f64,
) -> Result<(SurfaceAdaptation, f64), MotionError> {
    match known {
        Some(known) => {
            // What was learned are the offsets along the normal; the surface may now be tilted otherwise.
            let (weights, width) = (known.weights().to_vec(), known.kernels().width());
            let here = SurfaceCorrection::new(weights, width, config.normal)?;
            Ok((SurfaceAdaptation::resume(config, here, phase)?, touched - known.offset(phase)))
        }
        None => Ok((SurfaceAdaptation::new(config)?, touched)),
    }
}

/// Lowers the tool until the force is reached; returns the TCP's height there over where the tool was grasped, m. The surface may
/// be `rise` m higher or lower than that.
async fn touch_down(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    (force, rise): (f64, f64),
) -> Result<f64, Failure> {
    let hover = context.number("hover")?;
    let config =
        TouchdownConfig { force, farthest: hover + 2.0 * rise + MAX_DEPTH, ..TouchdownConfig::default() };
    let mut touchdown = Touchdown::new(config).map_err(failed)?;
    let mut over = wiper.height(&senses.newest());
    loop {
        let (sample, dt) = senses.next().await?;
        let rate = touchdown.step(dt, wiper.touch(&sample, dt)?).map_err(failed)?;
        over += rate * dt;
        wiper.step(&sample, dt, 0.0, Height { over, rate })?;
        match touchdown.status() {
            TouchdownStatus::Approaching | TouchdownStatus::Pressing => {}
            TouchdownStatus::Done => return Ok(over),
            TouchdownStatus::NoSurface => {
                return Err(Failure::new(format!(
                    "no surface was felt {:.0} mm below where the tool was grasped; is the tool still in the hand?",
                    MAX_DEPTH * 1e3
                )));
            }
            TouchdownStatus::NotReached => {
                return Err(Failure::new(format!(
                    "the surface was touched, but {force:.0} N were not reached"
                )));
            }
        }
    }
}

/// Runs the motion and learns the surface until the force stays within tolerance. Then brakes while still pressing.
async fn learn(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    mut surface: SurfaceAdaptation,
    over: f64,
) -> Result<SurfaceAdaptation, Failure> {
    let tolerance = context.number("tolerance")?;
    let most_cycles = context.number("cycles")?;
    let mut contact = ContactWatch::default();
    let mut omega = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        let pressing = wiper.pressing(&sample)?;
        contact.check(dt, pressing)?;
        let command = surface.step(dt, wiper.phase(), omega, pressing).map_err(failed)?;
        let settled = surface.cycles() >= MIN_CYCLES && surface.settled(tolerance);
        let pace = if settled { 0.0 } else { surface.pace() };
        let height = Height { over: over + command.offset, rate: command.velocity };
        omega = wiper.step(&sample, dt, pace, height)?;
        if settled && wiper.pace() == 0.0 {
            return Ok(surface);
        }
        if f64::from(surface.cycles()) >= most_cycles {
            return Err(Failure::new(format!(
                "the force did not settle within {most_cycles:.0} cycles: the last one was {:.1} N off (root mean square), \
                 {tolerance:.1} N are allowed",
                surface.rms().last().copied().unwrap_or(f64::NAN)
            )));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_was_fitted_before_begins_from_what_was_learned() {
        let weights = (0..36).map(|i| 1e-3 * f64::from(i % 7)).collect();
        let known = SurfaceCorrection::new(weights, 90.0, [0.0, 0.0, 1.0]).unwrap();
        let (phase, touched) = (1.3, 0.72);
        let (mut surface, z) = begin(SurfaceConfig::default(), Some(&known), touched, phase).unwrap();
        // The hand keeps its contact height, and follows the known surface from there.
        let force = SurfaceConfig::default().force;
        let first = surface.step(1e-3, phase, 0.0, force).unwrap();
        assert!((z + first.offset - touched).abs() < 1e-9);
        let mut later = first;
        for k in 1..=400 {
            later = surface.step(1e-3, phase + 0.003 * f64::from(k), 3.0, force).unwrap();
        }
        assert!((later.offset - known.offset(phase + 1.2)).abs() < 1e-4);
        let (_, unknown) = begin(SurfaceConfig::default(), None, touched, phase).unwrap();
        assert_eq!(unknown, touched);
    }
}
