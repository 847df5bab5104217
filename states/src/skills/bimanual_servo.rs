//! `BimanualVisualServo`: brings both hands to two grasps of one thing by observing the thing and both hands with the same cameras.
//!
//! Each hand has the law of single-handed servoing. They come from above: first up, then over their grasps, where they wait for each other,
//! and then down with one motion for both, which waits while a hand is not where it should be, and goes back where the thing has moved.
//! What is seen, and how the head looks at it in turns, is in [`both_seen`](crate::both_seen).

use armarium_motion::{
    Holding, PositionServo, ServoCommand, ServoConfig, ServoObservation, ServoStatus, in_step, rise,
};
use armarium_robot::{Sensed, Twist};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::Vector3;

use crate::arm::Senses;
use crate::both::{BothArms, moves_both};
use crate::both_seen::{BothSeen, LOST_AFTER};
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};
use crate::inputs::Inputs;
use crate::motions::failed;
use crate::skills::move_tcp::tolerances;

/// Speed of the head, rad/s.
const GAZE_SPEED: f64 = 1.5;
/// A force of this size means that a hand has met something, N.
const STOPPING_FORCE: f64 = 15.0;
/// Then it goes back: with this speed, m/s, for this time, s, and at most so often.
const BACK_SPEED: f64 = 0.08;
const BACK_TIME: f64 = 0.8;
const MOST_MET: usize = 3;
/// Where the hands wait for each other they need to be this much less exact.
const WAITING: f64 = 3.0;
/// For how long both hands have to be there, s, and how old what was seen of them may be then, s.
const HOLD: f64 = 0.35;
const FRESH: f64 = 1.5;
/// How long it takes both hands to come down, s.
const COMES_DOWN: f64 = 1.6;
/// It waits while a hand is further than this from its way, m, and goes back up while one is further than that.
const OFF_ITS_WAY: [f64; 2] = [0.008, 0.02];
/// A hand is beside its grasp when it is further than this from above it, m; there it goes up first: to its side from the first share of
/// `over` on, at full speed from the second.
const BESIDE: f64 = 0.01;
const CLEAR: [f64; 2] = [0.6, 0.85];

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "BimanualVisualServo",
        "Brings both hands to two grasps of one thing, seeing the thing and both hands with the same cameras.",
    )
    .input("object", Type::object(), "The thing in memory; prior knowledge has two grasps of it.")
    .optional("over", Type::quantity(Unit::M), 0.07, "How far before their grasps the hands wait for each other.")
    .optional("look", Type::Bool, true, "False: by what memory and the joints say alone, for comparison.");
    let manifest = tolerances(manifest, 0.003, 0.03)
        .optional("timeout", Type::Duration, 25.0, "Longest time for each of the two parts.")
        .output(
            "seen_error",
            Type::quantity(Unit::M),
            "The larger distance of a hand from its grasp, as seen.",
        )
        .output(
            "up",
            Type::list(Type::FLOAT),
            "The upward normal of the surface on which the thing stands, root frame: what turns of the head tell of it, or else level.",
        )
        .mark(Mark::at_start("reaching_started"))
        .mark(Mark::at_success("grasps_reached"));
    let manifest = moves_the_head(moves_both(manifest, equipment), equipment);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let looks = context.flag("look")?;
    let mut seen = BothSeen::new(&equipment, &context, looks).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let motions = seen.motions(&senses.newest());
    let mut both = BothArms::take(&equipment, &context, &motions, Holding::Gripping).await?;
    let mut head = Head::take(&equipment, &context)?;
    let mut reach = Reach::new(&context)?;
    loop {
        let (sample, dt) = senses.next().await?;
        seen.look()?;
        head.look(&sample, dt, &seen.looks_at(&sample), GAZE_SPEED)?;
        for i in 0..2 {
            let arm = both.arm(i);
            let force = arm.force(&sample).map_or(0.0, |force| force.norm());
            if force > STOPPING_FORCE && !reach.meets(i) {
                return Err(Failure::new(format!(
                    "`{}` met something on its way again and again: {force:.0} N at its wrist",
                    arm.limb.name
                )));
            }
        }
        let Some(twists) = reach.step(&sample, dt, &seen)? else {
            let up = <[f64; 3]>::from(seen.surface_up());
            return Ok(Outcome::success().with("seen_error", reach.farthest).with("up", up));
        };
        for (i, Twist { linear, angular }) in twists.into_iter().enumerate() {
            both.arm(i).twist(&sample, linear, angular)?;
        }
    }
}

