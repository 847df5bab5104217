//! Files that people write: how they are read, and what is said of them.
//!
//! - [`Source`], [`Span`], [`Finding`]: a file's text, places in it, and what is wrong there, as data;
//! - [`code`]: the stable codes of findings, one dialect for all kinds of files;
//! - [`yaml`]: the text as a bounded tree in which everything knows its place;
//! - [`form!`]: a section of keys, declared once: the type, its defaults, its reader and its JSON Schema.
//!
//! Charts, worlds, prior knowledge, test cases and calibration files are read with it. It knows none of them, and it prints
//! nothing.

// `form!` names this crate.
extern crate self as armarium_source;

pub mod code;
mod field;
mod finding;
mod form;
mod stack;
#[cfg(test)]
mod tests;
pub mod yaml;

pub use field::{Field, Rule, word};
pub use finding::{Finding, Findings, Severity, Source, Span, suggest};
pub use form::{Form, Key, object, read, read_node, schema, set};
pub use stack::on_a_large_stack;
#[doc(hidden)]
pub use {serde, serde_json};
