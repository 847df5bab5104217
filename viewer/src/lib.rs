//! What people look at: the live progress line, the recording, the report.
//!
//! - [`recorder`]: `run.mcap`, everything that a run sensed and that the referee saw, for Foxglove and for programs.
//! - [`chart`]: a statechart as a picture, for papers and for other tools.
//! - [`report`]: `report.html`, one file with every picture inside, and the judgement of a report's figures.
//! - [`progress`]: one line that says what is happening now.
//!
//! This room is given plain values and draws them: it knows no simulator, reads no clock and never prints; the
//! program hands it numbers and a place to write.

pub mod chart;
pub mod progress;
pub mod recorder;
pub mod report;
