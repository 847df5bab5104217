//! Detects fingertips as circles in an edge map, with a radius that depends on the hand's distance.
//!
//! # Source
//! Do, Asfour, Dillmann 2011, "Particle filter-based fingertip tracking with circular Hough transform features"; the
//! voting along the edge's normal after Kimme, Ballard, Sklansky 1975.

use image::{ImageBuffer, Luma};
use imageproc::filter::gaussian_blur_f32;
use imageproc::suppress::suppress_non_maximum;
use nalgebra::{Point2, Vector2};

use super::edges::Edge;
use crate::mask::Region;

/// A circular Hough transform for fingertips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptiveHoughTransform {
    /// Radius of a fingertip, m.
    pub tip_radius: f64,
    /// A distance whose radius in pixels is used at all distances, m; `None`: the radius follows the distance.
    pub fixed_depth: Option<f64>,
}

/// A circle that may be a fingertip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipCandidate {
    /// Centre of the circle, px.
    pub center: Point2<f64>,
    /// Its radius, px.
    pub radius: f64,
    /// Direction out of the finger, unit vector.
    pub outward: Vector2<f64>,
    /// Similarity to a tip, 0 to 1: edges on half of the circle, and none on the finger's side.
    pub score: f64,
}

/// The votes of a transform.
#[derive(Clone, Debug)]
pub struct HoughVotes {
    region: Region,
    radius: f64,
    votes: ImageBuffer<Luma<f32>, Vec<f32>>,
}

/// Radii that get votes, relative to the expected one.
const RADII: [f64; 5] = [0.80, 0.90, 1.0, 1.10, 1.20];
/// Sectors of the circle in which edges are counted.
const SECTORS: usize = 24;
/// Least score of a candidate.
const MIN_SCORE: f64 = 0.35;
/// Smallest usable radius, px.
const MIN_RADIUS: f64 = 2.0;

impl Default for AdaptiveHoughTransform {
    fn default() -> Self {
        Self { tip_radius: 0.0083, fixed_depth: None }
    }
}

impl AdaptiveHoughTransform {
    /// The radius of a fingertip at a depth, px, for a focal length in px: `f R / Z`.
    pub fn radius_px(&self, focal: f64, depth: f64) -> f64 {
        focal * self.tip_radius / self.fixed_depth.unwrap_or(depth).max(1e-3)
    }

    /// Lets the edges vote for the centres of circles of a radius, px. `None` without edges or with an invalid
    /// radius.
    pub fn votes(&self, edges: &[Edge], radius: f64) -> Option<HoughVotes> {
        if edges.is_empty() || !(MIN_RADIUS..=200.0).contains(&radius) {
            return None;
        }
        let pixels = edges.iter().flat_map(|edge| [edge.at, edge.at + Vector2::repeat(1.0)]);
        let region = Region::around(pixels, 0.0, 1 << 15, 1 << 15);
        if region.area() == 0 || region.area() > 1 << 24 {
            return None;
        }
        let mut votes = ImageBuffer::<Luma<f32>, Vec<f32>>::new(region.width, region.height);
        for edge in edges {
            for share in RADII {
                let at = edge.at + edge.inward * (radius * share);
                splat(&mut votes, at.x - f64::from(region.x), at.y - f64::from(region.y));
            }
        }
        let votes = gaussian_blur_f32(&votes, (0.13 * radius).clamp(0.7, 3.0) as f32);
        Some(HoughVotes { region, radius, votes })
    }
}

impl HoughVotes {
    /// The votes at a pixel, 0 outside.
    fn at(&self, x: i64, y: i64) -> f64 {
        let (x, y) = (x - i64::from(self.region.x), y - i64::from(self.region.y));
        let inside =
            x >= 0 && y >= 0 && x < i64::from(self.region.width) && y < i64::from(self.region.height);
        if inside { f64::from(self.votes.get_pixel(x as u32, y as u32).0[0]) } else { 0.0 }
    }

