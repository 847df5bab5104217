//! Physics of the robot, table, sponge and coach, the cameras, and a referee that alone knows the truth.
//!
//! - [`world`]: the world file. [`Simulation`]: everything together, stepped by tokio's clock.
//! - [`physics`]: Rapier, grip and wrist sensor; on [`table`] and [`foundation`], the soft underside of objects.
//! - [`start`]: where robots and bodies are at first. [`person`]: people who keep to a schedule; [`figure`]: their bodies.
//! - [`coach`]: the person who demonstrates and coaches. [`cameras`], [`render`]: what the robot sees.
//! - [`truth`]: the true state, for recorder and [`referee`]; skills never see it.
//!
//! This room does not know skills, charts or memory.

mod accidents;
pub mod cameras;
pub mod coach;
mod error;
pub mod figure;
pub mod foundation;
mod leading;
pub mod modification;
pub mod person;
pub mod physics;
pub mod referee;
pub mod render;
mod sensing;
pub mod simulation;
pub mod start;
pub mod table;
pub mod truth;
pub mod world;

pub use error::{PlantError, SimulationError};
pub use referee::{KnownHypothesis, KnownSurface, KnownThing, KnownTouch, Milestone, Referee};
pub use simulation::{Handle, Options, RobotInWorld, Simulation};
pub use truth::{TruthDigest, TruthEvent, TruthSample, TruthSink};
pub use world::World;
