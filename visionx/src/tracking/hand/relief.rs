//! Finds what stands out of the background by depth: objects narrower than what lies behind them.
//!
//! The background is the grey-level closing of the depth image by a square that is wider than a hand: each pixel is
//! as near as the nearest placement of the square over it allows. A tilted plane is its own closing, so a table with
//! its tilt and bumps stays background, while a hand, an arm or a tool over it does not. A region that is too narrow
//! for the square but continues a large plane of the background, such as a table's corner, is background too (a
//! reconstruction). Colour is not used.

use nalgebra::{Matrix3, Vector3};

use super::candidates::median;
use crate::camera::PinholeCamera;
use crate::frame::DepthImage;
use crate::mask::{Mask, Region, beside};

/// Edge of the square, m, at the distance of the scene's middle.
const SQUARE: f64 = 0.30;
/// Limit of the square's edge, share of the image's height.
const LARGEST: f64 = 0.45;
/// Least distance in front of the background, m.
const NEARER: f32 = 0.02;
/// Largest distance of a surface from its plane of the background, m.
const FLAT: f32 = 0.010;
/// A surface continues where neighbours of the coarse grid differ less than this in depth, m.
const SMOOTH: f32 = 0.05;
/// Least share of the scene that a plane covers, and the most planes.
const MIN_PLANE_SHARE: f64 = 0.015;
const MAX_PLANES: usize = 4;
/// Every so many pixels the background is computed.
const STRIDE: usize = 4;
/// Depth of pixels without a measurement, m: far away.
const NOWHERE: f32 = 100.0;
/// Least share of a hand's outline where the scene behind is deeper. A patch of a surface has none, except at the
/// surface's edge.
pub(super) const MIN_RELIEF: f64 = 0.3;
/// Least difference that counts as deeper or nearer, m.
const STEP: f32 = 0.012;

/// The pixels in front of the background; `None` unless the depth image has the camera's size.
pub(super) fn standing_out(depth: &DepthImage, camera: &PinholeCamera) -> Option<Mask> {
    let depth = camera.usable(depth)?;
    let (w, h) = (depth.width as usize, depth.height as usize);
    if w.min(h) < 2 * STRIDE {
        return None;
    }
    let coarse = Grid::sampled(depth);
    let square = (SQUARE * camera.focal / median(coarse.data.clone())?).min(LARGEST * h as f64);
    let scenery = coarse.closed((square / STRIDE as f64).round().max(1.0) as usize | 1);
    let mut mask = Mask::empty(Region::whole(depth.width, depth.height));
    let mut behind = vec![0.0; w];
    for (y, (bits, row)) in mask.data_mut().chunks_exact_mut(w).zip(depth.data.chunks_exact(w)).enumerate() {
        scenery.row(y, &mut behind);
        for ((bit, z), behind) in bits.iter_mut().zip(row).zip(&behind) {
            *bit = u8::from((*z > 0.0) & (behind - z > NEARER));
        }
    }
    let planes = coarse.planes(&mask);
    // Most pixels are background, which nobody needs to look at again for each plane.
    let mut nearer = Vec::new();
    for (first, bits) in
        (0..).step_by(w).zip(mask.data().chunks_exact(w)).filter(|(_, bits)| bits.contains(&1))
    {
        nearer.extend((first..).zip(bits).filter(|(_, bit)| **bit != 0).map(|(i, _): (usize, _)| i));
    }
    planes.iter().for_each(|plane| reconstruct(&mut mask, &nearer, depth, plane));
    Some(mask)
}

/// Removes from a mask what continues a plane outside of it. All pixels of the mask are among `nearer`.
fn reconstruct(mask: &mut Mask, nearer: &[usize], depth: &DepthImage, plane: &Plane) {
    let (w, h) = (depth.width as usize, depth.height as usize);
    let around = |i: usize| beside(i, [w, h]);
    // Divisions of 32 bits take a fraction of the time of wider ones.
    let flat = |i: usize| {
        let (y, x) = (i as u32 / w as u32, i as u32 % w as u32);
        (plane.depth(x, y) - depth.data[i]).abs() < FLAT
    };
    let bits = mask.data_mut();
    let reached = |bits: &[u8], i: usize| flat(i) && around(i).any(|j| bits[j] == 0 && flat(j));
    let mut open: Vec<usize> = nearer.iter().copied().filter(|&i| bits[i] != 0 && reached(bits, i)).collect();
    while let Some(i) = open.pop() {
        if std::mem::take(&mut bits[i]) != 0 {
            open.extend(around(i).filter(|&j| bits[j] != 0 && flat(j)));
        }
    }
}

