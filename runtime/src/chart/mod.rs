//! Charts as files: reading them, finding what is wrong with them, compiling them for the engine.
//!
//! [`load`] reads a file and the charts that it names, [`check`] finds everything that is wrong at once and,
//! where nothing is, gives the [`Program`](crate::program::Program) that the executor runs. [`index()`] says what every name in
//! them stands for.

mod actions;
mod catalog;
mod channels;
mod compile;
mod early;
mod expressions;
mod flatten;
mod foreign;
mod forms;
mod index;
mod library;
mod lint;
mod literals;
mod model;
mod names;
mod outline;
mod read;
mod read_action;
mod read_state;
mod schema;
mod scope;
mod scoped;
mod suspicious;
mod symbols;
mod targets;

pub use catalog::{
    ChannelDescription, ChannelSchema, KnownNames, MemorySegment, Refused, Registry, UnknownName,
};
pub use compile::{Checked, check};
pub use index::index;
pub use library::{Library, files, load, load_from, load_text};
pub(crate) use literals::unit_of_time;
pub use model::Chart;
pub use outline::{Outline, OutlineKind, OutlineState, OutlineTransition};
pub use read::is_name;
pub use schema::schema;
pub use symbols::{HeadSection, NameReference, SkillPart, Symbol};

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
