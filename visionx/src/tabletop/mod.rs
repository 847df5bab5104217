//! Finds the table and the objects on it in a depth image: a level plane, and what rises from it; and the floor.
//!
//! No object models are needed: an object is the bounding box of its visible part, down to the table. Objects cut by
//! the image's border, such as an arm that reaches in, are left out. Without a depth image nothing is found.

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};

use crate::camera::PinholeCamera;
use crate::frame::StereoFrame;
use crate::mask::{Region, beside};
use crate::plane::{Plane, upwards};
use crate::points::{DepthPoint, DepthPoints};
use crate::providers::{PixelFormat, RawFrame};
use crate::rectangle::Rectangle;

/// Rounding of a footprint's points in the search of its smallest rectangle, m.
const CELL: f64 = 0.0002;
/// Every so many pixels the depth is sampled.
const STEP: u32 = 2;
/// Least height of a table above the root frame's floor, m.
const NO_FLOOR: f64 = 0.3;
/// The floor's largest distance from the root frame's, m; up to which depth it is looked for, m; and how far its points stray at most, m.
const FLOOR: (f64, f64, f64) = (0.15, 3.0, 0.004);
/// And the least z of its normal, a unit vector in the root frame: 6 degrees.
const LEVEL: f64 = 0.9945;
/// Least share of the points that lie on the table.
const MIN_SHARE: f64 = 0.05;
/// Lowest height of an object's points above the table, and its greatest height, m.
const RISES: (f64, f64) = (0.010, 0.50);
/// Largest distance of an object from the table's border, m.
const OVERHANG: f64 = 0.02;
/// Least step in depth between neighbours that separates two objects, m.
const DEPTH_STEP: f32 = 0.02;
/// Least number of points of an object.
const MIN_POINTS: usize = 30;
/// Share of an object's points that its height and footprint ignore at each end, against outliers in depth.
const STRAYS: f64 = 0.01;

/// A table, or another level surface.
#[derive(Clone, Debug, PartialEq)]
pub struct TableEstimate {
    /// Pose of the centre of its visible surface in the root frame of the frame's `root_from_left`; z is the
    /// surface's normal, upwards, x along the longer edge.
    pub root_from_table: Isometry3<f64>,
    /// Lengths of the visible surface along x and y, m.
    pub size: [f64; 2],
    /// Standard deviation of its points' distances from the plane, m.
    pub deviation: f64,
}

/// An object on a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableObject {
    /// Pose of its bounding box's centre in the same root frame; z is the table's normal, x along the longer edge.
    pub root_from_object: Isometry3<f64>,
    /// Edge lengths of that box, m.
    pub size: Vector3<f64>,
    /// Covariance of its centre in the root frame, m²: the pixels' width at its distance on either side, and the
    /// table's deviation.
    pub covariance: Matrix3<f64>,
    /// Its mean colour, RGB.
    pub color: [u8; 3],
    /// Bounding box in the left image.
    pub bounding_box: Region,
}

/// A table with its objects.
#[derive(Clone, Debug, PartialEq)]
pub struct Tabletop {
    /// The table.
    pub table: TableEstimate,
    /// The objects on it, largest in the image first.
    pub objects: Vec<TableObject>,
}

/// Finds a table and the objects on it in stereo frames with depth.
#[derive(Clone, Debug)]
pub struct TabletopSegmentation {
    camera: PinholeCamera,
}

impl TabletopSegmentation {
    /// A segmentation for depth images of this camera.
    pub fn new(camera: PinholeCamera) -> Self {
        Self { camera }
    }

