//! Compares periodic logs phase by phase.

use nalgebra::SVector;

/// Resamples the one period before the step `end` at equal phases from 0 on, one value per whole step of a period, by
/// interpolation. `period` is in steps and need not be whole; phase 0 is at step 0.
pub(crate) fn over_period<const N: usize>(
    log: &[SVector<f64, N>],
    end: f64,
    period: f64,
) -> Vec<SVector<f64, N>> {
    let count = period.round() as usize;
    let value = |k: usize| {
        let (phase, begin) = (period * k as f64 / count as f64, end - period);
        let at = begin + (phase - begin).rem_euclid(period) + 1e-9;
        // Rounding may put the end of the window at its beginning.
        let at = if at >= end { at - period } else { at }.max(0.0);
        let (i, part) = (at.floor() as usize, at.fract());
        let (a, b) = (log[i.min(log.len() - 1)], log[(i + 1).min(log.len() - 1)]);
        a + (b - a) * part
    };
    if log.is_empty() { Vec::new() } else { (0..count).map(value).collect() }
}

/// The mean; NaN for an empty iterator.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    sum / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;

    #[test]
    fn a_period_is_read_at_its_phases_wherever_it_ends() {
        for period in [50.0, 33.3] {
            let log: Vec<_> = (0..500)
                .map(|k| Vector1::new(libm::sin(std::f64::consts::TAU * f64::from(k) / period)))
                .collect();
            for end in [period, 211.0, 499.0] {
                let values = over_period(&log, end, period);
                for (k, value) in values.iter().enumerate() {
                    let phase = std::f64::consts::TAU * k as f64 / values.len() as f64;
                    assert!((value.x - libm::sin(phase)).abs() < 5e-3, "{period} {end} {k}");
                }
            }
        }
    }
}
