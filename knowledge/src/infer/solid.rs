//! Objects as boxes along the axes of their frame, with the uncertainty of their positions, and the probability of a
//! condition on two of them. Knows no relations.

use armarium_memoryx::{EntityId, Snapshot, place_of};
use armarium_values::{Frame, Value};

/// The standard deviation of a position without covariance, and the lowest of any, m.
const MIN_SIGMA: f64 = 0.005;

/// An object.
#[derive(Clone, Debug)]
pub(super) struct SolidObject {
    pub(super) id: EntityId,
    pub(super) version: u64,
    pub(super) referenced_ns: u64,
    pub(super) class: String,
    pub(super) frame: Frame,
    /// Centre, m.
    pub(super) centre: [f64; 3],
    /// Half of the extent along the frame's axes, m; `None` where the size is unknown.
    pub(super) half: Option<[f64; 3]>,
    /// Variance of the centre along each axis, m².
    pub(super) variance: [f64; 3],
    pub(super) confidence: f64,
}

impl SolidObject {
    /// The object of a snapshot; `size`: its extent along its own axes, m. `None` when it has no position.
    pub(super) fn new(snapshot: &Snapshot, size: Option<[f64; 3]>) -> Option<Self> {
        let (frame, centre) = place_of(snapshot)?;
        let instance = snapshot.instance()?;
        Some(Self {
            id: snapshot.id.clone(),
            version: snapshot.version,
            referenced_ns: snapshot.referenced_ns,
            class: snapshot.attribute("class").and_then(Value::as_str).unwrap_or_default().to_owned(),
            frame: frame.clone(),
            centre,
            half: size.map(|size| half_of(snapshot, size)),
            variance: variance_of(snapshot),
            confidence: instance.confidence,
        })
    }

    pub(super) fn min(&self, axis: usize) -> f64 {
        self.centre[axis] - self.half.map_or(0.0, |half| half[axis])
    }

    pub(super) fn max(&self, axis: usize) -> f64 {
        self.centre[axis] + self.half.map_or(0.0, |half| half[axis])
    }

    pub(super) fn volume(&self) -> f64 {
        self.half.map_or(0.0, |half| half.iter().map(|h| 2.0 * h).product())
    }

    /// The standard deviation of the difference of two positions along an axis, m.
    pub(super) fn sigma(&self, other: &Self, axis: usize) -> f64 {
        (self.variance[axis] + other.variance[axis]).sqrt()
    }
}

/// Half of the axis-aligned box that encloses the rotated one.
fn half_of(snapshot: &Snapshot, size: [f64; 3]) -> [f64; 3] {
    let half = size.map(|length| length.abs() / 2.0);
    let Some(Value::Pose(pose)) = snapshot.attribute("pose") else { return half };
    let turned = pose.isometry().rotation.to_rotation_matrix();
    std::array::from_fn(|i| (0..3).map(|j| turned[(i, j)].abs() * half[j]).sum())
}

fn variance_of(snapshot: &Snapshot) -> [f64; 3] {
    let least = MIN_SIGMA * MIN_SIGMA;
    let rows = snapshot.instance().and_then(|instance| {
        let of = if instance.attributes.get("pose").is_some() { "pose" } else { "position" };
        instance.covariance.get(of)
    });
    let columns = rows.map_or(0, |rows| if rows.len() == 36 { 6 } else { 3 });
    let at = |axis: usize| rows.and_then(|rows| rows.get(axis * (columns + 1))).copied().unwrap_or(0.0);
    std::array::from_fn(|axis| at(axis).max(least))
}

/// The probability that a normally distributed number lies between `low` and `high`.
pub(super) fn between(mean: f64, sigma: f64, low: f64, high: f64) -> f64 {
    (below((high - mean) / sigma) - below((low - mean) / sigma)).max(0.0)
}

/// The standard normal distribution function.
fn below(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_distribution_is_that_of_the_tables() {
        for (x, expected) in [
            (0.0, 0.5),
            (1.0, 0.841_344_746),
            (-1.0, 0.158_655_254),
            (1.96, 0.975_002_105),
            (-3.0, 0.001_349_898),
        ] {
            assert!((below(x) - expected).abs() < 2e-7, "{x}");
        }
        assert!((between(0.0, 2.0, -2.0, 2.0) - 0.682_689_492).abs() < 4e-7);
    }
}
