//! Points, sizes and lines of a picture, px; y points down.

/// A point: x, y.
pub(super) type Point = (f64, f64);

/// The extent of a box or text.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Size {
    pub(super) width: f64,
    pub(super) height: f64,
}

impl Size {
    pub(super) fn turned(self) -> Self {
        Self { width: self.height, height: self.width }
    }
}

/// A rectangle by its upper left corner and its size.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Rect {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) size: Size,
}

impl Rect {
    pub(super) fn right(&self) -> f64 {
        self.x + self.size.width
    }

    pub(super) fn bottom(&self) -> f64 {
        self.y + self.size.height
    }

    pub(super) fn moved(self, (dx, dy): Point) -> Self {
        Self { x: self.x + dx, y: self.y + dy, ..self }
    }
}

/// A step of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum LineStep {
    Move(Point),
    Line(Point),
    /// A cubic Bézier curve: two control points, and the end.
    Curve(Point, Point, Point),
}

impl LineStep {
    /// The step with a function applied to its points.
    pub(super) fn map(self, f: impl Fn(Point) -> Point) -> Self {
        match self {
            Self::Move(p) => Self::Move(f(p)),
            Self::Line(p) => Self::Line(f(p)),
            Self::Curve(a, b, p) => Self::Curve(f(a), f(b), f(p)),
        }
    }
}
