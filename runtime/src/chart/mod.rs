//! Charts as files: reading them, finding what is wrong with them, compiling them for the engine.
//!
//! [`load`] reads a file and the charts that it names, [`check`] finds everything that is wrong at once and,
//! where nothing is, gives the [`Program`](crate::program::Program) that the executor runs.

mod actions;
mod catalog;
mod compile;
mod early;
mod expressions;
mod flatten;
mod forms;
mod library;
mod lint;
mod model;
mod outline;
mod read;
mod read_state;
mod schema;
mod targets;

pub use catalog::{ChannelSchema, Refused, Registry};
pub use compile::{Checked, check};
pub use library::{Library, load, load_text};
pub use model::Chart;
pub use outline::{Outline, OutlineKind, OutlineState, OutlineTransition};
pub(crate) use read::is_name;
pub use schema::schema;

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
