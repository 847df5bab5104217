//! Binary images, and rectangles in an image. The meaning of a mask is up to its maker.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// A horizontal run of set pixels, in the coordinates of the image: columns `x0 .. x1` of row `y`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRun {
    /// Row, px.
    pub y: u32,
    /// First column, px.
    pub x0: u32,
    /// One past the last column, px.
    pub x1: u32,
}

/// A rectangle of pixels: columns `x .. x + width`, rows `y .. y + height`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Region {
    /// First column, px.
    pub x: u32,
    /// First row, px.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A binary image that is a part of a larger image: pixel `(x, y)` of the mask is pixel `(region.x + x,
/// region.y + y)` of the larger image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    region: Region,
    data: Vec<u8>,
}

impl Region {
    /// The whole of an image.
    pub fn whole(width: u32, height: u32) -> Self {
        Self { x: 0, y: 0, width, height }
    }

    /// The smallest region in an image of `width` x `height` that holds all pixels from `(x0, y0)` to `(x1, y1)`,
    /// inclusive; empty when there are none. Coordinates may be anything, even not finite.
    pub fn spanning(x0: f64, y0: f64, x1: f64, y1: f64, width: u32, height: u32) -> Self {
        // A cast from f64 to u32 saturates and takes NaN to 0.
        let clip = |v: f64, end: u32| (v.max(0.0) as u32).min(end);
        let (left, top) = (clip(x0.floor(), width), clip(y0.floor(), height));
        let (right, bottom) = (clip(x1.floor() + 1.0, width), clip(y1.floor() + 1.0, height));
        Self { x: left, y: top, width: right.saturating_sub(left), height: bottom.saturating_sub(top) }
    }

    /// The smallest region in an image of `width` x `height` that holds these points and `margin` px on each side of them.
    pub fn around(
        points: impl IntoIterator<Item = Point2<f64>>,
        margin: f64,
        width: u32,
        height: u32,
    ) -> Self {
        let none = (Point2::from([f64::MAX; 2]), Point2::from([f64::MIN; 2]));
        let (low, high) = points.into_iter().fold(none, |(low, high), p| (low.inf(&p), high.sup(&p)));
        Self::spanning(low.x - margin, low.y - margin, high.x + margin, high.y + margin, width, height)
    }

    /// This region with `border` more pixels on each side, clipped to an image of `width` x `height`.
    pub fn grown(&self, border: u32, width: u32, height: u32) -> Self {
        let x = self.x.saturating_sub(border);
        let y = self.y.saturating_sub(border);
        let right = (self.x + self.width).saturating_add(border).min(width);
        let bottom = (self.y + self.height).saturating_add(border).min(height);
        Self { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
    }

    /// The part of this region inside an image of `width` x `height`.
    pub fn clipped(&self, width: u32, height: u32) -> Self {
        self.grown(0, width, height)
    }

    /// Its pixels (column, row), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let Self { x, y, width, height } = *self;
        (y..y + height).flat_map(move |row| (x..x + width).map(move |column| (column, row)))
    }

    /// Number of pixels.
    pub fn area(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether the region touches the border of an image of `width` x `height`.
    pub fn touches_border(&self, width: u32, height: u32) -> bool {
        self.x == 0 || self.y == 0 || self.x + self.width >= width || self.y + self.height >= height
    }
}

/// The neighbours in its row and column of the pixel with the index `i`, in an image of this width and height.
pub(crate) fn beside(i: usize, [w, h]: [usize; 2]) -> impl Iterator<Item = usize> {
    // A division of 32 bits takes a fraction of the time of a wider one.
    let column = (i as u32 % w as u32) as usize;
    let left = (column > 0).then(|| i - 1);
    let right = (column + 1 < w).then_some(i + 1);
    [left, right, i.checked_sub(w), (i + w < w * h).then_some(i + w)].into_iter().flatten()
}

impl Mask {
    /// A mask with nothing set.
    pub fn empty(region: Region) -> Self {
        Self { region, data: vec![0; region.area()] }
    }

    /// A mask with these pixels, row by row; those that are missing at the end are not set.
    pub fn of(region: Region, bits: impl IntoIterator<Item = bool>) -> Self {
        let mut mask = Self::empty(region);
        mask.data.iter_mut().zip(bits).for_each(|(pixel, bit)| *pixel = u8::from(bit));
        mask
    }

