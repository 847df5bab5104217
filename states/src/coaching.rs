//! What force and vision coaching share: they follow the phase of the running motion, change its weights by the
//! coaching law, and write each change to the motion's entity in memory, where the motion that runs reads it.

use armarium_memoryx::EntityId;
use armarium_motion::{Coach, CoachConfig, CoachInput, CoachReport, PeriodicDmp};
use armarium_runtime::skill::{Failure, SkillContext};
use armarium_values::Value;

use crate::arm::Senses;
use crate::equipment::Equipment;
use crate::inputs::Inputs;
use crate::motions;

/// How often changed weights are written to memory, s.
const WRITE_EVERY: f64 = 0.02;

/// The running motion at one control step.
pub(crate) struct RunningStep {
    dt: f64,
    phase: f64,
    omega: f64,
    stamp_ns: u64,
}

impl RunningStep {
    /// Time since the step before, s.
    pub(crate) fn dt(&self) -> f64 {
        self.dt
    }
}

/// A coach at work on the motion that runs.
pub(crate) struct Coaching {
    equipment: Equipment,
    context: SkillContext,
    senses: Senses,
    id: EntityId,
    dmp: PeriodicDmp,
    coach: Coach,
    /// Since the coach last did something, s.
    idle: f64,
    /// Since the weights were last written, s.
    unwritten: f64,
    changed: bool,
}

impl Coaching {
    /// Starts from the newest version of the motion that the input `motion` refers to.
    pub(crate) async fn begin(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let id = context.entity("motion")?;
        let (motion, _) = motions::load(&*equipment.memory, &id).await?;
        let dmp = motion.primitive().clone();
        let coach = Coach::new(CoachConfig::default(), &dmp).map_err(|e| Failure::new(e.to_string()))?;
        Ok(Self {
            senses: Senses::new(&*equipment.robot, context),
            equipment: equipment.clone(),
            context: context.clone(),
            id,
            dmp,
            coach,
            idle: 0.0,
            unwritten: 0.0,
            changed: false,
        })
    }

    /// Waits for the next control step of the running motion.
    pub(crate) async fn next(&mut self) -> Result<RunningStep, Failure> {
        let (sample, dt) = self.senses.next().await?;
        let running = self.context.channels.newest("motion");
        let number = |name: &str| running.as_ref().and_then(|s| s.value.get(name).and_then(Value::as_f64));
        let phase =
            number("phase").ok_or_else(|| Failure::new("no motion is running that could be coached"))?;
        let frequency = number("frequency").unwrap_or(0.0);
        Ok(RunningStep { dt, phase, omega: std::f64::consts::TAU * frequency, stamp_ns: sample.stamp_ns })
    }

    /// At which phase (rad) the hand that is seen came to its place, if it was seen to come.
    pub(crate) fn hand_came_at(&mut self, phase: Option<f64>) {
        self.coach.hand_came_at(phase);
    }

    /// Lets the coach act on the motion for this step.
    pub(crate) async fn apply(
        &mut self,
        step: &RunningStep,
        input: CoachInput,
    ) -> Result<CoachReport, Failure> {
        let failed = |e: armarium_motion::MotionError| Failure::new(e.to_string());
        self.dmp.set_phase(step.phase).map_err(failed)?;
        let report = self.coach.step(&mut self.dmp, step.dt, step.omega, input).map_err(failed)?;
        self.idle = if input == CoachInput::None { self.idle + step.dt } else { 0.0 };
        self.changed |= report.active;
        self.unwritten += step.dt;
        if self.changed && self.unwritten >= WRITE_EVERY {
            self.write(step.stamp_ns).await?;
        }
        Ok(report)
    }

    /// For how long the coach has done nothing, s.
    pub(crate) fn idle(&self) -> f64 {
        self.idle
    }

    /// Writes what has not been written yet.
    pub(crate) async fn keep(&mut self) -> Result<(), Failure> {
        let stamp_ns = self.senses.newest().stamp_ns;
        if self.changed { self.write(stamp_ns).await } else { Ok(()) }
    }

    /// Writes weights and centre; what others have changed of the motion meanwhile (its surface) stays.
    async fn write(&mut self, stamp_ns: u64) -> Result<(), Failure> {
        let coached = &self.dmp;
        motions::change(&*self.equipment.memory, &self.id, stamp_ns, |motion| {
            motion.next_version(coached.clone(), "coaching").map_err(|e| Failure::new(e.to_string()))
        })
        .await?;
        self.changed = false;
        self.unwritten = 0.0;
        Ok(())
    }
}
