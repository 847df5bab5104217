//! The physics: Rapier, the bed of springs under objects, the grip and the wrist sensor.
//!
//! Start with [`Plant`]. This module knows no clock, no noise and no coach.

mod assembly;
mod build;
pub mod carrying;
mod convert;
mod drives;
pub mod grip;
pub mod pad;
mod plant;
#[cfg(test)]
mod tests;
mod wrench;

pub use plant::{DT, External, PAD_FRICTION, Plant, PlantError};
