//! What can be wrong with the numbers that are handed in. Every operation of this crate that fails leaves
//! its state as it was.

/// Why an operation refused its input. `what` names the argument.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionError {
    /// A slice has another length than the primitive needs.
    #[error("{what}: {expected} values needed, {got} given")]
    Size {
        /// The argument.
        what: &'static str,
        /// The length that was needed.
        expected: usize,
        /// The length that was given.
        got: usize,
    },
    /// A number is NaN or infinite, or a result would be.
    #[error("{what} is not finite")]
    NotFinite {
        /// The argument or result.
        what: &'static str,
    },
    /// A number lies outside of what it may be; the bounds belong to the allowed range unless the doc says otherwise.
    #[error("{what} = {value} is outside {low}..{high}")]
    OutOfRange {
        /// The argument.
        what: &'static str,
        /// What was given.
        value: f64,
        /// The smallest allowed value.
        low: f64,
        /// The largest allowed value.
        high: f64,
    },
    /// There is too little data.
    #[error("{what}: at least {needed} needed, {got} given")]
    TooFew {
        /// What there is too little of.
        what: &'static str,
        /// The smallest number that works.
        needed: usize,
        /// The number given.
        got: usize,
    },
    /// The data do not determine the answer (points on one line, a constant signal).
    #[error("{what} does not determine the answer: {why}")]
    Degenerate {
        /// The data.
        what: &'static str,
        /// What is missing in them.
        why: &'static str,
    },
}

pub(crate) fn size(what: &'static str, expected: usize, got: usize) -> Result<(), MotionError> {
    if expected == got { Ok(()) } else { Err(MotionError::Size { what, expected, got }) }
}

pub(crate) fn finite(what: &'static str, values: &[f64]) -> Result<(), MotionError> {
    if values.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(MotionError::NotFinite { what }) }
}

/// The largest magnitude that is taken for a number of this world; beyond it products would overflow.
pub(crate) const LARGEST: f64 = 1e60;

/// Right length, all finite and none absurdly large.
pub(crate) fn vector(what: &'static str, expected: usize, values: &[f64]) -> Result<(), MotionError> {
    size(what, expected, values.len())?;
    values.iter().try_for_each(|v| within(what, *v, -LARGEST, LARGEST))
}

/// Finite and within `low..=high`.
pub(crate) fn within(what: &'static str, value: f64, low: f64, high: f64) -> Result<(), MotionError> {
    finite(what, &[value])?;
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(MotionError::OutOfRange { what, value, low, high })
    }
}

/// Finite and over zero.
pub(crate) fn positive(what: &'static str, value: f64) -> Result<(), MotionError> {
    within(what, value, f64::MIN_POSITIVE, f64::MAX)
}
