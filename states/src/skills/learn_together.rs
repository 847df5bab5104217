//! `LearnTogether`: both hands lift and shake what they hold, again and again. One leads, and the other learns from what both
//! feel to move with it.

use std::f64::consts::TAU;

use armarium_motion::{
    FeedbackError, Holding, LearningControl, LearningControlConfig, LiftAndShake, LinePoint, LoadForces,
    LoadStatus, SharedLoad, SharedLoadConfig, SharedLoadStep, StraightLine, joint_coupling,
};
use armarium_robot::Sensed;
use armarium_runtime::skill::{
    Events, Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult,
};
use armarium_values::{Type, Unit, Value};
use nalgebra::{Vector3, Vector6};

use crate::arm::Senses;
use crate::both::{BothArms, config, moves_both, squeezes};
use crate::equipment::{self, Equipment};
use crate::hand_motion::{HandMotion, Space};
use crate::inputs::Inputs;
use crate::motions::{self, LearnedTogether, failed};

/// The outcome besides `success`.
const LOST: &str = "lost";
/// Raised when an epoch begins, when its periodic part begins, and when it ends.
const EPOCH: &str = "epoch";
const PERIODS: &str = "periods";
const EPOCH_OVER: &str = "epoch_over";
/// Raised in its place when the epoch was disturbed from outside.
const DISTURBANCE: &str = "disturbed";
/// The words of the input `space`.
const TASK: &str = "task";
const JOINT: &str = "joint";
/// Longest epoch that is learned, in samples.
const MOST_SAMPLES: usize = 60_000;
/// How long the load rests before an epoch, s, and over how much of that what the hands feel is averaged.
const RESTS: (f64, f64) = (0.8, 0.4);
/// Time in which the motion comes to rest after an epoch, s, and the speed on the way back, m/s.
const FADES: f64 = 0.8;
const BACK: f64 = 0.08;
/// Cut-off frequency of the filter on what the hands feel, Hz.
const FILTER: f64 = 20.0;
/// (11): what is learned of the last epoch, and the feedback within one: in task space, in joint space, and in task space from forces alone. In
/// the latter two the discrete part falls less with more feedback.
const LEARNING: LearningControlConfig = LearningControlConfig { q: 1.0, l: 0.3, c: 0.3 };
const LEARNING_JOINTS: LearningControlConfig = LearningControlConfig { c: 0.15, ..LEARNING };
const LEARNING_FORCES: LearningControlConfig = LearningControlConfig { l: 0.45, c: 0.15, ..LEARNING };
/// K1 of (10), m/s/N.
const K1: f64 = 0.08;
/// How much more the hands press than with what a friction needs.
const MARGIN: f64 = 1.2;
/// The weight of forces along the line between the hands, in which the load is stiff.
const ALONG: f64 = 0.1;
/// An epoch in which the hands carry so much more or less than at rest, N and share of the weight, is disturbed from outside:
/// it is not learned, but repeated, at most so often.
const DISTURBED: (f64, f64) = (5.0, 0.3);
const REPEATED: usize = 3;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let length = || Type::quantity(Unit::M);
    let manifest = SkillManifest::new(
        "LearnTogether",
        "Lifts and shakes what both hands hold, again and again: one hand leads, the other learns from what both feel to move with it.",
    )
    .optional("leads", Type::one_of(["first", "second"]), "first", "Which of the robot's arms leads.")
    .optional("space", Type::one_of([TASK, JOINT]), TASK, "In which space the other one learns.")
    .optional("velocity", Type::Bool, true, "Whether it also learns from the velocities of both hands.")
    .optional("epochs", Type::Int, 10_i64, "How often the motion is done.")
    .optional("duration", Type::Duration, 1.5, "Duration of the lift.")
    .optional("periods", Type::Int, 3_i64, "Periods of shaking in an epoch.")
    .optional("period", Type::Duration, 1.2, "Length of a period.")
    .optional("lift", length(), 0.07, "How high the leading hand lifts.")
    .optional("amplitude", length(), 0.02, "How far it shakes, up and down.")
    .optional("own_lift", length(), 0.035, "How high the other one lifts before it has learned.")
    .optional("own_amplitude", length(), 0.01, "How far it shakes before it has learned.")
    .optional("name", Type::String, "", "Under which name what is learned is kept, and found again the next day; empty: it is not kept.")
    .optional("own_phase", Type::quantity(Unit::RAD), 0.6, "By how much its shaking is ahead before it has learned.");
    let manifest = squeezes(manifest)
        .output(
            "first_error",
            Type::quantity(Unit::N),
            "What the hands did against each other in the first epoch, RMS.",
        )
        .output("last_error", Type::quantity(Unit::N), "The same in the last epoch.")
        .output("epochs_before", Type::Int, "From how many epochs it had learned before, by what was kept.")
        .event(EPOCH)
        .event(PERIODS)
        .event(EPOCH_OVER)
        .event(DISTURBANCE)
        .outcome(LOST)
        .mark(Mark::at_event(EPOCH, "epoch_started"))
        .mark(Mark::at_event(PERIODS, "periods_started"))
        .mark(Mark::at_event(EPOCH_OVER, "epoch_ended"))
        .mark(Mark::at_success("learned_together").with_output("before", "epochs_before"));
    equipment::skill(equipment, moves_both(manifest, equipment), run)
}

