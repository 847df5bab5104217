//! What no single room can show: scenarios, two processes, conformance, golden charts, rules of the repository.
//!
//! The tests are in `tests/tests`; here is what several of them share. The program `figures` judges the report of a
//! run for the repository's check.

pub mod hostile;
pub mod recorded;
pub mod repository;