    /// Why a frame cannot be used: it has no camera pose, so that points in the root frame are unknown, or no depth
    /// image of the camera's size. A message with a remedy, for people; `None` when it can be used.
    pub fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        if frame.root_from_camera.is_none() {
            return Some(
                "a frame that does not say where its camera is, and a table lies in the robot's root frame: give \
                 `root_from_camera` in the frame's header, or in the `calibration.yaml` of files"
                    .into(),
            );
        }
        let depth = frame.image("depth").filter(|image| {
            matches!(image.format(), PixelFormat::Depth32F | PixelFormat::Depth16)
                || image.format() == PixelFormat::Points32F && image.height() > 1
        });
        let Some(depth) = depth else {
            return Some(
                "a frame without depth, and tables are found by depth alone: give an image `depth` that lies on the \
                 left one (of files: `NAME_depth.png`, 16 bit gray, mm)"
                    .into(),
            );
        };
        let (size, wanted) = ((depth.width(), depth.height()), (self.camera.width, self.camera.height));
        (size != wanted).then(|| {
            format!(
                "a depth image of {} x {} pixels, and its camera is calibrated for {} x {}: both are of one size",
                size.0, size.1, wanted.0, wanted.1
            )
        })
    }

    /// The floor in a frame: the largest level plane about z = 0 of the root frame; `None` without a depth image of the camera's size, or
    /// without such a plane.
    pub fn floor(&self, frame: &StereoFrame) -> Option<TableEstimate> {
        let depth = self.camera.usable(frame.depth.as_ref()?)?;
        let seen = DepthPoints::of(depth, &self.camera, &frame.root_from_left, (2 * STEP, FLOOR.1));
        let wanted = |at: &Point3<f64>, normal: &Vector3<f64>| {
            upwards(normal).filter(|up| at.z.abs() < FLOOR.0 && up.z > LEVEL)
        };
        let plane = Plane::largest(&seen, &|_| true, MIN_SHARE, &wanted)?;
        let (floor, _) = visible_part(&seen, &plane)?;
        (floor.deviation < FLOOR.2).then_some(floor)
    }

    /// The table in a frame with its objects; `None` without a depth image of the camera's size, or without a level
    /// plane above floor height.
    pub fn segment(&self, frame: &StereoFrame) -> Option<Tabletop> {
        let depth = self.camera.usable(frame.depth.as_ref()?)?;
        let seen = DepthPoints::of(depth, &self.camera, &frame.root_from_left, (STEP, f64::MAX));
        let wanted = |at: &Point3<f64>, normal: &Vector3<f64>| upwards(normal).filter(|_| at.z >= NO_FLOOR);
        let plane = Plane::largest(&seen, &|_| true, MIN_SHARE, &wanted)?;
        let (table, border) = visible_part(&seen, &plane)?;
        let mut objects: Vec<(usize, TableObject)> = self
            .rising_objects(&seen, &plane, &border)
            .into_iter()
            .filter_map(|thing| Some((thing.len(), self.object(&thing, &plane, frame)?)))
            .collect();
        objects.sort_by_key(|(points, _)| std::cmp::Reverse(*points));
        Some(Tabletop { table, objects: objects.into_iter().map(|(_, object)| object).collect() })
    }

    /// The objects that rise from the table: neighbours without a step in depth belong together.
    fn rising_objects<'s>(
        &self,
        seen: &'s DepthPoints,
        plane: &Plane,
        border: &Rectangle,
    ) -> Vec<Vec<&'s DepthPoint>> {
        let [w, h] = seen.size;
        let mut rising: Vec<Option<&DepthPoint>> = vec![None; w * h];
        let rises = |s: &&DepthPoint| (RISES.0..RISES.1).contains(&plane.above(&s.at));
        for s in seen.points.iter().filter(rises).filter(|s| border.holds(&plane.flat(&s.at), OVERHANG)) {
            rising[s.place] = Some(s);
        }
        let mut rising_objects = Vec::new();
        for start in 0..rising.len() {
            let Some(first) = rising[start].take() else { continue };
            let (mut thing, mut open, mut cut) = (vec![first], vec![first], false);
            while let Some(here) = open.pop() {
                let (x, y) = (here.place % w, here.place / w);
                cut |= x == 0 || y == 0 || x + 1 == w || y + 1 == h;
                for place in beside(here.place, seen.size) {
                    let near = |next: &mut &DepthPoint| (next.depth - here.depth).abs() < DEPTH_STEP;
                    if let Some(next) = rising[place].take_if(near) {
                        thing.push(next);
                        open.push(next);
                    }
                }
            }
            if !cut && thing.len() >= MIN_POINTS {
                rising_objects.push(thing);
            }
        }
        rising_objects
    }

    fn object(&self, thing: &[&DepthPoint], plane: &Plane, frame: &StereoFrame) -> Option<TableObject> {
        let footprint: Vec<Point2<f64>> = thing.iter().map(|s| plane.flat(&s.at)).collect();
        let rectangle = Rectangle::around(&footprint, STRAYS, CELL)?;
        let mut heights: Vec<f64> = thing.iter().map(|s| plane.above(&s.at)).collect();
        heights.sort_by(f64::total_cmp);
        let height = heights[((heights.len() - 1) as f64 * (1.0 - STRAYS)) as usize];
        let distance = thing.iter().map(|s| f64::from(s.depth)).sum::<f64>() / thing.len() as f64;
        let pixel = f64::from(STEP) * distance / self.camera.focal;
        let variance = pixel * pixel / 2.0 + plane.deviation * plane.deviation;
        let w = self.camera.width / STEP;
        let pixels = || thing.iter().map(|s| (s.place as u32 % w * STEP, s.place as u32 / w * STEP));
        let mut color = [0u64; 3];
        for (x, y) in pixels() {
            (0..3).for_each(|i| color[i] += u64::from(frame.left.pixel(x, y)[i]));
        }
        let corners = pixels().map(|(x, y)| Point2::new(x.into(), y.into()));
        Some(TableObject {
            root_from_object: plane.pose(&rectangle, height / 2.0),
            size: Vector3::new(rectangle.size[0], rectangle.size[1], height),
            covariance: Matrix3::from_diagonal_element(variance),
            color: color.map(|c| (c / thing.len() as u64) as u8),
            bounding_box: Region::around(corners, 0.0, self.camera.width, self.camera.height),
        })
    }
}

/// The visible part of a plane.
fn visible_part(seen: &DepthPoints, plane: &Plane) -> Option<(TableEstimate, Rectangle)> {
    let on_it = seen.points.iter().filter(|s| plane.above(&s.at).abs() < RISES.0);
    let on_it: Vec<Point2<f64>> = on_it.map(|s| plane.flat(&s.at)).collect();
    let border = Rectangle::around(&on_it, 0.0, CELL)?;
    let root_from_table = plane.pose(&border, 0.0);
    Some((TableEstimate { root_from_table, size: border.size, deviation: plane.deviation }, border))
}

#[cfg(test)]
mod tests;
