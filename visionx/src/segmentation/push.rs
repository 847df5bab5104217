//! Which push tells the most: of which hypothesis it is least known whether it is one thing, from where, and to where.
//!
//! A push comes from the side with nothing in its way, goes through what is free, ends in reach and on the table, and is best across
//! the longer edge of a hypothesis, at which two things side by side slide along each other.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Point2, SymmetricEigen, Vector2};

use super::hypothesis::Hypothesis;
use super::top_view::{CELL, middle_of};

/// How many directions are tried, and where on a hypothesis, of its half width.
const DIRECTIONS: usize = 16;
const OFFSETS: [f64; 3] = [0.0, -0.4, 0.4];
/// Room between the finger and the thing before the push, and beside its way, m.
const BEFORE: f64 = 0.03;
const BESIDE: f64 = 0.008;
/// By what share of its length a thing is to be pushed; at least and at most so far, m.
const WAY: (f64, f64, f64) = (0.6, 0.045, 0.07);
/// How near to the bounds a pushed thing may come, m.
const MARGIN: f64 = 0.02;
/// What counts for a push, against what it tells: each thing in its way, a push before, and distance from the middle of the bounds.
const HITS: f64 = 0.7;
const AGAIN: f64 = 0.3;
const INWARDS: f64 = 0.3;
/// A push aside of the middle tells less by this, or more by twice this where a push before was not enough: it moves one of two things.
const ASIDE: f64 = 0.1;

/// A push: the tip of a finger goes straight from one place to another, root frame, m.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPush {
    /// The name of the hypothesis.
    pub of: String,
    /// Where the tip comes down.
    pub from: Point2<f64>,
    /// Where it ends.
    pub to: Point2<f64>,
    /// How much it tells.
    pub tells: f64,
}

/// What pushes are chosen for.
#[derive(Clone, Debug, PartialEq)]
pub struct PushChoice {
    /// The corners of where fingers and things may be, root frame, m.
    pub bounds: [Point2<f64>; 2],
    /// The longer edge of a fingertip as seen from above, a unit vector, and half its edges, m.
    pub finger: (Vector2<f64>, [f64; 2]),
    /// Most pushes of one hypothesis.
    pub most: u32,
}

/// What a hypothesis covers along and across a direction.
struct Extent {
    along: [f64; 2],
    across: [f64; 2],
}

impl PushChoice {
    /// The best push; `None` where everything is known, was pushed often enough, or cannot be pushed.
    pub fn best(&self, hypotheses: &[Hypothesis]) -> Option<PlannedPush> {
        let open = hypotheses.iter().filter(|h| !h.confirmed && h.pushes < self.most);
        let pushes = open.flat_map(|hypothesis| self.pushes(hypothesis, hypotheses));
        pushes.max_by(|a, b| a.tells.total_cmp(&b.tells))
    }

    fn pushes(&self, of: &Hypothesis, all: &[Hypothesis]) -> Vec<PlannedPush> {
        let directions = (0..DIRECTIONS).map(|k| TAU * k as f64 / DIRECTIONS as f64);
        let tried = directions.flat_map(|angle| OFFSETS.map(|offset| (angle, offset)));
        tried.filter_map(|(angle, offset)| self.push(of, all, (angle, offset))).collect()
    }

