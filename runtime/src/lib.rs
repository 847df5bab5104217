//! Statecharts: written in YAML, checked at load, run by a pure engine and an executor that starts skills.
//!
//! - [`skill`]: what a leaf of a chart is, and what it is given while it runs;
//! - [`channels`]: what observers publish and watches read.
//!
//! This room knows no robot, no memory and no network (remote states: feature `remote`).

pub mod channels;
pub mod skill;
