//! Follows a thing of known colour through stereo frames: segmentation by colour, a particle filter over both eyes,
//! and triangulation of the two centroids.
//!
//! The cloud of particles says where the marker can be; the images' coloured pixels about each particle's projection
//! thin it; the centroids of the coloured pixels near the cloud's mean give a measured point that corrects it. The
//! less of the marker is seen, the less the centroids are trusted. The thing is taken for round: its centroid in the
//! image is the projection of its centre. It does not measure orientation; see [`crate::ObjectLocalizer`].

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::camera::StereoCalibration;
use crate::color::ColorModel;
use crate::components::{Component, components};
use crate::frame::{Image, StereoFrame};
use crate::mask::{Mask, Region};
use crate::particles::Cloud;

/// What is known of a marker and of how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerSettings {
    /// Its colour.
    pub color: ColorModel,
    /// Its mean diameter, m, if known; otherwise it is learned while the marker is seen.
    pub diameter_m: Option<f64>,
    /// Distances along the optical axis at which it can be, m.
    pub depth_m: (f64, f64),
    /// Standard deviation of its acceleration, m/s^2.
    pub acceleration: f64,
    /// Number of particles.
    pub particles: usize,
}

/// Where a marker is.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerEstimate {
    /// Its centre in the left camera's frame, m.
    pub point_in_left: Point3<f64>,
    /// Its velocity in the left camera's frame, m/s.
    pub velocity_in_left: Vector3<f64>,
    /// Covariance of the centre, m^2.
    pub covariance: Matrix3<f64>,
    /// Its centre in the left image, px.
    pub left_px: Point2<f64>,
    /// Its centre in the right image, px.
    pub right_px: Point2<f64>,
    /// Fraction of it that is seen, 0 to 1, of the eye that sees less.
    pub visible: f64,
    /// The frame's stamp, ns.
    pub stamp_ns: u64,
}

/// Colour segmentation and a particle filter over both eyes.
#[derive(Clone, Debug)]
pub struct ColorMarkerObjectTracking {
    calibration: StereoCalibration,
    settings: MarkerSettings,
    rng: ChaCha8Rng,
    track: Option<Track>,
    /// Diameter of the disc of the same area as the marker's silhouette, m, as learned so far.
    diameter: Option<f64>,
    /// The marker's colour as seen when the track began; other things of similar colour do not have it.
    seen_color: Option<ColorModel>,
}

#[derive(Clone, Debug)]
struct Track {
    cloud: Cloud,
    root_from_left: Isometry3<f64>,
    stamp_ns: u64,
    /// When a whole measurement was made last, ns.
    measured_ns: u64,
}

/// The coloured pixels of one eye near the expected place.
struct Sight {
    /// Their centroid, px.
    center: Point2<f64>,
    /// How many.
    area: f64,
}

/// One eye's coloured pixels, to be counted in rectangles.
struct Counts {
    width: i64,
    height: i64,
    origin: (i64, i64),
    sums: Vec<u32>,
}

/// A marker that is not measured for this long is lost, ns.
const LOST_AFTER_NS: u64 = 500_000_000;
/// Below this visible fraction an eye's centroid says nothing.
const LEAST_VISIBLE: f64 = 0.12;
/// Standard deviation of a centroid of a wholly visible marker, px; measured on rendered spheres.
const CENTROID_SIGMA_PX: f64 = 0.15;
/// How near to its expected place a marker is taken for near, m.
const NEAR: f64 = 0.08;
/// What hides no more than this of a row of the marker is narrow, share of the radius in which its pixels are looked for.
const NARROW: f64 = 0.5;
/// Components smaller than this are noise, px.
const LEAST_AREA: u32 = 12;

impl MarkerSettings {
    /// A marker of this colour (RGB) and unknown size, moved by a person at arm's length.
    #[must_use]
    pub fn new(color: [u8; 3]) -> Self {
        Self {
            color: ColorModel::from_rgb(color),
            diameter_m: None,
            depth_m: (0.2, 3.0),
            acceleration: 4.0,
            particles: 300,
        }
    }

    /// The same with a known diameter, m.
    #[must_use]
    pub fn with_diameter(self, diameter_m: f64) -> Self {
        Self { diameter_m: Some(diameter_m), ..self }
    }
}