    /// The set pixels in the coordinates of the image (column, row), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (i64, i64)> + '_ {
        let set = self.region.pixels().zip(&self.data).filter(|(_, bit)| **bit != 0);
        set.map(|((x, y), _)| (i64::from(x), i64::from(y)))
    }

    /// Where the mask lies in its image.
    pub fn region(&self) -> Region {
        self.region
    }

    /// Width of the mask, px.
    pub fn width(&self) -> usize {
        self.region.width as usize
    }

    /// Height of the mask, px.
    pub fn height(&self) -> usize {
        self.region.height as usize
    }

    /// The pixels, 0 or 1, rows from the top.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The pixels, to write 0 or 1 into.
    #[must_use]
    pub fn data_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }

    /// One row of the mask, counted from the mask's own top.
    pub fn row(&self, y: usize) -> &[u8] {
        let w = self.width();
        &self.data[y * w..(y + 1) * w]
    }

    /// Whether the pixel `(x, y)` of the *image* is set; false outside of the mask's region.
    pub fn contains(&self, x: i64, y: i64) -> bool {
        let (x, y) = (x - i64::from(self.region.x), y - i64::from(self.region.y));
        if x < 0 || y < 0 || x >= i64::from(self.region.width) || y >= i64::from(self.region.height) {
            return false;
        }
        self.data[y as usize * self.width() + x as usize] != 0
    }

    /// Whether a neighbour of this pixel of the image in its row or column is not set.
    pub(crate) fn is_at_edge(&self, (x, y): (i64, i64)) -> bool {
        [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].into_iter().any(|(x, y)| !self.contains(x, y))
    }

    /// Sets the pixels of some runs, given in the coordinates of the image; skips those outside of the region.
    pub fn add(&mut self, runs: &[PixelRun]) {
        let (region, w) = (self.region, self.width());
        for run in runs.iter().filter(|r| r.y >= region.y && r.y < region.y + region.height) {
            let clip = |x: u32| x.clamp(region.x, region.x + region.width) - region.x;
            let start = (run.y - region.y) as usize * w;
            let (x0, x1) = (clip(run.x0) as usize, clip(run.x1) as usize);
            self.data[start + x0..start + x1].fill(1);
        }
    }

    /// How many pixels are set.
    pub fn count(&self) -> usize {
        self.data.iter().map(|&v| usize::from(v)).sum()
    }

    /// Majority filter: sets each pixel where five or more of the nine around it are set; pixels at the
    /// mask's border stay.
    pub fn majority(&self) -> Self {
        let (w, h) = (self.width(), self.height());
        let mut result = self.clone();
        for y in 1..h.saturating_sub(1) {
            let rows = [self.row(y - 1), self.row(y), self.row(y + 1)];
            for x in 1..w.saturating_sub(1) {
                let sum: u8 = rows.iter().map(|r| r[x - 1] + r[x] + r[x + 1]).sum();
                result.data[y * w + x] = u8::from(sum >= 5);
            }
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_majority_closes_a_hole_and_takes_off_a_speck() {
        let rows = ["###....", "#.#....", "###..#.", ".......", "......#"];
        let smooth = Mask::of(Region::whole(7, 5), rows.concat().bytes().map(|c| c == b'#')).majority();
        assert_eq!([smooth.row(1)[1], smooth.row(2)[5], smooth.row(4)[6]], [1, 0, 1]);
    }

    #[test]
    fn regions_clip() {
        assert_eq!(Region::spanning(-3.0, 2.2, 4.9, 99.0, 10, 8), Region { x: 0, y: 2, width: 5, height: 6 });
        assert_eq!(Region::spanning(f64::NAN, f64::NAN, f64::NAN, f64::NAN, 10, 8).area(), 0);
        assert_eq!(Region::spanning(20.0, 0.0, 30.0, 5.0, 10, 8).area(), 0);
        let grown = Region { x: 1, y: 1, width: 3, height: 3 }.grown(2, 10, 5);
        assert_eq!(grown, Region { x: 0, y: 0, width: 6, height: 5 });
    }
}
