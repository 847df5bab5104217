//! The referee's log of a run: the part of the truth that the figures need, once per millisecond, bounded.

use std::collections::BTreeMap;

use armarium_robot::LinkId;
use nalgebra::{Isometry3, Vector3};

use crate::coach::ActionEvent;
use crate::physics::{LedHand, PressedLoad, Touched};
use crate::truth::{FrameTruth, TrueReach, TruthEvent, TruthSample};

/// Largest number of samples: 20 minutes. Later ones are dropped, and `truncated` is set.
const MAX_SAMPLES: usize = 1_200_000;
/// Largest number of frames and gestures.
pub(super) const MAX_FRAMES: usize = 100_000;

/// An arm that was not seen to reach for this long has come back, ns.
const GOES_ON_NS: u64 = 100_000_000;

/// How far an object that is not in question must have moved for its place to be logged anew, m.
const MOVED: f64 = 1e-4;
/// And how far it must have turned, rad.
const TURNED: f64 = 1e-3;

/// One millisecond. In the recording: `/truth/tcp`, `/truth/contact` and `/truth/sponge`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Time since the robot's start, ns.
    pub stamp_ns: u64,
    /// Pose of the right TCP in the root frame.
    pub tcp: Isometry3<f64>,
    /// The object in question (see [`TruthSample::object`]), and the pose of its middle.
    pub object: Option<(usize, Isometry3<f64>)>,
    /// Normal force of the table on this object, N.
    pub normal: f64,
    /// Friction of the table on this object, N, its magnitude.
    pub tangential: f64,
    /// Position of the coach's tool, while it is shown.
    pub tool: Option<Vector3<f64>>,
    /// Speed of the fastest joint, rad/s (m/s).
    pub fastest_joint: f64,
}

/// A surface as the robot's memory knows it, or a bulk, which is a box.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownSurface {
    /// `table`, `floor`, `wall` ..., or `bulk`.
    pub class: String,
    /// Pose of its middle in the root frame; z is its normal.
    pub root_from_surface: Isometry3<f64>,
    /// Its lengths along x and y, and a bulk's along z, m.
    pub size: [f64; 3],
    /// The probability that it is there.
    pub probability: f64,
}

/// A thing as the robot's memory knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownThing {
    /// Its class in prior knowledge.
    pub class: String,
    /// Its middle in the root frame, m.
    pub place: Vector3<f64>,
    /// When the picture was taken in which it was seen last, ns.
    pub seen_ns: u64,
}

/// What the robot's memory takes for one thing in a picture of the left eye.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownHypothesis {
    /// Its pixels: row, first column, and one past the last column.
    pub mask: Vec<[u32; 3]>,
    /// Whether it has moved as one.
    pub confirmed: bool,
    /// The learned class of which it is taken to be, if any.
    pub class: Option<String>,
}

/// A touch of a hand as the robot's memory knows it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownTouch {
    /// The link of the finger; empty where the robot does not know it.
    pub finger: String,
    /// `seen` or `felt`.
    pub by: String,
}

/// A time in which a running skill needed to know the place of a thing.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NeededThing {
    /// The skill's activation.
    activation: u64,
    /// The thing's name in memory.
    pub(super) thing: String,
    pub(super) from_ns: u64,
    /// `None` while it lasts.
    pub(super) to_ns: Option<u64>,
}

/// An arm of a person that reached for a place and came back.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LoggedReach {
    /// The person and the action, by their indices.
    of: (usize, usize),
    /// Which arm: 0 right, 1 left.
    pub(super) side: usize,
    /// When the hand set out, and when it was back, ns.
    pub(super) began_ns: u64,
    pub(super) ended_ns: u64,
    /// The sums of the places of elbow and wrist while the hand was there, m, and of how many samples.
    sums: [Vector3<f64>; 2],
    held: u32,
}

impl LoggedReach {
    /// The middles of elbow and wrist while the hand was there, root frame, m.
    pub(super) fn forearm(&self) -> Option<[Vector3<f64>; 2]> {
        (self.held > 0).then(|| self.sums.map(|sum| sum / f64::from(self.held)))
    }
}

