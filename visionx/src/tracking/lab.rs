//! Small images in CIELAB, where distances of colours match their perceived differences.
//!
//! # Source
//! IEC 61966-2-1 (sRGB), CIE 15 (L*a*b*, white point D65).

use image::imageops::thumbnail;

use crate::frame::RgbImage;

/// An image in CIELAB, rows from the top.
#[derive(Clone, Debug)]
pub(super) struct LabImage {
    pub(super) width: usize,
    pub(super) height: usize,
    /// L* 0 to 100, a*, b* about -100 to 100.
    pub(super) data: Vec<[f32; 3]>,
    /// Pixels of the original per pixel here.
    pub(super) scale: f64,
}

impl LabImage {
    /// Reduces the image to a longer side of at most `longest` px by averaging.
    pub(super) fn of(image: &RgbImage, longest: u32) -> Option<Self> {
        let (w, h) = (image.width(), image.height());
        let scale = (f64::from(w.max(h)) / f64::from(longest)).max(1.0);
        let small = |v: u32| ((f64::from(v) / scale).round() as u32).max(1);
        let whole = image::RgbImage::from_raw(w, h, image.data().to_vec())?;
        let reduced = if scale > 1.0 { thumbnail(&whole, small(w), small(h)) } else { whole };
        let linear = linear_levels();
        let data = reduced.pixels().map(|p| lab(p.0.map(|v| linear[usize::from(v)]))).collect();
        let (width, height) = (reduced.width() as usize, reduced.height() as usize);
        (width > 0 && height > 0).then_some(Self { width, height, data, scale })
    }

    /// The colour at a pixel; outside of the image, that of the nearest pixel inside.
    pub(super) fn at(&self, x: i64, y: i64) -> [f32; 3] {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.data[y * self.width + x]
    }
}

/// The squared distance of two colours.
pub(super) fn apart(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum()
}

/// The linear intensity of each of the 256 levels of sRGB, 0 to 1.
fn linear_levels() -> [f32; 256] {
    std::array::from_fn(|v| {
        let v = v as f32 / 255.0;
        if v <= 0.04045 { v / 12.92 } else { libm::powf((v + 0.055) / 1.055, 2.4) }
    })
}

fn lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let x = (0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505;
    let y = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let z = (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089;
    let f = |t: f32| if t > 0.008_856 { libm::cbrtf(t) } else { 7.787 * t + 16.0 / 116.0 };
    let (fx, fy, fz) = (f(x), f(y), f(z));
    [116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_where_the_standard_puts_them() {
        let linear = linear_levels();
        // Published values of the primaries and of white, D65.
        for (rgb, expected) in [
            ([255, 255, 255], [100.0, 0.0, 0.0]),
            ([255, 0, 0], [53.24, 80.09, 67.20]),
            ([0, 255, 0], [87.73, -86.18, 83.18]),
            ([0, 0, 255], [32.30, 79.19, -107.86]),
            ([0, 0, 0], [0.0, 0.0, 0.0]),
        ] {
            let found = lab(rgb.map(|v: usize| linear[v]));
            assert!(apart(&found, &expected).sqrt() < 0.3, "{rgb:?}: {found:?}");
        }
    }

    #[test]
    fn large_images_are_reduced_and_small_ones_stay() {
        let image = RgbImage::painted(40, 20, |_, _| [90; 3]);
        let small = LabImage::of(&image, 10).unwrap();
        assert_eq!((small.width, small.height, small.scale), (10, 5, 4.0));
        assert_eq!(LabImage::of(&image, 100).unwrap().width, 40);
        assert!(LabImage::of(&RgbImage::from_rgb(0, 0, vec![]).unwrap(), 10).is_none());
    }
}
