//! Classifies skin pixels, adapted to each scene.
//!
//! Skin can have many colours, and wooden tables, cardboard and warm walls have them too, so colour alone does not
//! decide. The skin-like colours of a frame are split into clusters at the valleys of a histogram of
//! log-chromaticities, which shading by a white light does not change. A cluster that covers more area than a hand can
//! is background; that decision needs the depth and is made by [`super::HandObserver`].

use crate::components::root;
use crate::frame::RgbImage;
use crate::mask::{Mask, Region};

/// Bins of the histogram along ln(R/G) and ln(G/B).
const BINS: usize = 40;
/// Width of a bin.
const BIN: f32 = 0.02;
/// Ranges of ln(R/G) and of ln(G/B) for skin of any tone in white light: measured in photographs, then
/// widened. The second begins below zero for reddened skin.
const RED_OVER_GREEN: (f32, f32) = (0.07, 0.87);
const GREEN_OVER_BLUE: (f32, f32) = (-0.06, 0.74);
/// Darkest usable red.
const DARK: u16 = 45;
/// Fewest pixels (at half resolution) that make a cluster.
const MIN_PIXELS: f32 = 60.0;
/// Bins by which a cluster is extended beyond the observed colours.
const SPREAD: usize = 2;

/// The skin-like colours of one frame, by cluster.
#[derive(Clone, Debug)]
pub(super) struct SkinClusters {
    /// The cluster of each bin, 0 for none.
    labels: Vec<u8>,
    /// The peaks: ln(R/G), ln(G/B).
    peaks: Vec<[f32; 2]>,
    logs: Logs,
}

/// An image at half the resolution: sums of two by two pixels.
#[derive(Clone, Debug)]
pub(super) struct HalfImage {
    width: u32,
    height: u32,
    data: Vec<[u16; 3]>,
}

/// Logarithms of 0..=1020 (the sums of four pixels), in 1/16 of a bin.
#[derive(Clone, Debug)]
struct Logs(Vec<i16>);

impl HalfImage {
    pub(super) fn of(image: &RgbImage) -> Self {
        let (w, h) = (image.width() / 2, image.height() / 2);
        let stride = image.width() as usize * 3;
        let mut data = Vec::with_capacity((w * h) as usize);
        for rows in image.data().chunks_exact((2 * stride).max(1)).take(h as usize) {
            let (top, bottom) = rows.split_at(stride);
            for (a, b) in top.chunks_exact(6).zip(bottom.chunks_exact(6)) {
                let sum =
                    |i: usize| u16::from(a[i]) + u16::from(a[i + 3]) + u16::from(b[i]) + u16::from(b[i + 3]);
                data.push([sum(0), sum(1), sum(2)]);
            }
        }
        Self { width: w, height: h, data }
    }

    /// Whether the pixel with index `i` is set in `among`, a mask of the full-resolution image.
    fn is_among(&self, i: usize, among: Option<&Mask>) -> bool {
        let (x, y) = ((i % self.width as usize) as i64, (i / self.width as usize) as i64);
        among.is_none_or(|m| m.contains(2 * x, 2 * y))
    }
}

impl Logs {
    fn new() -> Self {
        let log = |v: u16| (libm::logf(f32::from(v.max(1))) / BIN * 16.0).round() as i16;
        Self((0..=1020).map(log).collect())
    }

    /// The bin of a colour given by sums of four pixels; `None` outside of the skin range.
    #[inline]
    fn bin(&self, [r, g, b]: [u16; 3]) -> Option<usize> {
        let log = |v: u16| self.0[usize::from(v.min(1020))];
        let (lr, lg, lb) = (log(r), log(g), log(b));
        let index = |d: i16, start: f32| (d - (start / BIN * 16.0) as i16) >> 4;
        let (u, v) = (index(lr - lg, RED_OVER_GREEN.0), index(lg - lb, GREEN_OVER_BLUE.0));
        let inside = |i: i16| (0..BINS as i16).contains(&i);
        (r >= 4 * DARK && inside(u) && inside(v)).then(|| v as usize * BINS + u as usize)
    }
}

