//! Finds the level plane that contains the most points and is not the floor.

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::rectangle::Rectangle;

/// Largest tilt of a level plane, rad.
const LEVEL: f64 = 0.26;
/// Least height of a plane above the root frame's floor, m.
const NO_FLOOR: f64 = 0.3;
/// Inlier distance during the search, m.
const NEAR: f64 = 0.008;
/// Number of random triples of points.
const TRIES: usize = 300;
/// Number of points that score a plane.
const JUDGES: usize = 2000;
/// Least share of the points that lie in the plane.
const MIN_SHARE: f64 = 0.05;
/// Points farther away than this many standard deviations are outliers.
const OUTLIER: f64 = 3.0;

/// A plane with axes in it.
pub(super) struct Plane {
    middle: Point3<f64>,
    /// x and y in the plane, z its normal, upwards.
    axes: Rotation3<f64>,
    /// Standard deviation of its points' distances, m.
    pub(super) deviation: f64,
}

impl Plane {
    /// Finds the level plane that contains the most points (root frame, m); `None` where there is none.
    ///
    /// # Source
    /// Fischler, Bolles 1981 (RANSAC), with a fixed seed; then total least squares on the inliers.
    pub(super) fn level(points: &[Point3<f64>]) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let judges: Vec<&Point3<f64>> = points.iter().step_by(points.len().div_ceil(JUDGES)).collect();
        let mut best: Option<(usize, Point3<f64>, Vector3<f64>)> = None;
        for _ in 0..TRIES {
            let [a, b, c] = std::array::from_fn(|_| judges[rng.random_range(0..judges.len())]);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-6).and_then(|n| upwards(&n)) else {
                continue;
            };
            if a.z < NO_FLOOR {
                continue;
            }
            let votes = judges.iter().filter(|p| normal.dot(&(**p - a)).abs() < NEAR).count();
            if best.as_ref().is_none_or(|(most, ..)| votes > *most) {
                best = Some((votes, *a, normal));
            }
        }
        let (votes, on_it, normal) = best?;
        if (votes as f64) < MIN_SHARE * judges.len() as f64 {
            return None;
        }
        let (mut on_it, mut normal, mut reach) = (on_it, normal, NEAR);
        for _ in 0..4 {
            let near: Vec<&Point3<f64>> =
                points.iter().filter(|p| normal.dot(&(*p - on_it)).abs() < reach).collect();
            let deviation;
            (on_it, normal, deviation) = least_squares(&near)?;
            reach = (OUTLIER * deviation).clamp(NEAR / 4.0, NEAR);
        }
        let near = points.iter().map(|p| normal.dot(&(p - on_it))).filter(|d| d.abs() < reach);
        let (n, squares) = near.fold((0.0, 0.0), |(n, s), d| (n + 1.0, s + d * d));
        let x = Vector3::x().cross(&normal).cross(&normal).try_normalize(1e-6)? * -1.0;
        let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, normal.cross(&x), normal]));
        Some(Self { middle: on_it, axes, deviation: (squares / f64::max(n, 1.0)).sqrt() })
    }

    /// A point's height above the plane, m.
    pub(super) fn above(&self, point: &Point3<f64>) -> f64 {
        (self.axes.inverse() * (point - self.middle)).z
    }

    /// A point's coordinates along the plane's axes, m.
    pub(super) fn flat(&self, point: &Point3<f64>) -> Point2<f64> {
        Point2::from((self.axes.inverse() * (point - self.middle)).xy())
    }

    /// The pose in the root frame of a rectangle's centre at a height above the plane, x along its longer edge.
    pub(super) fn pose(&self, rectangle: &Rectangle, height: f64) -> Isometry3<f64> {
        let middle = self.middle + self.axes * rectangle.middle.coords.push(height);
        let turned = self.axes * Rotation3::from_axis_angle(&Vector3::z_axis(), rectangle.angle);
        Isometry3::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&turned))
    }
}

/// A level plane's normal, upwards; `None` for one that is too steep.
fn upwards(normal: &Vector3<f64>) -> Option<Vector3<f64>> {
    let normal = normal * normal.z.signum();
    (normal.z > LEVEL.cos()).then_some(normal)
}

/// The centroid, the normal and the points' standard deviation of the plane that fits the points best.
fn least_squares(points: &[&Point3<f64>]) -> Option<(Point3<f64>, Vector3<f64>, f64)> {
    let n = points.len() as f64;
    if n < 3.0 {
        return None;
    }
    let middle = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / n;
    let spread = points.iter().fold(Matrix3::zeros(), |sum, p| {
        let d = p.coords - middle;
        sum + d * d.transpose()
    }) / n;
    let eigen = SymmetricEigen::new(spread);
    let least = eigen.eigenvalues.imin();
    let normal = upwards(&eigen.eigenvectors.column(least).into_owned())?;
    Some((Point3::from(middle), normal, eigen.eigenvalues[least].max(0.0).sqrt()))
}
