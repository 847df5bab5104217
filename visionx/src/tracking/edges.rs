//! The edge map of a hand: points on its outline with the inward direction.
//!
//! A silhouette's outline has pixel resolution. Each of its points is moved along the normal to where the colour is
//! half way between inside and outside, so that circles fitted to the edges have subpixel accuracy.

use image::{ImageBuffer, Luma};
use imageproc::filter::gaussian_blur_f32;
use nalgebra::{Point2, Vector2};

use crate::frame::RgbImage;
use crate::mask::Mask;

/// A point of the outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Position, px.
    pub at: Point2<f64>,
    /// Unit normal into the hand.
    pub inward: Vector2<f64>,
}

/// Blur of the silhouette before its normals are computed, px.
const BLUR: f32 = 1.5;
/// Search range of the edge along the normal, px.
const SEARCH: f64 = 2.0;

/// The edges of a silhouette in its image. There is no edge where the silhouette ends at the image's border.
pub fn edge_map(image: &RgbImage, hand: &Mask) -> Vec<Edge> {
    let region = hand.region();
    let (w, h) = (region.width, region.height);
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    if w == 0 || h == 0 {
        return Vec::new();
    }
    // A border around the mask, so that a hand that fills the mask has a gradient there.
    const FRAME: u32 = 4;
    let level = |x: u32, y: u32| {
        let (x, y) = (i64::from(x) - i64::from(FRAME), i64::from(y) - i64::from(FRAME));
        f32::from(u8::from(hand.contains(x + i64::from(region.x), y + i64::from(region.y))))
    };
    let plain = ImageBuffer::from_fn(w + 2 * FRAME, h + 2 * FRAME, |x, y| Luma([level(x, y)]));
    let smooth: ImageBuffer<Luma<f32>, Vec<f32>> = gaussian_blur_f32(&plain, BLUR);
    let at = |x: u32, y: u32| f64::from(smooth.get_pixel(x, y).0[0]);
    let inner = |&(x, y): &(i64, i64)| x > 0 && y > 0 && x + 1 < width && y + 1 < height;
    let edge = |(px, py): (i64, i64)| {
        let (x, y) = (px as u32 - region.x + FRAME, py as u32 - region.y + FRAME);
        let slope = Vector2::new(at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1)) / 2.0;
        let inward = slope.try_normalize(1e-4)?;
        // The level 0.5 of the blurred silhouette, about half a pixel outside of its outermost pixel.
        let half =
            Point2::new(px as f64, py as f64) + inward * ((0.5 - at(x, y)) / slope.norm()).clamp(-1.5, 1.5);
        Some(Edge { at: refined(image, &half, &inward), inward })
    };
    hand.pixels().filter(inner).filter(|at| hand.is_at_edge(*at)).filter_map(edge).collect()
}

/// Finds where the colour along the normal is half way between inside and outside; returns `at` where that is
/// unclear.
fn refined(image: &RgbImage, at: &Point2<f64>, inward: &Vector2<f64>) -> Point2<f64> {
    let color = |t: f64| bilinear(image, &(at + inward * t));
    let (outside, inside) = (color(-SEARCH - 0.5), color(SEARCH + 0.5));
    let axis: Vec<f64> = (0..3).map(|i| inside[i] - outside[i]).collect();
    let length: f64 = axis.iter().map(|a| a * a).sum();
    if length < 400.0 {
        return *at;
    }
    let level = |t: f64| {
        let c = color(t);
        (0..3).map(|i| (c[i] - outside[i]) * axis[i]).sum::<f64>() / length
    };
    let steps = 8;
    let place = |k: i32| -SEARCH + 2.0 * SEARCH * f64::from(k) / f64::from(steps);
    let mut before = level(place(0));
    let mut best: Option<f64> = None;
    for k in 1..=steps {
        let now = level(place(k));
        if before < 0.5 && now >= 0.5 {
            let t = place(k - 1) + (0.5 - before) / (now - before) * (2.0 * SEARCH / f64::from(steps));
            if best.is_none_or(|b| t.abs() < b.abs()) {
                best = Some(t);
            }
        }
        before = now;
    }
    at + inward * best.unwrap_or(0.0)
}

fn bilinear(image: &RgbImage, at: &Point2<f64>) -> [f64; 3] {
    let (w, h) = (f64::from(image.width()) - 1.0, f64::from(image.height()) - 1.0);
    let (x, y) = (at.x.clamp(0.0, w.max(0.0)), at.y.clamp(0.0, h.max(0.0)));
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let pixel = |dx: u32, dy: u32| {
        let p = image.pixel((x0 as u32 + dx).min(w as u32), (y0 as u32 + dy).min(h as u32));
        p.map(f64::from)
    };
    let (a, b, c, d) = (pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1));
    std::array::from_fn(|i| {
        (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::mask::Region;

    /// A skin-coloured disc before a wall, with smooth edges, and its silhouette in whole pixels.
    pub(in crate::tracking) fn disc(x: f64, y: f64, r: f64) -> (RgbImage, Mask) {
        let (w, h) = (80u32, 70u32);
        let share = |(u, v)| (0.5 - (libm::hypot(f64::from(u) - x, f64::from(v) - y) - r)).clamp(0.0, 1.0);
        let color = |share: f64| {
            [(224.0, 90.0), (172.0, 110.0), (138.0, 120.0)].map(|(i, o)| (o + (i - o) * share) as u8)
        };
        let whole = Region::whole(w, h);
        let mask = Mask::of(whole, whole.pixels().map(|at| share(at) >= 0.5));
        (RgbImage::painted(w, h, |u, v| color(share((u, v)))), mask)
    }

    #[test]
    fn edges_of_a_disc_lie_on_its_circle_and_look_inwards() {
        let (image, mask) = disc(40.3, 33.8, 12.4);
        let edges = edge_map(&image, &mask);
        assert!(edges.len() > 60, "{}", edges.len());
        for e in edges {
            let out = e.at - Point2::new(40.3, 33.8);
            assert!((out.norm() - 12.4).abs() < 0.25, "{} {}", out.norm(), e.at);
            assert!(e.inward.dot(&out.normalize()) < -0.97);
        }
    }

    #[test]
    fn there_are_no_edges_at_the_pictures_border() {
        let (image, mut mask) = disc(0.0, 0.0, 20.0);
        assert!(edge_map(&image, &mask).iter().all(|e| e.at.coords.norm() > 18.0));
        mask.data_mut().fill(1);
        assert!(edge_map(&image, &mask).is_empty());
        assert!(edge_map(&image, &Mask::empty(Region::whole(0, 0))).is_empty());
    }
}
