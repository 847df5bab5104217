//! Where perception has looked, so that what it did not find there counts, too.

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};

use crate::Frame;

/// Whether a point, m, was in view with nothing before it.
type Open = Arc<dyn Fn(&Point3<f64>) -> bool + Send + Sync>;

/// That things of some classes were looked for at one time, and where they would have been seen.
#[derive(Clone)]
pub struct Search {
    /// The time, ns; for images that of the exposure.
    pub stamp_ns: u64,
    /// What was looked for: core segments and classes.
    pub classes: Vec<(String, String)>,
    /// The frame of the points that `open` is asked for.
    pub frame: Frame,
    open: Open,
}

impl Search {
    /// A search for these classes; `open` says of a point in `frame`, m, whether it was in view with nothing before it.
    pub fn new(
        stamp_ns: u64,
        classes: Vec<(String, String)>,
        frame: &Frame,
        open: impl Fn(&Point3<f64>) -> bool + Send + Sync + 'static,
    ) -> Self {
        Self { stamp_ns, classes, frame: frame.clone(), open: Arc::new(open) }
    }

    /// Whether a point of its frame, m, was in view with nothing before it.
    pub fn shows(&self, point: &Point3<f64>) -> bool {
        (self.open)(point)
    }

    /// The same search for points in the frame `to`; `to_from_frame` is the pose of its frame there.
    #[must_use]
    pub fn moved(self, to: &Frame, to_from_frame: &Isometry3<f64>) -> Self {
        let (open, frame_from_to) = (self.open, to_from_frame.inverse());
        let open = move |point: &Point3<f64>| open(&(frame_from_to * point));
        Self { frame: to.clone(), open: Arc::new(open), ..self }
    }
}

impl fmt::Debug for Search {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stamp_ns, classes, frame, open: _ } = self;
        f.debug_struct("Search")
            .field("stamp_ns", stamp_ns)
            .field("classes", classes)
            .field("frame", frame)
            .finish_non_exhaustive()
    }
}