/// A plane in pixel coordinates: its inverse depth, 1/m, is affine there.
struct Plane(Vector3<f64>);

impl Plane {
    /// Fits points `(x, y, inverse depth)` by least squares, twice: the second time without outliers.
    fn through(points: &[[f64; 3]]) -> Option<Self> {
        let first = Self::fit(points.iter())?;
        let near =
            |p: &&[f64; 3]| (1.0 / first.inverse(p[0], p[1]) - 1.0 / p[2]).abs() < 2.0 * f64::from(FLAT);
        Self::fit(points.iter().filter(near)).or(Some(first))
    }

    fn fit<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> Option<Self> {
        let (mut xx, mut xy, mut yy, mut n) = (0.0, 0.0, 0.0, 0.0);
        let (mut sum, mut sums) = ([0.0; 2], Vector3::zeros());
        for [x, y, inverse] in points {
            (xx, xy, yy, n) = (xx + x * x, xy + x * y, yy + y * y, n + 1.0);
            sum = [sum[0] + x, sum[1] + y];
            sums += Vector3::new(x * inverse, y * inverse, *inverse);
        }
        let squares = Matrix3::new(xx, xy, sum[0], xy, yy, sum[1], sum[0], sum[1], n);
        squares.cholesky().map(|c| Self(c.solve(&sums)))
    }

    fn inverse(&self, x: f64, y: f64) -> f64 {
        self.0.dot(&Vector3::new(x, y, 1.0))
    }

    /// Depth at a pixel, m.
    fn depth(&self, x: u32, y: u32) -> f32 {
        (1.0 / self.inverse(f64::from(x), f64::from(y))) as f32
    }
}

/// The depth around an object: shares of its outline, 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Surroundings {
    /// Where the scene is deeper by [`STEP`] or more, or not measured: the object ends there.
    pub(super) deeper: f64,
    /// Where something is nearer by [`STEP`] or more: it may hide a part of the object.
    pub(super) nearer: f64,
}

/// Compares depth on both sides of a mask's outline, along rows and columns; the image's border does not count.
/// All zero without an outline.
pub(super) fn surroundings(mask: &Mask, depth: &DepthImage) -> Surroundings {
    let at = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < i64::from(depth.width) && y < i64::from(depth.height);
        inside.then(|| depth.data.get(y as usize * depth.width as usize + x as usize).copied()).flatten()
    };
    let (mut outline, mut deeper, mut nearer) = (0usize, 0usize, 0usize);
    for (x, y) in mask.pixels() {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            if mask.contains(x + dx, y + dy) {
                continue;
            }
            let (here, there) = (at(x - 2 * dx, y - 2 * dy), at(x + 4 * dx, y + 4 * dy));
            let Some((here, there)) = here.zip(there) else { continue };
            outline += 1;
            // Pixels without a measurement count as far away.
            deeper += usize::from(here > 0.0 && (there == 0.0 || there > here + STEP));
            nearer += usize::from(here > 0.0 && there > 0.0 && there < here - STEP);
        }
    }
    let share = |count: usize| if outline == 0 { 0.0 } else { count as f64 / outline as f64 };
    Surroundings { deeper: share(deeper), nearer: share(nearer) }
}

/// Depths on every [`STRIDE`]th row and column, m.
struct Grid {
    width: usize,
    data: Vec<f32>,
}

impl Grid {
    fn sampled(depth: &DepthImage) -> Self {
        let w = depth.width as usize;
        let rows = depth.data.chunks_exact(w).skip(STRIDE / 2).step_by(STRIDE);
        let sound = |z: &f32| if *z > 0.0 && *z < NOWHERE { *z } else { NOWHERE };
        let data = rows.flat_map(|row| row.iter().skip(STRIDE / 2).step_by(STRIDE).map(sound)).collect();
        Self { width: (w - STRIDE / 2).div_ceil(STRIDE), data }
    }

    /// The closing by a square of `window` cells. The square may extend beyond the border, where it ignores missing
    /// cells.
    fn closed(&self, window: usize) -> Self {
        let widest = |grid: &Self| grid.rows(|row| sliding_max(row, window)).transposed();
        let dilated = widest(&widest(self));
        let within = |row: &[f32]| {
            let all = sliding_max(row, window);
            all[window - 1..row.len()].to_vec()
        };
        let narrowest = |grid: &Self| grid.rows(within).transposed();
        narrowest(&narrowest(&dilated.negated())).negated()
    }

