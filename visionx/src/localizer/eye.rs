//! What one eye shows of a thing of known colour: its pixels, its border, and what is around it.
//!
//! Other things, as the robot's own arms, come before it, and may be nearly of its hue. So its colour is taken from what most of a piece
//! shows, and of its border only what leads to its surroundings. It knows no shape and no pose.

use nalgebra::Point2;

use crate::color::{ColorModel, median_color};
use crate::components::{Component, components, fill_holes};
use crate::frame::{RgbImage, StereoFrame};
use crate::mask::Mask;
use crate::outline::{BorderPoint, RowSums, border_points};

/// Components smaller than this are noise, px.
const MIN_AREA: u32 = 40;
/// So far outside of its border an object's colour may be mixed with that of its surroundings, px.
const MIXED_PX: i64 = 3;
/// A hue that is further than this from another one is certainly another, rad.
const OTHER_HUE: f64 = 0.2;
/// Where less than this share of its border is one to the surroundings, these have many colours.
const LEAST_OWN: f64 = 0.3;

/// The observation of a candidate in one image.
pub(super) struct Eye {
    pub(super) object: RowSums,
    pub(super) surroundings: RowSums,
    /// Pixels of the object's colour.
    pub(super) area: f64,
    /// The border of the coloured region, px.
    pub(super) border: Vec<Point2<f64>>,
    /// The centroid of the component that it was looked for around, px.
    pub(super) center: Point2<f64>,
}

impl Eye {
    /// The observation around a component: the component with the pieces near it, and the surroundings. `color`: that of the object;
    /// `radius_px`: its largest radius.
    pub(super) fn of(
        color: &ColorModel,
        seed: &Component,
        all: &[Component],
        image: &RgbImage,
        radius_px: f64,
    ) -> Self {
        let (w, h) = (image.width(), image.height());
        let border = (radius_px * 1.2).min(400.0) as u32 + 4;
        let mut object = seed.mask(border, w, h);
        for piece in all.iter().filter(|c| (c.centroid - seed.centroid).norm() < 1.2 * radius_px) {
            object.add(&piece.runs);
        }
        let (surroundings, area) = (RowSums::of(&surroundings(image, &object)), object.count() as f64);
        let sums = RowSums::of(&object);
        // What is inside, pixels of noise or things that stand on it, is no border of it.
        fill_holes(&mut object, u32::MAX);
        let border = own_border(&border_points(&object, w, h), color, image);
        Self { area, border, center: seed.centroid, surroundings, object: sums }
    }
}

/// The components of a colour, largest first.
pub(super) fn pieces_of(color: &ColorModel, image: &RgbImage) -> Vec<Component> {
    components(&color.segment(image), MIN_AREA)
}

/// The components of both images that have the colour of one of the left image, `shown`, as it is seen there: in the left one that at its
/// place first, all others by size. What has a similar colour is not taken for a part of it.
pub(super) fn pieces_like(color: &ColorModel, shown: &Component, frame: &StereoFrame) -> [Vec<Component>; 2] {
    let color = color.learned_from_most(shown.colors(&frame.left));
    let [mut left, right] = [&frame.left, &frame.right].map(|image| pieces_of(&color, image));
    let away = |piece: &Component| (piece.centroid - shown.centroid).norm();
    if let Some(at) = (0..left.len()).min_by(|a, b| away(&left[*a]).total_cmp(&away(&left[*b]))) {
        left[..=at].rotate_right(1);
    }
    [left, right]
}

/// The border of an object of this colour to what is around most of it, without that to what hides it. All of it where that is nearly all,
/// as where the surroundings have many colours.
fn own_border(border: &[BorderPoint], color: &ColorModel, image: &RgbImage) -> Vec<Point2<f64>> {
    let outside = border.iter().map(|point| point.outside(image, MIXED_PX));
    // Where what is beside it is nearly of its hue, its border is not sure.
    let other = outside.clone().filter(|pixel| color.angle(pixel.map(f64::from)) > OTHER_HUE);
    let around = ColorModel::from_rgb(median_color(other));
    let points = || border.iter().map(|point| point.at);
    let own: Vec<Point2<f64>> =
        points().zip(outside).filter(|(_, pixel)| around.accepts(*pixel)).map(|(at, _)| at).collect();
    if own.len() as f64 > LEAST_OWN * border.len() as f64 { own } else { points().collect() }
}

/// The pixels with the surroundings' colour: the median colour of the mask's region without the object.
fn surroundings(image: &RgbImage, object: &Mask) -> Mask {
    let region = object.region();
    let outside = region.pixels().zip(object.data()).filter(|(_, bit)| **bit == 0);
    let color = median_color(outside.map(|((x, y), _)| image.pixel(x, y)));
    let mut mask = ColorModel::from_rgb(color).segment_region(image, region);
    for (m, o) in mask.data_mut().iter_mut().zip(object.data()) {
        *m &= 1 - o;
    }
    mask
}
