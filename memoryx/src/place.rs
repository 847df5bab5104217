//! Where objects are: the position of a snapshot, and regions for queries.

use armarium_values::{Frame, Value};

use crate::entity::Snapshot;
use crate::error::MemoryError;

/// A region of space, in one frame. It contains no entity whose position is known in another frame only.
#[derive(Clone, Debug, PartialEq)]
pub enum SpatialRegion {
    /// A box along the frame's axes, faces included.
    Box {
        /// The frame of the corners.
        frame: Frame,
        /// The smallest x, y and z, m.
        min: [f64; 3],
        /// The largest x, y and z, m.
        max: [f64; 3],
    },
    /// A ball.
    Within {
        /// The frame of the centre.
        frame: Frame,
        /// The centre, m.
        of: [f64; 3],
        /// The radius, m.
        radius: f64,
    },
    /// The nearest ones, ordered by distance.
    Nearest {
        /// The frame of the point.
        frame: Frame,
        /// The point, m.
        to: [f64; 3],
        /// How many.
        count: usize,
    },
}

/// The position of an entity, from `pose` or else `position`, m. `None` when it has neither, or a number is not
/// finite.
pub fn place_of(snapshot: &Snapshot) -> Option<(&Frame, [f64; 3])> {
    let (frame, position) = match snapshot.attribute("pose").or_else(|| snapshot.attribute("position"))? {
        Value::Pose(pose) => (&pose.frame, pose.position),
        Value::Vector(vector) => (&vector.frame, vector.components),
        _ => return None,
    };
    position.iter().all(|x| x.is_finite()).then_some((frame, position))
}

/// The distance of two points, m.
pub fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl SpatialRegion {
    /// The region's frame.
    pub fn frame(&self) -> &Frame {
        match self {
            Self::Box { frame, .. } | Self::Within { frame, .. } | Self::Nearest { frame, .. } => frame,
        }
    }

    /// Whether a snapshot's position is in the region; for [`SpatialRegion::Nearest`], whether it has a position in the
    /// frame.
    pub fn holds(&self, snapshot: &Snapshot) -> bool {
        let Some((frame, position)) = place_of(snapshot) else { return false };
        frame == self.frame()
            && match self {
                Self::Box { min, max, .. } => (0..3).all(|i| min[i] <= position[i] && position[i] <= max[i]),
                Self::Within { of, radius, .. } => distance(of, &position) <= *radius,
                Self::Nearest { .. } => true,
            }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when one is not finite, or the region is empty.
    pub fn check(&self) -> Result<(), MemoryError> {
        let wrong = |what: &str| Err(MemoryError::Query { what: format!("the region {what}") });
        let (point, others) = match self {
            Self::Box { min, max, .. } => (min, &max[..]),
            Self::Within { of, radius, .. } => (of, std::slice::from_ref(radius)),
            Self::Nearest { to, .. } => (to, &[][..]),
        };
        match self {
            _ if !point.iter().chain(others).all(|n| n.is_finite()) => {
                wrong("has a number that is not finite")
            }
            Self::Box { min, max, .. } if (0..3).any(|i| min[i] > max[i]) => {
                wrong("has a minimum above its maximum")
            }
            Self::Within { radius, .. } if *radius < 0.0 => wrong("has a negative radius"),
            _ => Ok(()),
        }
    }
}