    /// The circles that may be fingertips, best first: peaks of the votes whose edges form the end of a finger.
    pub fn candidates(&self, edges: &[Edge]) -> Vec<TipCandidate> {
        let mut found: Vec<TipCandidate> = self
            .peaks()
            .into_iter()
            .filter_map(|peak| self.judged(&peak, edges))
            .filter(|c| c.score >= MIN_SCORE)
            .collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut apart: Vec<TipCandidate> = Vec::new();
        for c in found {
            if apart.iter().all(|a| (a.center - c.center).norm() > 1.2 * self.radius) {
                apart.push(c);
            }
        }
        apart
    }

    /// The mean position of the votes around a point, px, by repeated mean-shift steps (Comaniciu, Meer).
    pub fn mean_shift(&self, start: &Point2<f64>) -> Point2<f64> {
        let reach = 0.6 * self.radius;
        let mut at = *start;
        for _ in 0..8 {
            let (mut weight, mut sum) = (0.0, Vector2::zeros());
            let r = reach.ceil() as i64 + 1;
            let (cx, cy) = (at.x.round() as i64, at.y.round() as i64);
            for (x, y) in (cy - r..=cy + r).flat_map(|y| (cx - r..=cx + r).map(move |x| (x, y))) {
                let offset = Vector2::new(x as f64, y as f64) - at.coords;
                let kernel = (1.0 - offset.norm_squared() / (reach * reach)).max(0.0);
                // The square sharpens the peak against the ridge along the finger.
                let w = kernel * self.at(x, y).powi(2);
                weight += w;
                sum += offset * w;
            }
            if weight <= 0.0 {
                return *start;
            }
            let step = sum / weight;
            at += step;
            if step.norm() < 0.02 {
                break;
            }
        }
        at
    }

    /// Local maxima with a sufficient share of the votes of half a circle.
    fn peaks(&self) -> Vec<Point2<f64>> {
        let expected = std::f64::consts::PI * self.radius;
        let blur = (0.13 * self.radius).clamp(0.7, 3.0);
        // All votes of one radius coincide in the blur's peak. Integers, because the peak search needs a total
        // order.
        let whole = |votes: f64| (votes * 4096.0) as u32;
        let least = whole(0.22 * expected / (2.0 * std::f64::consts::PI * blur * blur));
        let (w, h) = self.votes.dimensions();
        let votes =
            ImageBuffer::from_fn(w, h, |x, y| Luma([whole(f64::from(self.votes.get_pixel(x, y).0[0]))]));
        let suppressed = suppress_non_maximum(&votes, (0.5 * self.radius).max(1.0) as u32);
        let peak = |(x, y, p): (u32, u32, &Luma<u32>)| {
            (p.0[0] > least).then(|| Point2::new(f64::from(x + self.region.x), f64::from(y + self.region.y)))
        };
        suppressed.enumerate_pixels().filter_map(peak).collect()
    }

