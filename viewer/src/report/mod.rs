//! `report.html`: one file that shows how a run went, with all pictures embedded; no scripts and no external resources.
//!
//! The program fills a [`ReportData`] with sections and calls [`render`]; `armarium_values::report` defines sections.
//! Long signals are reduced to a screen's resolution, so that the page stays small whatever the run's length.

mod axes;
mod curves;
mod data;
mod gantt;
mod page;
mod plan;
mod series;
mod svg;
mod timeplot;

pub use curves::{Curve, Look, Panel, PanelRow, picture};
pub use data::{ChainLink, ReportData};
pub use page::render;
pub(crate) use page::{fragment, scoped_style};
pub(crate) use series::thinned;
