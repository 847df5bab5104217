//! Classifies the pixels that have an object's colour, independent of shading.
//!
//! Shading by a white light scales a pixel's RGB vector and keeps its direction. A pixel has the colour when it lies
//! in a cone about the reference's direction and its brightness is within the range that shading can explain. The
//! camera's noise widens the cone at its tip. Colours without hue (white, grey, black) share one direction, so they
//! are told apart by brightness instead. Gamma, coloured light and highlights are not modelled.

use crate::frame::RgbImage;
use crate::mask::{Mask, Region};

/// The colour of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorModel {
    /// Unit vector of the reference colour.
    direction: [f32; 3],
    /// Tangent of the half angle of the cone.
    tangent: f32,
    /// Added to the cone's radius, grey levels.
    radius: f32,
    /// Accepted lengths along the direction, grey levels.
    range: (f32, f32),
}

/// Half angle of the cone for a colour of full hue, rad.
const HALF_ANGLE: f32 = 0.105;
/// A hue that is nearer to another one than this is nearly the same, rad.
const NEAR_HUE: f32 = 0.06;
/// Widening by noise: about three times the noise of the cameras (sigma 2), grey levels.
const NOISE_RADIUS: f32 = 5.0;
/// Length under which a pixel has no usable direction, grey levels.
const DARK: f32 = 30.0;

impl ColorModel {
    /// The model of an object whose colour in full light is `reference` (RGB).
    pub fn from_rgb(reference: [u8; 3]) -> Self {
        let v = reference.map(f32::from);
        let length = norm(v);
        let grey = [1.0f32 / 3.0f32.sqrt(); 3];
        let direction = if length > 0.0 { v.map(|c| c / length) } else { grey };
        let from_grey = libm::acosf(dot(direction, grey).clamp(-1.0, 1.0));
        let hued = from_grey > 0.12;
        // A pale colour's cone must not reach the greys.
        let half_angle = if hued { HALF_ANGLE.min(from_grey * 0.45) } else { 0.06 };
        let range = if hued {
            ((0.25 * length).max(DARK), (1.35 * length).max(DARK))
        } else {
            (0.6 * length - 12.0, 1.3 * length + 12.0)
        };
        Self { direction, tangent: libm::tanf(half_angle), radius: NOISE_RADIUS, range }
    }

    /// Adapts the model to the observed `pixels` (RGB): a cone about their mean, as wide as their scatter, never
    /// wider than before. The accepted brightness range stays. Without usable pixels the model is unchanged.
    pub fn learned(&self, pixels: impl Iterator<Item = [u8; 3]> + Clone) -> Self {
        let bright = pixels.map(|p| p.map(f32::from)).filter(|p| norm(*p) > DARK);
        let mut sum = [0.0f32; 3];
        bright.clone().for_each(|p| (0..3).for_each(|i| sum[i] += p[i]));
        let length = norm(sum);
        if length <= 0.0 {
            return *self;
        }
        let direction = sum.map(|c| c / length);
        let (mut n, mut squares) = (0.0f32, 0.0f32);
        for p in bright {
            let along = dot(p, direction);
            n += 1.0;
            squares += (dot(p, p) - along * along).max(0.0) / (along * along).max(1.0);
        }
        let tangent = (2.5 * (squares / n).sqrt()).clamp(0.03, self.tangent.max(0.03));
        Self { direction, tangent, ..*self }
    }

    /// As [`learned`](Self::learned), by those of the pixels that have nearly the hue of most of them: some may be of another thing.
    pub(crate) fn learned_from_most(&self, pixels: impl Iterator<Item = [u8; 3]> + Clone) -> Self {
        let most = Self { tangent: libm::tanf(NEAR_HUE), ..Self::from_rgb(median_color(pixels.clone())) };
        self.learned(pixels.filter(|pixel| most.accepts(*pixel)))
    }

    /// The angle between a colour (RGB, any length) and the reference, rad; a right angle for black.
    pub fn angle(&self, rgb: [f64; 3]) -> f64 {
        let v = rgb.map(|c| c as f32);
        let length = norm(v);
        if length > 0.0 {
            f64::from(libm::acosf((dot(v, self.direction) / length).clamp(-1.0, 1.0)))
        } else {
            std::f64::consts::FRAC_PI_2
        }
    }

    /// All pixels of the image that have the colour.
    pub fn segment(&self, image: &RgbImage) -> Mask {
        self.segment_region(image, Region::whole(image.width(), image.height()))
    }

    /// The pixels of a part of the image that have the colour; the part is clipped to the image.
    pub fn segment_region(&self, image: &RgbImage, region: Region) -> Mask {
        let region = region.clipped(image.width(), image.height());
        let mut mask = Mask::empty(region);
        if region.area() == 0 {
            return mask;
        }
        let stride = image.width() as usize * 3;
        let width = region.width as usize;
        let rows = image.data().chunks_exact(stride).skip(region.y as usize);
        for (row, out) in rows.zip(mask.data_mut().chunks_exact_mut(width)) {
            let start = region.x as usize * 3;
            let pixels = row[start..start + width * 3].chunks_exact(3);
            for (p, o) in pixels.zip(out) {
                *o = u8::from(self.accepts([p[0], p[1], p[2]]));
            }
        }
        mask
    }