    /// Scores how well the edges around a place form the end of a finger.
    fn judged(&self, at: &Point2<f64>, edges: &[Edge]) -> Option<TipCandidate> {
        let mut sectors = [false; SECTORS];
        let (mut n, mut radius) = (0.0, 0.0);
        for edge in edges {
            let out = edge.at - at;
            let distance = out.norm();
            if (distance - self.radius).abs() > 0.35 * self.radius + 0.7
                || edge.inward.dot(&out) > -0.85 * distance
            {
                continue;
            }
            let turn = libm::atan2(out.y, out.x) / std::f64::consts::TAU + 0.5;
            sectors[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
            n += 1.0;
            radius += distance;
        }
        let (length, middle) = longest_arc(&sectors);
        let turn = (middle / SECTORS as f64 - 0.5) * std::f64::consts::TAU;
        let outward = Vector2::new(libm::cos(turn), libm::sin(turn));
        // Half a circle is a tip; much more is a ball, much less a bend of the outline.
        let share = length as f64 / (SECTORS as f64 / 2.0);
        let score = if share <= 1.0 { share } else { (1.0 - 1.2 * (share - 1.35).max(0.0)).max(0.0) };
        (n > 3.0).then(|| TipCandidate { center: *at, radius: radius / n, outward, score: score * score })
    }
}

/// The length and the middle of the longest run of set sectors around the circle; a single missing sector is
/// bridged.
fn longest_arc(sectors: &[bool; SECTORS]) -> (usize, f64) {
    let set = |i: usize| {
        sectors[i % SECTORS] || (sectors[(i + SECTORS - 1) % SECTORS] && sectors[(i + 1) % SECTORS])
    };
    let mut best = (0, 0.0);
    for start in 0..SECTORS {
        let length = (0..SECTORS).take_while(|k| set(start + k)).count();
        if length > best.0 {
            best = (length, (start as f64 + length as f64 / 2.0) % SECTORS as f64);
        }
    }
    best
}

/// Adds one vote, split among the four pixels around a place.
fn splat(votes: &mut ImageBuffer<Luma<f32>, Vec<f32>>, x: f64, y: f64) {
    let (x0, y0) = (x.floor(), y.floor());
    if x0 < 0.0 || y0 < 0.0 || x0 + 1.0 >= f64::from(votes.width()) || y0 + 1.0 >= f64::from(votes.height()) {
        return;
    }
    let (fx, fy) = (x - x0, y - y0);
    for (dx, dy, share) in
        [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
    {
        votes.get_pixel_mut(x0 as u32 + dx, y0 as u32 + dy).0[0] += share as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The edges of a finger that points up: a half circle and two sides, about a pixel apart.
    fn finger(x: f64, y: f64, r: f64, length: f64) -> Vec<Edge> {
        let arc =
            (0..=(3.2 * r) as i32).map(|i| std::f64::consts::PI * (1.0 + f64::from(i) / (3.2 * r).floor()));
        let mut edges: Vec<Edge> = arc
            .map(|a| Vector2::new(libm::cos(a), libm::sin(a)))
            .map(|d| Edge { at: Point2::new(x, y) + d * r, inward: -d })
            .collect();
        for i in 1..length as i32 {
            for side in [-1.0, 1.0] {
                let at = Point2::new(x + side * r, y + f64::from(i));
                edges.push(Edge { at, inward: Vector2::new(-side, 0.0) });
            }
        }
        edges
    }

    #[test]
    fn finds_the_middle_of_a_tips_rounding_at_any_distance() {
        for depth in [0.3, 0.5, 1.0] {
            let hough = AdaptiveHoughTransform::default();
            let radius = hough.radius_px(515.0, depth);
            let edges = finger(100.4, 80.7, radius, 6.0 * radius);
            let votes = hough.votes(&edges, radius).unwrap();
            let found = votes.candidates(&edges);
            assert_eq!(found.len(), 1, "{found:?}");
            let center = votes.mean_shift(&found[0].center);
            assert!((center - Point2::new(100.4, 80.7)).norm() < 1.0, "{depth}: {center}");
            assert!(found[0].score > 0.7 && found[0].outward.y < -0.9, "{found:?}");
        }
    }

    #[test]
    fn straight_edges_and_great_arcs_are_no_tips() {
        let hough = AdaptiveHoughTransform::default();
        let line: Vec<Edge> =
            (0..100).map(|i| Edge { at: Point2::new(f64::from(i), 50.0), inward: Vector2::y() }).collect();
        let arc: Vec<Edge> = (0..250)
            .map(|i| f64::from(i) / 40.0)
            .map(|a| Vector2::new(libm::cos(a), libm::sin(a)))
            .map(|d| Edge { at: Point2::new(90.0, 90.0) + d * 40.0, inward: -d })
            .collect();
        for edges in [line, arc] {
            let votes = hough.votes(&edges, 8.0).unwrap();
            assert!(votes.candidates(&edges).is_empty());
        }
        assert!(hough.votes(&[], 8.0).is_none());
        assert!(hough.votes(&finger(50.0, 50.0, 8.0, 20.0), f64::NAN).is_none());
    }

    #[test]
    fn the_radius_is_focal_length_times_size_over_depth() {
        let hough = AdaptiveHoughTransform { tip_radius: 0.008, fixed_depth: None };
        assert!((hough.radius_px(500.0, 0.5) - 8.0).abs() < 1e-12);
        let fixed = AdaptiveHoughTransform { fixed_depth: Some(0.5), ..hough };
        assert!((fixed.radius_px(500.0, 1.0) - 8.0).abs() < 1e-12);
    }
}