/// The log of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TruthLog {
    /// One per millisecond, in order of time.
    pub records: Vec<Record>,
    /// The places of the objects that were not in question, by their index: when each moved, and the pose of its middle.
    pub moved: BTreeMap<usize, Vec<(u64, Isometry3<f64>)>>,
    /// Where each object was at first and at last, by its index.
    ends: BTreeMap<usize, [Isometry3<f64>; 2]>,
    /// The largest force of the robot on each thing, N.
    pub(super) strongest: BTreeMap<Touched, f64>,
    /// The smallest distance to each person, m.
    pub(super) nearest: Vec<f64>,
    /// What was between the hands, and the pose of its middle, each millisecond in a world whose robot has pads.
    pub(super) pressed: Vec<(u64, PressedLoad, Isometry3<f64>)>,
    /// The TCPs of the first robot's first two arms, each millisecond in a world with handles.
    pub(super) tcps: Vec<(u64, [Isometry3<f64>; 2])>,
    /// What the arms of people reached for, in order of time.
    pub(super) reaches: Vec<LoggedReach>,
    /// The hands that people led, each millisecond.
    pub(super) led: Vec<(u64, LedHand)>,
    /// What the robot's memory told of the surfaces around it: when, ns, the surface's name, and `None` when it is no longer known.
    pub(super) surfaces: Vec<(u64, String, Option<KnownSurface>)>,
    /// What it told of things: when, ns, the thing's name, and what it knew.
    pub(super) things: Vec<(u64, String, KnownThing)>,
    /// What it told of things that it tells apart in a picture: the picture's time, ns, the name, and `None` when it was dropped.
    pub(super) hypotheses: Vec<(u64, String, Option<KnownHypothesis>)>,
    /// What it told of touches, and when, ns.
    pub(super) touches: Vec<(u64, KnownTouch)>,
    /// When it told that what a hand held slipped, ns.
    pub(super) slips: Vec<u64>,
    /// When a link of the first robot truly began to touch a body, ns; bodies by their index.
    pub(super) contacts: Vec<(u64, LinkId, usize)>,
    /// Those that touched at last.
    touching: Vec<(LinkId, usize)>,
    /// Which things the running skills needed.
    pub(super) needs: Vec<NeededThing>,
    /// The coach's events.
    pub coach: Vec<ActionEvent>,
    /// The truth about every rendered frame.
    pub frames: Vec<FrameTruth>,
    /// Whether entries were dropped because the log was full.
    pub truncated: bool,
}

impl TruthLog {
    pub(super) fn sample(&mut self, s: &TruthSample) {
        if self.records.len() >= MAX_SAMPLES {
            if !self.truncated {
                tracing::warn!("the referee's log is full; later samples do not count");
            }
            self.truncated = true;
            return;
        }
        self.records.push(Record {
            stamp_ns: s.stamp_ns,
            tcp: s.tcp,
            object: s.object_pose(),
            normal: s.contact.normal,
            tangential: s.contact.tangential.norm(),
            tool: s.coach.tool.map(|t| t.translation.vector),
            fastest_joint: s.velocity.iter().map(|v| v.abs()).fold(0.0, f64::max),
        });
        let between = s.pressed.and_then(|load| Some((load, *s.objects.get(load.body)?)));
        self.pressed.extend(between.map(|(load, pose)| (s.stamp_ns, load, pose)));
        if let [first, second, ..] = s.tcps[..] {
            self.tcps.push((s.stamp_ns, [first, second]));
        }
        self.led.extend(s.led.iter().map(|hand| (s.stamp_ns, *hand)));
        s.reaches.iter().for_each(|reach| self.reach(s.stamp_ns, reach));
        for (object, pose) in s.objects.iter().enumerate() {
            self.ends.entry(object).or_insert([*pose; 2])[1] = *pose;
        }
        for (what, force) in &s.collisions {
            let strongest = self.strongest.entry(*what).or_default();
            *strongest = strongest.max(*force);
        }
        for (link, body) in &s.links_touching {
            if !self.touching.contains(&(*link, *body)) && self.contacts.len() < MAX_FRAMES {
                self.contacts.push((s.stamp_ns, *link, *body));
            }
        }
        self.touching.clone_from(&s.links_touching);
        self.nearest.resize(s.people.len().max(self.nearest.len()), f64::INFINITY);
        for (nearest, distance) in self.nearest.iter_mut().zip(&s.people) {
            *nearest = nearest.min(*distance);
        }
        for (object, pose) in s.objects.iter().enumerate().filter(|(object, _)| s.object != Some(*object)) {
            let places = self.moved.entry(object).or_default();
            let near = |last: &Isometry3<f64>| {
                (last.translation.vector - pose.translation.vector).norm() < MOVED
                    && last.rotation.angle_to(&pose.rotation) < TURNED
            };
            if !places.last().is_some_and(|(_, last)| near(last)) && places.len() < MAX_FRAMES {
                places.push((s.stamp_ns, *pose));
            }
        }
    }

