//! Distance transforms, from `imageproc`, for masks.

use image::{GrayImage, Luma};
use imageproc::distance_transform::{Norm, distance_transform, euclidean_squared_distance_transform};

use crate::mask::{Mask, Region};

/// For each set pixel of a mask, the distance to the nearest unset pixel, px; 0 for unset pixels. Pixels outside
/// of the mask's region count as unset.
pub(crate) fn inside(mask: &Mask) -> Vec<f32> {
    let (w, h) = (mask.width() as u32, mask.height() as u32);
    // A border of one pixel stands for the outside.
    let is_set = |x: u32, y: u32| {
        let within = x > 0 && y > 0 && x <= w && y <= h;
        within && mask.row(y as usize - 1)[x as usize - 1] != 0
    };
    let squared = euclidean_squared_distance_transform(&white(w + 2, h + 2, |x, y| !is_set(x, y)));
    let at = |(x, y)| squared.get_pixel(x + 1, y + 1).0[0].sqrt() as f32;
    Region::whole(w, h).pixels().map(at).collect()
}

/// The distance of every pixel to the nearest set pixel, px; infinite when none is set.
pub(crate) fn to_set(mask: &Mask) -> Vec<f32> {
    let (w, h) = (mask.width() as u32, mask.height() as u32);
    if mask.count() == 0 {
        return vec![f32::INFINITY; mask.data().len()];
    }
    let set = white(w, h, |x, y| mask.row(y as usize)[x as usize] != 0);
    let squared = euclidean_squared_distance_transform(&set);
    squared.pixels().map(|d| d.0[0].sqrt() as f32).collect()
}

/// For each pixel of a mask, the distance to the nearest unset one in steps along rows and columns, 255 at most; what is outside of
/// its region does not count.
pub(crate) fn steps_inside(mask: &Mask) -> Vec<u8> {
    let (w, h) = (mask.width() as u32, mask.height() as u32);
    let unset = white(w, h, |x, y| mask.row(y as usize)[x as usize] == 0);
    distance_transform(&unset, Norm::L1).into_raw()
}

/// An image with the sources in white, from which the transforms measure.
fn white(w: u32, h: u32, is_source: impl Fn(u32, u32) -> bool) -> GrayImage {
    GrayImage::from_fn(w, h, |x, y| Luma([if is_source(x, y) { 255 } else { 0 }]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn distances_agree_with_brute_force(bits in proptest::collection::vec(0u8..8, 11 * 7)) {
            let mask = Mask::of(Region::whole(11, 7), bits.iter().map(|bit| *bit == 0));
            let found = to_set(&mask);
            for (i, d) in found.iter().enumerate() {
                let (x, y) = ((i % 11) as f32, (i / 11) as f32);
                let expected = (0..77)
                    .filter(|&j| mask.data()[j] != 0)
                    .map(|j| libm::hypotf((j % 11) as f32 - x, (j / 11) as f32 - y))
                    .fold(f32::INFINITY, f32::min);
                prop_assert!((d - expected).abs() < 1e-4 || *d == expected);
            }
        }
    }

    #[test]
    fn the_middle_of_a_square_is_farthest_in() {
        let mut mask = Mask::empty(Region { x: 4, y: 9, width: 9, height: 9 });
        mask.data_mut().fill(1);
        let found = inside(&mask);
        assert_eq!((found[0], found[40]), (1.0, 5.0));
        mask.data_mut().fill(0);
        assert!(inside(&mask).iter().all(|d| *d == 0.0));
    }
}
