//! Errors of invalid input. Every operation of this crate that fails leaves its state unchanged.

/// Why an operation refused its input. `what` names the argument.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionError {
    /// A slice has the wrong length.
    #[error("{what}: {expected} values needed, {got} given")]
    Size {
        /// The argument.
        what: &'static str,
        /// The required length.
        expected: usize,
        /// The given length.
        got: usize,
    },
    /// A number is NaN or infinite, or a result would be.
    #[error("{what} is not finite")]
    NotFinite {
        /// The argument or result.
        what: &'static str,
    },
    /// A number is outside its allowed range; the bounds are allowed unless the doc says otherwise.
    #[error("{what} = {value:?} {}", beyond(*.value, *.low, *.high))]
    OutOfRange {
        /// The argument.
        what: &'static str,
        /// The given value.
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
        /// The smallest sufficient number.
        needed: usize,
        /// The given number.
        got: usize,
    },
    /// The data do not determine the result (points on one line, a constant signal).
    #[error("{what} does not determine the answer: {why}")]
    Degenerate {
        /// The data.
        what: &'static str,
        /// What is missing in them.
        why: &'static str,
    },
}

/// Describes the position of a number relative to its range.
fn beyond(value: f64, low: f64, high: f64) -> String {
    if low == f64::MIN_POSITIVE && value < low {
        "is not over zero".to_owned()
    } else {
        format!("is outside {low:?}..{high:?}")
    }
}

pub(crate) fn size(what: &'static str, expected: usize, got: usize) -> Result<(), MotionError> {
    if expected == got { Ok(()) } else { Err(MotionError::Size { what, expected, got }) }
}

pub(crate) fn finite(what: &'static str, values: &[f64]) -> Result<(), MotionError> {
    if values.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(MotionError::NotFinite { what }) }
}

/// The largest accepted magnitude; with larger numbers, products would overflow.
pub(crate) const MAX_MAGNITUDE: f64 = 1e60;

/// Checks the length, and that all values are finite and not larger than [`MAX_MAGNITUDE`].
pub(crate) fn vector(what: &'static str, expected: usize, values: &[f64]) -> Result<(), MotionError> {
    size(what, expected, values.len())?;
    values.iter().try_for_each(|v| within(what, *v, -MAX_MAGNITUDE, MAX_MAGNITUDE))
}

/// Checks that a value is finite and within `low..=high`.
pub(crate) fn within(what: &'static str, value: f64, low: f64, high: f64) -> Result<(), MotionError> {
    finite(what, &[value])?;
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(MotionError::OutOfRange { what, value, low, high })
    }
}

/// Checks a constant of a linear system such as alpha_z, or a gain such as P(0): positive, and small enough that
/// products with other allowed values do not overflow.
pub(crate) fn constant(what: &'static str, value: f64) -> Result<(), MotionError> {
    within(what, value, 1e-9, 1e9)
}

/// Checks the time between two samples of a signal: positive and at most 1e6 s, after which a signal cannot be
/// followed.
pub(crate) fn sample_time(value: f64) -> Result<(), MotionError> {
    within("dt", value, f64::MIN_POSITIVE, 1e6)
}

/// Checks a frequency, rad/s, that is used as divisor.
pub(crate) fn frequency(what: &'static str, value: f64) -> Result<(), MotionError> {
    within(what, value, 1e-9, MAX_MAGNITUDE)
}

/// Checks the width h of `count` kernels over one period: positive, and not so narrow that there is a gap between
/// two centres.
pub(crate) fn kernel_width(what: &'static str, value: f64, count: usize) -> Result<(), MotionError> {
    within(what, value, 1e-9, 100.0 * (count * count) as f64)
}

/// Checks that a value is finite and positive.
pub(crate) fn positive(what: &'static str, value: f64) -> Result<(), MotionError> {
    within(what, value, f64::MIN_POSITIVE, f64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_said_shortly_and_with_its_range() {
        let said = |result: Result<(), MotionError>| result.unwrap_err().to_string();
        assert_eq!(said(within("q", 1e300, 0.0, 1.0)), "q = 1e300 is outside 0.0..1.0");
        assert_eq!(said(positive("dt", -1e-300)), "dt = -1e-300 is not over zero");
        assert_eq!(said(positive("dt", f64::NAN)), "dt is not finite");
        assert_eq!(said(size("y", 3, 2)), "y: 3 values needed, 2 given");
    }

    #[test]
    fn kernels_may_be_as_narrow_as_their_sum_allows() {
        let kernels = crate::PhaseKernels::new(25, 100.0 * 625.0);
        let between = std::f64::consts::PI / 25.0;
        assert!(kernel_width("width", kernels.width(), 25).is_ok());
        assert!(kernels.evaluate(between, &mut [0.0; 25]) > 1e-250);
        assert!(kernel_width("width", 1.01 * kernels.width(), 25).is_err());
    }
}
