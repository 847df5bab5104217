//! The physics: Rapier, the bed of springs under objects, the grip and the wrist sensor.
//!
//! Start with [`Plant`]. This module knows no clock, no noise and no coach.

mod assembly;
mod build;
mod convert;
pub mod grip;
mod plant;
#[cfg(test)]
mod tests;
mod wrench;

pub use plant::{DT, External, GRAVITY, PAD_FRICTION, Plant, PlantError};