/// The way of both hands to their grasps.
struct Reach {
    config: ServoConfig,
    laws: [PositionServo; 2],
    over: f64,
    /// The share of the way down, where both are on it.
    down: Option<f64>,
    /// For how long both are where they should be, s.
    there: f64,
    /// The larger distance of a hand from where it should be, m.
    farthest: f64,
    /// For how long each hand still goes back from what it has met, s, and how often one has.
    back: [f64; 2],
    met: usize,
}

impl Reach {
    fn new(context: &SkillContext) -> Result<Self, Failure> {
        let config = ServoConfig {
            position_tolerance: context.number("position_tolerance")?,
            rotation_tolerance: context.number("orientation_tolerance")?,
            // The thing may be moved while they are on their way, and they arrive together.
            divergence: 1e9,
            hold_frames: u32::MAX,
            timeout: context.number("timeout")?,
            max_linear: 0.12,
            gain_near: 4.0,
            lost_after: LOST_AFTER,
            ..ServoConfig::default()
        };
        let (laws, over) = (laws(&config)?, context.number("over")?);
        Ok(Self { config, laws, over, down: None, there: 0.0, farthest: 0.0, back: [0.0; 2], met: 0 })
    }

    /// A hand has met something, as a thing that is moved against it: it goes back and both begin again. False when that was too often.
    fn meets(&mut self, hand: usize) -> bool {
        if self.back[hand] <= 0.0 {
            (self.back[hand], self.down, self.there) = (BACK_TIME, None, 0.0);
            self.met += 1;
        }
        self.met <= MOST_MET
    }

    /// The velocities of both hands, root frame, m/s and rad/s; `None` when both are there.
    fn step(&mut self, sample: &Sensed, dt: f64, seen: &BothSeen) -> Result<Option<[Twist; 2]>, Failure> {
        let [height, speed] = self.height();
        let (mut oldest, mut approach) = (0.0_f64, [Vector3::zeros(); 2]);
        let mut command = |i: usize| -> Result<ServoCommand, Failure> {
            let (mut observation, age) = seen.observation(i, sample, height);
            oldest = oldest.max(age);
            approach[i] = observation.target.rotation * Vector3::x();
            if self.down.is_none() {
                first_up(&mut observation, &approach[i], self.over);
            }
            // What is lost stops both hands; it may be found again.
            self.laws[i].step_aged(dt, Some((&observation, age.min(LOST_AFTER)))).map_err(failed)
        };
        let mut commands = [command(0)?, command(1)?];
        if let Some(command) = commands.iter().find(|command| command.status != ServoStatus::Running) {
            let mm = command.distance * 1e3;
            return Err(Failure::new(match oldest < LOST_AFTER {
                true => format!("servoing took too long: a hand is still {mm:.0} mm from its grasp"),
                false => format!("{} was lost from sight while servoing", seen.unseen()),
            }));
        }
        self.farthest = commands.iter().map(|command| command.distance).fold(0.0, f64::max);
        let turned = commands.iter().map(|command| command.angle).fold(0.0, f64::max);
        let loosely = if self.down.is_none() { WAITING } else { 1.0 };
        let near = self.farthest <= self.config.position_tolerance * loosely
            && turned <= self.config.rotation_tolerance * loosely
            && oldest < FRESH;
        self.there = if near && self.down.is_none_or(|down| down == 1.0) { self.there + dt } else { 0.0 };
        let moving = match self.down {
            Some(1.0) if self.there >= HOLD => return Ok(None),
            Some(down) => {
                let rate = self.rate(oldest);
                self.down = Some((down + rate * dt / COMES_DOWN).clamp(0.0, 1.0));
                rate
            }
            None => {
                in_step(&mut commands);
                if self.there >= HOLD {
                    self.down = Some(0.0);
                    self.there = 0.0;
                    self.laws = laws(&self.config)?;
                }
                0.0
            }
        };
        let back = self.back;
        self.back = back.map(|left| (left - dt).max(0.0));
        let twist = |i: usize| {
            if back.iter().any(|left| *left > 0.0) {
                let linear = if back[i] > 0.0 { approach[i] * -BACK_SPEED } else { Vector3::zeros() };
                return Twist { linear, angular: Vector3::zeros() };
            }
            let descends = approach[i] * (speed * moving);
            Twist { linear: commands[i].linear + descends, angular: commands[i].angular }
        };
        Ok(Some([twist(0), twist(1)]))
    }

