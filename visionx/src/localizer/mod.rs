//! The pose of a box of known colour and size that lies on a surface of known tilt, by analysis by synthesis.
//!
//! Pairs of coloured components of both images give the starting points. For each, the box's silhouette is projected
//! into both images and its x, y, z and yaw are searched: all yaws coarsely, the best ones by a simplex, then
//! Gauss-Newton on the distances of the coloured region's border from the silhouette. Pixels inside the silhouette that
//! have the surroundings' colour contradict a pose. Pixels of any other colour may belong to something in front of the
//! box; they only lower the visible fraction. Roll and pitch are those of the surface, which is level where nothing else is
//! said. What the images show of the box's colour is in [`eye`].

mod eye;

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Matrix6, Point2, Point3, SMatrix, SVector, Translation3, UnitQuaternion,
    Vector3, Vector4, Vector6,
};

use crate::camera::{PinholeCamera, StereoCalibration};
use crate::color::ColorModel;
use crate::components::Component;
use crate::frame::StereoFrame;
use crate::minimize::simplex;
use crate::outline::{ConvexOutline, box_outline};
use eye::{Eye, pieces_like, pieces_of};

/// The located object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectEstimate {
    /// Pose of the box's centre in the root frame of the frame's `root_from_left` (as estimated), z along the surface's
    /// normal. Its turn about that lies within (-pi/2, pi/2] rad: a box looks the same after half a turn.
    pub root_from_object: Isometry3<f64>,
    /// Covariance of x, y, z in the root frame, m².
    pub covariance: Matrix3<f64>,
    /// Visible fraction of the silhouette, 0 to 1, mean of both images.
    pub visible: f64,
    /// The fitted silhouette in the left image, px.
    pub outline_left: Vec<Point2<f64>>,
}

/// Finds a box of known colour and size in stereo frames, anywhere or about where it is expected. Keeps no state between frames.
#[derive(Clone, Debug)]
pub struct ObjectLocalizer {
    calibration: StereoCalibration,
    size: Vector3<f64>,
    color: ColorModel,
    /// The rotation of the surface, root frame.
    surface: UnitQuaternion<f64>,
}

/// x, y, z (m) and yaw (rad) in a frame that is turned as the surface, with the root frame's origin.
type Pose4 = Vector4<f64>;

/// A pose and the quality of its fit.
struct PoseFit {
    found: ObjectEstimate,
    /// Fraction of the silhouette that shows the surroundings.
    contradicted: f64,
    /// Fraction of the coloured pixels outside of the silhouette.
    spilled: f64,
    /// Fraction of the coloured region's border, inside and near the outline, that lies on it.
    supported: f64,
    residual_px: f64,
}

/// Coarse yaws over half a turn.
const YAWS: usize = 24;
/// Border points farther than this from the outline belong to something else, px.
const BORDER_REACH_PX: f64 = 2.5;
/// Border points that are further outside than this share of the outline's size are not of the box.
const NEAR: f64 = 0.1;
/// Standard deviation of a border point, px: pixels are 0.29 by themselves.
const BORDER_SIGMA_PX: f64 = 0.35;
/// From a fit's information to its covariance, px². The factor was measured on rendered scenes: errors of neighbouring border points are
/// correlated, and the surface is not quite level.
const BORDER_VARIANCE: f64 = 15.0 * BORDER_SIGMA_PX * BORDER_SIGMA_PX;
/// How far roll and pitch of what is followed go from one frame to the next, rad: where only edges along the eyes' baseline are seen, the
/// images hardly tell them from its distance.
const TILT_SIGMA: f64 = 0.003;
/// By how much a surface, or the cameras, may be tilted otherwise than is believed, rad.
const SURFACE_SIGMA: f64 = 0.08;
/// How far the outline of what is followed may be from where it is expected, round by round, px.
const FOLLOWED_PX: [f64; 10] =
    [20.0, 14.0, 10.0, 7.0, 5.0, 3.5, BORDER_REACH_PX, BORDER_REACH_PX, BORDER_REACH_PX, BORDER_REACH_PX];

