//! Images from outside: the networks that ship, photographs, and frames between two sessions. One test program, which is built once and uses all cores.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

mod models;
mod photographs;
mod transport;
