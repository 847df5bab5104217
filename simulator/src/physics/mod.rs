//! The physics: Rapier, the springs under objects, the hands with grip and wrist sensor.
//!
//! Start with [`Plant`]. This module has no clock, noise or coach.

mod assembly;
mod build;
pub mod carrying;
mod convert;
mod drives;
pub mod grip;
mod hand;
pub mod pad;
mod plant;
#[cfg(test)]
mod tests;
mod wrench;

pub use plant::{DT, External, PAD_FRICTION, Plant};
