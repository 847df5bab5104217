//! Where perception has looked, so that what it did not find there counts, too.

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};

use crate::Frame;

/// How a place, m, was seen.
type View = Arc<dyn Fn(&Point3<f64>) -> Shown + Send + Sync>;

/// How a place was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// In view, with nothing before it.
    Open,
    /// In view, with something before it.
    Hidden,
    /// Out of view.
    Outside,
}

/// That things of some classes were looked for at one time, and where they would have been seen.
#[derive(Clone)]
pub struct Search {
    /// The time, ns; for images that of the exposure.
    pub stamp_ns: u64,
    /// What was looked for: core segments and classes.
    pub classes: Vec<(String, String)>,
    /// The frame of the places.
    pub frame: Frame,
    view: View,
}

impl Search {
    /// A search for these classes; `view` says of a place in `frame`, m, how it was seen.
    pub fn new(
        stamp_ns: u64,
        classes: Vec<(String, String)>,
        frame: &Frame,
        view: impl Fn(&Point3<f64>) -> Shown + Send + Sync + 'static,
    ) -> Self {
        Self { stamp_ns, classes, frame: frame.clone(), view: Arc::new(view) }
    }

    /// How a place in its frame, m, was seen.
    pub fn shows(&self, place: &Point3<f64>) -> Shown {
        (self.view)(place)
    }

    /// The same search for places in the frame `to`; `to_from_frame` is the pose of its frame there.
    #[must_use]
    pub fn moved(self, to: &Frame, to_from_frame: &Isometry3<f64>) -> Self {
        let (view, frame_from_to) = (self.view, to_from_frame.inverse());
        let view = move |place: &Point3<f64>| view(&(frame_from_to * place));
        Self { frame: to.clone(), view: Arc::new(view), ..self }
    }
}

impl fmt::Debug for Search {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stamp_ns, classes, frame, view: _ } = self;
        f.debug_struct("Search")
            .field("stamp_ns", stamp_ns)
            .field("classes", classes)
            .field("frame", frame)
            .finish_non_exhaustive()
    }
}
