//! The data that skills, memory and agents exchange: self-describing typed values with units and frames, their
//! schemas, CEL expressions over them, and reports as plain data.
//!
//! This room knows no robot, no clock and no network. Start with [`Value`] and [`Type`].

pub mod expr;
mod geometry;
pub mod report;
pub mod transforms;
mod types;
mod unit;
mod value;

pub use geometry::{Frame, Pose, Vector, Wrench};
pub use types::{ConvertError, Fit, Type};
pub use unit::{Unit, UnitExponents, UnknownUnit, parse_quantity, split_quantity};
pub use value::{Reference, Value};
