//! Tests that no single room can do: scenarios, two processes, conformance, golden charts, rules of the repository.
//!
//! The tests are in `tests/tests`; this library holds what several of them share. The program `figures` judges the
//! report of a run for the repository's check.

pub mod hostile;
pub mod outside;
pub mod recorded;
pub mod repository;