impl ObjectLocalizer {
    /// A localizer for boxes of this colour (RGB) with these edge lengths along their own x, y, z, m, on a level surface. They lie on a
    /// face normal to their z.
    pub fn new(calibration: StereoCalibration, size: impl Into<Vector3<f64>>, color: [u8; 3]) -> Self {
        let (size, color, surface) = (size.into(), ColorModel::from_rgb(color), UnitQuaternion::identity());
        Self { calibration, size, color, surface }
    }

    /// Half the longest edge of the boxes, m.
    pub(crate) fn reach(&self) -> f64 {
        self.size.max() / 2.0
    }

    /// The height of the boxes, m.
    pub(crate) fn height(&self) -> f64 {
        self.size.z
    }

    /// The same for objects on a surface with this rotation (root frame): a level one turned by its tilt.
    #[must_use]
    pub fn standing_on(mut self, surface: UnitQuaternion<f64>) -> Self {
        self.surface = surface;
        self
    }

    /// The best fit, or `None` when nothing in the frame fits the object's colour, shape and size, or the images do not have the
    /// calibration's size.
    pub fn localize(&self, frame: &StereoFrame) -> Option<ObjectEstimate> {
        let size = self.size;
        if !self.calibration.fits(frame) || size.min() <= 1e-3 || size.max() >= 2.0 || !size.sum().is_finite()
        {
            return None;
        }
        let surface_from_left = self.surface.inverse() * frame.root_from_left;
        let mut best: Option<PoseFit> = None;
        for shown in pieces_of(&self.color, &frame.left).iter().take(4) {
            let [left, right] = pieces_like(&self.color, shown, frame);
            let Some(l) = left.first() else { continue };
            for r in right.iter().take(4) {
                let Some(start) = self.start(l, r, &surface_from_left) else { continue };
                let eyes = [
                    Eye::of(&self.color, l, &left, &frame.left, start.1),
                    Eye::of(&self.color, r, &right, &frame.right, start.1),
                ];
                let fit = self.fit(&eyes, &start.0, &surface_from_left).filter(PoseFit::convinces);
                let better = |fit: &PoseFit| best.as_ref().is_none_or(|best| fit.quality() > best.quality());
                best = fit.filter(better).or(best);
            }
        }
        best.map(|fit| fit.found)
    }

    /// The box in a frame in which it is expected at `expected` (root frame of the frame's `root_from_left`), with its roll and pitch as
    /// the images show them; `None` where it does not fit there. Faster than [`localize`](Self::localize), and as exact where the border of
    /// the pictures cuts the box off or something covers a part of it.
    pub fn follow(&self, frame: &StereoFrame, expected: &Isometry3<f64>) -> Option<ObjectEstimate> {
        if !self.calibration.fits(frame) {
            return None;
        }
        let [left, right] = pieces_like(&self.color, pieces_of(&self.color, &frame.left).first()?, frame);
        let left_from_root = frame.root_from_left.inverse();
        let away = (left_from_root * expected).translation.vector.z.max(0.1);
        let radius_px = 0.5 * self.size.norm() * self.calibration.camera.focal / away;
        let eyes = [
            Eye::of(&self.color, left.first()?, &left, &frame.left, radius_px),
            Eye::of(&self.color, right.first()?, &right, &frame.right, radius_px),
        ];
        self.tilted(&eyes, expected, TILT_SIGMA, &left_from_root)
            .filter(PoseFit::convinces)
            .map(|fit| fit.found)
    }

