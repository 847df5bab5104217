//! Finds the phase of the path that a coach's hand addresses, and the range of phases around it that moves.
//!
//! Pure functions. Where a path crosses itself or returns on the same line, the position does not distinguish the
//! passes: there, the phase at which the hand arrived decides.

use std::f64::consts::{PI, TAU};

/// The cost of half a period between a phase and the hand's arrival, in units of the difference between the path's
/// farthest and nearest distance.
const ARRIVAL_WEIGHT: f64 = 2.0;
/// An arrival phase is ignored if the path is farther from the hand there than the nearest row by more than this share
/// of that difference.
const PLAUSIBLE: f64 = 0.75;
/// Two passes that are about as far from the hand, as a share of that difference, and at least this far apart, rad, are told
/// apart by the arrival alone.
const ALIKE: (f64, f64) = (0.15, TAU / 6.0);
/// The phase that a standing hand addresses changes by at most this much, rad.
const MAX_PHASE_CHANGE: f64 = TAU / 8.0;

/// The difference of two phases, -pi to pi.
fn apart(a: f64, b: f64) -> f64 {
    (a - b + PI).rem_euclid(TAU) - PI
}

/// The row of the path (`rows` of them, evenly over the period) that a hand addresses. `distance` is the hand's
/// distance from the path at a row, m; `arrival` is the phase at which the hand came to rest; `held` is the phase
/// addressed so far, rad.
///
/// It is the nearest row; with a plausible `arrival`, the one with the least sum of normalised distance and
/// `1 - cos(phase - arrival)`.
pub(super) fn addressed_row(
    rows: usize,
    distance: impl Fn(usize) -> f64,
    arrival: Option<f64>,
    held: Option<f64>,
) -> usize {
    let (mut nearest, mut farthest) = (f64::INFINITY, 0.0_f64);
    for d in (0..rows).map(&distance) {
        nearest = nearest.min(d);
        farthest = farthest.max(d);
    }
    let range = (farthest - nearest).max(1e-6);
    let far = |row: usize| (distance(row) - nearest) / range;
    let phase = |row: usize| TAU * row as f64 / rows as f64;
    let row_of = |phase: f64| ((phase / TAU).rem_euclid(1.0) * rows as f64) as usize % rows.max(1);
    let arrival = arrival.filter(|c| far(row_of(*c)) <= PLAUSIBLE);
    let cost = |row: usize| {
        far(row) + arrival.map_or(0.0, |c| 0.5 * ARRIVAL_WEIGHT * (1.0 - libm::cos(phase(row) - c)))
    };
    let allowed = |row: &usize| held.is_none_or(|h| apart(phase(*row), h).abs() <= MAX_PHASE_CHANGE);
    let best = (0..rows).filter(allowed).map(|row| (cost(row), row)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(0, |(_, row)| row)
}

/// Whether a hand without a plausible `arrival` may as well address another pass than that at `row`.
pub(super) fn is_ambiguous(
    rows: usize,
    distance: impl Fn(usize) -> f64,
    arrival: Option<f64>,
    row: usize,
) -> bool {
    let (nearest, farthest) =
        (0..rows).map(&distance).fold((f64::INFINITY, 0.0_f64), |(near, far), d| (near.min(d), far.max(d)));
    let range = (farthest - nearest).max(1e-6);
    let far = |row: usize| (distance(row) - nearest) / range;
    let phase = |row: usize| TAU * row as f64 / rows as f64;
    let row_of = |phase: f64| ((phase / TAU).rem_euclid(1.0) * rows as f64) as usize % rows.max(1);
    if arrival.is_some_and(|arrival| far(row_of(arrival)) <= PLAUSIBLE) {
        return false;
    }
    let is_pass = |other: usize| {
        let beside = [(other + 1) % rows, (other + rows - 1) % rows];
        beside.iter().all(|beside| distance(other) <= distance(*beside))
    };
    (0..rows).any(|other| {
        apart(phase(other), phase(row)).abs() > ALIKE.1 && (far(other) - far(row)) < ALIKE.0 && is_pass(other)
    })
}

/// 1 at the addressed phase, decreasing smoothly to 0 at `half_width`; both rad.
pub(super) fn window(away: f64, half_width: f64) -> f64 {
    let u = apart(away, 0.0) / half_width;
    if u.abs() < 1.0 { (1.0 - u * u) * (1.0 - u * u) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: usize = 200;

    /// The distance of `hand` from a point at each row.
    fn from(point: impl Fn(f64) -> [f64; 2], hand: [f64; 2]) -> impl Fn(usize) -> f64 {
        move |row| {
            let [x, y] = point(TAU * row as f64 / ROWS as f64);
            libm::hypot(x - hand[0], y - hand[1])
        }
    }

    fn turns(row: usize) -> f64 {
        row as f64 / ROWS as f64
    }

    #[test]
    fn on_a_circle_it_is_the_nearest_point_whenever_the_hand_arrived() {
        let circle = |p: f64| [0.05 * libm::cos(p), 0.05 * libm::sin(p)];
        for arrival in [None, Some(0.25 * TAU), Some(0.75 * TAU)] {
            let row = addressed_row(ROWS, from(circle, [0.0, 0.15]), arrival, None);
            assert!((turns(row) - 0.25).abs() < 0.006, "{arrival:?} {row}");
        }
    }

    #[test]
    fn of_two_passes_it_is_the_one_of_the_arrival() {
        let line = |p: f64| [0.05 * libm::cos(p), 0.03 * libm::cos(p)];
        let eight = |p: f64| [0.05 * libm::cos(p), 0.03 * libm::sin(2.0 * p)];
        for arrival in [0.25, 0.75] {
            // Beside the line's middle, and below the eight's crossing.
            let across = from(line, [0.06, -0.1]);
            assert!((turns(addressed_row(ROWS, across, Some(arrival * TAU), None)) - arrival).abs() < 0.006);
            let below = from(eight, [0.0, -0.12]);
            assert!((turns(addressed_row(ROWS, below, Some(arrival * TAU), None)) - arrival).abs() < 0.1);
        }
    }

    #[test]
    fn beside_two_passes_a_hand_that_came_nobody_knows_when_is_ambiguous() {
        let circle = |p: f64| [0.05 * libm::cos(p), 0.05 * libm::sin(p)];
        let eight = |p: f64| [0.05 * libm::cos(p), 0.03 * libm::sin(2.0 * p)];
        let told = |path: fn(f64) -> [f64; 2], hand, arrival| {
            let row = addressed_row(ROWS, from(path, hand), arrival, None);
            !is_ambiguous(ROWS, from(path, hand), arrival, row)
        };
        assert!(told(circle, [0.0, 0.15], None) && told(eight, [0.15, 0.0], None));
        assert!(!told(eight, [0.0, -0.12], None));
        assert!(told(eight, [0.0, -0.12], Some(0.25 * TAU)));
    }

    #[test]
    fn the_phase_of_a_standing_hand_does_not_jump() {
        let line = |p: f64| [0.05 * libm::cos(p), 0.0];
        let across = from(line, [0.0, 0.1]);
        assert_eq!(addressed_row(ROWS, &across, None, Some(0.26 * TAU)), 50);
        assert_eq!(addressed_row(ROWS, &across, None, Some(0.74 * TAU)), 150);
    }

    #[test]
    fn the_window_is_one_at_its_middle_and_ends_at_its_width() {
        assert_eq!(window(0.0, 1.0), 1.0);
        assert_eq!(window(TAU + 1.0, 1.0), 0.0);
        assert!(
            (window(-0.5, 1.0) - 0.5625).abs() < 1e-12 && (window(TAU - 0.5, 1.0) - 0.5625).abs() < 1e-12
        );
    }
}
