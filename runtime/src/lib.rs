//! Statecharts: written in YAML, checked at load, run by a pure engine and an executor that starts skills.
//!
//! - [`program`]: a chart as tables, ready to run;
//! - [`chart`]: reading a chart, finding what is wrong with it, compiling it to a program;
//! - [`engine`]: the pure interpreter of programs, event in, effects out;
//! - [`import`]: charts that were written in SCXML;
//! - [`stepping`]: a chart driven by hand under virtual time;
//! - [`test_cases`]: cases beside a chart, played by stepping;
//! - [`agenda`]: what is due and when, over a time that is handed in: timers, watches, graces;
//! - [`exec`]: runs charts on tokio: skills, the clock, the channels;
//! - `remote`, with the feature of that name: charts and skills of other agents, over Zenoh;
//! - [`trace`]: what happened in a run;
//! - [`skill`]: what a leaf of a chart is, and what it is given while it runs;
//! - [`channels`]: what observers publish and watches read.
//!
//! This room knows no robot and no memory; and no network without the feature `remote`.

mod activation;
pub mod agenda;
pub mod channels;
pub mod chart;
pub mod engine;
pub mod exec;
pub mod import;
pub mod program;
#[cfg(feature = "remote")]
pub mod remote;
pub mod skill;
pub mod stepping;
pub mod test_cases;
pub mod trace;
