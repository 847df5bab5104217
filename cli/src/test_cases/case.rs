//! The form of a file of test cases.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value as Json;

/// A file of test cases.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TestFile {
    /// The chart, relative to this file.
    pub(super) test: String,
    /// How skills end, by the skill's name or by the state, unless a case says otherwise.
    #[serde(default)]
    pub(super) skills: BTreeMap<String, Script>,
    pub(super) cases: Vec<Case>,
}

/// One case.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Case {
    /// What it shows.
    pub(super) case: String,
    /// Inputs of the chart.
    #[serde(default)]
    pub(super) given: BTreeMap<String, Json>,
    pub(super) profile: Option<String>,
    #[serde(default)]
    pub(super) skills: BTreeMap<String, Script>,
    #[serde(default)]
    pub(super) steps: Vec<Step>,
}

/// How a skill ends: always so, or one way after the other, the last of which stays.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum Script {
    // A list first: it could be read as the fields of an ending in their order.
    Several(Vec<Ending>),
    One(Ending),
}

impl Script {
    /// How the skill ends when it is started for the `n`th time, from 0.
    pub(super) fn ending(&self, n: usize) -> Ending {
        match self {
            Self::One(ending) => ending.clone(),
            Self::Several(list) => list.get(n).or(list.last()).cloned().unwrap_or_default(),
        }
    }
}

/// How a skill ends once: an outcome (`never` is one that does not come), or with more said about it.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum Ending {
    Outcome(String),
    Told(Told),
}

impl Default for Ending {
    fn default() -> Self {
        Self::Outcome("success".into())
    }
}

impl Ending {
    pub(super) fn told(self) -> Told {
        match self {
            Self::Outcome(outcome) => Told { outcome, ..Told::default() },
            Self::Told(told) => told,
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Told {
    pub(super) outcome: String,
    /// A duration: `2s`.
    pub(super) after: Option<String>,
    pub(super) outputs: BTreeMap<String, Json>,
    pub(super) reason: Option<String>,
}

impl Default for Told {
    fn default() -> Self {
        Self { outcome: "success".into(), after: None, outputs: BTreeMap::new(), reason: None }
    }
}

/// One step: time goes by, then one thing happens, then something is expected.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Step {
    pub(super) after: Option<String>,
    /// An event; with `from`, an outcome or a watch of that state.
    pub(super) event: Option<String>,
    pub(super) from: Option<String>,
    #[serde(default)]
    pub(super) data: Json,
    pub(super) channel: Option<String>,
    #[serde(default)]
    pub(super) value: Json,
    pub(super) expect: Option<Expect>,
}

/// What is expected; what is left out is not looked at.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Expect {
    /// All innermost active states.
    pub(super) active: Option<Vec<String>>,
    pub(super) locals: BTreeMap<String, Json>,
    pub(super) outputs: BTreeMap<String, Json>,
    /// How the run has ended.
    pub(super) outcome: Option<String>,
    /// A part of the reason.
    pub(super) reason: Option<String>,
    /// A part of what was logged since the last step that looked at it.
    pub(super) log: Option<String>,
    /// An event that was sent to another agent since the last step that looked at it.
    pub(super) sent: Option<String>,
}

/// Reads a file's text.
///
/// # Errors
/// What is wrong, with its place, for people.
pub(super) fn parse(text: &str) -> Result<TestFile, String> {
    let options = serde_saphyr::options! { strict_booleans: true, with_snippet: false };
    serde_saphyr::from_str_with_options(text, options).map_err(|e| e.without_snippet().to_string())
}
