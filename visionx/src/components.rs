//! Connected components of a mask, with their moments. One pass over runs of pixels and a union-find of the runs.

use nalgebra::{Matrix2, Point2};

use crate::frame::RgbImage;
use crate::mask::{Mask, PixelRun, Region};

/// A connected component (8-neighbours) of a mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Number of pixels.
    pub area: u32,
    /// Mean of the pixels, px; pixel centres are at whole coordinates.
    pub centroid: Point2<f64>,
    /// Covariance of the pixels, px^2.
    pub spread: Matrix2<f64>,
    /// The smallest rectangle around it.
    pub bounds: Region,
    /// Its pixels, by row and column.
    pub runs: Vec<PixelRun>,
}

/// The connected components of at least `min_area` pixels, largest first (of equals, the topmost leftmost).
pub fn components(mask: &Mask, min_area: u32) -> Vec<Component> {
    let runs = runs_of(mask);
    let parents = link(&runs);
    let mut groups: Vec<Vec<PixelRun>> = Vec::new();
    let mut group_of = vec![usize::MAX; runs.len()];
    for (i, run) in runs.iter().enumerate() {
        // Parents come before their children, so that a root's group exists when a child arrives.
        let root = parents[i];
        if group_of[root] == usize::MAX {
            group_of[root] = groups.len();
            groups.push(Vec::new());
        }
        groups[group_of[root]].push(*run);
    }
    let area = |g: &[PixelRun]| g.iter().map(|r| r.x1 - r.x0).sum::<u32>();
    let mut found: Vec<Component> =
        groups.into_iter().filter(|g| area(g) >= min_area.max(1)).map(Component::from_runs).collect();
    found.sort_by_key(|c| std::cmp::Reverse(c.area));
    found
}

impl Component {
    /// The component made of these runs, at least one pixel in total.
    fn from_runs(runs: Vec<PixelRun>) -> Self {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut x0, mut y0, mut x1, mut y1) = (u32::MAX, u32::MAX, 0, 0);
        for r in &runs {
            let (count, y) = (f64::from(r.x1 - r.x0), f64::from(r.y));
            let mean = (f64::from(r.x0) + f64::from(r.x1) - 1.0) / 2.0;
            n += count;
            sx += count * mean;
            sy += count * y;
            // The sum of squares of consecutive integers about their mean is n (n^2 - 1) / 12.
            sxx += count * mean * mean + count * (count * count - 1.0) / 12.0;
            sxy += count * mean * y;
            syy += count * y * y;
            (x0, x1) = (x0.min(r.x0), x1.max(r.x1));
            (y0, y1) = (y0.min(r.y), y1.max(r.y + 1));
        }
        let (mx, my) = (sx / n, sy / n);
        let xy = sxy / n - mx * my;
        Self {
            area: n as u32,
            centroid: Point2::new(mx, my),
            spread: Matrix2::new(sxx / n - mx * mx, xy, xy, syy / n - my * my),
            bounds: Region { x: x0, y: y0, width: x1 - x0, height: y1 - y0 },
            runs,
        }
    }

    /// The component alone, as a mask of its bounds grown by `border` and clipped to `width` x `height`.
    pub fn mask(&self, border: u32, width: u32, height: u32) -> Mask {
        self.alone(self.bounds.grown(border, width, height))
    }

    /// The colours of its pixels in an image.
    pub(crate) fn colors<'a>(&'a self, image: &'a RgbImage) -> impl Iterator<Item = [u8; 3]> + Clone + 'a {
        self.runs.iter().flat_map(move |run| (run.x0..run.x1).map(move |x| image.pixel(x, run.y)))
    }

    /// The component alone, as a mask of this region.
    pub(crate) fn alone(&self, region: Region) -> Mask {
        let mut mask = Mask::empty(region);
        mask.add(&self.runs);
        mask
    }
}

fn runs_of(mask: &Mask) -> Vec<PixelRun> {
    let region = mask.region();
    let mut runs = Vec::new();
    for y in 0..mask.height() {
        let row = mask.row(y);
        let mut x = 0;
        while let Some(start) = row[x..].iter().position(|&v| v != 0).map(|n| x + n) {
            let end = row[start..].iter().position(|&v| v == 0).map_or(row.len(), |n| start + n);
            runs.push(PixelRun {
                y: region.y + y as u32,
                x0: region.x + start as u32,
                x1: region.x + end as u32,
            });
            x = end;
        }
    }
    runs
}

