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
mod holding;
mod mass;
pub mod pad;
mod people;
mod plant;
mod robot;
#[cfg(test)]
mod scene_tests;
mod slippery;
mod soft_grip;
#[cfg(test)]
mod tests;
mod wrench;

pub use holding::{PressedLoad, PressingHand};
pub use people::LedHand;
pub use plant::{Contact, DT, External, PAD_FRICTION, Plant, Targets, Touched};