impl ColorMarkerObjectTracking {
    /// A tracker that has seen nothing yet. The same seed and frames give the same estimates.
    #[must_use]
    pub fn new(calibration: StereoCalibration, settings: MarkerSettings, seed: u64) -> Self {
        let diameter = settings.diameter_m.filter(|d| *d > 0.0 && d.is_finite());
        Self {
            calibration,
            settings,
            rng: ChaCha8Rng::seed_from_u64(seed),
            track: None,
            diameter,
            seen_color: None,
        }
    }

    /// The marker's diameter, m: as told, or as learned so far.
    #[must_use]
    pub fn diameter_m(&self) -> Option<f64> {
        self.diameter
    }

    /// Takes a frame; returns where the marker is, `None` while it is not seen.
    ///
    /// Frames whose images do not have the calibration's size are taken for black. After half a second without a
    /// measurement the marker is searched for anywhere again.
    pub fn update(&mut self, frame: &StereoFrame) -> Option<MarkerEstimate> {
        self.update_near(frame, None)
    }

    /// As [`Self::update`], for a marker that should be at a `place` (left camera frame, m): where a track begins,
    /// things of its colour are preferred the nearer they are to there, whatever else has that colour.
    pub fn update_near(
        &mut self,
        frame: &StereoFrame,
        place: Option<&Point3<f64>>,
    ) -> Option<MarkerEstimate> {
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
        let lost = |t: &Track| frame.stamp_ns - t.measured_ns > LOST_AFTER_NS;
        if self.track.as_ref().is_none_or(lost) {
            (self.track, self.seen_color) = (None, None);
            self.acquire(&self.masks(frame), frame, place)?;
            let masks = self.masks(frame);
            return self.follow(&masks, frame);
        }
        None
    }

    /// The pixels of both eyes that have the marker's colour.
    fn masks(&self, frame: &StereoFrame) -> [Mask; 2] {
        let color = self.seen_color.as_ref().unwrap_or(&self.settings.color);
        [&frame.left, &frame.right].map(|image| color.segment(image))
    }

    /// Moves the track to the frame's time and camera pose, or drops it where that makes no sense.
    fn predict(&mut self, frame: &StereoFrame) {
        let Some(track) = &mut self.track else { return };
        if frame.stamp_ns < track.stamp_ns || frame.stamp_ns - track.stamp_ns > 2 * LOST_AFTER_NS {
            self.track = None;
            return;
        }
        let dt = (frame.stamp_ns - track.stamp_ns) as f64 * 1e-9;
        track.cloud.transform(&(frame.root_from_left.inverse() * track.root_from_left));
        track.cloud.predict(dt, self.settings.acceleration, &mut self.rng);
        track.root_from_left = frame.root_from_left;
        track.stamp_ns = frame.stamp_ns;
    }

