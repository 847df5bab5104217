//! Output for people: the live progress line, the recording, the report.
//!
//! - [`recorder`]: `run.mcap`, all sensor data of a run and the referee's ground truth, for Foxglove and for
//!   programs.
//! - [`chart`]: a statechart as a picture, for papers and for other tools.
//! - [`report`]: `report.html`, one file with all pictures embedded, and the judgement of a report's figures.
//! - [`progress`]: one line with the current state of a run.
//!
//! This room draws plain values: it knows no simulator, reads no clock and never prints. The caller passes the
//! numbers and a writer.

pub mod chart;
mod markup;
pub mod progress;
pub mod recorder;
pub mod report;
