//! The Euclidean distance transform, from `imageproc`, for masks.

use image::{GrayImage, Luma};
use imageproc::distance_transform::euclidean_squared_distance_transform;

use crate::mask::Mask;

/// For each pixel of a mask that is set, the distance of the nearest that is not, px; 0 for the others. What lies
/// outside of the mask's region counts as not set.
pub(super) fn inside(mask: &Mask) -> Vec<f32> {
    let (w, h) = (mask.width() as u32, mask.height() as u32);
    // The transform measures from white pixels; a frame of one pixel is the outside.
    let white = |x: u32, y: u32| {
        let within = x > 0 && y > 0 && x <= w && y <= h;
        !within || mask.row(y as usize - 1)[x as usize - 1] == 0
    };
    let framed = GrayImage::from_fn(w + 2, h + 2, |x, y| Luma([if white(x, y) { 255 } else { 0 }]));
    let squared = euclidean_squared_distance_transform(&framed);
    let at = |x: u32, y: u32| squared.get_pixel(x + 1, y + 1).0[0].sqrt() as f32;
    (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::Region;

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
