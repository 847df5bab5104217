//! Paths of joints around bodies: the robot's own ones, and boxes that are known to be there. Start at [`Planner::plan`].
//!
//! - here: which configurations are free, and how far a straight line in joint space stays free. No line is sampled at
//!   fixed steps: from the distances at one configuration follows how far the joints may move before anything can touch.
//! - `rrt`: the search for a way around, and its shortening.
//!
//! It knows neither time nor speed, commands nothing, and sees nothing: who asks says which boxes are there. The same
//! question with the same seed has the same answer, because the work is bounded by a count and not by a clock.

mod rrt;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::bodies::{Bodies, Distances, FAR, KEPT};
use crate::{JointKind, Kinematics, LinkId, Load, Model};

pub use crate::bodies::KnownBox;

/// Distance that bodies keep on a path, m: more than the guard insists on, so that it does not stop what was planned.
const CLEARANCE: f64 = KEPT + 0.005;
/// Followed distances may be too small by this, m.
const TIGHTNESS: f64 = 0.002;
/// A distance that changes by less than this, m, is the same.
const SAME: f64 = 1e-6;
/// Nearer than this to another one, m, no body rests that the guard stops: the last of the way to its bound takes without end.
const STOPS: f64 = KEPT + TIGHTNESS;
/// Shortest way of a body between two checks, m.
const FINEST: f64 = 0.003;
/// Distance of planned positions from joint limits, rad (m): more than the guard's.
const LIMIT_MARGIN: f64 = 0.01;
/// Travel that is assumed of a sliding joint without limits, m.
const ENDLESS: f64 = 10.0;

/// Two bodies that are near each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Nearness {
    /// The link of a body.
    pub first: String,
    /// The link of another one, or the name of a known box.
    pub second: String,
    /// Their distance, m; negative where they overlap.
    pub distance_m: f64,
}

/// Why there is no path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The goal cannot be taken.
    #[error(
        "the goal is not free: `{}` would be {:.0} mm from `{}`",
        .0.first, .0.distance_m * 1e3, .0.second
    )]
    GoalBlocked(Nearness),
    /// A path that was given is not free.
    #[error(
        "the way is not free: `{}` would come within {:.0} mm of `{}`",
        .0.first, .0.distance_m * 1e3, .0.second
    )]
    WayBlocked(Nearness),
    /// The goal is out of a joint's range.
    #[error("the goal is beyond the limits of the joint `{joint}`")]
    BeyondLimit {
        /// The joint.
        joint: String,
    },
    /// The start or the goal is not a number, or not one for each joint.
    #[error("the start or the goal has not one finite position for each joint of the robot")]
    NotFinite,
    /// The search ended without a path. That there is none is not proven.
    #[error(
        "no way around was found in {checks} steps: straight on, `{}` would come too near to `{}`",
        straight.first, straight.second
    )]
    NoWay {
        /// Number of configurations that were looked at.
        checks: usize,
        /// What is in the way of the straight line.
        straight: Nearness,
    },
}

/// Finds paths for one robot among boxes that stand still.
#[derive(Debug)]
pub struct Planner {
    model: Arc<Model>,
    bodies: Arc<Bodies>,
    /// For each joint, how far any point that it moves goes at most per rad (m).
    levers: Vec<f64>,
    kinematics: Kinematics,
    distances: Distances,
    /// The distance that each pair has to keep, m.
    required: Vec<f64>,
    /// The distance that each pair has to have at a goal, m.
    at_goal: Vec<f64>,
    checks: usize,
}

impl Planner {
    /// A planner for a robot with empty hands among `boxes`. It looks at the robot in some hundred postures first: keep it for more questions.
    pub fn new(model: &Arc<Model>, boxes: &[KnownBox]) -> Self {
        Self::carrying(model, &BTreeMap::new(), boxes)
    }

    /// The same for a robot whose hands hold something, by their names.
    pub fn carrying(model: &Arc<Model>, loads: &BTreeMap<String, Load>, boxes: &[KnownBox]) -> Self {
        let bodies = Arc::new(Bodies::new(model).with(model, loads, boxes));
        let levers = levers(model, &bodies);
        let own = |pair: usize| bodies.pair(pair).iter().all(|&body| bodies.is_own(body));
        Self {
            distances: Distances::new(&bodies),
            required: vec![CLEARANCE; bodies.pairs().count()],
            at_goal: (0..bodies.pairs().count()).map(|pair| if own(pair) { STOPS } else { 0.0 }).collect(),
            kinematics: Kinematics::new(model),
            model: Arc::clone(model),
            levers,
            bodies,
            checks: 0,
        }
    }

