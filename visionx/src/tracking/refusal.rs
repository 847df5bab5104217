//! Rejects regions of a photograph that were segmented as a hand but are not one: in at least one feature they are
//! farther from all hands of a collection than these are from each other.
//!
//! # Source
//! Measured on 513 images of hands. Three are photographs; the others are rendered, rotated, scaled, recoloured or
//! pasted on other images. Each limit is the most extreme hand, in brackets below, and a fifth more. Boxes and balls
//! have limits set by hand.

use nalgebra::Point2;

use super::lab::LabImage;
use crate::distance::{inside, steps_inside};
use crate::mask::Mask;
use crate::rectangle::Rectangle;

/// Rounding of pixels in the search of the smallest rectangle, px.
const CELL: f64 = 0.05;
/// Share of the image's border (hands: 0.25).
const BORDER: f64 = 0.30;
/// Share of the image (0.45).
const SHARE: f64 = 0.54;
/// Squared perimeter over that of a disc of the same area (5.5).
const RAGGED: f64 = 6.6;
/// Area over that of the smallest rectangle around it (0.885): a box.
const RECTANGLE: f64 = 0.93;
/// Area of the largest disc inside over the area (0.75): a ball.
const DISC: f64 = 0.86;
/// Mean change of colour per pixel inside, CIELAB (2.8).
const TEXTURE: f64 = 3.4;
/// The same relative to that along the outline (0.48).
const BLURRED: f64 = 0.58;
/// Standard deviation of a* or b*, relative to L* + 16 (0.15).
const MOTLEY: f64 = 0.178;
/// Depth inside from which texture is measured, radii of the largest disc.
const DEEP: f64 = 0.12;

/// Whether a region segmented from an image, as a mask of the whole image, is not a hand.
pub(super) fn is_other_object(image: &LabImage, mask: &Mask) -> bool {
    let view = MaskedImage { image, mask, width: image.width as i64, height: image.height as i64 };
    let pixels: Vec<(i64, i64)> = mask.pixels().collect();
    let area = pixels.len() as f64;
    let radius = inside(mask).into_iter().map(f64::from).fold(0.0, f64::max);
    if area < 1.0 || radius < 1.0 {
        return true;
    }
    let edge: Vec<(i64, i64)> = pixels.iter().copied().filter(|at| view.is_edge(*at)).collect();
    let perimeter = edge.len() as f64;
    area > SHARE * (view.width * view.height) as f64
        || view.border() > BORDER
        || perimeter * perimeter > RAGGED * 4.0 * std::f64::consts::PI * area
        || std::f64::consts::PI * radius * radius > DISC * area
        || rectangle(&pixels).is_some_and(|around| area > RECTANGLE * around)
        || view.motley(&pixels) > MOTLEY
        || view.is_textured(&pixels, &edge, radius)
}

struct MaskedImage<'v> {
    image: &'v LabImage,
    mask: &'v Mask,
    width: i64,
    height: i64,
}

