//! Movement primitives and control laws: numbers in, numbers out.
//!
//! Pure mathematics on `nalgebra`. Nothing here knows a robot, a thread, a file or a clock; time enters as `dt`.
//! A step does not allocate. What comes from outside is checked: an operation that refuses its input says which
//! value was wrong and leaves its state as it was.
//!
//! Where to start reading: `dmp/mod.rs` is the core that all primitives share, [`PeriodicDmp`] is what is executed,
//! [`AdaptiveOscillator`] finds the rhythm of a demonstration, [`Imitation`] joins the two, [`Coach`] changes a motion while
//! it runs, [`SurfaceAdaptation`] learns how it must move to keep a force, [`Motion`] is how it is kept.
//! [`PeriodicOrientationDmp`] and [`DiscreteOrientationDmp`] are the primitives of orientations.
//!
//! Equation numbers refer to Petrič, Gams, Žlajpah, Ude and Morimoto, "Online approach for altering robot
//! behaviors based on human in the loop coaching gestures", ICRA 2014, unless another paper is named.

mod coach;
mod coupling;
mod discrete;
mod discrete_periodic;
mod dmp;
mod edit;
mod error;
mod field;
mod fourier;
mod friction;
mod ilc;
mod imitation;
mod motion;
mod orientation;
mod oscillator;
mod period;
mod periodic;
mod rigid_fit;
mod segment;
mod servo;
mod straight_line;
mod surface;
mod surface_correction;
mod synchronisation;
mod touchdown;

pub use coach::{Coach, CoachConfig, CoachInput, CoachReport, HandField};
pub use coupling::{ObstacleAvoidance, joint_coupling};
pub use discrete::{DiscreteDmp, DiscreteDmpConfig, DiscreteState};
pub use discrete_periodic::{
    CanonicalRule, CanonicalSystem, DiscretePeriodicConfig, DiscretePeriodicDmp, DiscretePeriodicState,
    differentiate,
};
pub use dmp::TimeSample;
pub use edit::MotionEdit;
pub use error::MotionError;
pub use field::{
    CoachArm, CoachingCommand, PotentialField, SlowDown, nearer_hand, pulling_hand, pushing_hand,
};
pub use friction::{FrictionConfig, FrictionModel};
pub use ilc::{FeedbackError, LearningControl, LearningControlConfig};
pub use imitation::Imitation;
pub use motion::{Motion, MotionDof, MotionSwitch};
pub use orientation::{DiscreteOrientationDmp, OrientationState, PeriodicOrientationDmp};
pub use oscillator::{AdaptiveOscillator, OscillatorConfig, OscillatorRule};
pub use period::{PeriodEstimate, PeriodEstimator};
pub use periodic::{
    DmpState, Integrator, PathResponse, PeriodicDmp, PeriodicDmpConfig, PeriodicPath, PhaseKernels,
    PhaseSample,
};
pub use rigid_fit::{RigidFit, rigid_fit};
pub use segment::{Demonstration, DemonstrationSegmenter, DemonstrationStage, SegmenterConfig, Swipe};
pub use servo::{PositionServo, ServoCommand, ServoConfig, ServoObservation, ServoStatus};
pub use straight_line::{LinePoint, StraightLine};
pub use surface::{SurfaceAdaptation, SurfaceCommand, SurfaceConfig};
pub use surface_correction::SurfaceCorrection;
pub use synchronisation::{Synchronisation, SynchronisationConfig};
pub use touchdown::{Touchdown, TouchdownConfig, TouchdownStatus};
