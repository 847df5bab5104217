//! The data that skills, memory and agents exchange: self-describing typed values with units and frames, their
//! schemas, CEL expressions over them, observations, and reports as plain data.
//!
//! This room knows no robot, no clock and no network. Start with [`Value`] and [`Type`].

pub mod expr;
mod frame_change;
mod geometry;
mod observation;
pub mod random;
pub mod report;
mod search;
pub mod transforms;
mod types;
mod unit;
mod value;

pub use frame_change::FrameChange;
pub use geometry::{Frame, Pose, Vector, Wrench, distance_from_box};
pub use observation::{NotAnObservation, Observation, ObservedPlace};
pub use search::{Search, Shown};
pub use types::{ConvertError, Fit, Type};
pub use unit::{Unit, UnitExponents, UnknownUnit, parse_quantity, split_quantity};
pub use value::{Reference, Value};