/// Why it ends before its time.
enum Stop {
    Lost,
    Failed(Failure),
}

impl From<Failure> for Stop {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

/// What the inputs ask for.
struct Task {
    leader: usize,
    space: Space,
    gains: FeedbackError,
    epochs: usize,
    periods: f64,
    /// Of the leading and of the other hand.
    paths: [LiftAndShake; 2],
}

impl Task {
    fn read(context: &SkillContext) -> Result<Self, Failure> {
        let count = |name: &str| -> Result<i64, Failure> {
            let value = context.value(name)?;
            value
                .as_int()
                .filter(|n| (1..=100).contains(n))
                .ok_or_else(|| Failure::input(name, "from 1 to 100", value))
        };
        let space = if context.text("space")? == JOINT { Space::Joint } else { Space::Task };
        let k2 = if context.flag("velocity")? { 1.0 } else { 0.0 };
        let (omega, duration) = (TAU / context.number("period")?, context.number("duration")?);
        let path = |lift: &str, amplitude: &str, phase: f64| -> Result<LiftAndShake, Failure> {
            let (lift, amplitude) = (context.number(lift)?, context.number(amplitude)?);
            Ok(LiftAndShake { lift, amplitude, phase, omega, duration })
        };
        Ok(Self {
            leader: usize::from(context.text("leads")? == "second"),
            space,
            gains: FeedbackError { k1: K1, k2, ..FeedbackError::default() },
            epochs: count("epochs")? as usize,
            periods: count("periods")? as f64,
            paths: [
                path("lift", "amplitude", 0.0)?,
                path("own_lift", "own_amplitude", context.number("own_phase")?)?,
            ],
        })
    }

    /// What is done and learned, in one line: what was learned for it serves the same task alone.
    fn described(&self) -> String {
        let hand = |path: &LiftAndShake| {
            format!("{:.3} m and {:.3} m at {:.2} rad", path.lift, path.amplitude, path.phase)
        };
        let [leads, other] = &self.paths;
        format!(
            "hand {} leads by {}, the other {}, {:.2} s and then {:.3} rad/s, in {:?} space",
            self.leader + 1,
            hand(leads),
            hand(other),
            leads.duration,
            leads.omega,
            self.space
        )
    }

