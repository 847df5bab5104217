//! From the landmarks of a body in images to its joints in space, each with its covariance: left camera frame.
//!
//! A joint's ray is known from its landmark. How far along the ray it is, is the most probable depth by what the depth image or both eyes
//! measure there, by what the network tells of it relative to the other joints, and by how far it is from the joint before it in the
//! arm. What was measured may be of something else, such as what hides the joint: beyond three deviations it counts the same
//! wherever it is.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::{BodyJoint, SeenJoint};
use crate::camera::{PinholeCamera, StereoCalibration};
use crate::epipolar::EpipolarCheck;
use crate::frame::DepthImage;
use crate::mask::{Mask, Region};
use crate::tracking::BodyLandmarks;

/// A landmark that is less probably visible than this says nothing of where its joint is.
const LEAST_VISIBLE: f64 = 0.1;
/// Standard deviations, m: of a landmark across its ray, of the surface's depth, and of the depth that the network tells.
const ACROSS: f64 = 0.025;
const SURFACE: f64 = 0.025;
const TOLD: f64 = 0.15;
/// Standard deviation of a landmark's disparity, px.
const DISPARITY: f64 = 1.5;
/// So many deviations away a measurement is of something else.
const ELSEWHERE: f64 = 3.0;
/// What a nearer surface costs a depth that it hides, squared deviations: one landmark of ten is on what is before its joint.
const HIDDEN: f64 = 4.6;
/// Radius in which a joint's surface is looked for, m; how far its pixels may be beside it, m; and what is deeper by more than this is
/// another surface, m.
const ABOUT: f64 = 0.05;
const BESIDE: f64 = 0.025;
const THICK: f64 = 0.05;
/// A surface that is beside the joint by less than this, squared deviations, is at the joint itself.
const AT_JOINT: f64 = 0.25;
/// Fewer pixels are no surface.
const FEWEST: usize = 8;
/// How far away a person may be, m.
const NEAREST: f64 = 0.35;
const FARTHEST: f64 = 3.5;
/// How large the body may be, relative to one of usual size.
const SIZES: [f64; 2] = [0.75, 1.3];
/// The lengths of upper arm and forearm over the distance of the shoulders, and the standard deviation of that.
///
/// # Source
/// Drillis and Contini 1966, *Body Segment Parameters*: 0.186 and 0.146 of the height. The joints of the shoulders, which are inside of
/// their outer ends, are 0.22 of it apart.
const BONES: [f64; 2] = [0.85, 0.66];
const BONE: f64 = 0.2;
/// How far from where it is told to be a joint is looked for, m, and how finely.
const SOUGHT: f64 = 0.5;
const STEP: f64 = 0.005;

/// How joints are measured.
pub(super) enum Measured<'a> {
    /// By a depth image, where its pixels are not of the own body.
    Depth(&'a DepthImage, &'a Mask),
    /// By the same body in the right image.
    Eyes(&'a BodyLandmarks),
}

/// A depth that may be that of a joint.
#[derive(Clone, Copy, Debug)]
struct MeasuredDepth {
    depth: f64,
    deviation: f64,
    /// What else speaks against it, as squared deviations: its pixels are beside the joint, or something hides it.
    cost: f64,
}

/// A joint on its ray.
struct OnRay {
    /// The ray, with z = 1.
    ray: Vector3<f64>,
    /// Relative to the middle of the hips, m, for a body of usual size.
    in_body: Point3<f64>,
    measured: Vec<MeasuredDepth>,
}

/// The joint before another one in the arm, and how far apart they are, m.
type Bone = (Point3<f64>, f64);