    /// The box about where it is expected (root frame), with roll and pitch up to about `tilt` rad from those.
    fn tilted(
        &self,
        eyes: &[Eye; 2],
        expected: &Isometry3<f64>,
        tilt: f64,
        left_from_root: &Isometry3<f64>,
    ) -> Option<PoseFit> {
        let pose = |by: &Vector6<f64>| moved(expected, by);
        let outlines = |by: &Vector6<f64>| self.outlines_at(&(left_from_root * pose(by)));
        let steps = Vector6::new(2e-4, 2e-4, 2e-4, 1e-3, 1e-3, 1e-3);
        let tilt = tilt.powi(-2) * BORDER_VARIANCE / BORDER_SIGMA_PX.powi(2);
        let prior = Vector6::new(1e3, 1e3, 1e3, tilt, tilt, 30.0);
        let (by, information) = on_the_border(outlines, (Vector6::zeros(), steps, prior), eyes, &FOLLOWED_PX);
        let covariance = information.try_inverse().map_or(Matrix6::identity(), |i| i * BORDER_VARIANCE);
        let covariance = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        self.judge((pose(&by), covariance), &outlines(&by)?, eyes)
    }

    /// The position (frame of the surface, m) of a pair of components, and the box's largest radius there, px.
    fn start(
        &self,
        l: &Component,
        r: &Component,
        surface_from_left: &Isometry3<f64>,
    ) -> Option<(Point3<f64>, f64)> {
        let camera = &self.calibration.camera;
        let radius_m = 0.5 * self.size.norm();
        let point = self.calibration.triangulate(&l.centroid, &self.counterpart(l, r))?;
        let radius_px = radius_m * camera.focal / point.z;
        let rows = (l.centroid.y - r.centroid.y).abs();
        let fits = |c: &Component| f64::from(c.area) < 1.3 * PI * radius_px * radius_px;
        let plausible = (0.1..5.0).contains(&point.z) && rows < 2.0 + 0.5 * radius_px && fits(l) && fits(r);
        plausible.then(|| (surface_from_left * point, radius_px))
    }

    /// Where the right image shows what the left one shows at the centroid of a component. Where the border of a picture cuts it off, that
    /// is not the other's centroid: the side that is whole in both tells.
    fn counterpart(&self, l: &Component, r: &Component) -> Point2<f64> {
        let width = self.calibration.camera.width;
        let sides = |c: &Component| [c.bounds.x, c.bounds.x + c.bounds.width];
        let ([l_left, l_right], [r_left, r_right]) = (sides(l), sides(r));
        let (in_left, in_right) = match (l_left.min(r_left) == 0, l_right.max(r_right) == width) {
            (true, false) => (l_right, r_right),
            (false, true) => (l_left, r_left),
            _ => return r.centroid,
        };
        let disparity = f64::from(in_left) - f64::from(in_right);
        Point2::new(l.centroid.x - disparity, (l.centroid.y + r.centroid.y) / 2.0)
    }

    fn fit(
        &self,
        eyes: &[Eye; 2],
        start: &Point3<f64>,
        surface_from_left: &Isometry3<f64>,
    ) -> Option<PoseFit> {
        let left_from_surface = surface_from_left.inverse();
        let outlines = |pose: &Pose4| self.outlines_at(&(left_from_surface * isometry(pose)));
        let camera = &self.calibration.camera;
        let cost = |pose: &Pose4| outlines(pose).map_or(f64::INFINITY, |o| silhouette_cost(&o, eyes, camera));
        let mut coarse: Vec<(f64, f64)> = (0..YAWS)
            .map(|i| PI * i as f64 / YAWS as f64)
            .map(|yaw| (cost(&Pose4::new(start.x, start.y, start.z, yaw)), yaw))
            .collect();
        coarse.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut tried: Vec<f64> = Vec::new();
        let mut best: Option<(Pose4, f64)> = None;
        for (_, yaw) in coarse {
            if tried.len() == 3 || tried.iter().any(|t| half_turn(t - yaw).abs() < 0.35) {
                continue;
            }
            tried.push(yaw);
            let steps = Pose4::new(0.01, 0.01, 0.01, 0.1);
            let found = simplex(cost, &Pose4::new(start.x, start.y, start.z, yaw), &steps, 150);
            if best.as_ref().is_none_or(|b| found.1 < b.1) {
                best = Some(found);
            }
        }
        let steps = Pose4::new(2e-4, 2e-4, 2e-4, 2e-3);
        // A weak prior on the start (3 cm, 20 degrees) holds what the images do not determine.
        let prior = Pose4::new(1e3, 1e3, 1e3, 8.0);
        let from = (best?.0, steps, prior);
        let (pose, information) = on_the_border(outlines, from, eyes, &[BORDER_REACH_PX; 8]);
        let covariance = information.try_inverse().map_or(Matrix4::identity(), |i| i * BORDER_VARIANCE);
        let turn = self.surface.to_rotation_matrix();
        let covariance = turn * covariance.fixed_view::<3, 3>(0, 0) * turn.transpose();
        let upright = self.surface * isometry(&Pose4::new(pose.x, pose.y, pose.z, half_turn(pose.w)));
        let fit = self.judge((upright, covariance), &outlines(&pose)?, eyes).filter(PoseFit::convinces);
        // The surface may be tilted otherwise than is believed, as where the cameras are.
        fit.or_else(|| {
            self.tilted(eyes, &upright, SURFACE_SIGMA, &(left_from_surface * self.surface.inverse()))
        })
    }

