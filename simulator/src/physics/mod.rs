//! The physics: Rapier, the springs under objects, the hands with grip and wrist sensor.
//!
//! Start with [`Plant`]. This module has no clock, noise or coach.

mod assembly;
mod build;
mod contacts;
mod convert;
mod drives;
pub mod grip;
mod hand;
pub mod pad;
mod people;
mod plant;
mod robot;
#[cfg(test)]
mod scene_tests;
#[cfg(test)]
mod tests;
mod wrench;

pub use people::LedHand;
pub use plant::{Contact, DT, External, PAD_FRICTION, Plant, PressedLoad, PressingHand, Targets, Touched};
