//! Primitives and laws from outside: what holds for all of them, and what the papers show. One test program, which is built once and uses all cores.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

mod bounds;
mod coaching;
mod imitation;
mod invariance;
mod rhythm;