    /// Starts a track at the pair of coloured things that looks most like the marker.
    fn acquire(&mut self, masks: &[Mask; 2], frame: &StereoFrame, place: Option<&Point3<f64>>) -> Option<()> {
        // Far things keep a little, so that the one thing of the colour is found wherever it is.
        let nearness =
            |p: &Point3<f64>| place.map_or(1.0, |at| 1.0 / (1.0 + ((p - at).norm() / NEAR).powi(4)));
        let [left, right] = masks.each_ref().map(|m| components(m, LEAST_AREA));
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
        self.seen_color = Some(self.settings.color.learned(pixels(component, &frame.left)));
        if self.settings.diameter_m.is_none() {
            self.diameter = Some(diameter);
        }
        let spread = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 4e-4));
        let cloud = Cloud::around(&point, &spread, 0.3, self.settings.particles, &mut self.rng);
        let stamp_ns = frame.stamp_ns;
        self.track =
            Some(Track { cloud, root_from_left: frame.root_from_left, stamp_ns, measured_ns: stamp_ns });
        Some(())
    }

    /// Where a pair of components would be, how much it looks like the marker, and its diameter, m.
    fn candidate(&self, l: &Component, r: &Component, image: &Image) -> Option<(Point3<f64>, f64, f64)> {
        let height = f64::from(l.bounds.height.max(r.bounds.height));
        let (small, large) = (f64::from(l.area.min(r.area)), f64::from(l.area.max(r.area)));
        if (l.centroid.y - r.centroid.y).abs() > 2.0 + 0.15 * height || small < 0.5 * large {
            return None;
        }
        let point = self.calibration.triangulate(&l.centroid, &r.centroid)?;
        if !(self.settings.depth_m.0..=self.settings.depth_m.1).contains(&point.z) {
            return None;
        }
        let diameter = disc_diameter((small + large) / 2.0) * point.z / self.calibration.camera.focal;
        let size_fit = match self.diameter {
            Some(expected) if !(0.4..2.5).contains(&(diameter / expected)) => return None,
            Some(expected) => (-2.0 * (diameter / expected).ln().powi(2)).exp(),
            None => (diameter / 0.08).min(1.0),
        };
        let colour_fit = (-0.5 * (self.settings.color.angle(mean_color(l, image)) / 0.05).powi(2)).exp();
        Some((point, size_fit * colour_fit, diameter))
    }

    /// Corrects the track by the coloured pixels about it; `None` when there are none.
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
        let seen = [0, 1].map(|eye| {
            let shift = [0.0, calibration.baseline][eye];
            calibration
                .camera
                .project_shifted(&mean, shift)
                .and_then(|at| centroid(&masks[eye], at, radius_px))
        });
        let visible = seen.each_ref().map(|s| s.as_ref().map_or(0.0, |s| (s.area / expected).min(1.0)));
        self.correct(&seen, visible, radius_px, frame.stamp_ns)
    }

    /// The measurement from what both eyes have seen; with one eye only, a point on its ray.
    fn correct(
        &mut self,
        seen: &[Option<Sight>; 2],
        visible: [f64; 2],
        radius_px: f64,
        stamp_ns: u64,
    ) -> Option<MarkerEstimate> {
        let track = self.track.as_mut()?;
        let calibration = &self.calibration;
        let (predicted, _) = track.cloud.mean();
        let good = visible.map(|v| v >= LEAST_VISIBLE);
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
        let (point, velocity) = track.cloud.mean();
        // What is not a ball has its centroid beside its centre's projection, always to the same side.
        let shape =
            if self.settings.diameter_m.is_some() { 0.01 } else { 0.03 } * self.diameter.unwrap_or(0.0);
        let covariance = track.cloud.covariance() + Matrix3::identity() * (shape * shape);
        if whole && self.settings.diameter_m.is_none() {
            self.learn_diameter(seen, point.z);
        }
        let project = |shift| self.calibration.camera.project_shifted(&point, shift);
        Some(MarkerEstimate {
            point_in_left: point,
            velocity_in_left: velocity,
            covariance,
            left_px: project(0.0)?,
            right_px: project(self.calibration.baseline)?,
            visible: visible[0].min(visible[1]),
            stamp_ns,
        })
    }

    /// Grows quickly to what is seen and shrinks slowly, because what hides a part of the marker goes away again. Only
    /// slowly does it become much larger, because that may be another thing beside it.
    fn learn_diameter(&mut self, seen: &[Option<Sight>; 2], depth: f64) {
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

/// A point on the ray of one eye at the predicted depth, with a covariance that is wide along the ray.
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

/// How likely the images are when the marker is at `point`: coloured inside its disc, and not around it.
fn likelihood(
    point: &Point3<f64>,
    counts: &[Counts; 2],
    calibration: &StereoCalibration,
    diameter: f64,
) -> f64 {
    let mut sum = 0.0;
    for (eye, shift) in counts.iter().zip([0.0, calibration.baseline]) {
        let Some(at) = calibration.camera.project_shifted(point, shift) else { return 0.0 };
        let radius = 0.5 * diameter * calibration.camera.focal / point.z;
        // The square inside the disc is full, the frame around the disc's square is empty.
        let inner = eye.density(&at, 0.7 * radius);
        let (outer, square) = (eye.sum(&at, 1.5 * radius), eye.sum(&at, radius));
        let ring = (outer.0 - square.0) / (outer.1 - square.1).max(1.0);
        sum += inner - 0.5 * ring;
    }
    (4.0 * sum).exp()
}

/// The centroid of the coloured pixels about `at`, by mean shift with a disc that is wider than the marker.
fn centroid(mask: &Mask, mut at: Point2<f64>, radius_px: f64) -> Option<Sight> {
    let reach = 1.4 * radius_px + 2.0;
    let mut sight = None;
    for _ in 0..6 {
        let next = disc_mean(mask, &at, reach)?;
        let moved = (next.center - at).norm();
        at = next.center;
        sight = Some(next);
        if moved < 0.02 {
            break;
        }
    }
    sight
}

/// Centroid and area of the coloured pixels of a disc of `reach` px. What is not coloured between coloured pixels of a row
/// is something narrow in front of the marker, such as its handle, and counts as the marker.
fn disc_mean(mask: &Mask, at: &Point2<f64>, reach: f64) -> Option<Sight> {
    let region = mask.region();
    let (w, h) = (region.x + region.width, region.y + region.height);
    let part = Region::spanning(at.x - reach, at.y - reach, at.x + reach, at.y + reach, w, h);
    let narrow = NARROW * reach;
    let (mut n, mut sx, mut sy) = (0.0, 0.0, 0.0);
    for y in part.y.max(region.y)..part.y + part.height {
        let dy = f64::from(y) - at.y;
        let half = (reach * reach - dy * dy).max(0.0).sqrt();
        let x0 = ((at.x - half).ceil().max(f64::from(region.x))) as u32;
        let x1 = ((at.x + half).floor().min(f64::from(w) - 1.0)).max(-1.0) as i64;
        let row = mask.row((y - region.y) as usize);
        let mut end = None;
        for x in (x0..u32::try_from(x1 + 1).unwrap_or(0)).filter(|x| row[(x - region.x) as usize] != 0) {
            let from = end.filter(|&end| f64::from(x - end) <= narrow).unwrap_or(x);
            let count = f64::from(x + 1 - from);
            n += count;
            sx += count * f64::from(from + x) / 2.0;
            sy += count * f64::from(y);
            end = Some(x + 1);
        }
    }
    (n > 0.0).then(|| Sight { center: Point2::new(sx / n, sy / n), area: n })
}

fn pixels<'a>(component: &'a Component, image: &'a Image) -> impl Iterator<Item = [u8; 3]> + Clone + 'a {
    component.runs.iter().flat_map(move |run| (run.x0..run.x1).map(move |x| image.pixel(x, run.y)))
}

fn mean_color(component: &Component, image: &Image) -> [f64; 3] {
    let mut sum = [0.0; 3];
    pixels(component, image).for_each(|p| (0..3).for_each(|i| sum[i] += f64::from(p[i])));
    sum.map(|s| s / f64::from(component.area.max(1)))
}

impl Counts {
    /// Sums over the square of half width `reach` px about `at`, clipped to the mask.
    fn about(mask: &Mask, at: &Point2<f64>, reach: f64) -> Self {
        let whole = mask.region();
        let region = Region::spanning(
            at.x - reach,
            at.y - reach,
            at.x + reach,
            at.y + reach,
            whole.width,
            whole.height,
        );
        let (w, h) = (region.width as usize, region.height as usize);
        let mut sums = vec![0; (w + 1) * (h + 1)];
        for y in 0..h {
            let row = &mask.row(region.y as usize + y)[region.x as usize..][..w];
            let mut run = 0;
            for (x, v) in row.iter().enumerate() {
                run += u32::from(*v);
                sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + run;
            }
        }
        Self { width: w as i64, height: h as i64, origin: (i64::from(region.x), i64::from(region.y)), sums }
    }

    /// Coloured pixels in the square of half width `half` about `at`, and the square's pixels in all. Outside of
    /// the counted part nothing is coloured.
    fn sum(&self, at: &Point2<f64>, half: f64) -> (f64, f64) {
        let clip =
            |v: f64, origin: i64, end: i64| (v.round() as i64).saturating_sub(origin).clamp(0, end) as usize;
        let (x0, x1) =
            (clip(at.x - half, self.origin.0, self.width), clip(at.x + half, self.origin.0, self.width));
        let (y0, y1) =
            (clip(at.y - half, self.origin.1, self.height), clip(at.y + half, self.origin.1, self.height));
        let w = self.width as usize + 1;
        let inside = self.sums[y1 * w + x1] + self.sums[y0 * w + x0];
        let outside = self.sums[y0 * w + x1] + self.sums[y1 * w + x0];
        (f64::from(inside - outside), (2.0 * half).powi(2))
    }

    fn density(&self, at: &Point2<f64>, half: f64) -> f64 {
        let (coloured, all) = self.sum(at, half);
        (coloured / all.max(1.0)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, TABLE, Thing, empty_frames, frame, root_from_left, table};

    const GREEN: [u8; 3] = [40, 170, 60];

    fn ball(center: Point3<f64>, radius: f64, color: [u8; 3]) -> Thing {
        Thing::Ball { center, radius, color }
    }

    /// A tool on a circle, half a turn a second.
    fn path(i: u64) -> Point3<f64> {
        let angle = std::f64::consts::PI * i as f64 / 15.0;
        Point3::new(0.28 + 0.06 * angle.sin(), 0.53 + 0.05 * angle.cos(), 1.05)
    }

    fn stamp(i: u64) -> u64 {
        i * 66_666_667
    }

    fn tracker() -> ColorMarkerObjectTracking {
        ColorMarkerObjectTracking::new(CALIBRATION, MarkerSettings::new(GREEN), 1)
    }

    fn error(estimate: &MarkerEstimate, truth: &Point3<f64>) -> Vector3<f64> {
        estimate.point_in_left - root_from_left().inverse() * truth
    }

    #[test]
    fn follows_a_tool_past_a_thing_of_similar_colour() {
        let mut tracker = tracker();
        let mut squares = Vector3::zeros();
        for i in 0..30 {
            let other = ball(Point3::new(0.40, 0.53, 1.0), 0.033, [60, 175, 50]);
            let scene = [table(TABLE), ball(path(i), 0.03, GREEN), other];
            let estimate = tracker.update(&frame(&scene, stamp(i), i)).unwrap();
            let e = error(&estimate, &path(i));
            squares += e.component_mul(&e) / 30.0;
            assert!(estimate.visible > 0.9);
        }
        let rms = squares.map(f64::sqrt);
        assert!(rms.x < 0.003 && rms.y < 0.003 && rms.z < 0.008, "{rms}");
    }

    #[test]
    fn half_hidden_it_is_less_sure() {
        let mut tracker = tracker();
        let mut before = 0.0;
        for i in 0..12 {
            let at = path(i);
            let mut scene = vec![table(TABLE), ball(at, 0.03, GREEN)];
            if i > 6 {
                let toward = root_from_left().translation.vector - at.coords;
                let screen = at + toward.normalize() * 0.06 + root_from_left() * Vector3::new(0.05, 0.0, 0.0);
                scene.push(ball(screen, 0.05, [120, 120, 120]));
            }
            let estimate = tracker.update(&frame(&scene, stamp(i), i)).unwrap();
            let e = error(&estimate, &at);
            if i <= 6 {
                before = estimate.covariance.trace();
            } else {
                assert!(estimate.visible < 0.8 && estimate.covariance.trace() > 3.0 * before, "{estimate:?}");
                assert!(e.norm() < 0.03);
                let distance = e.dot(&(estimate.covariance.try_inverse().unwrap() * e));
                assert!(distance < 16.0, "{distance}");
            }
        }
    }

    #[test]
    fn a_lost_marker_is_found_again_elsewhere() {
        let mut tracker = tracker();
        let nothing = [table(TABLE)];
        for i in 0..40 {
            let at = if i < 5 { path(0) } else { Point3::new(0.1, 0.6, 1.0) };
            let hidden = (5..20).contains(&i);
            let scene = [table(TABLE), ball(at, 0.03, GREEN)];
            let seen = tracker.update(&frame(if hidden { &nothing } else { &scene }, stamp(i), i));
            assert_eq!(seen.is_none(), hidden, "frame {i}");
            if let Some(estimate) = seen {
                assert!(error(&estimate, &at).norm() < 0.02, "frame {i}");
            }
        }
    }

    #[test]
    fn what_is_where_it_should_be_is_preferred() {
        let small = Point3::new(0.20, 0.50, 1.0);
        let scene =
            [table(TABLE), ball(small, 0.012, GREEN), ball(Point3::new(0.45, 0.60, 1.0), 0.05, GREEN)];
        let frame = frame(&scene, 0, 1);
        let anywhere = tracker().update(&frame).unwrap();
        assert!(error(&anywhere, &small).norm() > 0.2);
        let place = root_from_left().inverse() * (small + Vector3::new(0.02, -0.02, 0.02));
        let there = tracker().update_near(&frame, Some(&place)).unwrap();
        assert!(error(&there, &small).norm() < 0.01, "{there:?}");
        let elsewhere = root_from_left().inverse() * Point3::new(-0.2, 0.5, 1.0);
        assert!(tracker().update_near(&frame, Some(&elsewhere)).is_some());
    }

    #[test]
    fn nothing_is_seen_where_nothing_is() {
        let mut tracker = tracker();
        for frame in empty_frames() {
            assert_eq!(tracker.update(&frame), None);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_track() {
        let run = || {
            let mut tracker = tracker();
            (0..4)
                .map(|i| tracker.update(&frame(&[ball(path(i), 0.03, GREEN)], stamp(i), i)))
                .collect::<Vec<_>>()
        };
        assert_eq!(run(), run());
    }
}
