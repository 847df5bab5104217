//! The program as its users run it. One test program for all of it, which is built once and uses all cores.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod driver;
mod earlier;
mod image;
mod live;
mod losses;
mod lsp;
mod machines;
mod manual;
mod memory_commands;
mod memory_observe;
mod observe;
#[path = "../../tests/src/outside.rs"]
mod outside;
mod program;
mod programs;
mod remote;
mod robots;
mod share_scene;
mod two_runs;
