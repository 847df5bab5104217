//! The robot, table, sponge, coach and cameras, in physics; and a referee that alone knows the truth.
//!
//! - [`world`]: the world file. [`Simulation`]: everything together, stepped by tokio's clock.
//! - [`physics`]: Rapier, grip and wrist sensor; on [`table`] and [`foundation`], the soft underside of objects.
//! - [`coach`]: the person who demonstrates and coaches. [`cameras`], [`render`]: what the robot sees.
//! - [`carrying`]: both arms and a box between their hands, an experiment beside the wiping.
//! - [`truth`]: what is true, for recorder and [`referee`]; skills never see it.
//!
//! This room knows no skill, no chart and no memory.

pub mod cameras;
pub mod carrying;
pub mod coach;
mod error;
pub mod foundation;
pub mod modification;
pub mod physics;
pub mod referee;
pub mod render;
mod sensing;
pub mod simulation;
pub mod table;
pub mod truth;
pub mod world;

pub use error::SimulationError;
pub use referee::{Mark, Referee, RefereeReport};
pub use simulation::{Handle, Options, Simulation};
pub use truth::{TruthDigest, TruthEvent, TruthSample, TruthSink};
pub use world::World;
