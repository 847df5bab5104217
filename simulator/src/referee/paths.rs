//! Periodic paths: their period, the mean of several periods, and alignment in phase.
//!
//! Pure geometry on positions sampled once per millisecond. No filtering.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::log::Record;
use crate::coach::CoachPath;

/// Number of points to which a period is resampled.
pub(super) const POINTS: usize = 256;
/// Seconds between records.
const DT: f64 = 1e-3;

/// One period, sampled uniformly in time.
pub(super) type Period = [Vector3<f64>; POINTS];

pub(super) fn positions(records: &[Record]) -> Vec<Vector3<f64>> {
    records.iter().map(|r| r.tcp.translation.vector).collect()
}

/// The repeat period of a path, s: the shortest time after which the whole path returns to itself. `None` if it
/// does not repeat at least once within the samples (one per millisecond).
pub(super) fn repeat_period(path: &[Vector3<f64>]) -> Option<f64> {
    const STRIDE: usize = 10;
    if path.len() < 200 {
        return None;
    }
    let mean = path.iter().sum::<Vector3<f64>>() / path.len() as f64;
    let variance = path.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / path.len() as f64;
    if variance < 1e-8 {
        return None;
    }
    // Mean squared distance to itself `lag` samples later; twice the variance for unrelated points.
    let distance = |lag: usize, stride: usize| {
        let pairs = path.len() - lag;
        let sum: f64 = (0..pairs).step_by(stride).map(|i| (path[i] - path[i + lag]).norm_squared()).sum();
        sum / pairs.div_ceil(stride) as f64 / (2.0 * variance)
    };
    let most = path.len() * 2 / 3;
    let mut away = false;
    let mut candidate: Option<(f64, usize)> = None;
    for lag in (100..most).step_by(STRIDE) {
        let d = distance(lag, 5);
        away |= d > 0.3;
        if !away {
            continue;
        }
        match candidate {
            Some((best, _)) if d > best + 0.05 => break,
            Some((best, _)) if d >= best => {}
            _ if d < 0.1 => candidate = Some((d, lag)),
            _ => {}
        }
    }
    // If the distance still decreases at the end of the search, the period is longer than that.
    let (_, coarse) = candidate.filter(|(_, lag)| lag + 2 * STRIDE < most)?;
    let lags = coarse.saturating_sub(2 * STRIDE)..(coarse + 2 * STRIDE).min(path.len() - 100);
    let (best, at) = lags.map(|lag| (distance(lag, 1), lag)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (before, after) = (distance(at - 1, 1), distance(at + 1, 1));
    let bend = before - 2.0 * best + after;
    let shift = if bend > 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    Some((at as f64 + shift.clamp(-0.5, 0.5)) * DT)
}

/// The mean of the first `count` periods of `period_s`, sampled uniformly in time; `None` if the path is shorter.
pub(super) fn mean_period(path: &[Vector3<f64>], period_s: f64, count: usize) -> Option<Period> {
    let samples = period_s / DT;
    if count == 0 || samples < 2.0 || (path.len() as f64) < samples * count as f64 + 1.0 {
        return None;
    }
    let mut mean = [Vector3::zeros(); POINTS];
    for (i, point) in mean.iter_mut().enumerate() {
        for k in 0..count {
            let at = samples * (k as f64 + i as f64 / POINTS as f64);
            let (low, part) = (at.floor() as usize, at.fract());
            let next = path[(low + 1).min(path.len() - 1)];
            *point += path[low] * (1.0 - part) + next * part;
        }
        *point /= count as f64;
    }
    Some(mean)
}

/// `b`, shifted in phase to match `a`, by the least distance of their velocities. Distances count by their size,
/// not by their square, so that a changed part does not pull the rest out of phase. Velocities are used so that a
/// motion that was moved as a whole is compared as if it had not been moved.
pub(super) fn aligned(a: &Period, b: &Period) -> Period {
    let (va, vb) = (velocity(a), velocity(b));
    let cost = |shift: usize| (0..POINTS).map(|i| (va[i] - vb[(i + shift) % POINTS]).norm()).sum::<f64>();
    let shift = (0..POINTS).min_by(|x, y| cost(*x).total_cmp(&cost(*y))).unwrap_or(0);
    // Phase between points: iteratively reweighted least squares, each difference divided by its size.
    let usual = (va.iter().map(Vector3::norm_squared).sum::<f64>() / POINTS as f64).sqrt().max(1e-12);
    let mut shift = shift as f64;
    for _ in 0..8 {
        let (mut gain, mut square) = (0.0, 0.0);
        for (i, v) in va.iter().enumerate() {
            let at = i as f64 + shift;
            let (apart, slope) = (v - between(&vb, at), between(&vb, at + 0.5) - between(&vb, at - 0.5));
            let weight = 1.0 / apart.norm().max(1e-4 * usual);
            gain += weight * apart.dot(&slope);
            square += weight * slope.norm_squared();
        }
        shift += if square > 0.0 { (gain / square).clamp(-0.5, 0.5) } else { 0.0 };
    }
    std::array::from_fn(|i| between(b, i as f64 + shift))
}

/// A period at a point index, which may lie between points and beyond the ends.
fn between(period: &Period, at: f64) -> Vector3<f64> {
    let (low, part) = (at.floor().rem_euclid(POINTS as f64) as usize % POINTS, at - at.floor());
    period[low] * (1.0 - part) + period[(low + 1) % POINTS] * part
}

/// The difference between the neighbours of each point, m.
fn velocity(period: &Period) -> Period {
    const REACH: usize = POINTS / 64;
    std::array::from_fn(|i| period[(i + REACH) % POINTS] - period[(i + POINTS - REACH) % POINTS])
}

/// RMS distance of one period to the coach's path, minimised over the phase only. Horizontally relative to the
/// coach's path; vertically relative to the period's own mean height, as the coach's path is level.
pub(super) fn distance_to_coach(period: &Period, path: &CoachPath) -> f64 {
    let height = period.iter().map(|p| p.z).sum::<f64>() / POINTS as f64;
    let rms = |phase: f64| {
        let sum: f64 = period
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let [x, y] = path.point(phase + TAU * i as f64 / POINTS as f64);
                (p - Vector3::new(x, y, height)).norm_squared()
            })
            .sum();
        (sum / POINTS as f64).sqrt()
    };
    let step = TAU / 720.0;
    let best = (0..720).map(|i| f64::from(i) * step).min_by(|a, b| rms(*a).total_cmp(&rms(*b)));
    let best = best.unwrap_or(0.0);
    (-10..=10).map(|i| rms(best + f64::from(i) * step / 10.0)).fold(f64::INFINITY, f64::min)
}