    /// The same, where the guard stops hands, and what they hold, before the boxes of these names: of those they keep at least 20 mm, and 22 mm at a goal,
    /// or what they have at the start where that is less.
    #[must_use]
    pub fn stopped_before(mut self, places: &[String]) -> Self {
        let hands = self.bodies.hands(&self.model);
        for (pair, at_goal) in self.at_goal.iter_mut().enumerate() {
            let [a, b] = self.bodies.pair(pair);
            let stops = |hand: usize, known: usize| {
                let name = || self.bodies.name(&self.model, known);
                hands.contains(&hand) && !self.bodies.is_own(known) && places.iter().any(|p| p == name())
            };
            if stops(a, b) || stops(b, a) {
                *at_goal = STOPS;
            }
        }
        self
    }

    /// The two bodies that are nearest to each other with all joints at `q`, rad (m), if any are within 0.3 m. Pairs that touch
    /// by construction are left out.
    pub fn nearest(&mut self, q: &[f64]) -> Option<Nearness> {
        self.look(q);
        let nearest = self.distances.near(FAR).min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))?;
        Some(self.nearness(nearest.0, nearest.1.distance))
    }

    /// The two bodies that the guard lets come no nearer to each other with all joints at `q`, rad (m), as far as `joints` move one against the
    /// other: the robot's own, and its hands before the boxes that [`stopped_before`](Self::stopped_before) names.
    pub fn stopped_by(&mut self, joints: &[usize], q: &[f64]) -> Option<Nearness> {
        self.nearest_guarded(joints, q, CLEARANCE)
    }

    /// Of the bodies between which the guard keeps a distance, as far as `joints` move one against the other, the two that are nearest to each
    /// other with all joints at `q`, rad (m), if any are within `within` m (0.3 at most).
    pub fn nearest_guarded(&mut self, joints: &[usize], q: &[f64], within: f64) -> Option<Nearness> {
        self.look(q);
        let links: Vec<[LinkId; 2]> = self.bodies.pairs().collect();
        let moved =
            |[a, b]: [LinkId; 2]| joints.iter().any(|&j| self.model.moves(j, a) != self.model.moves(j, b));
        let near = self.distances.near(within);
        let guarded = near.filter(|(pair, _)| self.at_goal[*pair] == STOPS && moved(links[*pair]));
        let (pair, near) = guarded.min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))?;
        Some(self.nearness(pair, near.distance))
    }

    /// A path for `joints` from one configuration to another, as all joints' positions at its corners, both ends included:
    /// between corners the joints go together in straight lines. Bodies keep 25 mm from each other and from boxes, or what they
    /// have at the start or the goal where that is less. The other joints stay as in `from`.
    ///
    /// # Errors
    /// [`PlanError`]: the goal cannot be taken, or no way was found within some 40 000 configurations.
    ///
    /// # Source
    /// Kuffner and LaValle 2000, RRT-Connect. Differs in: the metric is how far a body may move, which also bounds the
    /// distance between checks (as conservative advancement does; Mirtich 1996).
    pub fn plan(
        &mut self,
        joints: &[usize],
        from: &[f64],
        to: &[f64],
        seed: u64,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let n = self.model.joints().len();
        let finite = |q: &[f64]| q.len() == n && q.iter().all(|v| v.is_finite());
        if !finite(from) || !finite(to) || joints.iter().any(|&j| j >= n) {
            return Err(PlanError::NotFinite);
        }
        let mut goal = from.to_vec();
        for &j in joints {
            let joint = &self.model.joints()[j];
            if !(joint.lower..=joint.upper).contains(&to[j]) {
                return Err(PlanError::BeyondLimit { joint: joint.name.clone() });
            }
            goal[j] = to[j];
        }
        self.checks = 0;
        self.require([from, &goal])?;
        if self.free_share(from, &goal) >= 1.0 {
            return Ok(vec![from.to_vec(), goal]);
        }
        let straight = self.tightest();
        let path = rrt::search(self, joints, from, &goal, seed);
        path.ok_or(PlanError::NoWay { checks: self.checks, straight })
    }

    /// Whether the joints may go along this path, given as all joints' positions at its corners, with the distances of
    /// [`plan`](Self::plan).
    ///
    /// # Errors
    /// [`PlanError`] with the bodies that would come too near, at the end or on the way.
    pub fn check(&mut self, path: &[Vec<f64>]) -> Result<(), PlanError> {
        let n = self.model.joints().len();
        if path.iter().any(|q| q.len() != n || !q.iter().all(|v| v.is_finite())) {
            return Err(PlanError::NotFinite);
        }
        let (Some(first), Some(last)) = (path.first(), path.last()) else { return Ok(()) };
        self.require([first, last])?;
        for corner in path.windows(2) {
            if self.free_share(&corner[0], &corner[1]) < 1.0 {
                return Err(PlanError::WayBlocked(self.tightest()));
            }
        }
        Ok(())
    }

    /// Sets the distances to keep between a start and a goal. What touches at the start and is no nearer at the goal is not refused: another
    /// arm may be about to grasp something.
    fn require(&mut self, [from, goal]: [&[f64]; 2]) -> Result<(), PlanError> {
        self.required.fill(CLEARANCE);
        let mut least = self.at_goal.clone();
        let mut begins = vec![f64::INFINITY; least.len()];
        self.look(from);
        for (pair, near) in self.distances.near(CLEARANCE + TIGHTNESS) {
            begins[pair] = near.distance;
            self.required[pair] = near.distance - TIGHTNESS;
            least[pair] = least[pair].min(near.distance - TIGHTNESS);
        }
        self.look(goal);
        for (pair, near) in self.distances.near(CLEARANCE + TIGHTNESS) {
            self.required[pair] =
                self.required[pair].min(near.distance - TIGHTNESS).max(least[pair].min(KEPT));
        }
        let refused = |&(pair, near): &(usize, crate::bodies::Near)| {
            near.distance < least[pair].max(0.0) && near.distance < begins[pair] - SAME
        };
        match self.distances.near(STOPS).find(refused) {
            Some((pair, near)) => Err(PlanError::GoalBlocked(self.nearness(pair, near.distance))),
            None => Ok(()),
        }
    }

    fn look(&mut self, q: &[f64]) {
        self.checks += 1;
        self.kinematics.update(q);
        self.distances.update(&self.kinematics);
    }

    /// How much farther apart all pairs are than they have to be, m.
    fn spare(&mut self, q: &[f64]) -> f64 {
        self.look(q);
        let spare = self.distances.near(FAR).map(|(pair, near)| near.distance - self.required[pair]);
        spare.fold(FAR - CLEARANCE, f64::min)
    }

    /// The pair that has the least to spare at the configuration that was looked at last.
    fn tightest(&self) -> Nearness {
        let spare = |&(pair, near): &(usize, crate::bodies::Near)| near.distance - self.required[pair];
        let tightest = self.distances.near(FAR).min_by(|a, b| spare(a).total_cmp(&spare(b)));
        tightest.map_or_else(
            || Nearness { first: String::new(), second: String::new(), distance_m: FAR },
            |(pair, near)| self.nearness(pair, near.distance),
        )
    }

    fn nearness(&self, pair: usize, distance_m: f64) -> Nearness {
        let name = |body: usize| self.bodies.name(&self.model, body).to_owned();
        let [first, second] = self.bodies.pair(pair).map(name);
        Nearness { first, second, distance_m }
    }

    /// How far any body may move between two configurations, m.
    fn length(&self, from: &[f64], to: &[f64]) -> f64 {
        from.iter().zip(to).zip(&self.levers).map(|((a, b), lever)| lever * (b - a).abs()).sum()
    }

    /// The share of the straight line that is free, in `0..=1`.
    fn free_share(&mut self, from: &[f64], to: &[f64]) -> f64 {
        let length = self.length(from, to);
        let (mut free, mut share) = (0.0, 0.0);
        loop {
            let spare = self.spare(&between(from, to, share));
            if spare < 0.0 {
                return free;
            }
            free = share;
            if share >= 1.0 {
                return 1.0;
            }
            share = (share + spare.max(FINEST) / length.max(f64::MIN_POSITIVE)).min(1.0);
        }
    }

    /// The range in which a joint is planned, rad (m); one that turns without end, half a turn to both sides of `about`.
    fn range(&self, joint: usize, about: f64) -> (f64, f64) {
        let joint = &self.model.joints()[joint];
        let turn = std::f64::consts::PI;
        let lower = if joint.lower.is_finite() { joint.lower + LIMIT_MARGIN } else { about - turn };
        let upper = if joint.upper.is_finite() { joint.upper - LIMIT_MARGIN } else { about + turn };
        if lower < upper { (lower, upper) } else { (about, about) }
    }
}

