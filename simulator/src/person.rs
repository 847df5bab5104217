//! A person in the scene: what they want at each instant, from their schedule.
//!
//! Of the robot a person knows where its hands are seen, and leads one (`leading.rs`); their hands feel what touches them, as the
//! physics moves them by a spring. This module has no physics and draws nothing; their body is in `figure.rs`.

use std::f64::consts::TAU;

use armarium_values::random::StandardNormal;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::coach::minimum_jerk;
use crate::figure::{FOREARM, UPPER_ARM, shoulder, sign};
pub use crate::leading::Lead;
use crate::leading::Leading;
use crate::world::{PersonAction, PersonSpec};

/// Time from the end of an action to the beginning of the next, and its standard deviation, s.
const REACTION: [f64; 2] = [0.2, 0.04];
/// Time constant with which what a person sees follows what is, s.
const SEEING: f64 = 0.2;
/// Time constant of the tremor, s.
const TREMOR_S: f64 = 0.05;
/// How often a hand waves, Hz, and how far to each side, m.
const WAVE: (f64, f64) = (1.5, 0.12);

/// What a person wants at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Where they stand: on the floor, y ahead.
    pub room_from_feet: Isometry3<f64>,
    /// Where their hands want to be, right and left, m.
    pub hands: [Point3<f64>; 2],
    /// What each hand does with a hand of the robot.
    pub leads: [Option<Lead>; 2],
    /// What an arm does that reaches for a place.
    pub reaches: Option<Reach>,
}

/// An arm that reaches for a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reach {
    /// The action, by its index in the person's schedule.
    pub action: usize,
    /// Which arm: 0 right, 1 left.
    pub side: usize,
    /// Whether the hand is there.
    pub holds: bool,
}

impl Posture {
    /// Standing where the schedule begins, with hanging arms.
    pub fn standing(spec: &PersonSpec) -> Self {
        let [x, y] = spec.at;
        let room_from_feet =
            Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * spec.yaw_deg.to_radians());
        let hands = hanging(&room_from_feet, spec.height);
        Self { room_from_feet, hands, leads: [None; 2], reaches: None }
    }
}

/// A person of a world.
#[derive(Clone, Debug)]
pub struct Person {
    spec: PersonSpec,
    rng: ChaCha8Rng,
    /// Index of what they do, since when, s, and in which posture it began.
    doing: Option<(usize, f64, Posture)>,
    /// When they begin the next.
    next_at: f64,
    next: usize,
    tremor: [Vector3<f64>; 2],
    /// Without tremor.
    posture: Posture,
    /// Where the robot's hands are seen, m.
    seen: Vec<Point3<f64>>,
    leading: Option<Leading>,
}

impl Person {
    /// A person who begins with their arms hanging down.
    pub fn new(spec: &PersonSpec, rng: ChaCha8Rng) -> Self {
        let (tremor, posture) = ([Vector3::zeros(); 2], Posture::standing(spec));
        let (doing, seen, leading) = (None, Vec::new(), None);
        Self { spec: spec.clone(), rng, doing, next_at: 0.0, next: 0, tremor, posture, seen, leading }
    }

    /// What the world's file says of them.
    pub fn spec(&self) -> &PersonSpec {
        &self.spec
    }

    /// What an arm reaches for now.
    pub fn reaches(&self) -> Option<Reach> {
        self.posture.reaches
    }