    /// How far before their grasps the hands shall be, m, and how fast they come nearer, m/s.
    fn height(&self) -> [f64; 2] {
        let [share, rate, _] = rise([1.0, 0.0, 0.0], 1.0, self.down.unwrap_or(0.0));
        [self.over * (1.0 - share), self.over * rate / COMES_DOWN]
    }

    /// How fast the way down is gone, as a share; less than zero where it is gone back.
    fn rate(&self, oldest: f64) -> f64 {
        let [waits, back] = OFF_ITS_WAY;
        match self.farthest {
            off if off > back => -1.0,
            off if off > waits => 0.0,
            _ => 1.0 - oldest / LOST_AFTER,
        }
    }
}

fn laws(config: &ServoConfig) -> Result<[PositionServo; 2], Failure> {
    let law = || PositionServo::new(config.clone()).map_err(failed);
    Ok([law()?, law()?])
}

/// Moves the target of a hand that is beside its grasp, and not yet clear of it, to above where the hand is.
fn first_up(observation: &mut ServoObservation, approach: &Vector3<f64>, over: f64) {
    let off = observation.hand.translation.vector - observation.target.translation.vector;
    let beside = off - approach * off.dot(approach);
    if beside.norm() < BESIDE {
        return;
    }
    let height = over - off.dot(approach);
    let [from, to] = CLEAR.map(|share| share * over);
    let clear = ((height - from) / (to - from)).clamp(0.0, 1.0);
    observation.target.translation.vector += beside * (1.0 - clear);
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, UnitQuaternion};

    use super::*;

    #[test]
    fn a_hand_beside_its_grasp_goes_up_first_and_then_to_its_side() {
        let down = UnitQuaternion::rotation_between(&Vector3::x(), &-Vector3::z()).unwrap();
        let target = |at: Vector3<f64>, over: f64| {
            let pose = |at: Vector3<f64>| Isometry3::from_parts(at.into(), down);
            let grasp = Vector3::new(0.3, 0.45, 1.1);
            let mut seen = ServoObservation { hand: pose(at), target: pose(grasp + Vector3::z() * over) };
            first_up(&mut seen, &-Vector3::z(), over);
            seen.target.translation.vector
        };
        let above = Vector3::new(0.3, 0.45, 1.17);
        let low = Vector3::new(0.4, 0.42, 1.12);
        assert!((target(low, 0.07) - Vector3::new(0.4, 0.42, 1.17)).norm() < 1e-12);
        let high = Vector3::new(0.4, 0.42, 1.165);
        assert!((target(high, 0.07) - above).norm() < 1e-12);
        let almost = Vector3::new(0.304, 0.45, 1.1);
        assert!((target(almost, 0.07) - above).norm() < 1e-12, "it is not beside it");
    }
}
