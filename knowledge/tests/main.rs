//! An agent's memory from outside: other processes, other languages. One test program, which is built once and uses all cores.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

#[path = "../../tests/src/outside.rs"]
mod outside;
mod two_processes;
mod wire_examples;
