//! The robot, table, sponge, coach and cameras, in physics; and a referee that alone knows the truth.
//!
//! - [`world`]: the world file.
//! - [`table`], [`bed`]: the table, its dirt, and the soft underside of objects.
//! - [`coach`]: the person who demonstrates and coaches.
//! - [`physics`]: Rapier, grip and wrist sensor.
//! - [`render`]: what the cameras see.

pub mod bed;
pub mod coach;
pub mod physics;
pub mod render;
pub mod table;
pub mod world;
