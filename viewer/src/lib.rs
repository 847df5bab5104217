//! Output for people: the live progress line, the recording, the report.
//!
//! - [`recorder`]: `run.mcap`, all sensor data of a run and the referee's ground truth, for Foxglove and for
//!   programs.
//! - [`chart`]: a statechart as a picture, for papers and for other tools.
//! - [`report`]: `report.html`, one file with all pictures embedded, and the judgement of a report's figures.
//! - [`live`]: a page that shows a run while it goes on, or from its recording.
//! - [`image_page`]: a page that shows the images of a provider live.
//! - [`label_page`]: a page on which somebody labels hands in images.
//! - [`progress`]: one line with the current state of a run.
//!
//! This room draws plain values: it knows no simulator and never prints, and only a live page waits by a clock. The
//! caller passes the numbers and a writer.

pub mod chart;
mod http;
pub mod image_page;
pub mod label_page;
pub mod live;
mod markup;
pub mod progress;
pub mod recorder;
pub mod report;
