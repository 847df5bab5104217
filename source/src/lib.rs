//! Files that people write: how they are read, and what is said of them.
//!
//! - [`Source`], [`Span`], [`Finding`]: a file's text, places in it, and what is wrong there, as data;
//! - [`code`]: the stable codes of findings, one dialect for all kinds of files;
//! - [`yaml`]: the text as a bounded tree in which everything knows its place;
//! - [`Layout`]: where the entries of a text stand, broken texts too; [`Remedy`]: how a finding is put right;
//! - [`draw()`]: ranges become values, by a seed;
//! - [`Files`]: where files are read from;
//! - [`form!`]: a section of keys, declared once: the type, its defaults, its reader and its JSON Schema.
//!
//! Charts, worlds, prior knowledge, test cases and calibration files are read with it. It knows none of them, and it prints
//! nothing.

// `form!` names this crate.
extern crate self as armarium_source;

pub mod code;
mod draw;
mod field;
mod files;
mod finding;
mod form;
mod layout;
mod remedy;
mod span;
mod stack;
#[cfg(test)]
mod tests;
mod text;
mod tree;
pub mod yaml;

pub use draw::{Drawn, draw};
pub use field::{Field, Rule, word};
pub use files::{Disk, Files, is_yaml, outermost};
pub use finding::{Finding, Findings, Severity, listed, suggest};
pub use form::{Form, FormKey, object, read, read_node, schema, set};
pub use layout::{Brackets, Layout, LayoutEntry};
pub use remedy::{Edit, Remedy, applied};
pub use span::Span;
pub use stack::on_a_large_stack;
pub use text::Source;
#[doc(hidden)]
pub use {serde, serde_json};