    /// The path of the first or the second arm.
    fn path(&self, hand: usize) -> &LiftAndShake {
        &self.paths[usize::from(hand != self.leader)]
    }
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let task = Task::read(&context)?;
    let highest = task.paths.iter().map(|path| path.lift + path.amplitude).fold(0.0, f64::max);
    let mut both = BothArms::take(&equipment, &context, &[Vector3::z() * highest], Holding::Pressing).await?;
    let senses = Senses::new(&*equipment.robot, &context);
    let sample = senses.newest();
    // Hands that yielded would hide what they have to learn.
    let usual = config(&equipment, &context)?;
    let constants = SharedLoadConfig { compliance: 0.0, turning_compliance: 0.0, margin: MARGIN, ..usual };
    let law = SharedLoad::new(constants, &both.on_load(&sample)?).map_err(failed)?;
    let mut motion = |hand: usize| {
        HandMotion::demonstrated(both.arm(hand), &sample, task.space, task.path(hand), task.periods)
    };
    let mut motions = [motion(0)?, motion(1)?];
    let learning = match task.space {
        Space::Task if task.gains.k2 == 0.0 => LEARNING_FORCES,
        Space::Task => LEARNING,
        Space::Joint => LEARNING_JOINTS,
    };
    let control =
        LearningControl::new(learning, motions[0].primitive.dofs(), MOST_SAMPLES).map_err(failed)?;
    let name = context.text("name")?;
    let known = match name {
        "" => None,
        name => LearnedTogether::recall(&*equipment.memory, name).await?,
    };
    let before = known.as_ref().map_or(0, |known| known.epochs);
    let described = task.described();
    if let Some(known) = known {
        if known.task != described {
            return Err(Failure::new(format!(
                "`{name}` was learned for another task: {}; this is: {described}. Keep this under another name",
                known.task
            )));
        }
        motions[1 - task.leader].primitive.set_control_weights(&known.control_weights).map_err(failed)?;
    }
    let mut learner = Learner { both, senses, law, motions, control, task, events: context.events.clone() };
    match learner.learn().await {
        Ok(errors) => {
            if !name.is_empty() {
                let id = motions::address(&equipment.agent, name)?;
                let stamp_ns = learner.senses.newest().stamp_ns;
                learner.learned(described, before).keep(&*equipment.memory, &id, stamp_ns).await?;
            }
            let of = |error: Option<&f64>| error.copied().unwrap_or_default();
            let outcome = Outcome::success().with("first_error", of(errors.first()));
            Ok(outcome.with("last_error", of(errors.last())).with("epochs_before", i64::from(before)))
        }
        Err(Stop::Lost) => Ok(Outcome::named(LOST)),
        Err(Stop::Failed(failure)) => Err(failure),
    }
}

/// Both hands, their motions, and what is learned.
struct Learner {
    both: BothArms,
    senses: Senses,
    law: SharedLoad,
    motions: [HandMotion; 2],
    control: LearningControl,
    task: Task,
    events: Events,
}

impl Learner {
    /// All epochs; returns the error of each, N.
    async fn learn(&mut self) -> Result<Vec<f64>, Stop> {
        let (mut errors, mut disturbed) = (Vec::new(), 0);
        while errors.len() < self.task.epochs {
            let rest = self.rest().await?;
            let other = 1 - self.task.leader;
            match self.epoch(&rest).await? {
                Some(error) => {
                    self.events.raise(EPOCH_OVER, Value::Null);
                    errors.push(error);
                    self.control.finish(&mut self.motions[other].primitive).map_err(failed)?;
                }
                None if disturbed == REPEATED => {
                    let why = "something pulls or pushes the load or the hands again and again";
                    return Err(Failure::new(why).into());
                }
                None => {
                    self.events.raise(DISTURBANCE, Value::Null);
                    disturbed += 1;
                    self.control.abandon();
                }
            }
            self.fade().await?;
            self.back().await?;
        }
        Ok(errors)
    }

    /// What the other hand has learned.
    fn learned(&self, task: String, before: u32) -> LearnedTogether {
        let primitive = &self.motions[1 - self.task.leader].primitive;
        let epochs = before.saturating_add(self.control.epochs());
        LearnedTogether { task, epochs, control_weights: primitive.control_weights().to_vec() }
    }