    fn push(&self, of: &Hypothesis, all: &[Hypothesis], (angle, offset): (f64, f64)) -> Option<PlannedPush> {
        let along = Vector2::new(libm::cos(angle), libm::sin(angle));
        let across = Vector2::new(-along.y, along.x);
        let extent = |h: &Hypothesis| Extent::of(h, &along, &across);
        let own = extent(of);
        let middle = of.middle();
        let line = across.dot(&middle.coords) + offset * (own.across[1] - own.across[0]) / 2.0;
        let (half_along, half_across) = self.half_finger(&along, &across);
        let hits = |h: &Hypothesis, band: f64, from: f64, to: f64| {
            h.cells.keys().any(|place| {
                let at = middle_of(*place).coords;
                (across.dot(&at) - line).abs() < band && (from..to).contains(&along.dot(&at))
            })
        };
        let cells = of.cells.keys().map(|place| middle_of(*place).coords);
        let contact = cells
            .filter(|at| (across.dot(at) - line).abs() < half_across + CELL)
            .map(|at| along.dot(&at))
            .fold(f64::INFINITY, f64::min);
        if !contact.is_finite() {
            return None;
        }
        let begin = contact - half_along - BEFORE;
        let way = (WAY.0 * (own.along[1] - own.along[0])).clamp(WAY.1, WAY.2);
        let end = contact - half_along + way;
        let place = |s: f64| Point2::from(along * s + across * line);
        let (from, to) = (place(begin), place(end));
        let inside = |at: &Point2<f64>, margin: f64| {
            (0..2).all(|i| (self.bounds[0][i] + margin..self.bounds[1][i] - margin).contains(&at[i]))
        };
        if !inside(&from, 0.0) || !inside(&to, 0.0) || !inside(&(middle + along * way), MARGIN) {
            return None;
        }
        let others = || all.iter().filter(|other| other.name != of.name);
        if others().any(|h| hits(h, half_across + BESIDE, begin - half_along - BESIDE, contact)) {
            return None;
        }
        let in_the_way = others().filter(|h| extent(h).is_before(&own, way)).count();
        let center = nalgebra::center(&self.bounds[0], &self.bounds[1]);
        let inwards = along.dot(&(center - middle).try_normalize(1e-6).unwrap_or_default());
        let aside = if of.pushes == 0 { -ASIDE } else { 2.0 * ASIDE };
        let tells =
            1.0 + across_the_longer(of, &along) - HITS * in_the_way as f64 - AGAIN * f64::from(of.pushes)
                + aside * offset.abs()
                + INWARDS * inwards;
        Some(PlannedPush { of: of.name.clone(), from, to, tells })
    }

    /// Half of what a finger covers along and across a direction, m.
    fn half_finger(&self, along: &Vector2<f64>, across: &Vector2<f64>) -> (f64, f64) {
        let (longer, [long, short]) = self.finger;
        let shorter = Vector2::new(-longer.y, longer.x);
        let half = |d: &Vector2<f64>| long * longer.dot(d).abs() + short * shorter.dot(d).abs();
        (half(along), half(across))
    }
}

impl Extent {
    fn of(hypothesis: &Hypothesis, along: &Vector2<f64>, across: &Vector2<f64>) -> Self {
        let range = |d: &Vector2<f64>| {
            let all = hypothesis.cells.keys().map(|place| d.dot(&middle_of(*place).coords));
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            [low - CELL / 2.0, high + CELL / 2.0]
        };
        Self { along: range(along), across: range(across) }
    }

    /// Whether this is in the way of another one that is pushed so far.
    fn is_before(&self, pushed: &Self, way: f64) -> bool {
        let room = BESIDE / 2.0;
        let beside = self.across[1] < pushed.across[0] + room || self.across[0] > pushed.across[1] - room;
        !beside && self.along[1] > pushed.along[1] && self.along[0] < pushed.along[1] + way
    }
}

/// How much longer a hypothesis is than wide, at most 1, where a direction is across that.
fn across_the_longer(of: &Hypothesis, along: &Vector2<f64>) -> f64 {
    let middle = of.middle();
    let spread: Matrix2<f64> =
        of.cells.keys().map(|place| middle_of(*place) - middle).map(|off| off * off.transpose()).sum();
    let eigen = SymmetricEigen::new(spread);
    let (longest, least) = (eigen.eigenvalues.imax(), eigen.eigenvalues.min().max(1e-12));
    let longer = (eigen.eigenvalues[longest] / least).sqrt() - 1.0;
    let sine = eigen.eigenvectors.column(longest).into_owned().perp(along).abs();
    longer.clamp(0.0, 1.0) * sine
}
