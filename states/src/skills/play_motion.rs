//! `PlayMotion`: plays a kept motion in free space as it was led: from its start to its goal, or some periods of it. A rhythm that is
//! played may be coached meanwhile; what coaches have changed is kept when it ends.

use std::f64::consts::TAU;

use armarium_memoryx::EntityId;
use armarium_motion::{LinePoint, MovementPlay, PeriodicOrientationDmp};
use armarium_robot::Sensed;
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use nalgebra::{Isometry3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, pose_value};
use crate::motions::{self, StoredMotion, failed};
use crate::running_motion::MotionOwner;

/// Raised when the hand is where the motion begins, at its full pace, and when the motion is over.
const BEGINS: &str = "begins";
const OVER: &str = "over";
/// An arm that is this far behind cannot follow the motion, m.
const LOST_TRACK: f64 = 0.06;
/// Largest rate of change of the pace of a periodic motion (share of its frequency), 1/s.
const PACE_RATE: f64 = 1.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "PlayMotion",
        "Plays a kept motion in free space, with the speed at which it was led.",
    )
    .input("motion", Type::motion(), "The motion.")
    .optional(
        "periods",
        Type::Int,
        3_i64,
        "Of a periodic motion, how many periods; 0: until it is cancelled.",
    )
    .optional(
        "speed",
        Type::quantity(Unit::M_S),
        0.15,
        "Speed with which the hand goes to where the motion begins.",
    )
    .output("tcp", Type::Pose, "Where the TCP is at the end.")
    .publishes("motion")
    .event(BEGINS)
    .event(OVER)
    .mark(Mark::at_event(BEGINS, "play_started"))
    .mark(Mark::at_event(OVER, "play_ended"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let periods = context.value("periods")?.as_int().unwrap_or(3).max(0);
    let periods = f64::from(i32::try_from(periods).unwrap_or(i32::MAX));
    let mut play = MotionPlay::take(&equipment, &context.entity("motion")?, periods).await?;
    let tcp = play_on(&equipment, &context, &mut play).await;
    play.finish().await?;
    Ok(Outcome::success().with("tcp", pose_value(&tcp?)))
}

/// Goes to where the motion begins and plays it; returns where the TCP is at the end.
async fn play_on(
    equipment: &Equipment,
    context: &SkillContext,
    play: &mut MotionPlay,
) -> Result<Isometry3<f64>, Failure> {
    let begin = play.pose();
    let mut arm = LeasedArm::take(equipment, context, &[begin]).await?;
    let mut senses = Senses::new(&*equipment.robot, context);
    arm.go(&mut senses, begin, context.number("speed")?, check_track).await?;
    let (mut begun, mut ended, mut rested) = (false, false, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        let point = play.step(dt, sample.stamp_ns)?;
        check_track(arm.track(&sample, &point.pose, point.linear, point.angular)?)?;
        if let MotionPlay::Periodic(rhythm) = play {
            context.channels.publish("motion", rhythm.published(&mut arm, &sample));
        }
        if !begun && play.runs() {
            context.events.raise(BEGINS, Value::Null);
            begun = true;
        }
        if !ended && play.is_over() {
            context.events.raise(OVER, Value::Null);
            ended = true;
        }
        rested = if ended && !play.runs() { rested + dt } else { 0.0 };
        if rested > 0.3 {
            return Ok(arm.tcp(&sample));
        }
    }
}

fn check_track(behind: f64) -> Result<(), Failure> {
    if behind > LOST_TRACK {
        let mm = behind * 1e3;
        return Err(Failure::new(format!("the arm cannot follow the motion: it is {mm:.0} mm behind")));
    }
    Ok(())
}

/// A motion that is being played.
enum MotionPlay {
    ToAGoal(Box<MovementPlay>),
    Periodic(Box<Rhythm>),
}

/// A periodic motion, of which some periods are left.
struct Rhythm {
    motion: MotionOwner,
    orientation: PeriodicOrientationDmp,
    omega: f64,
    /// The phase that is left at the full pace, rad; infinite where it goes on.
    left: f64,
    /// The share of the frequency at which it runs.
    pace: f64,
}

impl MotionPlay {
    async fn take(equipment: &Equipment, id: &EntityId, periods: f64) -> Result<Self, Failure> {
        let newest = equipment.memory.latest(id).await.map_err(failed)?;
        match motions::kept_in(&newest)? {
            StoredMotion::Movement(movement) => Ok(Self::ToAGoal(Box::new(movement.play()))),
            StoredMotion::Motion(motion) => {
                let orientation = motion.orientation().cloned().ok_or_else(|| {
                    Failure::new(format!(
                        "the motion `{}` does not say how the hand is turned",
                        motion.name()
                    ))
                })?;
                if motion.primitive().dofs() != 3 {
                    return Err(Failure::new(format!(
                        "the motion `{}` is none of a hand in space",
                        motion.name()
                    )));
                }
                let (omega, left) =
                    (motion.omega(), if periods > 0.0 { TAU * periods } else { f64::INFINITY });
                let motion = equipment.motions.own(&equipment.memory, id).await?;
                let mut rhythm = Rhythm { motion, orientation, omega, left, pace: 0.0 };
                rhythm.motion.start_on_path(0.0)?;
                rhythm.orientation.start_on_path(0.0, omega).map_err(failed)?;
                Ok(Self::Periodic(Box::new(rhythm)))
            }
        }
    }

    /// Ends it, and keeps what coaches have changed.
    async fn finish(self) -> Result<(), Failure> {
        match self {
            Self::ToAGoal(_) => Ok(()),
            Self::Periodic(rhythm) => rhythm.motion.finish(None, None).await,
        }
    }

    fn pose(&self) -> Isometry3<f64> {
        match self {
            Self::ToAGoal(play) => play.pose(),
            Self::Periodic(rhythm) => rhythm.pose(),
        }
    }

    fn step(&mut self, dt: f64, stamp_ns: u64) -> Result<LinePoint, Failure> {
        match self {
            Self::ToAGoal(play) => play.step(dt).map_err(failed),
            Self::Periodic(rhythm) => rhythm.step(dt, stamp_ns),
        }
    }

    /// Whether it is at its full pace.
    fn runs(&self) -> bool {
        match self {
            Self::ToAGoal(play) => play.progress() < 1.0,
            Self::Periodic(rhythm) => rhythm.pace >= 1.0,
        }
    }

    /// Whether all of it was played; a rhythm then fades out.
    fn is_over(&self) -> bool {
        match self {
            Self::ToAGoal(play) => play.progress() >= 1.0,
            Self::Periodic(rhythm) => rhythm.left <= 0.0,
        }
    }
}

impl Rhythm {
    fn pose(&self) -> Isometry3<f64> {
        let place = Vector3::from_column_slice(self.motion.state().y);
        Isometry3::from_parts(place.into(), self.orientation.state().orientation)
    }

    fn step(&mut self, dt: f64, stamp_ns: u64) -> Result<LinePoint, Failure> {
        let wanted = if self.left > 0.0 { 1.0 } else { 0.0 };
        self.pace += (wanted - self.pace).clamp(-PACE_RATE * dt, PACE_RATE * dt);
        let omega = self.omega * self.pace;
        if self.pace >= 1.0 {
            self.left -= omega * dt;
        }
        self.motion.step(dt, omega, stamp_ns)?;
        let turned = self.orientation.step(dt, omega).map_err(failed)?;
        let linear = Vector3::from_column_slice(self.motion.state().yd);
        Ok(LinePoint { pose: self.pose(), linear, angular: turned.angular_velocity })
    }

    /// What the channel `motion` says of it: it touches no surface.
    fn published(&self, arm: &mut LeasedArm, sample: &Sensed) -> Value {
        let (tcp, velocity) = (arm.tcp(sample).translation.vector, arm.tcp_velocity(sample));
        Value::record([
            ("arm", Value::from(arm.limb.name.as_str())),
            ("phase", Value::Float(self.motion.state().phase)),
            ("frequency", Value::Float(self.omega * self.pace / TAU)),
            ("position", Value::from([tcp.x, tcp.y, tcp.z])),
            ("velocity", Value::from([velocity.x, velocity.y, velocity.z])),
        ])
    }
}