    /// A step with both TCPs there, without what they go beyond that.
    fn step(&mut self, sample: &Sensed, dt: f64, points: &[LinePoint; 2]) -> Result<SharedLoadStep, Stop> {
        let loads = [0, 1].map(|hand| self.law.load_of(hand, &points[hand]));
        let hands = self.both.on_load(sample)?;
        let step = self.law.step_each(dt, &hands, &loads).map_err(failed)?;
        if step.status == LoadStatus::Lost {
            return Err(Stop::Lost);
        }
        self.both.track(sample, &step.hands)?;
        Ok(step)
    }

    fn points(&mut self, sample: &Sensed) -> [LinePoint; 2] {
        [0, 1].map(|hand| self.motions[hand].point(self.both.arm(hand), sample))
    }

    /// Rests where the motions begin; returns what the hands do against each other then.
    async fn rest(&mut self) -> Result<RestForces, Stop> {
        let (long, averaged) = RESTS;
        let (mut time, mut mean) = (0.0, RestForces::default());
        let home = self.motions.each_ref().map(HandMotion::home);
        for hand in 0..2 {
            self.motions[hand].pull_home(self.both.arm(hand));
        }
        while time < long {
            let (sample, dt) = self.senses.next().await?;
            time += dt;
            let step = self.step(&sample, dt, &home)?;
            if time > long - averaged {
                mean.internal += internal(&step.forces) * (dt / averaged);
                mean.external += step.forces.external * (dt / averaged);
            }
        }
        Ok(mean)
    }

    /// The lift and its periods; returns the error, N, or `None` if it was disturbed.
    async fn epoch(&mut self, rest: &RestForces) -> Result<Option<f64>, Stop> {
        let other = 1 - self.task.leader;
        let omega = self.task.path(other).omega;
        self.motions.iter_mut().for_each(|motion| motion.primitive.restart());
        self.events.raise(EPOCH, Value::Null);
        let (mut felt, mut carried) = (rest.internal, rest.external);
        let (mut shaking, mut disturbed) = (false, false);
        let (mut sum, mut time) = (0.0, 0.0);
        loop {
            let (sample, dt) = self.senses.next().await?;
            let points = self.points(&sample);
            let step = self.step(&sample, dt, &points)?;
            let share = dt / (dt + 1.0 / (TAU * FILTER));
            felt += (internal(&step.forces) - felt) * share;
            carried += (step.forces.external - carried) * share;
            disturbed |= rest.is_disturbed(&carried);
            let wrench = missing(&rest.internal, &felt, &step);
            let along = wrench.fixed_rows::<3>(0).dot(&step.forces.line);
            sum += (wrench.fixed_rows::<3>(0).norm_squared() - along * along).max(0.0) * dt;
            time += dt;
            // From the force of the first hand on the load to that of the one that learns.
            let sign = if other == 0 { 1.0 } else { -1.0 };
            let error = self.error(&sample, &(weighted(&wrench, &step) * sign))?;
            self.control.step(&mut self.motions[other].primitive, omega, &error).map_err(failed)?;
            for motion in &mut self.motions {
                motion.primitive.step(dt, omega).map_err(failed)?;
            }
            let phase = self.motions[other].primitive.state().phase;
            if !shaking && phase >= 0.0 {
                shaking = true;
                self.events.raise(PERIODS, Value::Null);
            }
            if phase >= TAU * self.task.periods {
                return Ok((!disturbed).then(|| (sum / time).sqrt()));
            }
        }
    }

    /// The error for the hand that learns: (10) with the velocities of (14). It goes to the joints through the pseudoinverse in both
    /// terms: through the transpose, as (14) has it for the wrench, motions in which the hand shifts without a turn learn slowly.
    fn error(&mut self, sample: &Sensed, wrench: &Vector6<f64>) -> Result<Vec<f64>, Failure> {
        let leader = self.task.leader;
        let (first, _) = self.both.twist_and_columns(leader, sample);
        let (second, columns) = self.both.twist_and_columns(1 - leader, sample);
        let (gains, twist) = (&self.task.gains, first - second);
        let mut task = Vector6::zeros();
        gains.in_task_space(wrench.as_slice(), twist.as_slice(), task.as_mut_slice()).map_err(failed)?;
        match self.task.space {
            Space::Task => Ok(task.as_slice()[..3].to_vec()),
            Space::Joint => {
                let mut joints = vec![0.0; columns.len()];
                joint_coupling(&columns, &task, gains.damping, &mut joints).map_err(failed)?;
                Ok(joints)
            }
        }
    }