impl MaskedImage<'_> {
    /// Whether a pixel outside of the region is adjacent; the image's border does not count.
    fn is_edge(&self, (x, y): (i64, i64)) -> bool {
        let beside = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
        beside.into_iter().any(|(x, y)| {
            (0..self.width).contains(&x) && (0..self.height).contains(&y) && !self.mask.contains(x, y)
        })
    }

    /// The share of the image's border that is in the region.
    fn border(&self) -> f64 {
        let (right, bottom) = (self.width - 1, self.height - 1);
        let rows = (0..self.width).flat_map(|x| [(x, 0), (x, bottom)]);
        let columns = (1..bottom).flat_map(|y| [(0, y), (right, y)]);
        let (mut held, mut all) = (0.0, 0.0);
        for (x, y) in rows.chain(columns) {
            held += f64::from(u8::from(self.mask.contains(x, y)));
            all += 1.0;
        }
        held / all
    }

    /// The larger standard deviation of a* and b*, relative to the lightness.
    fn motley(&self, pixels: &[(i64, i64)]) -> f64 {
        let deviation = |channel: usize| {
            let of = |at: &(i64, i64)| {
                let color = self.image.at(at.0, at.1);
                f64::from(color[channel]) / (f64::from(color[0]) + 16.0)
            };
            let count = pixels.len() as f64;
            let mean = pixels.iter().map(of).sum::<f64>() / count;
            (pixels.iter().map(|at| (of(at) - mean).powi(2)).sum::<f64>() / count).sqrt()
        };
        deviation(1).max(deviation(2))
    }

    /// Whether colours inside change as much as along an outline, or more than on skin.
    fn is_textured(&self, pixels: &[(i64, i64)], edge: &[(i64, i64)], radius: f64) -> bool {
        let depth = steps_inside(self.mask);
        let least = (DEEP * radius).floor().max(2.0) as u8;
        let deep: Vec<(i64, i64)> =
            pixels.iter().copied().filter(|(x, y)| depth[(y * self.width + x) as usize] > least).collect();
        let deep = if deep.len() < 20 { pixels } else { &deep[..] };
        let mean = |places: &[(i64, i64)]| {
            places.iter().map(|at| self.change(*at)).sum::<f64>() / places.len().max(1) as f64
        };
        let within = mean(deep);
        within > TEXTURE || (!edge.is_empty() && within > BLURRED * mean(edge))
    }

    /// The change of colour per pixel in the smoothed image.
    fn change(&self, (x, y): (i64, i64)) -> f64 {
        // Sobel's differences of the image smoothed by a Gaussian of one pixel, in one kernel along each axis.
        const SMOOTH: [f32; 7] =
            [0.0625 / 4.0, 0.375 / 4.0, 0.9375 / 4.0, 1.25 / 4.0, 0.9375 / 4.0, 0.375 / 4.0, 0.0625 / 4.0];
        const SLOPE: [f32; 7] = [-0.03125, -0.125, -0.15625, 0.0, 0.15625, 0.125, 0.03125];
        let (mut along, mut across) = ([0.0_f32; 3], [0.0_f32; 3]);
        for (j, v) in (-3..=3).enumerate() {
            for (i, u) in (-3..=3).enumerate() {
                let color = self.image.at(x + u, y + v);
                for c in 0..3 {
                    along[c] += SLOPE[i] * SMOOTH[j] * color[c];
                    across[c] += SMOOTH[i] * SLOPE[j] * color[c];
                }
            }
        }
        f64::from((0..3).map(|c| along[c] * along[c] + across[c] * across[c]).sum::<f32>()).sqrt()
    }
}

/// The area of the smallest rectangle around pixels, px².
fn rectangle(pixels: &[(i64, i64)]) -> Option<f64> {
    let points: Vec<Point2<f64>> = pixels.iter().map(|(x, y)| Point2::new(*x as f64, *y as f64)).collect();
    let around = Rectangle::around(&points, 0.0, CELL)?;
    // From the centres of the outermost pixels to their edges.
    Some((around.size[0] + 1.0) * (around.size[1] + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::RgbImage;
    use crate::mask::Region;

    /// An image of `inside` where `holds`, of gray elsewhere, and the mask of it.
    fn picture(holds: impl Fn(i64, i64) -> bool, inside: impl Fn(i64, i64) -> [u8; 3]) -> (LabImage, Mask) {
        let whole = Region::whole(120, 160);
        let holds = |x: u32, y: u32| holds(x.into(), y.into());
        let color = |x, y| if holds(x, y) { inside(x.into(), y.into()) } else { [90, 95, 92] };
        let image = RgbImage::painted(whole.width, whole.height, color);
        (LabImage::of(&image, 480).unwrap(), Mask::of(whole, whole.pixels().map(|(x, y)| holds(x, y))))
    }

    const SKIN: [u8; 3] = [222, 170, 140];

    fn is_refused(holds: impl Fn(i64, i64) -> bool, inside: impl Fn(i64, i64) -> [u8; 3]) -> bool {
        let (image, mask) = picture(holds, inside);
        is_other_object(&image, &mask)
    }

    #[test]
    fn a_hand_is_none_of_these() {
        let fist = |x: i64, y: i64| {
            ((x - 60) * (x - 60) + (y - 60) * (y - 60) < 30 * 30) || ((45..75).contains(&x) && y > 60)
        };
        assert!(!is_refused(fist, |_, _| SKIN), "a fist and its arm");
        assert!(is_refused(|x, y| x > 20 && y > 50, |_, _| SKIN), "a table, to three borders");
        assert!(is_refused(|x, y| (30..90).contains(&x) && (50..110).contains(&y), |_, _| SKIN), "a box");
        let tilted = |x: i64, y: i64| (x + y - 140).abs() < 50 && (x - y + 20).abs() < 25;
        assert!(is_refused(tilted, |_, _| SKIN), "a box that is turned");
        assert!(is_refused(|x, y| (x - 60) * (x - 60) + (y - 70) * (y - 70) < 900, |_, _| SKIN), "a ball");
        let noise =
            |x: i64, y: i64| if (x * 7919 + y * 104_729) % 5 < 2 { [250, 200, 120] } else { [150, 120, 160] };
        assert!(is_refused(fist, noise), "noise");
        assert!(is_refused(|x, y| fist(x, y) && (x + y) % 6 < 3, |_, _| SKIN), "threads");
        assert!(is_refused(|_, _| false, |_, _| SKIN), "nothing");
    }
}
