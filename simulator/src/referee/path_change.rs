//! How far somebody moved a running motion: two periods of its path, aligned in phase, compared where it was coached and far from there.

use armarium_values::report::Figure;
use armarium_values::report::Requirement::{AtLeast, AtMost};
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::Value;

use super::paths::{POINTS, Period};
use super::probes::figure;

/// How far a motion was moved. Figures that were not complete when the run ended are absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct PathChange {
    /// Signed shift of the executed path along the direction, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    displacement_m: Option<f64>,
    /// Angle between the horizontal shift there and the direction, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    direction_error_deg: Option<f64>,
    /// The same shift two cycles after the coach has gone, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    retained_m: Option<f64>,
    /// RMS shift of the phases more than a quarter period away, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) far_side_rms_m: Option<f64>,
}

impl PathChange {
    /// The change at a point of the path along a direction (unit length), from the period `before` to those at once and two cycles after.
    pub(super) fn measured(
        before: &Period,
        [at_once, later]: [Option<Period>; 2],
        index: usize,
        direction: &Vector3<f64>,
    ) -> Self {
        let shift = |after: &Period| shift_at(before, after, index);
        Self {
            displacement_m: at_once.as_ref().map(|after| shift(after).dot(direction)),
            direction_error_deg: at_once.as_ref().and_then(|after| angle_deg(&shift(after), direction)),
            retained_m: later.as_ref().map(|after| shift(after).dot(direction)),
            far_side_rms_m: at_once.as_ref().map(|after| far_side(before, after, index)),
        }
    }
}

/// How much of the change is still there two cycles after.
pub(super) fn kept(group: &str, own: &Value) -> Figure {
    let number = |key: &str| own.get(key).and_then(Value::as_f64);
    let value = number("retained_m").zip(number("displacement_m")).map(|(kept, all)| kept / all * 100.0);
    Figure { value, ..figure((group, "kept after two cycles"), own, ("", 1.0), ("%", 0), AtLeast(80.0)) }
}

/// How little the rest of the path moved.
pub(super) fn far_side_moved(group: &str, own: &Value) -> Figure {
    figure((group, "far side moved, RMS"), own, ("far_side_rms_m", 1e3), ("mm", 1), AtMost(5.0))
}

/// The shift at a phase: the mean over a thirty-second of the period around it.
fn shift_at(before: &Period, after: &Period, index: usize) -> Vector3<f64> {
    let reach = POINTS / 64;
    let around = (0..=2 * reach).map(|k| (index + POINTS + k - reach) % POINTS);
    around.map(|i| after[i] - before[i]).sum::<Vector3<f64>>() / (2 * reach + 1) as f64
}

/// RMS shift of the phases more than a quarter period away, m.
fn far_side(before: &Period, after: &Period, index: usize) -> f64 {
    let far = (POINTS / 4 + 1..POINTS - POINTS / 4).map(|k| (index + k) % POINTS);
    let (sum, count) = far.fold((0.0, 0), |(s, n), i| (s + (after[i] - before[i]).norm_squared(), n + 1));
    (sum / f64::from(count)).sqrt()
}

/// The angle between two directions as seen from above, degrees.
fn angle_deg(shift: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let flat = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let (a, b) = (flat(shift).try_normalize(1e-6)?, flat(direction).try_normalize(1e-6)?);
    Some(libm::acos(a.dot(&b).clamp(-1.0, 1.0)).to_degrees())
}
