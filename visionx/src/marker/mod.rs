//! Tracks an object of known colour in stereo frames: segmentation by colour, a particle filter over both images,
//! and triangulation of the two centroids.
//!
//! The cloud of particles represents the marker's possible positions. The coloured pixels around each particle's
//! projection weight it. The centroids of the coloured pixels near the cloud's mean give a measured point that
//! corrects the cloud; the less of the marker is visible, the less weight they get. The object is assumed to be
//! round, or a level box: then its centroid in the image tells the projection of its centre. Orientation is not measured;
//! see [`crate::ObjectLocalizer`].

mod measurement;
#[cfg(test)]
mod tests;

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use nalgebra::{Isometry3, Matrix3, Point2, Point3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::camera::StereoCalibration;
use crate::color::ColorModel;
use crate::components::{Component, components};
use crate::frame::{RgbImage, StereoFrame};
use crate::mask::Mask;
use crate::outline::box_outline;
use crate::particles::Cloud;
use measurement::{Blob, Counts, centroid, likelihood};

/// The state of a marker.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerEstimate {
    /// Its centre in the left camera's frame, m.
    pub point_in_left: Point3<f64>,
    /// Covariance of the centre, m^2.
    pub covariance: Matrix3<f64>,
    /// Its centre in the left image, px.
    pub left_px: Point2<f64>,
    /// Visible fraction, 0 to 1, of the image that shows less.
    pub visible: f64,
}

/// Colour segmentation and a particle filter over both eyes.
#[derive(Clone, Debug)]
pub struct ColorMarkerObjectTracking {
    calibration: StereoCalibration,
    color: ColorModel,
    rng: ChaCha8Rng,
    track: Option<MarkerTrack>,
    /// Diameter of a disc with the area of the marker's silhouette, m: given, or as learned so far.
    diameter: Option<f64>,
    /// Whether the diameter is learned.
    learns_diameter: bool,
    /// The marker's colour as observed when the track began, to reject other objects of similar colour.
    seen_color: Option<ColorModel>,
    /// Edge lengths of what is a level box, m.
    level_box: Option<Vector3<f64>>,
}

#[derive(Clone, Debug)]
struct MarkerTrack {
    cloud: Cloud,
    root_from_left: Isometry3<f64>,
    stamp_ns: u64,
    /// Time of the last complete measurement, ns.
    measured_ns: u64,
}

/// A marker without a measurement for this long is lost, ns.
const LOST_AFTER_NS: u64 = 500_000_000;
/// Visible fraction below which an image's centroid is not used.
const MIN_VISIBLE: f64 = 0.12;
/// Standard deviation of a fully visible marker's centroid, px; measured on rendered spheres.
const CENTROID_SIGMA_PX: f64 = 0.15;
/// Scale of the distance from the expected position at which candidates are preferred, m.
const NEAR: f64 = 0.08;
/// Components smaller than this are noise, px.
const MIN_AREA: u32 = 12;
/// Range of a marker's depth along the optical axis, m: a person holds it at arm's length.
const DEPTHS: RangeInclusive<f64> = 0.2..=3.0;
/// Standard deviation of its acceleration, m/s^2.
const ACCELERATION: f64 = 4.0;
/// Turns about the vertical, evenly over half a turn, over which a level box is averaged.
const TURNS: usize = 8;
/// Number of particles.
const PARTICLES: usize = 300;

impl ColorMarkerObjectTracking {
    /// A tracker without a track of a marker of this colour (RGB) and mean diameter, m; `None`: learned while the marker is visible. The
    /// same seed and frames give the same estimates.
    pub fn new(calibration: StereoCalibration, color: [u8; 3], diameter: Option<f64>, seed: u64) -> Self {
        Self {
            calibration,
            color: ColorModel::from_rgb(color),
            rng: ChaCha8Rng::seed_from_u64(seed),
            track: None,
            diameter: diameter.filter(|d| *d > 0.0 && d.is_finite()),
            learns_diameter: diameter.is_none(),
            seen_color: None,
            level_box: None,
        }
    }