/// The joints of a body, left camera frame; `None` where nothing was measured that fits a body.
pub(super) fn joints(
    body: &BodyLandmarks,
    by: &Measured<'_>,
    calibration: &StereoCalibration,
) -> Option<[Option<SeenJoint>; 7]> {
    let on_rays = BodyJoint::ALL.map(|joint| on_ray(joint, body, by, calibration));
    let [head, shoulders @ ..] = [BodyJoint::Head, BodyJoint::RightShoulder, BodyJoint::LeftShoulder]
        .map(|joint| on_rays[joint as usize].as_ref());
    // Where the body is, by those joints that are mostly free.
    let offset = |on: &OnRay| Some(on.measured.first()?.depth - on.in_body.z);
    let offsets: Vec<f64> =
        head.into_iter().chain(shoulders.into_iter().flatten()).filter_map(offset).collect();
    let depth = EpipolarCheck::median(&offsets)?;
    let size = size(shoulders, depth);
    let found = |joint: BodyJoint, before: Option<Bone>| {
        let on = on_rays[joint as usize].as_ref()?;
        on.lifted(depth + size * on.in_body.z, before)
    };
    let mut seen = [None; 7];
    for joint in [BodyJoint::Head, BodyJoint::RightShoulder, BodyJoint::LeftShoulder] {
        seen[joint as usize] = found(joint, None);
    }
    let [right, left] = [BodyJoint::RightShoulder, BodyJoint::LeftShoulder].map(|joint| seen[joint as usize]);
    let across = right.zip(left).map(|(right, left): (SeenJoint, SeenJoint)| (right.at - left.at).norm());
    for arm in [
        [BodyJoint::RightShoulder, BodyJoint::RightElbow, BodyJoint::RightWrist],
        [BodyJoint::LeftShoulder, BodyJoint::LeftElbow, BodyJoint::LeftWrist],
    ] {
        for (pair, share) in arm.windows(2).zip(BONES) {
            let before = seen[pair[0] as usize].zip(across);
            let before = before.map(|(before, across): (SeenJoint, f64)| (before.at, share * across));
            seen[pair[1] as usize] = found(pair[1], before);
        }
    }
    Some(seen)
}

/// How large the body is, relative to one of usual size, by the distance of its shoulders.
fn size(shoulders: [Option<&OnRay>; 2], depth: f64) -> f64 {
    let [Some(right), Some(left)] = shoulders else { return 1.0 };
    let at = |on: &OnRay| on.ray * (depth + on.in_body.z);
    let (is, usual) = ((at(right) - at(left)).norm(), (right.in_body - left.in_body).norm());
    (is / usual.max(1e-3)).clamp(SIZES[0], SIZES[1])
}

impl OnRay {
    /// The most probable place of the joint, which is told to be at this depth.
    fn lifted(&self, told: f64, before: Option<Bone>) -> Option<SeenJoint> {
        let steps = (2.0 * SOUGHT / STEP) as u32;
        let depths = (0..=steps).map(|i| told - SOUGHT + f64::from(i) * STEP);
        let cost = |depth: f64| self.cost(depth, told, before);
        let depth = depths.min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
        // The curvature of the negative logarithm of the probability is the inverse of the variance.
        let curvature = (cost(depth - STEP) - 2.0 * cost(depth) + cost(depth + STEP)) / (2.0 * STEP * STEP);
        let variance = 1.0 / curvature.max(1.0 / (TOLD * TOLD));
        let along = self.ray * self.ray.transpose() * variance;
        let covariance = along + Matrix3::identity() * (ACROSS * ACROSS);
        let at = Point3::from(self.ray * depth);
        (NEAREST..=FARTHEST).contains(&depth).then_some(SeenJoint { at, covariance })
    }

    /// The sum of the squared deviations at a depth.
    fn cost(&self, depth: f64, told: f64, before: Option<Bone>) -> f64 {
        let off = |by: f64, deviation: f64| (by / deviation).powi(2);
        let measured = self.measured.iter().map(|m| off(depth - m.depth, m.deviation) + m.cost);
        let measured = measured.fold(ELSEWHERE * ELSEWHERE, f64::min);
        let bone = before.map_or(0.0, |(before, length)| {
            off((self.ray * depth - before.coords).norm() - length, BONE * length)
        });
        measured + bone + off(depth - told, TOLD)
    }
}