    /// The silhouettes in both images.
    fn outlines_at(&self, left_from_box: &Isometry3<f64>) -> Option<[ConvexOutline; 2]> {
        let (camera, size) = (&self.calibration.camera, &self.size);
        let left = box_outline(camera, 0.0, left_from_box, size)?;
        Some([left, box_outline(camera, self.calibration.baseline, left_from_box, size)?])
    }

    /// How well the outlines of a pose (root frame) with this covariance of its place fit what the eyes show.
    fn judge(
        &self,
        (root_from_object, covariance): (Isometry3<f64>, Matrix3<f64>),
        outlines: &[ConvexOutline; 2],
        eyes: &[Eye; 2],
    ) -> Option<PoseFit> {
        let (mut visible, mut contradicted, mut spilled, mut in_pictures) = (0.0, 0.0, 0.0, 0.0);
        let (mut on, mut all, mut squares) = (0.0, 0.0, 0.0);
        for (outline, eye) in outlines.iter().zip(eyes) {
            let area = outline.area();
            let [object, surroundings] = outline.integrate([&eye.object, &eye.surroundings]);
            visible += 0.5 * object / area;
            contradicted += 0.5 * surroundings / area;
            in_pictures += 0.5 * outline.area_in(&self.calibration.camera) / area;
            spilled += 0.5 * (eye.area - object) / eye.area.max(1.0);
            // Further away is another thing of its colour.
            let near = NEAR * area.sqrt();
            for d in eye.border.iter().map(|p| outline.signed_distance(p)).filter(|d| *d < near) {
                all += 1.0;
                if d.abs() < BORDER_REACH_PX {
                    on += 1.0;
                    squares += d * d;
                }
            }
        }
        // What hides a part may hide an error.
        let hidden = (in_pictures - visible).max(0.0) / visible.max(0.05);
        let inflate = 1.0 + 6.0 * (hidden - 0.1).max(0.0);
        (on > 0.0 && visible > 0.0).then(|| PoseFit {
            found: ObjectEstimate {
                root_from_object,
                covariance: covariance * (inflate * inflate),
                visible: visible.min(1.0),
                outline_left: outlines[0].corners().to_vec(),
            },
            contradicted,
            spilled,
            supported: on / f64::max(all, 1.0),
            residual_px: f64::sqrt(squares / on),
        })
    }
}

