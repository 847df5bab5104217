//! `MovePlatform`: drives to a place, or by a way.

use std::sync::Arc;

use armarium_robot::{Lease, Platform, PlatformKind};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Vector2, Vector3};

use crate::arm::{Senses, lease};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, pose_value};
use crate::motions::failed;
use crate::platform::{place, platform_of, turn_between};

/// Gain of the errors, 1/s.
const GAIN: f64 = 2.0;
/// Share of the platform's acceleration with which it brakes.
const BRAKING: f64 = 0.15;
/// How long it must rest at its goal, s, and the speed that is rest, m/s and rad/s.
const REST: (f64, f64) = (0.2, 0.02);

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "MovePlatform",
        "Drives to a place in the root frame, straight and turning on the way, or by a way from where it is.",
    )
    .optional(
        "to",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "Where it goes: x and y in the root frame, m, and its turn to the left, rad.",
    )
    .optional(
        "by",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "Instead: how far to the right and forward, m, and how far it turns to the left, rad, seen from where it is.",
    )
    .optional("speed", Type::quantity(Unit::M_S), 0.3, "Speed on the way.")
    .optional("position_tolerance", Type::quantity(Unit::M), 0.01, "When the place counts as reached.")
    .optional("orientation_tolerance", Type::quantity(Unit::RAD), 0.02, "When the turn counts as reached.")
    .optional("timeout", Type::Duration, 60.0, "Longest time it may take.")
    .output("pose", Type::Pose, "Where it is at the end, as its odometry says.");
    let manifest = match equipment.robot.model().platform() {
        Some(_) => manifest.limb(Platform::LIMB),
        None => manifest,
    };
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let model = Arc::clone(equipment.robot.model());
    let platform = platform_of(&model)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let goal = goal(&context, &place(&model, &platform, &senses.newest()))?;
    let (position, orientation) =
        (context.number("position_tolerance")?, context.number("orientation_tolerance")?);
    let timeout = context.number("timeout")?;
    let drive = Drive {
        lease: lease(&equipment, &context, Platform::LIMB, &[])?,
        speed: context.number("speed")?.min(model.joints()[platform.joints[0]].velocity),
        turn: model.joints()[platform.joints[2]].velocity,
        braking: BRAKING * model.joints()[platform.joints[0]].acceleration,
        kind: platform.kind,
        tolerance: position,
    };
    let (mut elapsed, mut rested) = (0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let here = place(&model, &platform, &sample);
        let (off, turn) = error(&here, &goal);
        let still = platform.joints.iter().all(|&joint| sample.velocity[joint].abs() < REST.1);
        let there = off.norm() < position && turn.abs() < orientation;
        rested = if there && still { rested + dt } else { 0.0 };
        if rested > REST.0 {
            return Ok(Outcome::success().with("pose", pose_value(&here)));
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the platform was not at its goal within {timeout:.0} s: {:.0} mm and {:.2} rad are missing; is the way free?",
                off.norm() * 1e3,
                turn.abs()
            )));
        }
        drive.towards(&here, off, turn)?;
    }
}

/// Where it is to go, root frame.
fn goal(context: &SkillContext, here: &Isometry3<f64>) -> Result<Isometry3<f64>, Failure> {
    let (from, way) = match (context.vector_if_given("to")?, context.vector_if_given("by")?) {
        (Some(to), None) => (Isometry3::identity(), to),
        (None, Some(by)) => (*here, by),
        _ => return Err(Failure::new("give either `to` or `by`")),
    };
    Ok(from * Isometry3::new(Vector3::new(way.x, way.y, 0.0), Vector3::z() * way.z))
}

/// The way that is missing along the floor, root frame, m, and the turn to the left, rad.
fn error(here: &Isometry3<f64>, goal: &Isometry3<f64>) -> (Vector2<f64>, f64) {
    let way = goal.translation.vector - here.translation.vector;
    (way.xy(), turn_between(&here.rotation, &goal.rotation))
}

struct Drive {
    lease: Lease,
    speed: f64,
    turn: f64,
    braking: f64,
    kind: PlatformKind,
    tolerance: f64,
}

impl Drive {
    fn towards(&self, here: &Isometry3<f64>, off: Vector2<f64>, turn: f64) -> Result<(), Failure> {
        let bounded = |error: f64, most: f64| {
            (GAIN * error).abs().min(most).min((2.0 * self.braking * error.abs()).sqrt()).copysign(error)
        };
        let far = off.norm();
        let (velocity, turning) = match self.kind {
            PlatformKind::Differential if far > self.tolerance => {
                // It turns to where it drives, forward or backward, and drives while it looks there.
                let forward = (here.rotation * Vector3::y()).xy();
                let ahead = forward.dot(&off);
                let aside = forward.perp(&off);
                let bearing =
                    if ahead < 0.0 { libm::atan2(-aside, -ahead) } else { libm::atan2(aside, ahead) };
                let straight = libm::cos(bearing).max(0.0).powi(8);
                (forward * (bounded(ahead, self.speed) * straight), bounded(bearing, self.turn))
            }
            _ => {
                // It arrives and has turned at the same time.
                let speed = bounded(far, self.speed);
                let turning = bounded(turn, self.turn);
                let way = off.try_normalize(1e-9).unwrap_or_default();
                let held = self.kind == PlatformKind::Differential;
                (if held { Vector2::zeros() } else { way * speed }, turning)
            }
        };
        self.lease.command(&[velocity.x, velocity.y, turning]).map_err(failed)
    }
}
