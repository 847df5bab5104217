//! The rigid transform that maps one set of points onto another in the least-squares sense, for calibrating a
//! camera to a robot from pairs of points.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::error::{MotionError, finite, size};

/// A fitted transform and its accuracy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidFit {
    /// `target = target_from_source * source`.
    pub target_from_source: Isometry3<f64>,
    /// RMS distance between the mapped points and their targets, m.
    pub rms: f64,
    /// The largest of these distances, m.
    pub worst: f64,
    /// Spread of the points along their principal axes, m, largest first (RMS).
    pub spread: [f64; 3],
    /// Standard deviation of the rotation about the worst-determined axis, from the residuals, rad.
    pub angle_sigma: f64,
}

/// By how much carriers must rotate: a point at 1 m from them moves by at least this (RMS, m), in whichever direction it lies.
const LEAST_ROTATION: f64 = 0.1;
/// Iterations after which a search is given up, and a step of the point that ends it, m.
const MAX_ITERATIONS: usize = 20_000;
const STEP_TOLERANCE: f64 = 1e-8;

/// Fits `target ~ R source + t` to pairs of points, m.
///
/// # Errors
/// [`MotionError::TooFew`] for fewer than three pairs, [`MotionError::Degenerate`] when the points lie (nearly) on
/// one line, so that the rotation about it is free; also for sizes that differ and values that are not finite.
///
/// # Source
/// Arun, Huang and Blostein 1987, by the singular value decomposition; a reflection is replaced by the nearest
/// rotation.
pub fn rigid_fit(source: &[Point3<f64>], target: &[Point3<f64>]) -> Result<RigidFit, MotionError> {
    size("target points", source.len(), target.len())?;
    if source.len() < 3 {
        return Err(MotionError::TooFew { what: "point pairs", needed: 3, got: source.len() });
    }
    for p in source.iter().chain(target) {
        finite("point", p.coords.as_slice())?;
    }
    let n = source.len() as f64;
    let mean = |points: &[Point3<f64>]| points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
    let (source_mean, target_mean) = (mean(source), mean(target));
    let mut cross = Matrix3::zeros();
    let mut covariance = Matrix3::zeros();
    for (s, t) in source.iter().zip(target) {
        let (s, t) = (s.coords - source_mean, t.coords - target_mean);
        cross += t * s.transpose();
        covariance += s * s.transpose() / n;
    }
    let spread = principal_spread(&covariance);
    if spread[1] <= 1e-3 * spread[0] || spread[0] <= 0.0 {
        return Err(MotionError::Degenerate { what: "points", why: "they lie on one line" });
    }
    let rotation = nearest_rotation(&cross)?;
    let translation = target_mean - rotation * source_mean;
    let residual =
        |(s, t): (&Point3<f64>, &Point3<f64>)| (rotation * s.coords + translation - t.coords).norm();
    let squares: f64 = source.iter().zip(target).map(|p| residual(p).powi(2)).sum();
    let worst = source.iter().zip(target).map(residual).fold(0.0, f64::max);
    // A rotation about the longest axis moves the points only in proportion to their spread across it.
    let freedom = (3.0 * n - 6.0).max(1.0);
    let across = (spread[1].powi(2) + spread[2].powi(2)).sqrt();
    let turn = UnitQuaternion::from_rotation_matrix(&rotation);
    Ok(RigidFit {
        target_from_source: Isometry3::from_parts(Translation3::from(translation), turn),
        rms: (squares / n).sqrt(),
        worst,
        spread,
        angle_sigma: (squares / freedom / n).sqrt() / across,
    })
}

/// Fits `R source + t ~ carrier point` for a point that its carriers hold at one unknown place, m: the transform and that point in the
/// carriers' frame, searched from `start`.
///
/// # Errors
/// Those of [`rigid_fit`]; [`MotionError::Degenerate`] when the carriers rotate by too little, or about one axis only: then where the point
/// is along it cannot be told from `t`; and when the search does not end.
///
/// # Source
/// Coordinate descent: both unknowns by turns, each in closed form, the transform as in [`rigid_fit`] and the point as a mean. No step
/// makes the sum of squares larger. The fit's `angle_sigma` takes the point for known, which makes it too small.
pub fn rigid_fit_held(
    source: &[Point3<f64>],
    carriers: &[Isometry3<f64>],
    start: &Point3<f64>,
) -> Result<(RigidFit, Point3<f64>), MotionError> {
    size("carriers", source.len(), carriers.len())?;
    let rotation = |carrier: &Isometry3<f64>| carrier.rotation.to_rotation_matrix().into_inner();
    let n = carriers.len().max(1) as f64;
    let mean = carriers.iter().map(rotation).sum::<Matrix3<f64>>() / n;
    let deviation = |carrier: &Isometry3<f64>| (rotation(carrier) - mean).tr_mul(&(rotation(carrier) - mean));
    let varied = carriers.iter().map(deviation).sum::<Matrix3<f64>>() / n;
    finite("carrier", varied.as_slice())?;
    if principal_spread(&varied)[2] < LEAST_ROTATION {
        return Err(MotionError::Degenerate {
            what: "carriers",
            why: "they rotate about one axis only, or hardly",
        });
    }
    let mut point = *start;
    for _ in 0..MAX_ITERATIONS {
        let targets: Vec<Point3<f64>> = carriers.iter().map(|carrier| carrier * point).collect();
        let fit = rigid_fit(source, &targets)?;
        let seen = |(s, carrier): (&Point3<f64>, &Isometry3<f64>)| {
            (carrier.inverse() * (fit.target_from_source * s)).coords
        };
        let better = Point3::from(source.iter().zip(carriers).map(seen).sum::<Vector3<f64>>() / n);
        if (better - point).norm() < STEP_TOLERANCE {
            return Ok((fit, point));
        }
        point = better;
    }
    Err(MotionError::Degenerate { what: "points", why: "they hardly tell where the carriers hold them" })
}

