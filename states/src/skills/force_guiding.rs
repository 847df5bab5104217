//! `ForceGuiding`: the hand follows the force of a person who leads it, until they let go of it. The way that it was led is kept
//! as a motion.

use armarium_motion::{Admittance, AdmittanceConfig, GuidingStatus};
use armarium_robot::{Fault, Platform};
use armarium_runtime::skill::{Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Vector3, Vector6};

use crate::arm::{LeasedArm, Senses, chosen, moves_the_arm};
use crate::both::at_rest;
use crate::equipment::{self, Equipment};
use crate::inputs::reference;
use crate::led::LedWay;
use crate::motions::{self, failed};
use crate::platform::FollowingPlatform;

/// The outcomes besides `success`.
const NOBODY: &str = "nobody";
const SHOVED: &str = "shoved";
/// What moves.
const ARM: &str = "arm";
const ROBOT: &str = "robot";
/// A hand that went less than this was not led, m.
const LED: f64 = 0.02;
/// A shove is over this share of the force limit, so that the law stands before the guard gives way.
const SHOVE: f64 = 0.75;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "ForceGuiding",
        "Lets a person lead the arm's hand by the force on it, until they let go. Tare before, with the hand free.",
    )
    .optional("patience", Type::Duration, 60.0, "How long it waits to be led.")
    .optional("released", Type::Duration, 2.0, "How long the hand rests until it counts as let go.")
    .optional("name", Type::String, "led", "Name of the motion as which the way is kept.")
    .optional("moves", Type::one_of([ROBOT, ARM]), ROBOT, "What moves: `robot` is the arm with what helps it, and the platform beyond its reach; `arm` is the arm alone, where both hands are led.")
    .output("motion", Type::motion(), "The way as a motion: to its goal, or periodic where it repeats.")
    .output("way", Type::quantity(Unit::M), "Length of the way that the hand was led.")
    .output("force", Type::quantity(Unit::N), "Mean force with which it was led, or that of the shove.")
    .outcome(NOBODY)
    .outcome(SHOVED)
    .mark(Mark::at_start("guiding_started"));
    let manifest = match equipment.robot.model().platform() {
        Some(_) => manifest.limb_by_input("moves", ROBOT, Platform::LIMB),
        None => manifest,
    };
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (patience, released) = (context.number("patience")?, context.number("released")?);
    let alone = context.text("moves")? == ARM;
    let mut arm = if alone {
        LeasedArm::take_limb(&equipment, &context, chosen(&equipment, &context)?, &[]).await?
    } else {
        LeasedArm::take(&equipment, &context, &[]).await?
    };
    let mut way = LedWay::new()?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut platform = match alone {
        true => None,
        false => FollowingPlatform::after_hand(&equipment, &context, &arm.limb, &senses.newest())?,
    };
    let mut law = Admittance::new(config(&equipment, &context)).map_err(failed)?;
    let mut led = Led::default();
    loop {
        let (sample, dt) = senses.next().await?;
        if let Some(Fault::Force { force_n, .. }) = arm.leases.lease.fault() {
            return Ok(led.outcome(SHOVED, force_n));
        }
        let pose = arm.tcp(&sample);
        let step = law.step(dt, &arm.wrench(&sample)?, &pose.translation.vector).map_err(failed)?;
        match step.status {
            GuidingStatus::Shoved(force_n) => return Ok(led.outcome(SHOVED, force_n)),
            // Without a motion of the null space either, so that nothing drifts.
            GuidingStatus::Resting => {
                arm.stand()?;
                platform.as_mut().map_or(Ok(()), FollowingPlatform::stand)?;
            }
            GuidingStatus::Led => {
                let [linear, angular] = [0, 3].map(|row| step.twist.fixed_rows::<3>(row).into_owned());
                let carried = match &mut platform {
                    Some(platform) => {
                        platform.follow(dt, &sample, &at_rest(pose))?;
                        platform.carries(&sample, &pose.translation.vector).linear
                    }
                    None => Vector3::zeros(),
                };
                let mut possible = arm.twist(&sample, linear - carried, angular)?;
                possible.linear += carried;
                let both = possible.linear.iter().chain(&possible.angular).copied();
                law.hold_to(&Vector6::from_iterator(both)).map_err(failed)?;
            }
        }
        way.add(dt, &pose, step.status == GuidingStatus::Led)?;
        let moved = step.twist.fixed_rows::<3>(0).norm() * dt;
        led.add(dt, moved, arm.force(&sample)?.norm());
        if led.rested > released && led.way > LED {
            drop(arm);
            let id = motions::address(&equipment.agent, context.text("name")?)?;
            let learned = way.learned(context.text("name")?)?;
            motions::keep(&*equipment.memory, &id, &learned, sample.stamp_ns).await?;
            let mean = led.work / led.way;
            return Ok(led.outcome("success", mean).with("motion", reference("Motion", &id)));
        }
        if led.rested > patience {
            return Ok(Outcome::named(NOBODY));
        }
    }
}

/// The law for this robot, with the chart's limits.
fn config(equipment: &Equipment, context: &SkillContext) -> AdmittanceConfig {
    let usual = AdmittanceConfig::default();
    let (limits, own) = (context.limits, equipment.robot.model().limits());
    let force = own.force_of(limits.force_n);
    let speed = limits.speed_m_s.unwrap_or(own.speed_m_s).min(own.speed_m_s);
    AdmittanceConfig {
        shove: usual.shove.min(SHOVE * force),
        max_linear: usual.max_linear.min(speed),
        ..usual
    }
}

/// What the hand was led so far.
#[derive(Default)]
struct Led {
    way: f64,
    /// The sum of force times way, N m.
    work: f64,
    /// How long it has rested, s.
    rested: f64,
}

impl Led {
    fn add(&mut self, dt: f64, moved: f64, force: f64) {
        self.way += moved;
        self.work += force * moved;
        self.rested = if moved > 0.0 { 0.0 } else { self.rested + dt };
    }

    fn outcome(&self, name: &str, force: f64) -> Outcome {
        Outcome::named(name).with("way", self.way).with("force", force)
    }
}