    fn reach(&mut self, stamp_ns: u64, now: &TrueReach) {
        let TrueReach { person, reach, forearm } = now;
        let of = (*person, reach.action);
        let goes_on = |known: &LoggedReach| known.of == of && stamp_ns - known.ended_ns < GOES_ON_NS;
        let known = self.reaches.iter().rposition(goes_on).unwrap_or(self.reaches.len());
        if known >= MAX_FRAMES {
            return;
        }
        if known == self.reaches.len() {
            let (sums, side) = ([Vector3::zeros(); 2], reach.side);
            let first = LoggedReach { of, side, began_ns: stamp_ns, ended_ns: stamp_ns, sums, held: 0 };
            self.reaches.push(first);
        }
        let known = &mut self.reaches[known];
        known.ended_ns = stamp_ns;
        if reach.holds {
            known.held += 1;
            known.sums.iter_mut().zip(forearm).for_each(|(sum, joint)| *sum += joint.coords);
        }
    }

    pub(super) fn frame(&mut self, frame: &FrameTruth) {
        if self.frames.len() < MAX_FRAMES {
            self.frames.push(*frame);
        } else {
            self.truncated = true;
        }
    }

    pub(super) fn event(&mut self, _stamp_ns: u64, event: &TruthEvent) {
        if let TruthEvent::Coach(event) = event
            && self.coach.len() < MAX_FRAMES
        {
            self.coach.push(*event);
        }
    }

    pub(super) fn needs(&mut self, stamp_ns: u64, activation: u64, thing: &str) {
        if self.needs.len() < MAX_FRAMES {
            let thing = thing.to_owned();
            self.needs.push(NeededThing { activation, thing, from_ns: stamp_ns, to_ns: None });
        }
    }

    pub(super) fn needs_no_more(&mut self, stamp_ns: u64, activation: u64) {
        let ended = |need: &&mut NeededThing| need.activation == activation && need.to_ns.is_none();
        self.needs.iter_mut().filter(ended).for_each(|need| need.to_ns = Some(stamp_ns));
    }

    /// The records from `from_ns` to before `to_ns`.
    pub fn between(&self, from_ns: u64, to_ns: u64) -> &[Record] {
        let at = |t: u64| self.records.partition_point(|r| r.stamp_ns < t);
        let (from, to) = (at(from_ns), at(to_ns));
        &self.records[from..to.max(from)]
    }

    /// The pose of an object's middle at a time.
    pub fn object_at(&self, object: usize, stamp_ns: u64) -> Option<Isometry3<f64>> {
        let in_question = self.at(stamp_ns)?.object.filter(|(other, _)| *other == object);
        let places = self.moved.get(&object).map_or(&[][..], Vec::as_slice);
        let place = || places.iter().rev().find(|(at, _)| *at <= stamp_ns);
        in_question.map(|(_, pose)| pose).or_else(|| place().map(|(_, pose)| *pose))
    }

    /// Where an object was at the beginning and at the end.
    pub(super) fn begin_and_end(&self, object: usize) -> Option<(Isometry3<f64>, Isometry3<f64>)> {
        self.ends.get(&object).map(|[begin, end]| (*begin, *end))
    }

    /// The last record at or before a time.
    pub fn at(&self, stamp_ns: u64) -> Option<&Record> {
        let after = self.records.partition_point(|r| r.stamp_ns <= stamp_ns);
        after.checked_sub(1).map(|i| &self.records[i])
    }
}
