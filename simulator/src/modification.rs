//! How much a coach has changed a periodic motion, computed from the referee's log: the true path of the hand in
//! two periods, compared phase by phase.
//!
//! Pure geometry on the [`TruthLog`]; it uses no other figures.

use nalgebra::Vector3;

use crate::referee::TruthLog;

/// The two periods to compare, and where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// Length of a period, s; phases count from the log's beginning.
    pub period_s: f64,
    /// End of the period before the change, s from the log's beginning.
    pub before_s: f64,
    /// End of the period after it, s.
    pub after_s: f64,
    /// The place that the coach points to, root frame, m.
    pub place: Vector3<f64>,
    /// The direction in which the motion shall move there, a unit vector.
    pub way: Vector3<f64>,
    /// A phase is on the far side if its point was farther from the place than this, m.
    pub far_m: f64,
}

/// The resulting figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct ModificationFigures {
    /// Displacement along `way`, at the phase whose point was nearest to the place, m.
    pub displacement_m: f64,
    /// Root mean square displacement on the far side, m; NaN when there is none.
    pub far_side_rms_m: f64,
}

/// The figures of a log; `None` if it does not contain both periods.
pub fn modification(log: &TruthLog, compared: &Compared) -> Option<ModificationFigures> {
    let path: Vec<_> = log.records.iter().map(|r| r.tcp.translation.vector).collect();
    of_path(&path, compared)
}

/// The same for a path with one point per millisecond.
pub fn of_path(path: &[Vector3<f64>], compared: &Compared) -> Option<ModificationFigures> {
    let before = period(path, compared.before_s, compared.period_s)?;
    let after = period(path, compared.after_s, compared.period_s)?;
    let distance = |k: &usize| (before[*k] - compared.place).norm();
    let nearest = (0..before.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let far = (0..before.len()).filter(|k| distance(k) > compared.far_m);
    let far: Vec<f64> = far.map(|k| (after[k] - before[k]).norm_squared()).collect();
    Some(ModificationFigures {
        displacement_m: (after[nearest] - before[nearest]).dot(&compared.way),
        far_side_rms_m: (far.iter().sum::<f64>() / far.len() as f64).sqrt(),
    })
}

/// The period of a path (one point per millisecond) that ends at `end_s`: points at equal phases from 0 on, one per
/// whole millisecond. Phase 0 is the path's first point. `None` if the path does not contain the period.
pub fn period(path: &[Vector3<f64>], end_s: f64, period_s: f64) -> Option<Vec<Vector3<f64>>> {
    let (end, length) = (end_s * 1e3, period_s * 1e3);
    let count = length.round();
    // This is also false for NaN.
    let fits = count >= 2.0 && end - length > -1e-6 && end.ceil() < path.len() as f64;
    if !fits {
        return None;
    }
    let begin = end - length;
    let point = |k: usize| {
        let at = begin + (length * k as f64 / count - begin).rem_euclid(length);
        let (i, part) = (at.max(0.0).floor() as usize, at.max(0.0).fract());
        let (a, b) = (path[i.min(path.len() - 1)], path[(i + 1).min(path.len() - 1)]);
        a + (b - a) * part
    };
    Some((0..count as usize).map(point).collect())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A circle of 0.1 m, 2 s a period, that has a dent outwards at angle 0 from 6 s on.
    fn path(dent: f64) -> Vec<Vector3<f64>> {
        let point = |k: u32| {
            let angle = TAU * f64::from(k) / 2000.0;
            let bump = if k >= 6000 { dent * libm::exp(-(2.0 - 2.0 * libm::cos(angle)) / 0.02) } else { 0.0 };
            Vector3::new(libm::cos(angle), libm::sin(angle), 0.0) * (0.1 + bump)
        };
        (0..12_001).map(point).collect()
    }

    fn compared() -> Compared {
        Compared {
            period_s: 2.0,
            before_s: 5.0,
            after_s: 11.3,
            place: Vector3::new(0.15, 0.0, 0.0),
            way: Vector3::x(),
            far_m: 0.15,
        }
    }

    #[test]
    fn a_dent_is_where_it_was_made() {
        let figures = of_path(&path(0.03), &compared()).unwrap();
        assert!((figures.displacement_m - 0.03).abs() < 1e-9, "{figures:?}");
        assert!(figures.far_side_rms_m < 1e-9, "{figures:?}");
        let inward = of_path(&path(-0.02), &compared()).unwrap();
        assert!((inward.displacement_m + 0.02).abs() < 1e-9);
    }

    #[test]
    fn what_the_log_does_not_hold_is_not_judged() {
        let short = path(0.0)[..10_000].to_vec();
        assert_eq!(of_path(&short, &compared()), None);
        assert_eq!(of_path(&path(0.0), &Compared { before_s: 1.9, ..compared() }), None);
        assert_eq!(of_path(&path(0.0), &Compared { period_s: f64::NAN, ..compared() }), None);
        assert_eq!(modification(&TruthLog::default(), &compared()), None);
    }

    #[test]
    fn phases_are_equal_whatever_the_window() {
        let path = path(0.0);
        let (a, b) = (period(&path, 4.0, 2.0).unwrap(), period(&path, 5.3337, 2.0).unwrap());
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).norm() < 1e-6));
    }
}
