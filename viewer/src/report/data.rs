//! What the page of a run shows: how it ended, what describes it, and sections in order.

use armarium_values::report::Section;
use serde::{Deserialize, Serialize};

/// All that the page shows. What is absent is not shown.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ReportData {
    /// The page's title, usually the chart's name.
    pub title: String,
    /// One sentence under it, usually the chart's description.
    pub subtitle: String,
    /// `success`, or how else the run ended.
    pub outcome: String,
    /// Why, when it is not success.
    pub reason: Option<String>,
    /// The states that the failure came through, innermost first.
    pub failure_chain: Vec<ChainLink>,
    /// What describes the run (seed, world, durations ...) in the order shown.
    pub facts: Vec<(String, String)>,
    /// The rest, in order.
    pub sections: Vec<Section>,
}

/// One state of a failure's chain.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainLink {
    /// The state's path.
    pub state: String,
    /// What it says, where it adds something.
    pub reason: Option<String>,
}
