//! `report.html`: one file that says how a run went, with every picture inside; no script, nothing from elsewhere.
//!
//! The program fills a [`ReportData`] with sections and calls [`render`]; what a section is, `armarium_values::report` says.
//! Long signals are thinned to what a screen can show, so that the page stays small whatever the run's length.

mod axes;
mod curves;
mod data;
mod gantt;
mod page;
mod plan;
mod series;
mod svg;
mod timeplot;

pub use curves::{Curve, Look, Panel, Row, picture};
pub use data::{ChainLink, ReportData};
pub use page::render;
