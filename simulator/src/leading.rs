//! How a person leads a hand of the robot: takes it where they see it, leads it along a way, holds it, and lets go.
//!
//! Only what the person wants: the physics joins the hands by a spring, and moves the person's hand by theirs. The robot is
//! seen with a delay, and nothing else of it is known.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::coach::minimum_jerk;
use crate::world::PersonAction;

/// Time from taking a hand to leading it, s.
const SETTLE: f64 = 0.5;
/// Time in which leading comes to its speed, and to rest, s.
const RAMP: f64 = 0.5;
/// Time constant of each of two low-passes that round the corners of a way, s.
const ROUND: f64 = 0.15;
/// Speed with which a hand reaches for the one that it takes, m/s.
const REACHING: f64 = 0.4;

/// What a person's hand does with a hand of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lead {
    /// The robot's arm, as an index among its arms.
    pub arm: usize,
    /// Whether it holds the robot's hand; else it reaches for it, or draws back.
    pub holds: bool,
    /// How far it wants that turned since it took it, in the room.
    pub turn: UnitQuaternion<f64>,
}

/// Leading, from reaching for a hand to letting go of it.
#[derive(Clone, Debug)]
pub(crate) struct Leading {
    hands: [Option<TakenHand>; 2],
    way: LeadPath,
    turn: Vector3<f64>,
    reaching: f64,
    holding: f64,
    /// The way so far with rounded corners, in two stages, m.
    rounded: [Vector3<f64>; 2],
}

/// A hand of the robot for a hand of the person.
#[derive(Clone, Copy, Debug)]
struct TakenHand {
    arm: usize,
    /// Where the person's hand was before.
    from: Point3<f64>,
    /// Where it took the robot's hand; until then, where it sees that.
    at: Point3<f64>,
}

impl Leading {
    /// What `action` asks for, with the person's hands at `from` and the robot's seen at `seen`; `None` if it is not to lead, or the
    /// robot has too few hands.
    pub(crate) fn new(action: &PersonAction, from: &[Point3<f64>; 2], seen: &[Point3<f64>]) -> Option<Self> {
        if action.lead.is_empty() {
            return None;
        }
        let mut hands = [None; 2];
        let first = action.hand.index();
        for side in [first, 1 - first].into_iter().take(if action.both { 2 } else { 1 }) {
            let taken = hands.iter().flatten().map(|taken: &TakenHand| taken.arm).next();
            let free = seen.iter().enumerate().filter(|(arm, _)| Some(*arm) != taken);
            let nearest =
                free.min_by(|(_, a), (_, b)| (*a - from[side]).norm().total_cmp(&(*b - from[side]).norm()))?;
            hands[side] = Some(TakenHand { arm: nearest.0, from: from[side], at: *nearest.1 });
        }
        let far = hands.iter().flatten().map(|hand| (hand.at - hand.from).norm()).fold(0.0, f64::max);
        Some(Self {
            hands,
            way: LeadPath::new(action),
            turn: Vector3::from(action.turn_deg.map(f64::to_radians)),
            reaching: (1.9 * far / REACHING).max(0.3),
            holding: action.duration,
            rounded: [Vector3::zeros(); 2],
        })
    }

    /// Goes on, `age` s after the beginning; returns whether it is over. Sets where the hands are wanted and what they do; hanging
    /// arms have their hands at `rest`.
    pub(crate) fn step(
        &mut self,
        (age, dt): (f64, f64),
        seen: &[Point3<f64>],
        rest: &[Point3<f64>; 2],
        (wanted, leads): (&mut [Point3<f64>; 2], &mut [Option<Lead>; 2]),
    ) -> bool {
        let begins = self.reaching + SETTLE;
        let lets_go = begins + self.way.duration() + self.holding;
        let along = self.way.at(age - begins);
        let share = 1.0 - libm::exp(-dt / ROUND);
        self.rounded[0] += (along - self.rounded[0]) * share;
        let first = self.rounded[0];
        self.rounded[1] += (first - self.rounded[1]) * share;
        let turn = UnitQuaternion::from_scaled_axis(self.turn * self.way.share(age - begins));
        let over = age >= lets_go + self.reaching;
        for (side, hand) in self.hands.iter_mut().enumerate() {
            let Some(hand) = hand else { continue };
            let holds = age >= self.reaching && age < lets_go;
            leads[side] = (!over).then_some(Lead { arm: hand.arm, holds, turn });
            wanted[side] = if age < self.reaching {
                hand.at = seen.get(hand.arm).copied().unwrap_or(hand.at);
                hand.from + (hand.at - hand.from) * minimum_jerk(age / self.reaching)
            } else {
                let end = hand.at + self.rounded[1];
                end + (rest[side] - end) * minimum_jerk(((age - lets_go) / self.reaching).clamp(0.0, 1.0))
            };
        }
        over
    }
}

