//! The interface of an experiment: from settings to figures and plots.

use armarium_viewer::report::{Curve, Panel};
use serde_json::{Map, Value};

use super::error::ExperimentError;
use super::settings::{self, ExperimentSettings, SettingInfo};

/// Named figures, and plots.
#[derive(Clone, Debug, Default)]
pub struct ExperimentResult {
    /// The top level of the JSON; a missing figure is `null`.
    pub figures: Map<String, Value>,
    /// File stem and SVG of each plot.
    pub plots: Vec<(String, String)>,
}

impl ExperimentResult {
    /// Adds a figure; a number that is not finite becomes `null`.
    pub(crate) fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.to_owned(), value.into());
    }

    /// Adds a plot, `stem.svg`.
    pub(crate) fn plot(&mut self, stem: &str, svg: String) {
        self.plots.push((stem.to_owned(), svg));
    }
}

/// A panel with these axes.
pub(crate) fn panel(x_label: impl Into<String>, y_label: impl Into<String>, curves: Vec<Curve>) -> Panel {
    Panel { x_label: x_label.into(), y_label: y_label.into(), curves, ..Panel::default() }
}

/// An experiment of the papers.
pub(crate) trait Experiment: ExperimentSettings {
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
    fn run(&self) -> Result<ExperimentResult, ExperimentError>;
}

type Run = fn(&[(String, String)]) -> Result<(Value, ExperimentResult), ExperimentError>;

/// An entry in the list of experiments.
#[derive(Debug)]
pub struct Entry {
    /// Its name on the command line.
    pub name: &'static str,
    /// A one-line description.
    pub about: &'static str,
    /// Its settings.
    pub keys: Vec<SettingInfo>,
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
    pub fn run(&self, settings: &[(String, String)]) -> Result<(Value, ExperimentResult), ExperimentError> {
        (self.run)(settings)
    }
}

/// Reads the settings and runs; returns all settings as they were used, and the outcome.
fn run<E: Experiment>(given: &[(String, String)]) -> Result<(Value, ExperimentResult), ExperimentError> {
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
