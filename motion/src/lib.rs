//! Movement primitives and control laws: numerical input, numerical output.
//!
//! Pure mathematics on `nalgebra`, without robots, threads, files or clocks; time enters as `dt`. A step does not
//! allocate. Input is checked: an operation that refuses its input names the invalid value and leaves its state
//! unchanged.
//!
//! Where to start reading: `dmp/mod.rs` is the core that all primitives share, and [`PeriodicDmp`] is the primitive
//! that is executed. [`AdaptiveOscillator`] finds the frequency of a demonstration, [`Imitation`] combines the two,
//! [`CoachedMotion`] changes a running motion, [`SurfaceAdaptation`] learns the motion that keeps a force, and [`Motion`]
//! is the stored form, [`Movement`] that of a movement to a goal. [`Admittance`] lets a hand be led by the force on it;
//! [`SharedLoad`] moves one load with two hands. [`PeriodicOrientationDmp`] and [`DiscreteOrientationDmp`] are the primitives of
//! orientations.
//!
//! Equation numbers refer to Petrič, Gams, Žlajpah, Ude and Morimoto, "Online approach for altering robot
//! behaviors based on human in the loop coaching gestures", ICRA 2014, unless another paper is named.

#[macro_use]
mod constants;
#[macro_use]
mod dmp;

mod admittance;
mod coach;
mod contact_frame;
mod coupling;
mod discrete;
mod discrete_periodic;
mod edit;
mod error;
mod field;
mod fourier;
mod friction;
mod gaze;
mod ilc;
mod imitation;
mod lift_and_shake;
mod motion;
mod mounting;
mod movement;
mod orientation;
mod oscillator;
mod period;
mod periodic;
mod planar_turn;
mod rigid_fit;
mod segment;
mod servo;
mod shared_load;
mod straight_line;
mod surface;
mod surface_correction;
mod synchronisation;
mod touchdown;

pub use admittance::{Admittance, AdmittanceConfig, GuidedStep, GuidingStatus};
pub use coach::{CoachConfig, CoachInput, CoachReport, CoachedMotion, HandField};
pub use contact_frame::ContactFrame;
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
pub use gaze::{GazeConfig, GazeSelection, GazeStrategy, GazeTarget, GazeView, saliency};
pub use ilc::{FeedbackError, LearningControl, LearningControlConfig};
pub use imitation::Imitation;
pub use lift_and_shake::{LiftAndShake, rise};
pub use motion::{Motion, MotionDof, MotionSwitch};
pub use mounting::{CameraMounting, MarkerView};
pub use movement::{Movement, MovementPlay};
pub use orientation::{DiscreteOrientationDmp, OrientationState, PeriodicOrientationDmp};
pub use oscillator::{AdaptiveOscillator, OscillatorConfig, OscillatorRule};
pub use period::{PeriodEstimate, PeriodEstimator};
pub use periodic::{
    DmpState, Integrator, PathResponse, PeriodicDmp, PeriodicDmpConfig, PeriodicPath, PhaseKernels,
    PhaseSample,
};
pub use planar_turn::planar_turn;
pub use rigid_fit::{RigidFit, rigid_fit, rigid_fit_held};
pub use segment::{Demonstration, DemonstrationSegmenter, DemonstrationStage, SegmenterConfig, Swipe};
pub use servo::{PositionServo, ServoCommand, ServoConfig, ServoObservation, ServoStatus, in_step};
pub use shared_load::{
    HandOnLoad, Holding, LoadForces, LoadStatus, SharedLoad, SharedLoadConfig, SharedLoadStep,
};
pub use straight_line::{LinePoint, StraightLine};
pub use surface::{SurfaceAdaptation, SurfaceCommand, SurfaceConfig};
pub use surface_correction::SurfaceCorrection;
pub use synchronisation::{Synchronisation, SynchronisationConfig};
pub use touchdown::{Touchdown, TouchdownConfig, TouchdownStatus};
