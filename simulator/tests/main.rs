//! The simulator from outside: a robot that is commanded through its seam. One test program, which is built once and uses all cores.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod simulation;
mod wiping;