/// The index of the point at the coach's `phase` (0 to 1): nearest in position and direction.
pub(super) fn index_of_phase(period: &Period, path: &CoachPath, phase: f64) -> usize {
    let theta = TAU * phase;
    let (p, d) = (path.point(theta), path.tangent(theta));
    let half = path.half();
    let scale = (half[0] * half[0] + half[1] * half[1]).max(1e-6);
    let (tx, ty) = unit(d[0], d[1]);
    let cost = |i: &usize| {
        let here = period[*i];
        let ahead = period[(i + 2) % POINTS] - period[(i + POINTS - 2) % POINTS];
        let (ux, uy) = unit(ahead.x, ahead.y);
        let place = (here.x - p[0]).powi(2) + (here.y - p[1]).powi(2);
        place + 0.1 * scale * ((ux - tx).powi(2) + (uy - ty).powi(2))
    };
    (0..POINTS).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
}

fn unit(x: f64, y: f64) -> (f64, f64) {
    let n = libm::hypot(x, y);
    if n > 1e-12 { (x / n, y / n) } else { (0.0, 0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{DemonstrationSpec, PathShape};

    fn path(shape: PathShape) -> CoachPath {
        CoachPath::new(&DemonstrationSpec { shape, ..DemonstrationSpec::default() })
    }

    fn performed(shape: PathShape, frequency: f64, seconds: f64) -> Vec<Vector3<f64>> {
        let p = path(shape);
        (0..(seconds / DT) as usize)
            .map(|i| {
                let [x, y] = p.point(TAU * frequency * i as f64 * DT + 1.0);
                Vector3::new(x, y, 1.05)
            })
            .collect()
    }

    #[test]
    fn the_repeat_period_is_that_of_the_whole_path() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            for f in [0.3, 0.5, 0.8] {
                let period = repeat_period(&performed(shape, f, 12.0)).unwrap();
                assert!((period * f - 1.0).abs() < 1e-4, "{shape:?} {f} {period}");
            }
        }
        assert_eq!(repeat_period(&vec![Vector3::x(); 5000]), None);
        assert_eq!(repeat_period(&performed(PathShape::Ellipse, 0.1, 5.0)), None);
        assert_eq!(
            repeat_period(&performed(PathShape::Ellipse, 0.3, 4.7)),
            None,
            "3.1 s of it, of 3.3, are compared"
        );
    }

    #[test]
    fn a_perfect_imitation_is_at_no_distance_whatever_its_phase() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            let period = mean_period(&performed(shape, 0.5, 5.0), 2.0, 2).unwrap();
            assert!(distance_to_coach(&period, &path(shape)) < 2e-4, "{shape:?}");
        }
        let shifted = performed(PathShape::Ellipse, 0.5, 5.0)
            .iter()
            .map(|p| p + Vector3::x() * 0.01)
            .collect::<Vec<_>>();
        let period = mean_period(&shifted, 2.0, 2).unwrap();
        assert!((distance_to_coach(&period, &path(PathShape::Ellipse)) - 0.01).abs() < 2e-4);
    }

    #[test]
    fn alignment_undoes_a_shift_in_time() {
        let path = performed(PathShape::Eight, 0.5, 6.0);
        let a = mean_period(&path, 2.0, 1).unwrap();
        let b = mean_period(&path[700..], 2.0, 1).unwrap();
        assert!(apart(&a, &aligned(&a, &b)) < 5e-5);
    }

    /// RMS distance of two periods.
    fn apart(a: &Period, b: &Period) -> f64 {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum();
        (sum / POINTS as f64).sqrt()
    }

    #[test]
    fn a_part_that_has_changed_and_a_shift_of_the_whole_do_not_pull_the_rest_out_of_phase() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            let path = performed(shape, 0.5, 6.0);
            let before = mean_period(&path, 2.0, 1).unwrap();
            let mut after = before;
            for (i, point) in after.iter_mut().enumerate() {
                let off = (i as f64 - 90.0) / 25.0;
                *point += Vector3::new(0.02, 0.04, 0.0) * libm::exp(-0.5 * off * off) + Vector3::y() * 0.01;
            }
            let late: Period = std::array::from_fn(|i| after[(i + 100) % POINTS]);
            let found = aligned(&before, &late);
            assert!(apart(&found, &after) < 2e-4, "{shape:?} {}", apart(&found, &after));
        }
    }

    #[test]
    fn phases_are_found_on_crossings_and_doubled_strokes() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            let period = mean_period(&performed(shape, 0.5, 5.0), 2.0, 2).unwrap();
            for phase in [0.1, 0.25, 0.6, 0.75] {
                let i = index_of_phase(&period, &path(shape), phase);
                let expected = (phase - 1.0 / TAU).rem_euclid(1.0) * POINTS as f64;
                let off = (i as f64 - expected + POINTS as f64 / 2.0).rem_euclid(POINTS as f64)
                    - POINTS as f64 / 2.0;
                assert!(off.abs() < 4.0, "{shape:?} {phase} {i} {expected}");
            }
        }
    }
}
