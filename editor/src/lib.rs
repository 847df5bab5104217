//! The language server and the formatter for charts, worlds, test cases and prior knowledge: errors, completion and hover while
//! a file is being written.
//!
//! - [`Workspace`] knows the open documents and answers: what is wrong, what may be written, what a name stands for. Start reading
//!   there; each kind of answer is a file of its own;
//! - [`check`] finds what is wrong with a file: `armarium check` does it with the same function;
//! - [`format()`] gives a file its form;
//! - [`serve`] speaks the protocol.
//!
//! What names stand for is found by the compiler of charts (`runtime::chart::index`), and what may stand where by the tables of keys
//! from which the readers are made; there is no second grammar here. Only `server` knows of a connection; nothing prints.

mod cases;
mod completion;
mod cursor;
mod fixes;
mod format;
mod hints;
mod hover;
mod kind;
mod navigate;
mod rename;
mod schemas;
mod scope;
mod server;
mod symbols;
mod text;
mod uri;
mod workspace;

pub use format::format;
pub use kind::{Catalog, CheckedFile, FileKind, check};
pub use lsp_types;
pub use rename::RenameError;
pub use server::{ServerError, serve, serve_stdio};
pub use workspace::Workspace;
