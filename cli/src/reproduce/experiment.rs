//! What an experiment is: settings that know how to become figures and plots.

use armarium_motion::MotionError;
use serde_json::{Map, Value};

use super::settings::{self, Key, Settings};

/// Figures under their names, and plots.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outcome {
    /// What stands at the top level of the JSON; a figure that does not exist is `null`.
    pub(crate) figures: Map<String, Value>,
    /// File stem and SVG of each plot.
    pub(crate) plots: Vec<(String, String)>,
}

impl Outcome {
    /// Adds a figure; a number that is not finite becomes `null`.
    pub(crate) fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.to_owned(), value.into());
    }

    /// Adds a plot, `stem.svg`.
    pub(crate) fn plot(&mut self, stem: &str, svg: String) {
        self.plots.push((stem.to_owned(), svg));
    }
}

/// Why there are no figures.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReproduceError {
    /// A setting is not there, not of its type or outside of what it may be.
    #[error("{key}: {why}")]
    Setting {
        /// The setting.
        key: String,
        /// What is wrong with it.
        why: String,
    },
    /// The settings are each possible, and together lead nowhere.
    #[error("{0}")]
    Failed(String),
}

impl From<MotionError> for ReproduceError {
    fn from(error: MotionError) -> Self {
        match error {
            MotionError::OutOfRange { what, value, low, high } => {
                Self::Setting { key: what.to_owned(), why: outside(value, low, high) }
            }
            other => Self::Failed(other.to_string()),
        }
    }
}

/// Refuses a setting outside of `low..=high`.
pub(crate) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), ReproduceError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ReproduceError::Setting { key: key.to_owned(), why: outside(value, low, high) })
}

/// The numbers as they would be written as a setting.
fn outside(value: f64, low: f64, high: f64) -> String {
    if low == f64::MIN_POSITIVE {
        return format!("{value:?} is not over zero");
    }
    format!("{value:?} is outside of {low:?} to {high:?}")
}

/// An experiment of the papers.
pub(crate) trait Experiment: Settings {
    /// Its name on the command line and of its JSON.
    const NAME: &'static str;
    /// What it runs, in one line.
    const ABOUT: &'static str;
    /// What the library calls a setting that has another name here, and that name.
    const ALIASES: &'static [(&'static str, &'static str)] = &[];

    /// Runs it.
    ///
    /// # Errors
    /// [`ReproduceError`] when a setting is outside of what it may be, or the settings lead nowhere.
    fn run(&self) -> Result<Outcome, ReproduceError>;
}

type Run = fn(&[(String, String)]) -> Result<(Value, Outcome), ReproduceError>;

/// An experiment as the command line sees it.
pub(crate) struct Entry {
    pub(crate) name: &'static str,
    pub(crate) about: &'static str,
    pub(crate) keys: Vec<Key>,
    pub(crate) run: Run,
}

impl Entry {
    /// The entry of an experiment.
    pub(crate) fn of<E: Experiment>() -> Self {
        Self { name: E::NAME, about: E::ABOUT, keys: settings::keys::<E>(), run: run::<E> }
    }
}

/// Reads the settings and runs; returns them all as they were used, and what came out.
fn run<E: Experiment>(given: &[(String, String)]) -> Result<(Value, Outcome), ReproduceError> {
    let experiment: E = settings::read(given)?;
    let inputs = serde_json::to_value(&experiment)
        .map_err(|error| ReproduceError::Failed(format!("the inputs cannot be written: {error}")))?;
    let outcome = experiment.run().map_err(|error| match error {
        ReproduceError::Setting { key, why } => {
            let name =
                E::ALIASES.iter().find(|(theirs, _)| *theirs == key).map(|(_, ours)| (*ours).to_owned());
            ReproduceError::Setting { key: name.unwrap_or(key), why }
        }
        other => other,
    })?;
    Ok((inputs, outcome))
}