/// The configuration at a share of the straight line between two.
fn between(from: &[f64], to: &[f64], share: f64) -> Vec<f64> {
    from.iter().zip(to).map(|(a, b)| if share >= 1.0 { *b } else { a + share * (b - a) }).collect()
}

/// For each joint, how far any point of a body goes at most per rad (m) of its motion.
fn levers(model: &Model, bodies: &Bodies) -> Vec<f64> {
    // The farthest point beyond each link from its origin, whatever the joints between are at.
    let mut reach = vec![0.0_f64; model.links().len()];
    for (link, radius) in bodies.radii() {
        reach[link.index()] = reach[link.index()].max(radius);
    }
    let mut levers = vec![0.0; model.joints().len()];
    for (index, link) in model.links().iter().enumerate().rev() {
        let mut offset = link.parent_from_link.translation.vector.norm();
        if let Some(motion) = link.motion {
            let joint = &model.joints()[motion.joint];
            levers[motion.joint] += motion.multiplier.abs()
                * match motion.kind {
                    JointKind::Revolute => reach[index],
                    JointKind::Prismatic => {
                        let travel = joint.lower.abs().max(joint.upper.abs());
                        let travel = if travel.is_finite() { travel } else { ENDLESS };
                        offset += motion.multiplier.abs() * travel + motion.offset.abs();
                        1.0
                    }
                };
        }
        if let Some(LinkId(parent)) = link.parent {
            reach[parent] = reach[parent].max(offset + reach[index]);
        }
    }
    levers
}