    fn rows(&self, of: impl Fn(&[f32]) -> Vec<f32>) -> Self {
        let rows: Vec<Vec<f32>> = self.data.chunks_exact(self.width).map(of).collect();
        Self { width: rows.first().map_or(0, Vec::len), data: rows.concat() }
    }

    fn transposed(&self) -> Self {
        let columns = (0..self.width).flat_map(|x| self.data[x..].iter().step_by(self.width));
        Self { width: self.data.len() / self.width, data: columns.copied().collect() }
    }

    fn negated(mut self) -> Self {
        self.data.iter_mut().for_each(|z| *z = -*z);
        self
    }

    /// The planes through the largest smooth surfaces outside of a mask.
    fn planes(&self, mask: &Mask) -> Vec<Plane> {
        let (w, n) = (self.width, self.data.len());
        let pixel = |i: usize| [i % w, i / w].map(|at| at * STRIDE + STRIDE / 2);
        let known =
            |i: usize| self.data[i] < NOWHERE && !mask.contains(pixel(i)[0] as i64, pixel(i)[1] as i64);
        let mut free: Vec<bool> = (0..n).map(known).collect();
        let mut surfaces = Vec::new();
        for start in 0..n {
            let mut surface = Vec::new();
            let mut open = vec![start];
            while let Some(i) = open.pop() {
                if !std::mem::take(&mut free[i]) {
                    continue;
                }
                let [x, y] = pixel(i).map(|at| at as f64);
                surface.push([x, y, 1.0 / f64::from(self.data[i])]);
                let near = |&j: &usize| free[j] && (self.data[j] - self.data[i]).abs() < SMOOTH;
                open.extend(beside(i, [w, n / w]).filter(near));
            }
            if surface.len() as f64 > MIN_PLANE_SHARE * n as f64 {
                surfaces.push(surface);
            }
        }
        surfaces.sort_by_key(|s| std::cmp::Reverse(s.len()));
        surfaces.iter().take(MAX_PLANES).filter_map(|s| Plane::through(s)).collect()
    }

    /// The depths along an image's row `y`, interpolated between cells.
    fn row(&self, y: usize, depths: &mut [f32]) {
        let rows = self.data.len() / self.width;
        let place = ((y as f32 - (STRIDE / 2) as f32) / STRIDE as f32).clamp(0.0, (rows - 1) as f32);
        let (first, part) = (place as usize, place.fract());
        let row = |r: usize| &self.data[r * self.width..(r + 1) * self.width];
        let both = row(first).iter().zip(row((first + 1).min(rows - 1)));
        let line: Vec<f32> = both.map(|(a, b)| a + (b - a) * part).collect();
        let (before, rest) = depths.split_at_mut(STRIDE / 2);
        before.fill(line[0]);
        let (between, beyond) = rest.split_at_mut((STRIDE * (self.width - 1)).min(rest.len()));
        for (pixels, ends) in between.chunks_mut(STRIDE).zip(line.windows(2)) {
            for (n, depth) in pixels.iter_mut().enumerate() {
                *depth = ends[0] + (ends[1] - ends[0]) * (n as f32 / STRIDE as f32);
            }
        }
        beyond.fill(line[self.width - 1]);
    }
}