/// Gauss-Newton on the border's distances from the outlines of a pose, with only the points that are within the reach of each round,
/// px. `start`: the first pose, the steps of its derivatives, and the inverse variances of a weak prior on it. Returns the pose and its
/// information, 1/px².
fn on_the_border<const N: usize>(
    outlines: impl Fn(&SVector<f64, N>) -> Option<[ConvexOutline; 2]>,
    (start, steps, prior): (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>),
    eyes: &[Eye; 2],
    reaches: &[f64],
) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
    let prior = SMatrix::<f64, N, N>::from_diagonal(&prior) * BORDER_SIGMA_PX.powi(2);
    let (mut pose, mut information) = (start, SMatrix::zeros());
    let along = |i: usize| SVector::<f64, N>::from_fn(|k, _| if k == i { steps[i] } else { 0.0 });
    for reach in reaches {
        let Some(here) = outlines(&pose) else { break };
        let moved: Option<Vec<[ConvexOutline; 2]>> = (0..N).map(|i| outlines(&(pose + along(i)))).collect();
        let Some(moved) = moved else { break };
        let (mut jtj, mut jtr) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
        for (eye, e) in eyes.iter().enumerate() {
            for p in &e.border {
                let d = here[eye].signed_distance(p);
                let weight = (1.0 - (d / reach).powi(2)).max(0.0).powi(2);
                if weight > 0.0 {
                    let j =
                        SVector::<f64, N>::from_fn(|i, _| (moved[i][eye].signed_distance(p) - d) / steps[i]);
                    jtj += j * j.transpose() * weight;
                    jtr += j * (d * weight);
                }
            }
        }
        information = jtj + prior;
        jtr += prior * (pose - start);
        let Some(inverse) = information.try_inverse() else { break };
        let step = inverse * jtr;
        pose -= step.map(|s| s.clamp(-0.02, 0.02));
        if step.amax() < 1e-5 && *reach == BORDER_REACH_PX {
            break;
        }
    }
    (pose, information)
}

impl PoseFit {
    /// Whether the fit is good enough to accept the object.
    fn convinces(&self) -> bool {
        self.found.visible > 0.25
            && self.contradicted < 0.12
            && self.spilled < 0.12
            && self.supported > 0.3
            && self.residual_px < 1.3
    }

    fn quality(&self) -> f64 {
        self.found.visible + self.supported - self.contradicted - self.spilled
    }
}

/// A pose that is moved and turned about its origin by this, m and rad, root frame.
fn moved(pose: &Isometry3<f64>, by: &Vector6<f64>) -> Isometry3<f64> {
    let place = pose.translation.vector + by.fixed_rows::<3>(0);
    let turn = UnitQuaternion::from_scaled_axis(by.fixed_rows::<3>(3).into_owned());
    Isometry3::from_parts(place.into(), turn * pose.rotation)
}

fn isometry(pose: &Pose4) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.w);
    Isometry3::from_parts(Translation3::new(pose.x, pose.y, pose.z), rotation)
}

/// The angle within (-pi/2, pi/2] that differs by whole half turns.
fn half_turn(angle: f64) -> f64 {
    let a = angle.rem_euclid(PI);
    if a > FRAC_PI_2 { a - PI } else { a }
}

/// The cost of silhouettes in both images: coloured pixels outside, surroundings inside, a little for hidden pixels,
/// and border points off the outline.
fn silhouette_cost(outlines: &[ConvexOutline; 2], eyes: &[Eye; 2], camera: &PinholeCamera) -> f64 {
    let mut cost = 0.0;
    for (outline, eye) in outlines.iter().zip(eyes) {
        let area = outline.area();
        let [object, surroundings] = outline.integrate([&eye.object, &eye.surroundings]);
        let hidden = (outline.area_in(camera) - object - surroundings).max(0.0);
        cost += (eye.area - object + surroundings + 0.1 * hidden) / eye.area.max(area);
        let reach = (NEAR * area.sqrt()).max(2.0);
        // Every third border point is enough.
        let off = |p: &Point2<f64>| (outline.signed_distance(p) / reach).powi(2).min(1.0);
        let points = eye.border.iter().step_by(3);
        cost += points.clone().map(off).sum::<f64>() / points.len().max(1) as f64;
        // Far away, where nothing overlaps, the cost still decreases towards the object.
        let center = outline.signed_distance(&eye.center).max(0.0);
        cost += center / area.sqrt();
    }
    cost
}

#[cfg(test)]
mod tests;