    /// The same for a box of these edge lengths along its own x, y, z, m, whose z is held upright. Of its silhouette the near part is the
    /// larger, so that the centroid lies on the near side of the centre, by millimetres; that is taken off, as a mean over all turns about
    /// z.
    #[must_use]
    pub fn of_level_box(self, size: impl Into<Vector3<f64>>) -> Self {
        Self { level_box: Some(size.into()), ..self }
    }

    /// From the centre of a level box of edge lengths `size` (m) at `point` to the point that the centroids of its silhouettes tell, both
    /// in the left camera's frame, m; the mean over [`TURNS`] turns.
    fn perspective_shift(
        &self,
        size: &Vector3<f64>,
        point: &Point3<f64>,
        left_from_root: &UnitQuaternion<f64>,
    ) -> Option<Vector3<f64>> {
        let calibration = &self.calibration;
        let mut sum = Vector3::zeros();
        for turn in 0..TURNS {
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI * turn as f64 / TURNS as f64);
            let left_from_box = Isometry3::from_parts(point.coords.into(), left_from_root * yaw);
            let centroid =
                |shift| Some(box_outline(&calibration.camera, shift, &left_from_box, size)?.centroid());
            let seen = calibration.triangulate(&centroid(0.0)?, &centroid(calibration.baseline)?)?;
            sum += (seen - point) / TURNS as f64;
        }
        Some(sum)
    }

    /// Processes a frame; returns the marker's state, `None` while it is not visible. Where it is expected at a `place` (left camera
    /// frame, m), candidates of its colour are preferred by their distance to that place when a track begins.
    ///
    /// Images that do not have the calibration's size count as black. After half a second without a measurement
    /// the whole image is searched again.
    pub fn update(&mut self, frame: &StereoFrame, place: Option<&Point3<f64>>) -> Option<MarkerEstimate> {
        let mut estimate = self.centroids(frame, place)?;
        let left_from_root = frame.root_from_left.rotation.inverse();
        let shift = self
            .level_box
            .and_then(|size| self.perspective_shift(&size, &estimate.point_in_left, &left_from_root));
        estimate.point_in_left -= shift.unwrap_or_default();
        Some(estimate)
    }

    /// The state by the centroids of its silhouettes.
    fn centroids(&mut self, frame: &StereoFrame, place: Option<&Point3<f64>>) -> Option<MarkerEstimate> {
        if !self.calibration.fits(frame) {
            return None;
        }
        self.predict(frame);
        if self.track.is_some() {
            let masks = self.masks(frame);
            if let Some(estimate) = self.follow(&masks, frame) {
                return Some(estimate);
            }
        }
        let lost = |t: &MarkerTrack| frame.stamp_ns - t.measured_ns > LOST_AFTER_NS;
        if self.track.as_ref().is_none_or(lost) {
            (self.track, self.seen_color) = (None, None);
            self.acquire(&self.masks(frame), frame, place)?;
            let masks = self.masks(frame);
            return self.follow(&masks, frame);
        }
        None
    }

    /// The pixels of both images that have the marker's colour.
    fn masks(&self, frame: &StereoFrame) -> [Mask; 2] {
        let color = self.seen_color.as_ref().unwrap_or(&self.color);
        [&frame.left, &frame.right].map(|image| color.segment(image))
    }

    /// Predicts the track to the frame's time and camera pose, or drops it where that is impossible.
    fn predict(&mut self, frame: &StereoFrame) {
        let Some(track) = &mut self.track else { return };
        if frame.stamp_ns < track.stamp_ns || frame.stamp_ns - track.stamp_ns > 2 * LOST_AFTER_NS {
            self.track = None;
            return;
        }
        let dt = (frame.stamp_ns - track.stamp_ns) as f64 * 1e-9;
        track.cloud.transform(&(frame.root_from_left.inverse() * track.root_from_left));
        track.cloud.predict(dt, ACCELERATION, &mut self.rng);
        track.root_from_left = frame.root_from_left;
        track.stamp_ns = frame.stamp_ns;
    }

    /// Starts a track at the pair of coloured components that fits the marker best.
    fn acquire(&mut self, masks: &[Mask; 2], frame: &StereoFrame, place: Option<&Point3<f64>>) -> Option<()> {
        // Distant candidates keep a small weight, so that a single candidate is found wherever it is.
        let nearness =
            |p: &Point3<f64>| place.map_or(1.0, |at| 1.0 / (1.0 + ((p - at).norm() / NEAR).powi(4)));
        let [left, right] = masks.each_ref().map(|m| components(m, MIN_AREA));
        let mut best: Option<(f64, Point3<f64>, f64, &Component)> = None;
        for l in left.iter().take(12) {
            for r in right.iter().take(12) {
                let Some((point, score, diameter)) = self.candidate(l, r, &frame.left) else { continue };
                let score = score * nearness(&point);
                if best.as_ref().is_none_or(|b| score > b.0) {
                    best = Some((score, point, diameter, l));
                }
            }
        }
        let (_, point, diameter, component) = best?;
        self.seen_color = Some(self.color.learned(component.colors(&frame.left)));
        if self.learns_diameter {
            self.diameter = Some(diameter);
        }
        let spread = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 4e-4));
        let cloud = Cloud::around(&point, &spread, 0.3, PARTICLES, &mut self.rng);
        let stamp_ns = frame.stamp_ns;
        self.track = Some(MarkerTrack {
            cloud,
            root_from_left: frame.root_from_left,
            stamp_ns,
            measured_ns: stamp_ns,
        });
        Some(())
    }

    /// The position of a pair of components, how well it fits the marker, and its diameter, m.
    fn candidate(&self, l: &Component, r: &Component, image: &RgbImage) -> Option<(Point3<f64>, f64, f64)> {
        let height = f64::from(l.bounds.height.max(r.bounds.height));
        let (small, large) = (f64::from(l.area.min(r.area)), f64::from(l.area.max(r.area)));
        if (l.centroid.y - r.centroid.y).abs() > 2.0 + 0.15 * height || small < 0.5 * large {
            return None;
        }
        let point = self.calibration.triangulate(&l.centroid, &r.centroid)?;
        if !DEPTHS.contains(&point.z) {
            return None;
        }
        let diameter = disc_diameter((small + large) / 2.0) * point.z / self.calibration.camera.focal;
        let size_fit = match self.diameter {
            Some(expected) if !(0.4..2.5).contains(&(diameter / expected)) => return None,
            Some(expected) => libm::exp(-2.0 * libm::log(diameter / expected).powi(2)),
            None => (diameter / 0.08).min(1.0),
        };
        let colour_fit = libm::exp(-0.5 * (self.color.angle(mean_color(l, image)) / 0.05).powi(2));
        Some((point, size_fit * colour_fit, diameter))
    }

    /// Corrects the track by the coloured pixels near it; `None` when there are none.
    fn follow(&mut self, masks: &[Mask; 2], frame: &StereoFrame) -> Option<MarkerEstimate> {
        let track = self.track.as_mut()?;
        let diameter = self.diameter?;
        let calibration = &self.calibration;
        let (mean, _) = track.cloud.mean();
        let radius_px = 0.5 * diameter * calibration.camera.focal / mean.z.max(0.1);
        let sigma = track.cloud.covariance().trace().max(0.0).sqrt();
        let reach = 2.0 * radius_px + 3.0 * sigma * calibration.camera.focal / mean.z.max(0.1) + 4.0;
        let eyes = [0.0, calibration.baseline].map(|shift| calibration.camera.project_shifted(&mean, shift));
        let [Some(left_at), Some(right_at)] = eyes else { return None };
        let counts =
            [(&masks[0], left_at), (&masks[1], right_at)].map(|(m, at)| Counts::about(m, &at, reach));
        track.cloud.resample(|p| likelihood(p, &counts, calibration, diameter), &mut self.rng);

        let (mean, _) = track.cloud.mean();
        let radius_px = 0.5 * diameter * calibration.camera.focal / mean.z.max(0.1);
        let expected = std::f64::consts::PI * radius_px * radius_px;
        let seen = [(&masks[0], 0.0), (&masks[1], calibration.baseline)].map(|(mask, shift)| {
            let at = calibration.camera.project_shifted(&mean, shift)?;
            centroid(mask, at, radius_px)
        });
        let visible = seen.each_ref().map(|s| s.as_ref().map_or(0.0, |s| (s.area / expected).min(1.0)));
        self.correct(&seen, visible, radius_px, frame.stamp_ns)
    }

    /// The measurement from both images; with one image only, a point on its ray.
    fn correct(
        &mut self,
        seen: &[Option<Blob>; 2],
        visible: [f64; 2],
        radius_px: f64,
        stamp_ns: u64,
    ) -> Option<MarkerEstimate> {
        let track = self.track.as_mut()?;
        let calibration = &self.calibration;
        let (predicted, _) = track.cloud.mean();
        let good = visible.map(|v| v >= MIN_VISIBLE);
        let sigma = visible.map(|v| {
            (CENTROID_SIGMA_PX.powi(2) + ((1.0 - v - 0.05).max(0.0) * 0.6 * radius_px).powi(2)).sqrt()
        });
        let (point, covariance, whole) = match (seen, good) {
            ([Some(l), Some(r)], [true, true]) if (l.center.y - r.center.y).abs() < 2.0 + radius_px => {
                let point = calibration.triangulate(&l.center, &r.center)?;
                (point, calibration.covariance(&point, sigma), true)
            }
            ([Some(s), _], [true, false]) => one_eye(calibration, &s.center, 0.0, &predicted, sigma[0])?,
            ([_, Some(s)], [false, true]) => {
                one_eye(calibration, &s.center, calibration.baseline, &predicted, sigma[1])?
            }
            _ => return None,
        };
        track.cloud.correct(&point, &covariance, &mut self.rng);
        if whole {
            track.measured_ns = stamp_ns;
        }
        let (point, _) = track.cloud.mean();
        // The centroid of an object that is no ball lies off its centre's projection, always to the same side.
        let shape = if self.learns_diameter { 0.03 } else { 0.01 } * self.diameter.unwrap_or(0.0);
        let covariance = track.cloud.covariance() + Matrix3::identity() * (shape * shape);
        if whole && self.learns_diameter {
            self.learn_diameter(seen, point.z);
        }
        Some(MarkerEstimate {
            point_in_left: point,
            covariance,
            left_px: self.calibration.camera.project(&point)?,
            visible: visible[0].min(visible[1]),
        })
    }

    /// Grows quickly and shrinks slowly, because an occlusion of the marker is temporary. A much larger size is
    /// learned only slowly, because it may come from another object beside the marker.
    fn learn_diameter(&mut self, seen: &[Option<Blob>; 2], depth: f64) {
        let area = seen.iter().flatten().map(|s| s.area).fold(0.0, f64::max);
        let now = disc_diameter(area) * depth / self.calibration.camera.focal;
        if let Some(d) = &mut self.diameter {
            let rate = if (*d..1.15 * *d).contains(&now) { 0.2 } else { 0.02 };
            *d += (now - *d) * rate;
        }
    }
}

fn disc_diameter(area: f64) -> f64 {
    2.0 * (area / std::f64::consts::PI).sqrt()
}

/// A point on the ray of one camera at the predicted depth, with a covariance that is large along the ray.
fn one_eye(
    calibration: &StereoCalibration,
    px: &Point2<f64>,
    shift: f64,
    predicted: &Point3<f64>,
    sigma_px: f64,
) -> Option<(Point3<f64>, Matrix3<f64>, bool)> {
    let camera = &calibration.camera;
    let z = predicted.z;
    let ray = camera.ray(px);
    let point = Point3::new(ray.x * z + shift, ray.y * z, z);
    let across = (sigma_px * z / camera.focal).powi(2);
    let along = ray.normalize();
    (z > 0.0).then(|| (point, Matrix3::identity() * across + along * along.transpose() * 0.01, false))
}

fn mean_color(component: &Component, image: &RgbImage) -> [f64; 3] {
    let mut sum = [0.0; 3];
    component.colors(image).for_each(|p| (0..3).for_each(|i| sum[i] += f64::from(p[i])));
    sum.map(|s| s / f64::from(component.area.max(1)))
}