    /// Whether a pixel has the colour.
    #[inline]
    pub(crate) fn accepts(&self, rgb: [u8; 3]) -> bool {
        let [r, g, b] = rgb.map(f32::from);
        let [u, v, w] = self.direction;
        let along = r * u + g * v + b * w;
        let across = r * r + g * g + b * b - along * along;
        let limit = along * self.tangent + self.radius;
        // Non-short-circuit `&`: the loop over pixels stays free of branches.
        (across <= limit * limit) & (along >= self.range.0) & (along <= self.range.1)
    }
}

/// The median of each channel; black of none.
pub(crate) fn median_color(colors: impl Iterator<Item = [u8; 3]>) -> [u8; 3] {
    let (mut histograms, mut count) = ([[0u32; 256]; 3], 0);
    for color in colors {
        histograms.iter_mut().zip(color).for_each(|(histogram, value)| histogram[usize::from(value)] += 1);
        count += 1;
    }
    histograms.map(|histogram| {
        let mut sum = 0;
        let middle = histogram.iter().position(|n| {
            sum += n;
            2 * sum >= count
        });
        middle.unwrap_or(0) as u8
    })
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(a: [f32; 3]) -> f32 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shaded(rgb: [u8; 3], factor: f64) -> [u8; 3] {
        rgb.map(|c| (f64::from(c) * factor).round() as u8)
    }

    #[test]
    fn shading_keeps_the_colour() {
        for reference in [[240, 210, 40], [40, 170, 60], [220, 30, 200], [230, 120, 20], [20, 60, 220]] {
            let model = ColorModel::from_rgb(reference);
            for percent in 35..=105 {
                let p = shaded(reference, f64::from(percent) / 100.0);
                assert!(model.accepts(p), "{reference:?} at {percent} %");
            }
        }
    }

    #[test]
    fn other_things_have_other_colours() {
        let wood_and_skin = [[150, 115, 80], [224, 172, 138], [205, 190, 165]];
        let scene = [[128; 3], [40, 40, 45], [235; 3]].into_iter().chain(wood_and_skin);
        for reference in [[240, 210, 40], [40, 170, 60], [220, 30, 200], [20, 60, 220]] {
            let model = ColorModel::from_rgb(reference);
            for other in scene.clone() {
                for percent in 30..=100 {
                    let p = shaded(other, f64::from(percent) / 100.0);
                    assert!(!model.accepts(p), "{p:?} is not {reference:?}");
                }
            }
        }
    }

    #[test]
    fn greys_are_told_apart_by_brightness() {
        let white = ColorModel::from_rgb([240, 240, 240]);
        assert!(white.accepts([200, 200, 200]) && !white.accepts([100, 100, 100]));
        let black = ColorModel::from_rgb([0, 0, 0]);
        assert!(black.accepts([5, 3, 4]) && !black.accepts([60, 60, 60]));
    }

    #[test]
    fn a_learned_colour_is_narrower() {
        let (tool, similar) = ([40, 170, 60], [60, 175, 50]);
        let model = ColorModel::from_rgb(tool);
        let learned = model.learned((60..=100).map(|percent| shaded(tool, f64::from(percent) / 100.0)));
        assert!(model.accepts(similar) && !learned.accepts(similar));
        assert!((50..=100).all(|percent| learned.accepts(shaded(tool, f64::from(percent) / 100.0))));
        assert_eq!(model.learned(std::iter::empty()), model);
    }

    #[test]
    fn what_most_pixels_show_is_learned_and_not_what_some_do() {
        let (tray, arm) = ([39, 86, 192], [38, 52, 100]);
        let seen = || std::iter::repeat_n(tray, 85).chain(std::iter::repeat_n(arm, 15));
        let model = ColorModel::from_rgb([40, 90, 200]);
        assert!(model.learned(seen()).accepts(arm));
        let learned = model.learned_from_most(seen());
        assert!(learned.accepts(tray) && !learned.accepts(arm));
    }

    #[test]
    fn a_region_is_a_part_of_the_whole() {
        let colored = [(2, 1), (3, 1), (7, 5)];
        let color = |x, y| if colored.contains(&(x, y)) { [220, 30, 200] } else { [0; 3] };
        let image = RgbImage::painted(8, 6, color);
        let model = ColorModel::from_rgb([220, 30, 200]);
        assert_eq!(model.segment(&image).count(), 3);
        let part = model.segment_region(&image, Region { x: 3, y: 0, width: 100, height: 3 });
        assert_eq!(part.count(), 1);
        assert!(part.contains(3, 1) && !part.contains(2, 1));
        assert_eq!(model.segment_region(&image, Region { x: 50, y: 50, width: 5, height: 5 }).count(), 0);
    }
}