/// For each run the first run of its component.
fn link(runs: &[PixelRun]) -> Vec<usize> {
    let mut parents: Vec<usize> = (0..runs.len()).collect();
    let mut above = 0;
    for i in 0..runs.len() {
        let run = runs[i];
        while above < i
            && (runs[above].y + 1 < run.y || (runs[above].y + 1 == run.y && runs[above].x1 < run.x0))
        {
            above += 1;
        }
        let mut j = above;
        while j < i && runs[j].y + 1 == run.y && runs[j].x0 <= run.x1 {
            join(&mut parents, i, j);
            j += 1;
        }
    }
    for i in 0..parents.len() {
        parents[i] = parents[parents[i]];
    }
    parents
}

/// The one at the end of the chain of parents.
pub(crate) fn root(parents: &mut [usize], mut i: usize) -> usize {
    while parents[i] != i {
        parents[i] = parents[parents[i]];
        i = parents[i];
    }
    i
}

fn join(parents: &mut [usize], i: usize, j: usize) {
    let (a, b) = (root(parents, i), root(parents, j));
    let (low, high) = (a.min(b), a.max(b));
    parents[high] = low;
}

/// The largest component; `None` when the mask is empty.
pub(crate) fn largest(mask: &Mask) -> Option<Component> {
    components(mask, 1).into_iter().next()
}

/// Fills enclosed holes of fewer than `most` pixels.
pub(crate) fn fill_holes(mask: &mut Mask, most: u32) {
    let region = mask.region();
    let outside = Mask::of(region, mask.data().iter().map(|bit| *bit == 0));
    for hole in components(&outside, 1) {
        let bounds = Region { x: hole.bounds.x - region.x, y: hole.bounds.y - region.y, ..hole.bounds };
        if hole.area < most && !bounds.touches_border(region.width, region.height) {
            mask.add(&hole.runs);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mask_of(rows: &[&str]) -> Mask {
        let region = Region { x: 3, y: 5, width: rows[0].len() as u32, height: rows.len() as u32 };
        Mask::of(region, rows.concat().bytes().map(|c| c == b'#'))
    }

    #[test]
    fn a_spiral_is_one_and_specks_are_others() {
        let mask = mask_of(&[
            "#######", "......#", "####..#", "#..#..#", "#.....#", "#######", ".......", "#.....#",
        ]);
        let found = components(&mask, 1);
        assert_eq!(found.iter().map(|c| c.area).collect::<Vec<_>>(), [25, 1, 1]);
        assert_eq!(found[0].bounds, Region { x: 3, y: 5, width: 7, height: 6 });
        assert_eq!(found[1].centroid, Point2::new(3.0, 12.0));
        assert_eq!(components(&mask, 2).len(), 1);
    }

    /// Flood fill, as the oracle.
    fn flood(mask: &Mask) -> Vec<u32> {
        let (w, h) = (mask.width() as i64, mask.height() as i64);
        let mut left = mask.data().to_vec();
        let mut areas = Vec::new();
        for start in 0..left.len() {
            let mut stack = vec![start as i64];
            let mut area = 0;
            while let Some(i) = stack.pop() {
                if left[i as usize] == 0 {
                    continue;
                }
                left[i as usize] = 0;
                area += 1;
                for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                    let (x, y) = (i % w + dx, i / w + dy);
                    if x >= 0 && y >= 0 && x < w && y < h {
                        stack.push(y * w + x);
                    }
                }
            }
            if area > 0 {
                areas.push(area);
            }
        }
        areas.sort_unstable_by(|a, b| b.cmp(a));
        areas
    }

    proptest! {
        #[test]
        fn same_as_flood_fill(bits in proptest::collection::vec(0u8..2, 12 * 9)) {
            let mask = Mask::of(Region::whole(12, 9), bits.iter().map(|bit| *bit == 1));
            let found = components(&mask, 1);
            prop_assert_eq!(found.iter().map(|c| c.area).collect::<Vec<_>>(), flood(&mask));
            let mut again = Mask::empty(mask.region());
            for c in &found {
                let own = c.mask(0, 12, 9);
                prop_assert_eq!(own.count() as u32, c.area);
                own.pixels().for_each(|(x, y)| again.data_mut()[(y * 12 + x) as usize] = 1);
            }
            prop_assert_eq!(again, mask);
        }
    }
}