impl SkinClusters {
    /// The clusters of the skin-like colours in an image, optionally only in the pixels `among`.
    pub(super) fn find(image: &HalfImage, among: Option<&Mask>) -> Self {
        debug_assert!(((RED_OVER_GREEN.1 - RED_OVER_GREEN.0) / BIN).round() as usize == BINS);
        debug_assert!(((GREEN_OVER_BLUE.1 - GREEN_OVER_BLUE.0) / BIN).round() as usize == BINS);
        let logs = Logs::new();
        let mut histogram = vec![0.0f32; BINS * BINS];
        for (i, p) in image.data.iter().enumerate() {
            if let Some(bin) = logs.bin(*p).filter(|_| image.is_among(i, among)) {
                histogram[bin] += 1.0;
            }
        }
        let (mut labels, peaks) = split(&histogram);
        (0..SPREAD).for_each(|_| spread(&mut labels));
        let peaks = peaks
            .iter()
            .map(|&bin| {
                let at = |i: usize, start: f32| start + (i as f32 + 0.5) * BIN;
                [at(bin % BINS, RED_OVER_GREEN.0), at(bin / BINS, GREEN_OVER_BLUE.0)]
            })
            .collect();
        Self { labels, peaks, logs }
    }

    /// The clusters' labels.
    pub(super) fn labels(&self) -> impl Iterator<Item = u8> + use<> {
        1..=self.peaks.len() as u8
    }

    /// A cluster's peak: ln(R/G), ln(G/B).
    pub(super) fn peak(&self, label: u8) -> [f32; 2] {
        self.peaks[usize::from(label) - 1]
    }

    /// The pixels of a half-resolution image that have a cluster's colour, optionally only those `among`.
    pub(super) fn half_mask(&self, image: &HalfImage, label: u8, among: Option<&Mask>) -> Mask {
        let pixels = image.data.iter().enumerate();
        let bits = pixels.map(|(i, p)| self.has_label(*p, label) && image.is_among(i, among));
        Mask::of(Region::whole(image.width, image.height), bits)
    }

    /// Whether a colour given by sums of four pixels is of a cluster.
    fn has_label(&self, sums: [u16; 3], label: u8) -> bool {
        self.logs.bin(sums).is_some_and(|bin| self.labels[bin] == label)
    }

    /// The pixels of a part of an image that have a cluster's colour, smoothed by a majority filter; optionally
    /// only those `among`.
    pub(super) fn mask(&self, image: &RgbImage, region: Region, label: u8, among: Option<&Mask>) -> Mask {
        let region = region.clipped(image.width(), image.height());
        let bit = |(x, y)| {
            let among = among.is_none_or(|m| m.contains(i64::from(x), i64::from(y)));
            among && self.has_label(row_sum(image, x, y), label)
        };
        Mask::of(region, region.pixels().map(bit)).majority()
    }
}

/// A horizontal filter with weights 1, 2, 1: less noise, no shift.
fn row_sum(image: &RgbImage, x: u32, y: u32) -> [u16; 3] {
    let [left, middle, right] =
        [x.saturating_sub(1), x, (x + 1).min(image.width() - 1)].map(|x| image.pixel(x, y));
    std::array::from_fn(|i| u16::from(left[i]) + 2 * u16::from(middle[i]) + u16::from(right[i]))
}

/// Gives each unlabelled bin the lowest label of its neighbours, for colours that arise from noise.
fn spread(labels: &mut [u8]) {
    let before = labels.to_vec();
    for (bin, label) in labels.iter_mut().enumerate().filter(|(_, l)| **l == 0) {
        *label = neighbours(bin).map(|n| before[n]).filter(|&l| l != 0).min().unwrap_or(0);
    }
}