    /// What they want at `t` s, `dt` s after the last step, with the hands of the first robot where they are.
    pub fn step(&mut self, t: f64, dt: f64, robot_hands: &[Point3<f64>]) -> Posture {
        let follows = 1.0 - libm::exp(-dt / SEEING);
        if self.seen.len() != robot_hands.len() {
            self.seen = robot_hands.to_vec();
        }
        for (seen, hand) in self.seen.iter_mut().zip(robot_hands) {
            *seen += (hand - *seen) * follows;
        }
        if self.doing.is_none() && t >= self.next_at && self.next < self.spec.does.len() {
            self.doing = Some((self.next, t, self.posture));
            self.leading = Leading::new(&self.spec.does[self.next], &self.posture.hands, &self.seen);
        }
        if let Some((index, since, from)) = self.doing {
            let action = self.spec.does[index].clone();
            self.posture.reaches = None;
            let over = self.act((index, &action), &from, (t - since, dt));
            if over {
                self.doing = None;
                let [mean, deviation] = REACTION;
                self.next_at = t + (mean + deviation * self.rng.sample::<f64, _>(StandardNormal)).max(0.0);
                self.next = index + 1;
                if self.spec.repeats && self.next == self.spec.does.len() {
                    self.next = 0;
                }
            }
        }
        let Posture { mut hands, .. } = self.posture;
        if self.spec.tremor > 0.0 {
            let kept = libm::exp(-dt / TREMOR_S);
            for (hand, tremor) in hands.iter_mut().zip(&mut self.tremor) {
                let shock = Vector3::from_fn(|_, _| self.rng.sample::<f64, _>(StandardNormal));
                *tremor = *tremor * kept + shock * (self.spec.tremor * (1.0 - kept * kept).sqrt());
                *hand += *tremor;
            }
        }
        Posture { hands, ..self.posture }
    }

    /// Goes on with an action that has lasted for `age` s; returns whether it is over.
    fn act(
        &mut self,
        (index, action): (usize, &PersonAction),
        from: &Posture,
        (age, dt): (f64, f64),
    ) -> bool {
        let height = self.spec.height;
        if let Some([x, y]) = action.walk {
            return self.walk(&Vector3::new(x, y, 0.0), from, (action.speed, action.keeps_facing), age);
        }
        let feet = &from.room_from_feet;
        if !action.lead.is_empty() {
            let Posture { hands, leads, .. } = &mut self.posture;
            let Some(leading) = &mut self.leading else { return true };
            let over = leading.step((age, dt), &self.seen, &hanging(feet, height), (hands, leads));
            for (side, hand) in hands.iter_mut().enumerate() {
                *hand = within_reach(feet, height, side, hand);
            }
            return over;
        }
        let side = action.hand.index();
        let rest = hanging(feet, height)[side];
        let beside_head = feet * Point3::new(sign(side) * 0.25, 0.20, 0.95 * height);
        let goal = match action.reach {
            Some(goal) => Point3::from(goal),
            None if action.wave => beside_head,
            None => return age >= action.duration,
        };
        let goal = within_reach(feet, height, side, &goal);
        let moving = |way: f64| (1.9 * way / action.speed).max(0.3);
        let (there, back) = (moving((goal - from.hands[side]).norm()), moving((rest - goal).norm()));
        let stays = there + action.duration;
        if action.reach.is_some() {
            let holds = (there..stays).contains(&age);
            self.posture.reaches = Some(Reach { action: index, side, holds }).filter(|_| age < stays + back);
        }
        self.posture.hands[side] = if age < there {
            from.hands[side] + (goal - from.hands[side]) * minimum_jerk(age / there)
        } else if age < stays {
            let waved = if action.wave { WAVE.1 * libm::sin(TAU * WAVE.0 * (age - there)) } else { 0.0 };
            goal + feet.rotation * Vector3::x() * waved
        } else {
            goal + (rest - goal) * minimum_jerk(((age - stays) / back).min(1.0))
        };
        age >= stays + back
    }

    /// Turns, unless the person keeps facing where they face, walks with hanging arms, and stays turned that way.
    fn walk(
        &mut self,
        to: &Vector3<f64>,
        from: &Posture,
        (speed, keeps_facing): (f64, bool),
        age: f64,
    ) -> bool {
        let begin = from.room_from_feet.translation.vector;
        let way = to - begin;
        let length = way.norm();
        let turning = if keeps_facing { 0.0 } else { 0.5 };
        let yaw = if !keeps_facing && length > 1e-6 {
            libm::atan2(-way.x, way.y)
        } else {
            from.room_from_feet.rotation.euler_angles().2
        };
        let ahead = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let turned =
            from.room_from_feet.rotation.try_slerp(&ahead, (age / turning).min(1.0), 1e-9).unwrap_or(ahead);
        let duration = 1.5 * length / speed;
        let share =
            if duration > 0.0 { minimum_jerk(((age - turning) / duration).clamp(0.0, 1.0)) } else { 1.0 };
        let feet = Isometry3::from_parts((begin + way * share).into(), turned);
        // The hands move with the body.
        let moved = feet * from.room_from_feet.inverse();
        self.posture.room_from_feet = feet;
        self.posture.hands = from.hands.map(|hand| moved * hand);
        age >= turning + duration
    }
}