    /// Comes to rest in the motion.
    async fn fade(&mut self) -> Result<(), Stop> {
        let mut pace: f64 = 1.0;
        while pace > 0.0 {
            let (sample, dt) = self.senses.next().await?;
            let points = self.points(&sample);
            self.step(&sample, dt, &points)?;
            pace = (pace - dt / FADES).max(0.0);
            let omega = self.task.paths[0].omega * pace;
            for motion in &mut self.motions {
                motion.primitive.step(dt, omega).map_err(failed)?;
            }
        }
        Ok(())
    }

    /// Goes back to where the motions begin, both hands at once.
    async fn back(&mut self) -> Result<(), Stop> {
        let sample = self.senses.newest();
        let points = self.points(&sample);
        let home = self.motions.each_ref().map(HandMotion::home);
        let far =
            |hand: usize| (points[hand].pose.translation.vector - home[hand].pose.translation.vector).norm();
        let longest = far(0).max(far(1)).max(1e-3);
        let line = |hand: usize| {
            let speed = BACK * far(hand).max(1e-6) / longest;
            StraightLine::new(points[hand].pose, home[hand].pose, speed).map_err(failed)
        };
        let mut lines = [line(0)?, line(1)?];
        for hand in 0..2 {
            self.motions[hand].pull_home(self.both.arm(hand));
        }
        while !lines.iter().all(|line| line.rested(0.0)) {
            let (sample, dt) = self.senses.next().await?;
            let [first, second] = &mut lines;
            let points = [first.step(dt).map_err(failed)?, second.step(dt).map_err(failed)?];
            self.step(&sample, dt, &points)?;
        }
        Ok(())
    }
}

/// What the hands do to the load at rest.
#[derive(Default)]
struct RestForces {
    internal: Vector6<f64>,
    /// What they carry, N.
    external: Vector3<f64>,
}

impl RestForces {
    /// Whether something else than the load's weight and inertia is on the hands.
    fn is_disturbed(&self, carried: &Vector3<f64>) -> bool {
        let (least, share) = DISTURBED;
        (carried - self.external).norm() > least.max(share * self.external.norm())
    }
}

/// What the first hand does against the second one: the internal force, N, and moment, N m.
fn internal(forces: &LoadForces) -> Vector6<f64> {
    let (f, m) = (forces.internal, forces.moment);
    Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
}

/// What it should do against it less what it does. It should press with the wanted squeeze, and do beside that what it did at rest.
fn missing(rest: &Vector6<f64>, felt: &Vector6<f64>, step: &SharedLoadStep) -> Vector6<f64> {
    let line = step.forces.line.into_inner();
    let mut wanted = *rest;
    let along = rest.fixed_rows::<3>(0).dot(&line);
    let mut force = wanted.fixed_rows_mut::<3>(0);
    force += line * (step.wanted - along);
    wanted - felt
}

/// A wrench whose force along the line between the hands counts less. Moments do not count: a hand that learns in its joints would
/// turn until it feels none, and keep a wrong height.
fn weighted(wrench: &Vector6<f64>, step: &SharedLoadStep) -> Vector6<f64> {
    let line = step.forces.line.into_inner();
    let mut weighted = *wrench;
    let along = wrench.fixed_rows::<3>(0).dot(&line);
    let mut force = weighted.fixed_rows_mut::<3>(0);
    force -= line * (along * (1.0 - ALONG));
    weighted.fixed_rows_mut::<3>(3).fill(0.0);
    weighted
}
