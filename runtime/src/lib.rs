//! Statecharts: written in YAML, checked at load, run by a pure engine, and by an executor that starts skills.
//!
//! - [`program`]: a chart as tables, ready to run;
//! - [`chart`]: reads a chart, reports its errors, compiles it to a program;
//! - [`engine`]: the pure interpreter of programs: inputs in, effects out;
//! - [`import`]: converts charts from SCXML;
//! - [`stepping`]: drives a chart by hand under virtual time;
//! - [`test_cases`]: plays the cases beside a chart by stepping;
//! - [`agenda`]: what is due and when: timers, watches, deadlines of cancelled skills; the time is passed in;
//! - [`exec`]: runs charts on tokio: skills, the clock, the channels;
//! - `remote`, with the feature of that name: charts and skills of other agents, over Zenoh;
//! - [`trace`]: what happened in a run;
//! - [`skill`]: what a leaf of a chart runs, and its context while it runs;
//! - [`attention`]: what the skills that run need to know the place of;
//! - [`channels`]: values that observers publish and watches read;
//! - [`observed`]: what charts observe of memory, as channels.
//!
//! This room does not know robots or memory, nor the network without the feature `remote`.

mod activation;
pub mod agenda;
pub mod attention;
pub mod channels;
pub mod chart;
pub mod engine;
pub mod exec;
pub mod import;
pub mod observed;
pub mod program;
#[cfg(feature = "remote")]
pub mod remote;
pub mod skill;
pub mod stepping;
pub mod test_cases;
pub mod trace;
