//! The interface of an experiment: from settings to figures and plots.

use armarium_motion::MotionError;
use armarium_viewer::report::{Curve, Panel};
use serde_json::{Map, Value};

use super::settings::{self, Key, Settings};

/// Named figures, and plots.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The top level of the JSON; a missing figure is `null`.
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

/// Why an experiment gives no figures.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExperimentError {
    /// A setting is unknown, of the wrong type or out of range.
    #[error("{key}: {why}")]
    Setting {
        /// The setting.
        key: String,
        /// The reason.
        why: String,
    },
    /// Each setting is valid, but their combination is not.
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

/// Returns an error for a setting outside of `low..=high`.
pub(crate) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), ExperimentError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ExperimentError::Setting { key: key.to_owned(), why: outside(value, low, high) })
}

/// The numbers, formatted as in a setting.
fn outside(value: f64, low: f64, high: f64) -> String {
    if low == f64::MIN_POSITIVE {
        return format!("{value:?} is not over zero");
    }
    format!("{value:?} is outside of {low:?} to {high:?}")
}

/// A panel with these axes.
pub(crate) fn panel(x_label: impl Into<String>, y_label: impl Into<String>, curves: Vec<Curve>) -> Panel {
    Panel { x_label: x_label.into(), y_label: y_label.into(), curves, ..Panel::default() }
}

/// An experiment of the papers.
pub(crate) trait Experiment: Settings {
    /// Its name on the command line and in its JSON.
    const NAME: &'static str;
    /// A one-line description.
    const ABOUT: &'static str;
    /// Settings that the library names differently: the library's name, and the name here.
    const ALIASES: &'static [(&'static str, &'static str)] = &[];

    /// Runs it.
    ///
    /// # Errors
    /// [`ExperimentError`] when a setting is out of range, or the settings do not fit together.
    fn run(&self) -> Result<Outcome, ExperimentError>;
}

type Run = fn(&[(String, String)]) -> Result<(Value, Outcome), ExperimentError>;

/// An entry in the list of experiments.
#[derive(Debug)]
pub struct Entry {
    /// Its name on the command line.
    pub name: &'static str,
    /// A one-line description.
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

    /// Runs it with settings given as text. Returns all settings as they were used, and the outcome.
    ///
    /// # Errors
    /// [`ExperimentError`] for an unknown or invalid setting, and when the settings do not fit together.
    pub fn run(&self, settings: &[(String, String)]) -> Result<(Value, Outcome), ExperimentError> {
        (self.run)(settings)
    }
}

/// Reads the settings and runs; returns all settings as they were used, and the outcome.
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