fn hanging(feet: &Isometry3<f64>, height: f64) -> [Point3<f64>; 2] {
    let down = (UPPER_ARM + FOREARM) * height * 0.97;
    [0, 1].map(|side| {
        shoulder(feet, height, side) + feet.rotation * Vector3::new(0.04 * sign(side), 0.05, -down)
    })
}

/// The place nearest to `goal` to which an arm reaches.
fn within_reach(feet: &Isometry3<f64>, height: f64, side: usize, goal: &Point3<f64>) -> Point3<f64> {
    let shoulder = shoulder(feet, height, side);
    let way = goal - shoulder;
    let most = (UPPER_ARM + FOREARM) * height * 0.98;
    if way.norm() > most { shoulder + way.normalize() * most } else { *goal }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;
    use std::f64::consts::FRAC_PI_2;

    fn person(spec: &PersonSpec, seed: u64) -> Person {
        Person::new(spec, ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn a_person_keeps_to_the_schedule_and_differs_by_the_seed_only() {
        let reach = PersonAction { reach: Some([0.0, 0.95, 1.2]), duration: 1.0, ..PersonAction::default() };
        let walk = PersonAction { walk: Some([0.0, 1.3]), ..PersonAction::default() };
        let spec = PersonSpec { does: vec![walk, reach], ..PersonSpec::default() };
        let run = |seed: u64| -> Vec<Posture> {
            let mut person = person(&spec, seed);
            (0..6000).map(|i| person.step(f64::from(i) * 1e-3, 1e-3, &[])).collect()
        };
        let postures = run(1);
        assert_eq!(postures, run(1));
        assert_ne!(postures[3000], run(2)[3000]);
        let nearest = |postures: &[Posture]| {
            postures
                .iter()
                .map(|p| (p.hands[0] - Point3::new(0.0, 0.95, 1.2)).norm())
                .fold(f64::MAX, f64::min)
        };
        assert!(nearest(&postures) < 0.01);
        let end = postures[5999].room_from_feet.translation.vector;
        assert!((end - Vector3::new(0.0, 1.3, 0.0)).norm() < 1e-9, "{end}");
        // No hand jumps.
        for pair in postures.windows(2) {
            assert!((pair[1].hands[0] - pair[0].hands[0]).norm() < 5e-3);
        }
    }

    #[test]
    fn who_steps_back_looks_where_they_looked() {
        let back = PersonAction { walk: Some([0.2, 1.9]), keeps_facing: true, ..PersonAction::default() };
        let spec = PersonSpec { does: vec![back], yaw_deg: 170.0, ..PersonSpec::default() };
        let mut person = person(&spec, 1);
        let begin = Posture::standing(&spec).room_from_feet;
        let end = (0..4000).map(|i| person.step(f64::from(i) * 1e-3, 1e-3, &[]).room_from_feet).last();
        let end = end.expect("it stands");
        assert!((end.translation.vector - Vector3::new(0.2, 1.9, 0.0)).norm() < 1e-9, "{end}");
        assert!(end.rotation.angle_to(&begin.rotation) < 1e-9, "{end}");
    }

    #[test]
    fn arms_keep_their_length_wherever_the_hand_is() {
        let spec = PersonSpec::default();
        let feet = Isometry3::new(Vector3::new(0.3, 1.0, 0.0), Vector3::z() * FRAC_PI_2);
        for goal in [Point3::new(0.2, 0.8, 1.2), Point3::new(9.0, 9.0, 9.0), Point3::new(0.3, 1.0, 1.4)] {
            for side in [0, 1] {
                let hand = within_reach(&feet, spec.height, side, &goal);
                let elbow = crate::figure::elbow(&feet, spec.height, side, &hand);
                let upper = (elbow - shoulder(&feet, spec.height, side)).norm();
                assert!((upper - UPPER_ARM * spec.height).abs() < 2e-3, "{upper}");
            }
        }
    }
}
