//! Why an experiment gives no figures, and the ranges of its settings.

use armarium_motion::MotionError;

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
