//! Shared by coaching by force, by gestures and by arms: applies the coaching law to the running motion, in step with the robot's
//! samples.
//!
//! It does not own the motion: each change is sent to the skill that executes it (see `running_motion/`).

use armarium_motion::{CoachConfig, CoachInput, CoachReport, CoachedMotion};
use armarium_runtime::skill::{Failure, Outcome, SkillContext};
use nalgebra::{Point3, Vector3};

use crate::arm::Senses;
use crate::equipment::Equipment;
use crate::inputs::Inputs;
use crate::motions::failed;
use crate::running_motion::MotionEditor;

/// A coach that changes the running motion.
pub(crate) struct Coaching {
    senses: Senses,
    motion: MotionEditor,
    coach: CoachedMotion,
    /// Time since the coach's last action, s.
    idle: f64,
    /// How far the path has moved where it moved most, m.
    displacement: f64,
}

impl Coaching {
    /// Coaches the running motion that the input `motion` refers to, along the surface on which it runs.
    pub(crate) fn begin(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        Self::with(equipment, context, CoachConfig::default())
    }

    /// The same in any direction.
    pub(crate) fn begin_in_space(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        Self::with(equipment, context, CoachConfig { normal: [0.0; 3], ..CoachConfig::default() })
    }

    fn with(equipment: &Equipment, context: &SkillContext, config: CoachConfig) -> Result<Self, Failure> {
        let motion = equipment.motions.edit(&context.entity("motion")?)?;
        let coach = CoachedMotion::new(config, &motion.view()?).map_err(failed)?;
        Ok(Self {
            senses: Senses::new(&*equipment.robot, context),
            motion,
            coach,
            idle: 0.0,
            displacement: 0.0,
        })
    }

    /// Waits for the robot's next sample; returns the time since the previous one, s.
    pub(crate) async fn next(&mut self) -> Result<f64, Failure> {
        Ok(self.senses.next().await?.1)
    }

    /// Sets the phase (rad) at which the visible hand came to rest, if that was observed.
    pub(crate) fn set_arrival(&mut self, phase: Option<f64>) {
        self.coach.set_arrival(phase);
    }

    /// Applies the coach's input (root frame) to the motion for the `dt` s since the previous sample.
    pub(crate) fn apply(&mut self, dt: f64, input: CoachInput) -> Result<CoachReport, Failure> {
        self.idle = if input == CoachInput::None { self.idle + dt } else { 0.0 };
        let motion_from_root = self.motion.frame()?.inverse();
        let point = |p: Vector3<f64>| (motion_from_root * Point3::from(p)).coords;
        let input = match input {
            CoachInput::Push { force } => CoachInput::Push { force: motion_from_root * force },
            CoachInput::Attract { hand } => CoachInput::Attract { hand: point(hand) },
            CoachInput::Repel { hand } => CoachInput::Repel { hand: point(hand) },
            CoachInput::Along { at, direction } => {
                CoachInput::Along { at: point(at), direction: motion_from_root * direction }
            }
            CoachInput::Shift { direction } => CoachInput::Shift { direction: motion_from_root * direction },
            other => other,
        };
        let coach = &mut self.coach;
        let report = self.motion.edit(|motion, omega| coach.step(motion, dt, omega, input))?;
        if report.active {
            self.displacement = self.displacement.max(report.displacement);
        }
        Ok(report)
    }

    /// How far the path has moved where it moved most, m.
    pub(crate) fn displacement(&self) -> f64 {
        self.displacement
    }

    /// The outcome, once the coach has not acted for longer than `patience` s.
    pub(crate) fn ended(&self, patience: f64) -> Option<Outcome> {
        (self.idle > patience).then(|| Outcome::success().with("displacement", self.displacement))
    }
}
