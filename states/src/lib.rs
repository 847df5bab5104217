//! The skills that charts are written with: each one a thin state around an algorithm of `motion`, `visionx` or
//! `robot`, and the observers that turn what is sensed into channels.
//!
//! - [`skills()`]: all of them; a new skill is one file in `skills/` and one line there.
//! - [`observers`]: the wrist and the coach's hand as channels.
//! - [`Equipment`]: what skills work with: traits only, so that the same chart runs against the simulator, another
//!   process or a real robot.
//!
//! A skill never sees the simulator: what it knows, it sensed.

mod arm;
mod coaching;
mod equipment;
mod frames;
mod grasp;
mod hand;
mod hand_eye;
mod head;
mod inputs;
mod motions;
pub mod observers;
mod prior;
mod reach;
mod running_motion;
mod skills;
mod wiper;

pub use equipment::Equipment;
pub use skills::skills;