fn principal_spread(covariance: &Matrix3<f64>) -> [f64; 3] {
    let mut values: Vec<f64> = covariance.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    [values[0], values[1], values[2]]
}

fn nearest_rotation(cross: &Matrix3<f64>) -> Result<Rotation3<f64>, MotionError> {
    let svd = cross.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(MotionError::Degenerate { what: "points", why: "their decomposition fails" });
    };
    // The sign belongs to the smallest singular value, wherever it is in the decomposition.
    let smallest = svd.singular_values.imin();
    let mut signs = Vector3::repeat(1.0);
    signs[smallest] = (u.determinant() * v_t.determinant()).signum();
    Ok(Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_transform_is_found_from_four_points(
            t in prop::array::uniform3(-2.0..2.0_f64), r in prop::array::uniform3(-3.0..3.0_f64)
        ) {
            let truth = Isometry3::new(Vector3::from(t), Vector3::from(r));
            let source = [
                Point3::new(0.1, 0.2, 0.3), Point3::new(0.5, 0.1, 0.2), Point3::new(0.2, 0.6, 0.1), Point3::new(0.3, 0.3, 0.3),
            ];
            let target: Vec<_> = source.iter().map(|p| truth * p).collect();
            let fit = rigid_fit(&source, &target).unwrap();
            prop_assert!(fit.rms < 1e-12);
            prop_assert!(fit.target_from_source.rotation.angle_to(&truth.rotation) < 1e-7);
        }
    }

    /// Where a hand went: places in a workspace, turned by up to half a radian about `axes` axes.
    fn carriers(axes: usize) -> Vec<Isometry3<f64>> {
        let at = |k: usize, d: usize| 0.1 * libm::sin((3 * k + d) as f64 * (1.3 + d as f64));
        let turn = |k: usize| Vector3::from_fn(|d, _| if d < axes { 5.0 * at(k, d + 3) } else { 0.0 });
        (0..8).map(|k| Isometry3::new(Vector3::from_fn(|d, _| 0.5 + at(k, d)), turn(k))).collect()
    }

    proptest! {
        #[test]
        fn a_tool_in_the_hand_gives_the_transform_and_its_place_in_the_hand(
            t in prop::array::uniform3(-0.1..0.1_f64), r in prop::array::uniform3(-0.2..0.2_f64),
            held in prop::array::uniform3(-0.1..0.1_f64)
        ) {
            let (truth, held) = (Isometry3::new(Vector3::from(t), Vector3::from(r)), Point3::from(held));
            let carriers = carriers(3);
            let seen: Vec<_> = carriers.iter().map(|carrier| truth.inverse() * (carrier * held)).collect();
            let (fit, found) = rigid_fit_held(&seen, &carriers, &Point3::origin()).unwrap();
            // The search ends when a step is 10 nm; it converges linearly, so that more is left.
            prop_assert!((found - held).norm() < 1e-4, "{found}");
            prop_assert!(fit.rms < 1e-5 && fit.target_from_source.rotation.angle_to(&truth.rotation) < 1e-3);
        }
    }

    #[test]
    fn a_hand_that_turns_about_one_axis_does_not_tell_where_its_tool_is() {
        for axes in [0, 1] {
            let carriers = carriers(axes);
            let seen: Vec<_> = carriers.iter().map(|carrier| carrier * Point3::new(0.0, 0.0, 0.1)).collect();
            let refused = rigid_fit_held(&seen, &carriers, &Point3::origin());
            assert!(matches!(refused, Err(MotionError::Degenerate { .. })), "{refused:?}");
        }
        assert!(rigid_fit_held(&[], &[], &Point3::origin()).is_err());
    }

    #[test]
    fn a_plane_of_points_gives_a_rotation_and_a_line_is_refused() {
        let truth = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.3, -0.4, 2.0));
        let plane: Vec<_> =
            [(0.0, 0.0), (0.4, 0.0), (0.0, 0.3), (0.4, 0.3)].map(|(x, y)| Point3::new(x, y, 0.5)).to_vec();
        let mapped: Vec<_> = plane.iter().map(|p| truth * p).collect();
        let fit = rigid_fit(&plane, &mapped).unwrap();
        assert!(fit.rms < 1e-12 && fit.target_from_source.rotation.angle_to(&truth.rotation) < 1e-7);
        let line: Vec<_> = (0..5).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 1.0)).collect();
        assert!(matches!(rigid_fit(&line, &line), Err(MotionError::Degenerate { .. })));
        assert!(matches!(rigid_fit(&plane[..2], &mapped[..2]), Err(MotionError::TooFew { .. })));
        assert!(matches!(rigid_fit(&plane, &mapped[..3]), Err(MotionError::Size { .. })));
    }

    #[test]
    fn residuals_are_reported() {
        let source = [
            Point3::new(0.0, 0.0, 0.0),
            Point3::new(0.4, 0.0, 0.0),
            Point3::new(0.0, 0.4, 0.0),
            Point3::new(0.0, 0.0, 0.4),
        ];
        let mut target = source;
        target[1].x += 0.01;
        let fit = rigid_fit(&source, &target).unwrap();
        assert!(fit.rms > 0.001 && fit.worst < 0.01 && fit.angle_sigma > 0.0);
    }
}
