//! Movement primitives and control laws: numbers in, numbers out.
//!
//! Pure mathematics on `nalgebra`. Nothing here knows a robot, a thread, a file or a clock; time enters as `dt`.
//! A step does not allocate. What comes from outside is checked: an operation that refuses its input says which
//! value was wrong and leaves its state as it was.
//!
//! Where to start reading: [`PeriodicDmp`] is what is executed, [`AdaptiveOscillator`] finds the rhythm of a
//! demonstration, [`Imitation`] joins the two, [`Coach`] changes a motion while it runs,
//! [`SurfaceAdaptation`] learns how it must move to keep a force, [`Motion`] is how it is kept.
//!
//! Equation numbers refer to Petrič, Gams, Žlajpah, Ude and Morimoto, "Online approach for altering robot
//! behaviors based on human in the loop coaching gestures", ICRA 2014, unless another paper is named.

mod coach;
mod coupling;
mod decay_kernels;
mod discrete;
mod discrete_learning;
mod discrete_periodic;
mod error;
mod field;
mod fourier;
mod friction;
mod ilc;
mod imitation;
mod kernels;
mod motion;
mod oscillator;
mod path;
mod pdmp;
mod pdmp_learning;
mod period;
mod rigid_fit;
mod segment;
mod servo;
mod straight_line;
mod surface;
mod surface_correction;
mod synchronisation;
mod touchdown;

pub use coach::{Coach, CoachConfig, CoachInput, CoachReport};
pub use coupling::{ObstacleAvoidance, joint_coupling};
pub use discrete::{DiscreteDmp, DiscreteDmpConfig, DiscreteState};
pub use discrete_learning::TimeSample;
pub use discrete_periodic::{
    CanonicalRule, CanonicalSystem, DiscretePeriodicConfig, DiscretePeriodicDmp, DiscretePeriodicState,
    differentiate,
};
pub use error::MotionError;
pub use field::{
    CoachArm, CoachingCommand, PotentialField, SlowDown, nearer_hand, pulling_hand, pushing_hand,
};
pub use friction::{FrictionConfig, FrictionModel};
pub use ilc::{FeedbackError, LearningControl, LearningControlConfig};
pub use imitation::Imitation;
pub use kernels::PhaseKernels;
pub use motion::{Motion, MotionDof, MotionSwitch};
pub use oscillator::{AdaptiveOscillator, OscillatorConfig, OscillatorRule};
pub use path::{PathResponse, PeriodicPath};
pub use pdmp::{DmpState, Integrator, PeriodicDmp, PeriodicDmpConfig};
pub use pdmp_learning::PhaseSample;
pub use period::{PeriodEstimate, PeriodEstimator};
pub use rigid_fit::{RigidFit, rigid_fit};
pub use segment::{Demonstration, DemonstrationSegmenter, DemonstrationStage, SegmenterConfig, Swipe};
pub use servo::{PositionServo, ServoCommand, ServoConfig, ServoObservation, ServoStatus};
pub use straight_line::{LinePoint, StraightLine};
pub use surface::{SurfaceAdaptation, SurfaceCommand, SurfaceConfig};
pub use surface_correction::SurfaceCorrection;
pub use synchronisation::{Synchronisation, SynchronisationConfig};
pub use touchdown::{Touchdown, TouchdownConfig, TouchdownStatus};
