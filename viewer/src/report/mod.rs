//! `report.html`: one file that says how a run went, with every picture inside; no script, nothing from elsewhere.
//!
//! The program fills a [`ReportData`] and calls [`render`]. [`figures`] judges the numbers of a `report.json`. Long
//! signals are thinned to what a screen can show, so that the page stays small whatever the run's length.

mod axes;
mod curves;
mod data;
mod figures;
mod gantt;
mod memories;
mod page;
mod plan;
mod series;
mod svg;
mod timeplot;

pub use curves::{Curve, Look, Panel, Row, picture};
pub use data::{
    Band, Cell, ChainLink, CoachingRow, Memories, MemoryRow, Path, PathRole, Picture, ReportData, Series,
    StateSpan, TimePlot, WipedArea,
};
pub use figures::{Figure, Requirement, figures};
pub use page::render;