/// The maximum of each `window` consecutive values, including windows that extend over the ends:
/// `values.len() + window - 1` results.
///
/// Each window is the end of one block of `window` values and the beginning of the next, whose maxima are computed for all windows at once
/// (van Herk 1992; Gil and Werman 1993).
fn sliding_max(values: &[f32], window: usize) -> Vec<f32> {
    let results = values.len() + window - 1;
    let mut beginnings = vec![f32::NEG_INFINITY; results + window - 1];
    beginnings[window - 1..results].copy_from_slice(values);
    let mut ends = beginnings.clone();
    for block in beginnings.chunks_mut(window) {
        block.iter_mut().fold(f32::NEG_INFINITY, |most, value| {
            *value = value.max(most);
            *value
        });
    }
    for block in ends.chunks_mut(window) {
        block.iter_mut().rev().fold(f32::NEG_INFINITY, |most, value| {
            *value = value.max(most);
            *value
        });
    }
    ends.iter().zip(&beginnings[window - 1..]).map(|(end, beginning)| end.max(*beginning)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CAMERA: PinholeCamera =
        PinholeCamera { width: 160, height: 120, focal: 130.0, center: [80.0, 60.0] };

    fn image(z: impl Fn(u32, u32) -> f32) -> DepthImage {
        let data = (0..160 * 120).map(|i| z(i % 160, i / 160)).collect();
        DepthImage { width: 160, height: 120, data }
    }

    proptest! {
        #[test]
        fn sliding_agrees_with_brute_force(values in proptest::collection::vec(-9.0f32..9.0, 1..20), window in 1usize..8) {
            let found = sliding_max(&values, window);
            prop_assert_eq!(found.len(), values.len() + window - 1);
            for (end, max) in found.iter().enumerate() {
                let seen = (0..values.len()).filter(|i| *i <= end && i + window > end);
                prop_assert_eq!(*max, seen.map(|i| values[i]).fold(f32::NEG_INFINITY, f32::max));
            }
        }
    }

    /// The depth of a tilted plane at a pixel: 1/z is linear there.
    fn plane(x: u32, y: u32) -> f32 {
        1.0 / (1.0 + 0.002 * x as f32 + 0.006 * (120.0 - y as f32))
    }

    #[test]
    fn a_tilted_plane_is_scenery_and_a_bar_over_it_stands_out() {
        let none = standing_out(&image(plane), &CAMERA).unwrap();
        assert_eq!(none.count(), 0);
        let bar = |x: u32, y: u32| (60..75).contains(&x) && (30..80).contains(&y);
        let seen = standing_out(&image(|x, y| plane(x, y) - if bar(x, y) { 0.05 } else { 0.0 }), &CAMERA);
        let seen = seen.unwrap();
        for (x, y) in (0..120).flat_map(|y| (0..160).map(move |x| (x, y))) {
            assert_eq!(seen.contains(i64::from(x), i64::from(y)), bar(x, y), "{x} {y}");
        }
    }

    /// A tilted plane over a floor that ends in a corner too narrow for the square, and a bar that leans on it.
    fn corner(bar: bool) -> DepthImage {
        image(move |x, y| {
            let on_bar = bar && (100..110).contains(&x) && (40..90).contains(&y);
            match x < 2 * y {
                _ if on_bar => plane(x, y) - 0.004 * (90 - y) as f32,
                true => plane(x, y),
                false => 2.0,
            }
        })
    }

    #[test]
    fn a_corner_of_a_plane_is_scenery_but_not_what_leans_on_it() {
        assert_eq!(standing_out(&corner(false), &CAMERA).unwrap().count(), 0);
        let seen = standing_out(&corner(true), &CAMERA).unwrap();
        let expected = |x: i64, y: i64| (100..110).contains(&x) && (40..84).contains(&y);
        for (x, y) in (0..120).flat_map(|y| (0..160).map(move |x| (x, y))) {
            let near_the_plane = (84..90).contains(&y);
            assert!(near_the_plane || seen.contains(x, y) == expected(x, y), "{x} {y}");
        }
    }

    #[test]
    fn odd_depth_images_show_nothing() {
        assert!(standing_out(&DepthImage { width: 160, height: 120, data: vec![] }, &CAMERA).is_none());
        for z in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-30] {
            assert_eq!(standing_out(&image(|_, _| z), &CAMERA).unwrap().count(), 0, "{z}");
        }
    }

    #[test]
    fn only_what_stands_out_has_relief() {
        let mut mask = Mask::empty(Region { x: 20, y: 20, width: 30, height: 30 });
        mask.data_mut().fill(1);
        let depth = |inside: f32, outside: f32| {
            let at = |i: u32| (20..50).contains(&(i % 80)) && (20..50).contains(&(i / 80));
            let data = (0..80 * 80).map(|i| if at(i) { inside } else { outside }).collect();
            DepthImage { width: 80, height: 80, data }
        };
        let about = |around: f32| surroundings(&mask, &depth(0.7, around));
        assert_eq!(about(0.8), Surroundings { deeper: 1.0, nearer: 0.0 });
        assert_eq!(about(0.0), Surroundings { deeper: 1.0, nearer: 0.0 });
        assert_eq!(about(0.705), Surroundings::default());
        assert_eq!(about(0.6), Surroundings { deeper: 0.0, nearer: 1.0 });
        let nothing = DepthImage { width: 80, height: 80, data: Vec::new() };
        assert_eq!(surroundings(&mask, &nothing), Surroundings::default());
    }
}
