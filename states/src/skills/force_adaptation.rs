//! `ForceAdaptation`: lowers the tool until it touches, then learns, cycle by cycle, the motion towards the surface
//! that keeps the desired force. Nobody told the robot the surface's height, tilt or bumps.

use std::sync::Arc;

use armarium_motion::{SurfaceAdaptation, SurfaceConfig, Touchdown, TouchdownConfig, TouchdownStatus};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::inputs::reference;
use crate::motions::{self, failed};
use crate::reach::required_speed;
use crate::wiper::{ContactWatch, GraspedTool, Height, Wiper};

/// Cycles before which the force does not count as settled.
const LEAST_CYCLES: u32 = 4;
/// How far below the place where the tool stood at the grasp the surface may be, m.
const DEEPEST: f64 = 0.05;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
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
    .mark(Mark::at_start("adaptation_started"))
    .mark(
        Mark::at_success("adaptation_ended").with_input("desired_n", "force").with_output("cycles", "cycles"),
    )
    .limb("torso")
    .limb("right_arm");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let tool = GraspedTool::of(&context)?;
    let force = context.number("force")?;
    let mut wiper = Wiper::take(&equipment, &context, tool.tcp.rotation).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    required_speed(&equipment, wiper.motion(), &tool.tcp, tool.standing_height())?;

    wiper.start_nearest(&senses.newest())?;
    wiper.approach(&mut senses, tool.standing_height() + context.number("hover")?, 0.2).await?;
    equipment.robot.tare();
    let z = touch_down(&context, &mut wiper, &mut senses, force).await?;
    let surface = learn(&context, &mut wiper, &mut senses, force, z).await?;

    let correction = surface.correction().clone();
    let stamp_ns = senses.newest().stamp_ns;
    motions::change(&*equipment.memory, wiper.id(), stamp_ns, |motion| {
        let mut primitive = motion.primitive().clone();
        let centre = primitive.centre().to_vec();
        primitive.set_centre(&[centre[0], centre[1], z]).map_err(failed)?;
        let fitted = motion.next_version(primitive, "force adaptation").map_err(failed)?;
        Ok(fitted.with_surface(Some(correction.clone())))
    })
    .await?;
    Ok(Outcome::success()
        .with("motion", reference("Motion", wiper.id()))
        .with("cycles", i64::from(surface.cycles()))
        .with("rms", surface.rms().last().copied().unwrap_or(f64::NAN))
        .with("stiffness", surface.stiffness()))
}

/// Lowers the tool until the force is reached; returns the height of the TCP there, m.
async fn touch_down(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    force: f64,
) -> Result<f64, Failure> {
    let hover = context.number("hover")?;
    let config = TouchdownConfig { force, farthest: hover + DEEPEST, ..TouchdownConfig::default() };
    let mut touchdown = Touchdown::new(config).map_err(failed)?;
    let mut z = wiper.arm.tcp(&senses.newest()).translation.z;
    loop {
        let (sample, dt) = senses.next().await?;
        let rate = touchdown.step(dt, sample.wrist.force.z).map_err(failed)?;
        z += rate * dt;
        wiper.step(&sample, dt, 0.0, Height { z, rate })?;
        match touchdown.status() {
            TouchdownStatus::Approaching | TouchdownStatus::Pressing => {}
            TouchdownStatus::Done => return Ok(z),
            TouchdownStatus::NoSurface => {
                return Err(Failure::new(format!(
                    "no surface was felt {:.0} mm below where the tool was grasped; is the tool still in the hand?",
                    DEEPEST * 1e3
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

/// Runs the motion and learns the surface until the force stays within tolerance, then brakes, still pressing.
async fn learn(
    context: &SkillContext,
    wiper: &mut Wiper,
    senses: &mut Senses,
    force: f64,
    z: f64,
) -> Result<SurfaceAdaptation, Failure> {
    let tolerance = context.number("tolerance")?;
    let most_cycles = context.number("cycles")?;
    let config = SurfaceConfig { force, ..SurfaceConfig::default() };
    let mut surface = SurfaceAdaptation::new(config).map_err(failed)?;
    let mut contact = ContactWatch::default();
    let mut omega = 0.0;
    loop {
        let (sample, dt) = senses.next().await?;
        let pressing = sample.wrist.force.z;
        contact.check(dt, pressing)?;
        let command = surface.step(dt, wiper.phase(), omega, pressing).map_err(failed)?;
        let settled = surface.cycles() >= LEAST_CYCLES && surface.settled(tolerance);
        let pace = if settled { 0.0 } else { surface.pace() };
        let height = Height { z: z + command.offset, rate: command.velocity };
        omega = wiper.step(&sample, dt, pace, height)?.omega;
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
