//! The pixels that the robot's own body fills, from boxes around its parts, and images without it.

use nalgebra::{Isometry3, Point2, Vector3};

use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbImage};
use crate::mask::{Mask, Region};
use crate::outline::box_outline;
use crate::own_part::OwnPart;

/// Own parts may be beside where they are known to be by this, px, and before or behind it, m.
const MARGIN_PX: f64 = 4.0;
const MARGIN: f64 = 0.04;

/// The pixels that show the own body. `left_from_root`: of the left camera; `shift`: position of this camera along its x, m. With a depth image
/// of this camera, what is before or behind the own parts is not own.
pub(super) fn own_pixels(
    parts: &[OwnPart],
    camera: &PinholeCamera,
    (left_from_root, shift): (&Isometry3<f64>, f64),
    depth: Option<&DepthImage>,
) -> Mask {
    let (width, height) = (camera.width, camera.height);
    let mut own = Mask::empty(Region::whole(width, height));
    for part in parts {
        let left_from_box = left_from_root * part.root_from_box;
        let Some(outline) = box_outline(camera, shift, &left_from_box, &part.size) else { continue };
        let region = Region::around(outline.corners().iter().copied(), MARGIN_PX, width, height);
        for (x, y) in region.pixels() {
            let px = Point2::new(f64::from(x), f64::from(y));
            if outline.signed_distance(&px) > MARGIN_PX {
                continue;
            }
            let is_own = match depth.map(|depth| f64::from(depth.at(x, y))) {
                // Along its edges depth is often not measured.
                None | Some(0.0) => true,
                Some(depth) => {
                    let along = inside(&(camera.ray(&px)), &left_from_box, &part.size);
                    along.is_some_and(|[from, to]| (from - MARGIN..=to + MARGIN).contains(&depth))
                }
            };
            if is_own {
                own.data_mut()[(y * width + x) as usize] = 1;
            }
        }
    }
    own
}

/// From which to which multiple of a ray from the camera's centre it is in a box that is a little larger than this one.
fn inside(ray: &Vector3<f64>, left_from_box: &Isometry3<f64>, size: &Vector3<f64>) -> Option<[f64; 2]> {
    let eye = left_from_box.inverse_transform_point(&nalgebra::Point3::origin());
    let ray = left_from_box.rotation.inverse() * ray;
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let half = size[axis] / 2.0 + MARGIN;
        if ray[axis].abs() < 1e-12 {
            if eye[axis].abs() > half {
                return None;
            }
            continue;
        }
        let (a, b) = ((-half - eye[axis]) / ray[axis], (half - eye[axis]) / ray[axis]);
        (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
    }
    (from <= to).then_some([from, to])
}

/// The image with what is beside the own body in each row continued across it.
pub(super) fn without(image: &RgbImage, own: &Mask) -> RgbImage {
    let mut free = image.clone();
    let width = image.width() as usize;
    for y in 0..image.height() as usize {
        let row = own.row(y);
        let pixels = &mut free.data_mut()[3 * width * y..3 * width * (y + 1)];
        let mut x = 0;
        while x < width {
            if row[x] == 0 {
                x += 1;
                continue;
            }
            let end = (x..width).find(|&i| row[i] == 0).unwrap_or(width);
            let beside =
                |at: Option<usize>| at.map(|i| std::array::from_fn(|c| f64::from(pixels[3 * i + c])));
            let left: Option<[f64; 3]> = beside(x.checked_sub(1));
            let right: Option<[f64; 3]> = beside((end < width).then_some(end));
            let [from, to] = match (left, right) {
                (Some(left), Some(right)) => [left, right],
                (Some(one), None) | (None, Some(one)) => [one; 2],
                (None, None) => [[0.0; 3]; 2],
            };
            for i in x..end {
                let share = (i - x + 1) as f64 / (end - x + 1) as f64;
                for c in 0..3 {
                    pixels[3 * i + c] = (from[c] + (to[c] - from[c]) * share).round() as u8;
                }
            }
            x = end;
        }
    }
    free
}