fn on_ray(
    joint: BodyJoint,
    body: &BodyLandmarks,
    by: &Measured<'_>,
    calibration: &StereoCalibration,
) -> Option<OnRay> {
    let [a, b] = joint.landmarks();
    if body.visible[a].min(body.visible[b]) < LEAST_VISIBLE {
        return None;
    }
    let px = nalgebra::center(&body.points[a], &body.points[b]);
    let camera = &calibration.camera;
    let inside = |at: f64, size: u32| (0.0..f64::from(size)).contains(&at);
    // What is beside the picture the networks guess.
    if !(inside(px.x, camera.width) && inside(px.y, camera.height)) {
        return None;
    }
    let in_body = nalgebra::center(&body.in_body[a], &body.in_body[b]);
    let mut measured = match by {
        Measured::Depth(depth, own) => surfaces(depth, own, camera, &px, joint.under_surface()),
        Measured::Eyes(right) => {
            let right = nalgebra::center(&right.points[a], &right.points[b]);
            let at = calibration.triangulate(&px, &right);
            let deviation = |z: f64| DISPARITY * z * z / (camera.focal * calibration.baseline);
            let measured =
                |at: Point3<f64>| MeasuredDepth { depth: at.z, deviation: deviation(at.z), cost: 0.0 };
            at.into_iter().map(measured).collect()
        }
    };
    measured.retain(|m| (NEAREST..=FARTHEST).contains(&m.depth));
    Some(OnRay { ray: camera.ray(&px), in_body, measured })
}

/// The depths of a joint that lies so far under the surfaces about a pixel, the most probable one first.
fn surfaces(
    depth: &DepthImage,
    own: &Mask,
    camera: &PinholeCamera,
    px: &Point2<f64>,
    under: f64,
) -> Vec<MeasuredDepth> {
    let radius = (ABOUT * camera.focal).clamp(3.0, 40.0);
    let is_free = |(x, y): &(u32, u32)| !own.contains(i64::from(*x), i64::from(*y));
    let seen = |(x, y): (u32, u32)| {
        let z = f64::from(depth.at(x, y));
        let beside = (Point2::new(f64::from(x), f64::from(y)) - px).norm() * z / camera.focal;
        (z > 0.0 && beside < ABOUT).then_some((z, beside))
    };
    let region = Region::around([*px], radius, depth.width, depth.height);
    let mut all: Vec<(f64, f64)> = region.pixels().filter(is_free).filter_map(seen).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let surface = |pixels: &[(f64, f64)]| {
        let nearest = pixels.iter().map(|(_, beside)| *beside).fold(ABOUT, f64::min);
        // Of a large surface, what is beside the joint.
        let about: Vec<f64> =
            pixels.iter().filter(|(_, beside)| *beside < nearest + ABOUT / 3.0).map(|(z, _)| *z).collect();
        let depth = EpipolarCheck::median(&about)? + under;
        let cost = (nearest / BESIDE).powi(2);
        (pixels.len() >= FEWEST).then_some(MeasuredDepth { depth, deviation: SURFACE, cost })
    };
    let mut found: Vec<MeasuredDepth> = all.chunk_by(|a, b| b.0 - a.0 < THICK).filter_map(surface).collect();
    // The nearest surface at the joint itself hides all that is behind it.
    let front = found.iter().position(|surface| surface.cost < AT_JOINT);
    for hidden in found.iter_mut().skip(front.map_or(usize::MAX, |front| front + 1)) {
        hidden.cost += HIDDEN;
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::CALIBRATION;

    /// A hand at 0.6 m before a trunk at 1 m; the landmark is on the hand, near to its edge.
    #[test]
    fn what_a_surface_at_the_joint_hides_is_less_probable() {
        let camera = CALIBRATION.camera;
        let (width, height) = (camera.width, camera.height);
        let shown = |x: u32| if x < 330 { 0.6 } else { 1.0 };
        let data = (0..height).flat_map(|_| (0..width).map(shown)).collect();
        let depth = DepthImage { width, height, data };
        let nothing = Mask::empty(Region::whole(width, height));
        let at = |x: f64| surfaces(&depth, &nothing, &camera, &Point2::new(x, 240.0), 0.02);
        let [hand, trunk] = at(322.0)[..] else { panic!("two surfaces") };
        assert!((hand.depth - 0.62).abs() < 1e-6 && hand.cost < AT_JOINT, "{hand:?}");
        assert!((trunk.depth - 1.02).abs() < 1e-6 && trunk.cost > HIDDEN, "{trunk:?}");
        // A landmark on the trunk says nothing against the hand beside it, but that it is beside.
        let [trunk, hand] = at(340.0)[..] else { panic!("two surfaces") };
        assert!(trunk.depth > hand.depth && hand.cost < HIDDEN, "{trunk:?} {hand:?}");
    }
}
