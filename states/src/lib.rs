//! The skills for charts: each one is a thin layer over an algorithm of `motion`, `visionx` or `robot`. Also the
//! observers, which publish sensor data on channels.
//!
//! - [`skills()`]: all of them; a new skill is one file in `skills/` and one line there.
//! - [`observers`]: the wrist and the coach's hand as channels.
//! - [`Equipment`]: the resources of skills, as traits only, so that the same chart runs with the simulator,
//!   another process or a real robot.
//!
//! A skill never accesses the simulator: it knows only what it senses.

mod arm;
mod around;
mod attended;
mod both;
mod both_seen;
mod coaching;
mod equipment;
mod grasp;
mod hand;
mod hand_eye;
mod hand_motion;
mod head;
mod held;
mod hypotheses;
mod inputs;
mod led;
mod motions;
mod needs;
pub mod observers;
mod own_hand;
mod places;
mod platform;
mod prior;
mod reach;
mod running_motion;
mod skills;
mod surface;
mod torso;
mod wiper;

pub use equipment::Equipment;
pub use hand_eye::CorrectedImages;
pub use needs::{Lack, lacks};
pub use running_motion::RunningMotions;
pub use skills::skills;
