//! The content of a run's page: its outcome, its facts, and sections in order.

use armarium_values::report::Section;
use serde::{Deserialize, Serialize};

/// The content of the page. Absent parts are not shown.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ReportData {
    /// The page's title, usually the chart's name.
    pub title: String,
    /// One sentence below it, usually the chart's description.
    pub subtitle: String,
    /// `success`, or the kind of failure.
    pub outcome: String,
    /// The reason, unless it is success.
    pub reason: Option<String>,
    /// The states that the failure passed through, innermost first.
    pub failure_chain: Vec<ChainLink>,
    /// Facts about the run (seed, world, durations ...) in display order.
    pub facts: Vec<(String, String)>,
    /// The sections, in display order.
    pub sections: Vec<Section>,
}

/// One state of a failure's chain.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainLink {
    /// The state's path.
    pub state: String,
    /// Its reason, where it adds information.
    pub reason: Option<String>,
}
