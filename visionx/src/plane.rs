//! Finds the plane that contains the most points of a depth image, among those of wanted directions.

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::points::{DepthPoint, DepthPoints};
use crate::rectangle::Rectangle;

/// Largest tilt of a level plane, and of an upright one against the vertical, rad.
const LEVEL: f64 = 0.26;
const UPRIGHT: f64 = 0.17;
/// Inlier distance of a near point during the search, m.
const NEAR: f64 = 0.008;
/// Number of random triples of points.
const TRIES: usize = 300;
/// Number of points that score a plane.
const JUDGES: usize = 2000;
/// The points of a triple are at most this part of the image's width apart.
const TOGETHER: usize = 8;
/// Points farther away than this many standard deviations are outliers.
const OUTLIER: f64 = 3.0;

/// A plane with axes in it.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub(crate) middle: Point3<f64>,
    /// x and y in the plane, z its normal: upwards, or of an upright one to where it is seen from.
    pub(crate) axes: Rotation3<f64>,
    /// Standard deviation of its points' distances, of near points, m.
    pub(crate) deviation: f64,
}

/// What points a search is for, by a place of the plane and its normal (root frame): the normal, outwards.
pub(crate) type Wanted<'a> = &'a dyn Fn(&Point3<f64>, &Vector3<f64>) -> Option<Vector3<f64>>;

impl Plane {
    /// Finds the wanted plane that contains the most of the points for which `free` is true; `None` where none contains at least
    /// `share` of them. RANSAC (Fischler, Bolles 1981) with a fixed seed and triples of points that are near to each other in the
    /// image, then total least squares on the inliers, weighted by how certain their depths are.
    pub(crate) fn largest(
        seen: &DepthPoints,
        free: &dyn Fn(usize) -> bool,
        share: f64,
        wanted: Wanted<'_>,
    ) -> Option<Self> {
        let all: Vec<usize> = (0..seen.points.len()).filter(|&i| free(i)).collect();
        if all.len() < 3 {
            return None;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let judges: Vec<&DepthPoint> =
            all.iter().step_by(all.len().div_ceil(JUDGES)).map(|&i| &seen.points[i]).collect();
        let reach = (seen.size[0] / TOGETHER).max(2) as i32;
        let mut best: Option<(usize, Point3<f64>, Vector3<f64>)> = None;
        for _ in 0..TRIES {
            let a = judges[rng.random_range(0..judges.len())];
            let mut other = || {
                let beside = (rng.random_range(-reach..=reach), rng.random_range(-reach..=reach));
                seen.beside(a.place, beside).filter(|&i| free(i)).map(|i| seen.points[i].at)
            };
            let (Some(b), Some(c)) = (other(), other()) else { continue };
            let Some(normal) = (b - a.at).cross(&(c - a.at)).try_normalize(1e-6) else { continue };
            let Some(normal) = wanted(&a.at, &normal) else { continue };
            let near = |p: &&&DepthPoint| normal.dot(&(p.at - a.at)).abs() < NEAR * p.scale();
            let votes = judges.iter().filter(near).count();
            if best.as_ref().is_none_or(|(most, ..)| votes > *most) {
                best = Some((votes, a.at, normal));
            }
        }
        let (votes, mut on_it, mut normal) = best?;
        if (votes as f64) < share * judges.len() as f64 {
            return None;
        }
        let mut reach = NEAR;
        for _ in 0..4 {
            let inliers = all.iter().map(|&i| &seen.points[i]);
            let inliers = inliers.filter(|p| normal.dot(&(p.at - on_it)).abs() < reach * p.scale());
            let deviation;
            (on_it, normal, deviation) = least_squares(inliers)?;
            normal = wanted(&on_it, &normal)?;
            reach = (OUTLIER * deviation).clamp(NEAR / 4.0, NEAR);
        }
        let offs = all.iter().map(|&i| &seen.points[i]).map(|p| normal.dot(&(p.at - on_it)) / p.scale());
        let (n, squares) =
            offs.filter(|d| d.abs() < reach).fold((0.0, 0.0), |(n, s), d| (n + 1.0, s + d * d));
        Some(Self { middle: on_it, axes: axes(&normal)?, deviation: (squares / f64::max(n, 1.0)).sqrt() })
    }

    /// A point's height above the plane, m.
    pub(crate) fn above(&self, point: &Point3<f64>) -> f64 {
        (self.axes.inverse() * (point - self.middle)).z
    }

    /// The point of it that is vertically above or below a place, root frame, m; of a plane that is not upright.
    pub(crate) fn over(&self, at: &Point2<f64>) -> Point3<f64> {
        let normal = self.axes * Vector3::z();
        let off = at.coords - self.middle.xy().coords;
        Point3::new(at.x, at.y, self.middle.z - normal.xy().dot(&off) / normal.z)
    }

    /// A point's coordinates along the plane's axes, m.
    pub(crate) fn flat(&self, point: &Point3<f64>) -> Point2<f64> {
        Point2::from((self.axes.inverse() * (point - self.middle)).xy())
    }

    /// The pose in the root frame of a rectangle's centre at a height above the plane, x along its longer edge.
    pub(crate) fn pose(&self, rectangle: &Rectangle, height: f64) -> Isometry3<f64> {
        let middle = self.middle + self.axes * rectangle.middle.coords.push(height);
        let turned = self.axes * Rotation3::from_axis_angle(&Vector3::z_axis(), rectangle.angle);
        Isometry3::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&turned))
    }
}

/// The axes of a plane with this normal: x along the root frame's x, of an upright plane horizontal.
fn axes(normal: &Vector3<f64>) -> Option<Rotation3<f64>> {
    let x = match normal.z.abs() > libm::cos(LEVEL) - 1e-9 {
        true => -Vector3::x().cross(normal).cross(normal),
        false => Vector3::z().cross(normal),
    };
    let x = x.try_normalize(1e-6)?;
    Some(Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, normal.cross(&x), *normal])))
}

/// A level plane's normal, upwards; `None` for one that is too steep.
pub(crate) fn upwards(normal: &Vector3<f64>) -> Option<Vector3<f64>> {
    let normal = normal * normal.z.signum();
    (normal.z > libm::cos(LEVEL)).then_some(normal)
}

/// An upright plane's normal, to where its point `at` is seen from; `None` for one that is not upright.
pub(crate) fn towards(eye: &Point3<f64>, at: &Point3<f64>, normal: &Vector3<f64>) -> Option<Vector3<f64>> {
    (normal.z.abs() < libm::sin(UPRIGHT)).then(|| normal * normal.dot(&(eye - at)).signum())
}

/// The centroid, the normal and the points' standard deviation of the plane that fits the points best.
fn least_squares<'p>(
    points: impl Iterator<Item = &'p DepthPoint> + Clone,
) -> Option<(Point3<f64>, Vector3<f64>, f64)> {
    let weight = |p: &DepthPoint| p.scale().powi(-2);
    let (count, sum, middle) = points.clone().fold((0, 0.0, Vector3::zeros()), |(n, sum, middle), p| {
        (n + 1, sum + weight(p), middle + p.at.coords * weight(p))
    });
    if count < 3 {
        return None;
    }
    let middle = middle / sum;
    let spread = points.fold(Matrix3::zeros(), |spread, p| {
        let d = p.at.coords - middle;
        spread + d * d.transpose() * weight(p)
    });
    // Each square is in the unit of a near point's.
    let eigen = SymmetricEigen::new(spread / f64::from(count));
    let least = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(least).into_owned();
    Some((Point3::from(middle), normal, eigen.eigenvalues[least].max(0.0).sqrt()))
}
