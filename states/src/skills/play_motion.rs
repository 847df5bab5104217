//! `PlayMotion`: plays a kept motion in free space as it was led: from its start to its goal, or some periods of it.

use std::f64::consts::TAU;

use armarium_motion::{LinePoint, MotionError, MovementPlay, PeriodicDmp, PeriodicOrientationDmp};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use nalgebra::{Isometry3, Vector3};

use crate::arm::{LeasedArm, Senses, moves_the_arm};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, pose_value};
use crate::motions::{self, StoredMotion, failed};

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
    .optional("periods", Type::Int, 3_i64, "Of a periodic motion, how many periods.")
    .optional(
        "speed",
        Type::quantity(Unit::M_S),
        0.15,
        "Speed with which the hand goes to where the motion begins.",
    )
    .output("tcp", Type::Pose, "Where the TCP is at the end.")
    .event(BEGINS)
    .event(OVER)
    .mark(Mark::at_event(BEGINS, "play_started"))
    .mark(Mark::at_event(OVER, "play_ended"));
    equipment::skill(equipment, moves_the_arm(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let periods = context.value("periods")?.as_int().unwrap_or(3).max(1);
    let periods = f64::from(i32::try_from(periods).unwrap_or(i32::MAX));
    let newest = equipment.memory.latest(&context.entity("motion")?).await.map_err(failed)?;
    let kept = motions::kept_in(&newest)?;
    let mut play = MotionPlay::new(&kept, periods)?;
    let begin = play.pose();
    let mut arm = LeasedArm::take(&equipment, &context, &[begin]).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    arm.go(&mut senses, begin, context.number("speed")?, check_track).await?;
    let (mut begun, mut ended, mut rested) = (false, false, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        let point = play.step(dt).map_err(failed)?;
        check_track(arm.track(&sample, &point.pose, point.linear, point.angular)?)?;
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
            return Ok(Outcome::success().with("tcp", pose_value(&arm.tcp(&sample))));
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
    position: PeriodicDmp,
    orientation: PeriodicOrientationDmp,
    omega: f64,
    /// The phase that is left at the full pace, rad.
    left: f64,
    /// The share of the frequency at which it runs.
    pace: f64,
}

impl MotionPlay {
    fn new(kept: &StoredMotion, periods: f64) -> Result<Self, Failure> {
        match kept {
            StoredMotion::Movement(movement) => Ok(Self::ToAGoal(Box::new(movement.play()))),
            StoredMotion::Motion(motion) => {
                let unfit = |why: &str| Failure::new(format!("the motion `{}` {why}", motion.name()));
                let orientation = motion.orientation().cloned();
                let orientation = orientation.ok_or_else(|| unfit("does not say how the hand is turned"))?;
                let (position, omega) = (motion.primitive().clone(), motion.omega());
                let mut rhythm = Rhythm { position, orientation, omega, left: TAU * periods, pace: 0.0 };
                if rhythm.position.dofs() != 3 {
                    return Err(unfit("is none of a hand in space"));
                }
                rhythm.position.start_on_path(0.0, omega).map_err(failed)?;
                rhythm.orientation.start_on_path(0.0, omega).map_err(failed)?;
                Ok(Self::Periodic(Box::new(rhythm)))
            }
        }
    }

    fn pose(&self) -> Isometry3<f64> {
        match self {
            Self::ToAGoal(play) => play.pose(),
            Self::Periodic(rhythm) => rhythm.pose(),
        }
    }

    fn step(&mut self, dt: f64) -> Result<LinePoint, MotionError> {
        match self {
            Self::ToAGoal(play) => play.step(dt),
            Self::Periodic(rhythm) => rhythm.step(dt),
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
        let place = Vector3::from_column_slice(self.position.state().y);
        Isometry3::from_parts(place.into(), self.orientation.state().orientation)
    }

    fn step(&mut self, dt: f64) -> Result<LinePoint, MotionError> {
        let wanted = if self.left > 0.0 { 1.0 } else { 0.0 };
        self.pace += (wanted - self.pace).clamp(-PACE_RATE * dt, PACE_RATE * dt);
        let omega = self.omega * self.pace;
        if self.pace >= 1.0 {
            self.left -= omega * dt;
        }
        self.position.step(dt, omega)?;
        let turned = self.orientation.step(dt, omega)?;
        let linear = Vector3::from_column_slice(self.position.state().yd);
        Ok(LinePoint { pose: self.pose(), linear, angular: turned.angular_velocity })
    }
}
