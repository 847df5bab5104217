//! What an experiment is: settings that know how to become figures and plots.

use armarium_motion::MotionError;
use serde_json::{Map, Value};

use super::settings::{self, Key, Settings};

/// Figures under their names, and plots.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// What stands at the top level of the JSON; a figure that does not exist is `null`.
    pub figures: Map<String, Value>,
    /// File stem and SVG of each plot.
    pub plots: Vec<(String, String)>,
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
#[non_exhaustive]
pub enum ExperimentError {
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

impl From<MotionError> for ExperimentError {
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
pub(crate) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), ExperimentError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ExperimentError::Setting { key: key.to_owned(), why: outside(value, low, high) })
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
    /// [`ExperimentError`] when a setting is outside of what it may be, or the settings lead nowhere.
    fn run(&self) -> Result<Outcome, ExperimentError>;
}

type Run = fn(&[(String, String)]) -> Result<(Value, Outcome), ExperimentError>;

/// An experiment in the list of them.
#[derive(Debug)]
pub struct Entry {
    /// By what it is asked for.
    pub name: &'static str,
    /// What it runs, in one line.
    pub about: &'static str,
    /// Its settings.
    pub keys: Vec<Key>,
    run: Run,
}

impl Entry {
    /// The entry of an experiment.
    pub(crate) fn of<E: Experiment>() -> Self {
        Self { name: E::NAME, about: E::ABOUT, keys: settings::keys::<E>(), run: run::<E> }
    }

    /// Runs it with settings given as text. Gives all settings as they were used, and what came out.
    ///
    /// # Errors
    /// [`ExperimentError`] for a setting that does not exist or is not possible, and where the settings lead nowhere.
    pub fn run(&self, settings: &[(String, String)]) -> Result<(Value, Outcome), ExperimentError> {
        (self.run)(settings)
    }
}

/// Reads the settings and runs; returns them all as they were used, and what came out.
fn run<E: Experiment>(given: &[(String, String)]) -> Result<(Value, Outcome), ExperimentError> {
    let experiment: E = settings::read(given)?;
    let inputs = serde_json::to_value(&experiment)
        .map_err(|error| ExperimentError::Failed(format!("the inputs cannot be written: {error}")))?;
    let outcome = experiment.run().map_err(|error| match error {
        ExperimentError::Setting { key, why } => {
            let name =
                E::ALIASES.iter().find(|(theirs, _)| *theirs == key).map(|(_, ours)| (*ours).to_owned());
            ExperimentError::Setting { key: name.unwrap_or(key), why }
        }
        other => other,
    })?;
    Ok((inputs, outcome))
}