/// A way through places, with a speed that rises and falls evenly.
#[derive(Clone, Debug)]
struct LeadPath {
    /// The places, each with the length of the way up to it, m.
    places: Vec<(f64, Vector3<f64>)>,
    speed: f64,
}

impl LeadPath {
    fn new(action: &PersonAction) -> Self {
        let mut places = vec![(0.0, Vector3::zeros())];
        for place in (0..action.times).flat_map(|_| &action.lead) {
            let place = Vector3::from(*place);
            let (so_far, last) = places[places.len() - 1];
            places.push((so_far + (place - last).norm(), place));
        }
        Self { places, speed: action.speed }
    }

    fn length(&self) -> f64 {
        self.places[self.places.len() - 1].0
    }

    /// From the first place to rest at the last, with rounded corners, s.
    fn duration(&self) -> f64 {
        self.length() / self.speed + RAMP + 4.0 * ROUND
    }

    /// The share of the way after `t` s.
    fn share(&self, t: f64) -> f64 {
        let length = self.length();
        if length <= 0.0 {
            return 1.0;
        }
        // The integral of a speed that ramps up and down: the mean of a ramp's two ends.
        let straight = |t: f64| (self.speed * t).clamp(0.0, length);
        let ramp = |t: f64| {
            let steps = 16;
            let part = |i: i32| straight(t - RAMP * (f64::from(i) + 0.5) / f64::from(steps));
            (0..steps).map(part).sum::<f64>() / f64::from(steps)
        };
        ramp(t) / length
    }

    /// The place after `t` s.
    fn at(&self, t: f64) -> Vector3<f64> {
        let gone = self.share(t) * self.length();
        let next = self.places.partition_point(|(so_far, _)| *so_far < gone).clamp(1, self.places.len() - 1);
        let ((from, a), (to, b)) = (self.places[next - 1], self.places[next]);
        let part = if to > from { ((gone - from) / (to - from)).clamp(0.0, 1.0) } else { 1.0 };
        a + (b - a) * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn action() -> PersonAction {
        PersonAction {
            lead: vec![[0.3, 0.0, 0.0], [0.3, 0.2, 0.0]],
            turn_deg: [0.0, 0.0, 20.0],
            speed: 0.2,
            duration: 1.0,
            ..PersonAction::default()
        }
    }

    #[test]
    fn a_hand_is_taken_where_it_is_seen_led_along_the_way_and_let_go() {
        let seen = [Point3::new(0.3, 0.5, 1.0), Point3::new(-0.3, 0.5, 1.0)];
        let rest = [Point3::new(0.2, 1.1, 0.8), Point3::new(-0.2, 1.1, 0.8)];
        let mut leading = Leading::new(&action(), &rest, &seen).unwrap();
        let (mut wanted, mut leads) = (rest, [None; 2]);
        let (mut fastest, mut way, mut held) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut farthest = wanted[0];
        for k in 0..20_000 {
            let before = wanted[0];
            let over = leading.step((f64::from(k) * 1e-3, 1e-3), &seen, &rest, (&mut wanted, &mut leads));
            if leads[0].is_some_and(|lead| lead.holds) {
                assert_eq!(leads[0].unwrap().arm, 0);
                held += 1e-3;
                way += (wanted[0] - before).norm();
                fastest = fastest.max((wanted[0] - before).norm() / 1e-3);
                farthest = wanted[0];
            }
            if over {
                break;
            }
        }
        assert_eq!((wanted, leads), (rest, [None; 2]));
        assert!((farthest - (seen[0] + Vector3::new(0.3, 0.2, 0.0))).norm() < 1e-3, "{farthest}");
        // The corner is cut.
        assert!(way > 0.47 && way < 0.5, "{way}");
        assert!(fastest < 0.201, "{fastest}");
        assert!((held - 5.1_f64).abs() < 0.01, "{held}");
    }

    #[test]
    fn both_hands_take_one_each_and_a_robot_without_hands_is_not_led() {
        let seen = [Point3::new(0.3, 0.5, 1.0), Point3::new(-0.3, 0.5, 1.0)];
        // Opposite of the robot: its right hand is at the person's left.
        let hands = [Point3::new(-0.2, 1.1, 0.8), Point3::new(0.2, 1.1, 0.8)];
        let both = Leading::new(&PersonAction { both: true, ..action() }, &hands, &seen).unwrap();
        assert_eq!(both.hands.map(|hand| hand.map(|taken| taken.arm)), [Some(1), Some(0)]);
        assert!(Leading::new(&action(), &hands, &[]).is_none());
    }
}