/// Splits a histogram at its valleys. Bins in order of their counts join the hill that they touch. Two hills that meet
/// are merged unless the valley is significantly lower than both peaks. Returns labels and the bins of the peaks.
///
/// The histogram is not smoothed: the camera's noise has smoothed it, and a table's peak would hide a hand's beside
/// it.
fn split(counts: &[f32]) -> (Vec<u8>, Vec<usize>) {
    let is_valley = |valley: f32, top: f32| valley < 0.6 * top && top - valley > 3.0 * top.sqrt();
    let mut order: Vec<usize> = (0..counts.len()).filter(|&i| counts[i] > 0.0).collect();
    order.sort_by(|&a, &b| counts[b].total_cmp(&counts[a]).then(a.cmp(&b)));
    // For each hill its peak and its pixels, and the hill that it was merged into.
    let (mut hills, mut owners): (Vec<(usize, f32)>, Vec<usize>) = (Vec::new(), Vec::new());
    let mut of = vec![usize::MAX; counts.len()];
    for bin in order {
        let mut touched: Vec<usize> =
            neighbours(bin).filter(|&n| of[n] != usize::MAX).map(|n| root(&mut owners, of[n])).collect();
        touched.sort_unstable();
        touched.dedup();
        // The highest hill gets the bin, because hills are numbered from the highest.
        let Some(&first) = touched.first() else {
            of[bin] = hills.len();
            owners.push(hills.len());
            hills.push((bin, counts[bin]));
            continue;
        };
        of[bin] = first;
        hills[first].1 += counts[bin];
        for &other in &touched[1..] {
            if !is_valley(counts[bin], counts[hills[other].0]) || hills[other].1 < MIN_PIXELS {
                hills[first].1 += hills[other].1;
                owners[other] = first;
            }
        }
    }
    let mut label_of = vec![0u8; hills.len()];
    let mut tops = Vec::new();
    for (i, hill) in hills.iter().enumerate() {
        if owners[i] == i && hill.1 >= MIN_PIXELS && tops.len() < 250 {
            tops.push(hill.0);
            label_of[i] = tops.len() as u8;
        }
    }
    let labels =
        of.iter().map(|&o| if o == usize::MAX { 0 } else { label_of[root(&mut owners, o)] }).collect();
    (labels, tops)
}

fn neighbours(bin: usize) -> impl Iterator<Item = usize> {
    let (x, y) = ((bin % BINS) as i32, (bin / BINS) as i32);
    let inside = |v: i32| (0..BINS as i32).contains(&v);
    (-1..=1)
        .flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy)))
        .filter(move |&(nx, ny)| inside(nx) && inside(ny) && (nx, ny) != (x, y))
        .map(|(nx, ny)| ny as usize * BINS + nx as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_values::random::StandardNormal;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A shaded image: left half one colour, right half another, noise of two grey levels.
    fn picture(left: [u8; 3], right: [u8; 3]) -> RgbImage {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut noisy = |c: f64| (c + 2.0 * rng.sample::<f64, _>(StandardNormal)).round() as u8;
        RgbImage::painted(120, 80, |x, y| {
            let shade = 0.6 + 0.4 * f64::from(y) / 80.0;
            (if x < 60 { left } else { right }).map(|c| noisy(f64::from(c) * shade))
        })
    }

    #[test]
    fn skin_and_a_brown_table_are_two_clusters() {
        let image = picture([224, 172, 138], [150, 115, 80]);
        let half = HalfImage::of(&image);
        let clusters = SkinClusters::find(&half, None);
        assert_eq!(clusters.labels().count(), 2, "{:?}", clusters.peaks);
        for label in clusters.labels() {
            let mask = clusters.mask(&image, Region::whole(120, 80), label, None);
            let (left, right): (Vec<_>, Vec<_>) = mask.pixels().partition(|(x, _)| *x < 60);
            let [left, right] = [left.len(), right.len()];
            let (own, other) = (left.max(right), left.min(right));
            assert!(own > 4600 && other < 100, "{own} {other}");
            assert!(clusters.half_mask(&half, label, None).count() > 1100);
        }
    }

    #[test]
    fn greys_and_bright_colours_are_not_skin() {
        for other in
            [[128, 128, 130], [235, 235, 235], [240, 210, 40], [40, 170, 60], [230, 120, 20], [30, 60, 200]]
        {
            let clusters = SkinClusters::find(&HalfImage::of(&picture(other, other)), None);
            assert_eq!(clusters.labels().count(), 0, "{other:?}");
        }
    }
}
