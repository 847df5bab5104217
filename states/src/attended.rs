//! What the skills that run need to know the place of, as memory knows it now: where each thing is, and how far off that may be.
//!
//! A place that nobody has seen for long is known less and less. Memory's own filter fuses what was seen of things that stand still; how
//! soon a thing may have been moved by somebody, which no picture shows, is added here.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{EntityId, Memory, Query, Snapshot};
use armarium_runtime::attention::Need;
use armarium_runtime::observed::MemoryPattern;
use armarium_runtime::skill::Failure;
use armarium_values::{Pose, Value};
use nalgebra::Point3;

use crate::arm::seconds;
use crate::inputs::{as_point, as_pose, entity_of, pattern_of};
use crate::motions::{self, failed};
use crate::places::Remembered;

/// How fast the place of a thing that nobody looks at becomes uncertain at least, m/√s: somebody may move it.
const THING_DRIFT: f64 = 0.02;
/// The same for people, who move all the time.
const PEOPLE_DRIFT: f64 = 0.2;
/// How long it counts that a thing has moved, s.
const OF_LATE: f64 = 5.0;
/// Time between two sights of it that are compared, s.
const COMPARED: f64 = 0.5;
/// Standard deviation of what happens at a place where anybody may come at any time, m.
const ANYBODY: f64 = 0.1;
/// The same of a thing that memory holds without a covariance, m.
const UNKNOWN: f64 = 0.05;
/// People of whom no picture has come for this long are gone, s.
const GONE_AFTER: f64 = 1.5;
/// What appeared or moved so lately is a stimulus, s, and by so much it must have moved, m.
const NEW_FOR: f64 = 2.0;
const MOVED: f64 = 0.03;
/// What a stimulus counts beside the needs of skills, and the error of its place that is borne, m.
const STIMULUS: f64 = 0.7;
const STIMULUS_WITHIN: f64 = 0.05;

/// The core segments of people, and of things.
const PEOPLE: [&str; 2] = ["HumanHands", "HumanPoses"];
const THINGS: &str = "ObjectInstances";

/// A place that is to be watched.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct AttendedPlace {
    /// Its name for people: of the entity, or of what takes place there.
    pub(crate) name: String,
    /// Root frame, m.
    pub(crate) place: Point3<f64>,
    /// Standard deviation of it along each axis, m.
    pub(crate) deviation: f64,
    /// The error that is borne, m, and how much it counts.
    pub(crate) within: f64,
    pub(crate) weight: f64,
    /// The states whose skills need it; none for a stimulus.
    pub(crate) needed_by: Vec<String>,
    /// The class of a thing that has to be looked for.
    pub(crate) class: Option<String>,
    /// When it was seen, ns.
    pub(crate) seen_ns: u64,
}

/// Resolves needs, and remembers what moved.
#[derive(Default)]
pub(crate) struct AttendedPlaces {
    /// The middles of motions.
    motions: BTreeMap<EntityId, Point3<f64>>,
    /// Where each thing was when it last moved or appeared, and when that was, ns.
    moved: BTreeMap<EntityId, (Point3<f64>, u64)>,
    /// Where each needed thing was last: memory may give it up while it is needed.
    last_known: BTreeMap<EntityId, AttendedPlace>,
    /// How fast each thing has moved of late.
    restless: BTreeMap<EntityId, Restless>,
}

/// How fast a thing moves, as its sights tell.
struct Restless {
    /// The pose at the last sight that was compared, in the frame in which memory holds it, and when that was, ns.
    pose: Pose,
    seen_ns: u64,
    /// Variance that its place gains in a second, m²/s.
    rate: f64,
}

impl Restless {
    /// Takes over a sight.
    fn see(&mut self, pose: &Pose, seen_ns: u64) {
        let dt = seconds(self.seen_ns, seen_ns);
        if dt < COMPARED {
            return;
        }
        if pose.frame == self.pose.frame {
            let way = (pose.isometry().translation.vector - self.pose.isometry().translation.vector).norm();
            self.rate += (way * way / dt - self.rate) * (1.0 - libm::exp(-dt / OF_LATE));
        }
        (self.pose, self.seen_ns) = (pose.clone(), seen_ns);
    }
}

impl AttendedPlaces {
    /// All that is to be watched at the time `now_ns` of the robot, by name: what is needed, then what is new or moves.
    pub(crate) async fn watched(
        &mut self,
        needs: &[Need],
        remembered: Remembered<'_>,
        now_ns: u64,
    ) -> Result<Vec<AttendedPlace>, Failure> {
        let mut watched = BTreeMap::new();
        for need in needs {
            for found in self.resolve(need, remembered, now_ns).await? {
                add(&mut watched, found, need);
            }
        }
        for found in self.stimuli(remembered, now_ns).await? {
            watched.entry(found.name.clone()).or_insert(found);
        }
        Ok(watched.into_values().collect())
    }

    async fn resolve(
        &mut self,
        need: &Need,
        remembered: Remembered<'_>,
        now_ns: u64,
    ) -> Result<Vec<AttendedPlace>, Failure> {
        if let Some(place) =
            as_point(&need.thing).or_else(|| Some(as_pose(&need.thing)?.translation.vector.into()))
        {
            return Ok(vec![somewhere(need.state.clone(), place)]);
        }
        let memory = remembered.memory;
        let known = match &need.thing {
            Value::Reference(reference) if reference.kind == "Motion" => {
                let id = entity_of(reference)?;
                let place = self.middle(memory, &id).await?;
                return Ok(vec![somewhere(id.entity().to_owned(), place)]);
            }
            Value::Reference(reference) => {
                let id = entity_of(reference)?;
                let Ok(known) = memory.latest(&id).await else {
                    // Memory has given it up: it may be near the place where it was.
                    return Ok(self.last_known.get(&id).cloned().into_iter().collect());
                };
                let seen = self.seen(remembered, &known, now_ns);
                if let Some(seen) = &seen {
                    self.last_known.insert(id, AttendedPlace { deviation: ANYBODY, ..seen.clone() });
                }
                return Ok(seen.into_iter().collect());
            }
            Value::String(text) => named(memory, text).await?,
            _ => Vec::new(),
        };
        Ok(known.iter().filter_map(|thing| self.seen(remembered, thing, now_ns)).collect())
    }

    async fn middle(&mut self, memory: &dyn Memory, id: &EntityId) -> Result<Point3<f64>, Failure> {
        if let Some(known) = self.motions.get(id) {
            return Ok(*known);
        }
        let (motion, _) = motions::load(memory, id).await?;
        let centre = motion.primitive().centre();
        let middle = Point3::new(centre[0], centre[1], centre[2]);
        self.motions.insert(id.clone(), middle);
        Ok(middle)
    }

    /// People, and things that appeared or moved lately.
    async fn stimuli(
        &mut self,
        remembered: Remembered<'_>,
        now_ns: u64,
    ) -> Result<Vec<AttendedPlace>, Failure> {
        let mut found = Vec::new();
        for segment in PEOPLE {
            let people = remembered.memory.segment(segment).await.map_err(failed)?;
            found.extend(people.iter().filter_map(|person| self.seen(remembered, person, now_ns)));
        }
        let things = remembered.memory.segment(THINGS).await.map_err(failed)?;
        let is_known = |id: &EntityId| things.iter().any(|thing| thing.id == *id);
        self.moved.retain(|id, _| is_known(id));
        self.restless.retain(|id, _| is_known(id));
        for thing in &things {
            let Some(watched) = self.seen(remembered, thing, now_ns) else { continue };
            let place = watched.place;
            let before = *self.moved.entry(thing.id.clone()).or_insert((place, thing.referenced_ns));
            let moved = (place - before.0).norm() > MOVED;
            if moved {
                self.moved.insert(thing.id.clone(), (place, thing.referenced_ns));
            }
            if moved || seconds(before.1, now_ns) < NEW_FOR {
                // Only skills that need a thing look for it.
                found.push(AttendedPlace { class: None, ..watched });
            }
        }
        Ok(found)
    }

    /// The variance that the place of a thing gains in a second, as it has moved of late, m²/s.
    fn moves(&mut self, known: &Snapshot) -> f64 {
        let Some(Value::Pose(pose)) = known.attribute("pose") else { return 0.0 };
        let first = || Restless { pose: pose.clone(), seen_ns: known.referenced_ns, rate: 0.0 };
        let restless = self.restless.entry(known.id.clone()).or_insert_with(first);
        restless.see(pose, known.referenced_ns);
        restless.rate
    }

    /// What memory knows of an entity, as a stimulus; `None` where it is not known where it is, and of what a hand carries: that is known by the
    /// arm's joints.
    fn seen(&mut self, remembered: Remembered<'_>, known: &Snapshot, now_ns: u64) -> Option<AttendedPlace> {
        let instance = known.instance()?;
        let age = seconds(known.referenced_ns, now_ns);
        let is_person = PEOPLE.contains(&known.id.segment());
        if (is_person && age > GONE_AFTER) || known.attribute("attached_to").is_some() {
            self.restless.remove(&known.id);
            return None;
        }
        let place = match is_person {
            true => as_point(known.attribute("shown")?.get("seen_at")?)?,
            false => Point3::from(remembered.root_pose(known)?.translation.vector),
        };
        let rows = instance.covariance.get("position").filter(|rows| rows.len() == 9);
        let variance = rows.map_or(UNKNOWN * UNKNOWN, |rows| (rows[0] + rows[4] + rows[8]) / 3.0);
        let gained =
            if is_person { PEOPLE_DRIFT.powi(2) } else { self.moves(known).max(THING_DRIFT.powi(2)) };
        let class = known.attribute("class").and_then(Value::as_str).filter(|_| !is_person);
        Some(AttendedPlace {
            deviation: (variance + gained * age).sqrt(),
            class: class.map(str::to_owned),
            seen_ns: known.referenced_ns,
            ..somewhere(known.id.entity().to_owned(), place)
        })
    }
}

fn add(all: &mut BTreeMap<String, AttendedPlace>, found: AttendedPlace, need: &Need) {
    let found = AttendedPlace {
        within: need.within,
        weight: need.weight,
        needed_by: vec![need.state.clone()],
        ..found
    };
    let known = all.entry(found.name.clone()).or_insert_with(|| found.clone());
    known.within = known.within.min(found.within);
    known.weight = known.weight.max(found.weight);
    if !known.needed_by.contains(&need.state) {
        known.needed_by.push(need.state.clone());
    }
}

/// A place to which anybody may come.
fn somewhere(name: String, place: Point3<f64>) -> AttendedPlace {
    let (deviation, within, weight) = (ANYBODY, STIMULUS_WITHIN, STIMULUS);
    AttendedPlace { name, place, deviation, within, weight, ..AttendedPlace::default() }
}

/// What a text names: a pattern of memory, or the newest thing of a class.
async fn named(memory: &dyn Memory, text: &str) -> Result<Vec<Arc<Snapshot>>, Failure> {
    if text.contains('/') {
        let named: MemoryPattern = text.parse().map_err(failed)?;
        return memory.query(&Query::latest(pattern_of(&named))).await.map_err(failed);
    }
    let things = memory.segment(THINGS).await.map_err(failed)?;
    let of_class = |thing: &&Arc<Snapshot>| thing.attribute("class").and_then(Value::as_str) == Some(text);
    Ok(things.iter().filter(of_class).max_by_key(|thing| thing.referenced_ns).cloned().into_iter().collect())
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::{Commit, Instance, WorkingMemory, tokio_clock};
    use armarium_values::transforms::Transforms;
    use armarium_values::{Frame, Pose, Reference, Vector};
    use nalgebra::{Isometry3, Matrix3, Vector3};
    use parking_lot::RwLock;

    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn need(thing: Value) -> Need {
        Need { state: "Grasp".into(), thing, within: 0.01, weight: 1.0 }
    }

    fn pose(x: f64) -> Value {
        Value::Pose(Pose::new(Frame::root(), &Isometry3::translation(x, 0.5, 1.0)))
    }

    async fn put(memory: &WorkingMemory, id: &str, at_s: u64, attributes: Vec<(&str, Value)>) {
        let named = |(name, value): (&str, Value)| (name.to_owned(), value);
        let attributes: BTreeMap<_, _> = attributes.into_iter().map(named).collect();
        let rows = (Matrix3::identity() * 1e-6).as_slice().to_vec();
        let placed = attributes.contains_key("position");
        let instance = Instance::new(attributes);
        let instances = vec![if placed { instance.with_covariance("position", rows) } else { instance }];
        let id = id.parse().unwrap();
        memory.commit(vec![Commit::of(id, at_s * SECOND, instances)]).await.unwrap();
    }

    async fn cup(memory: &WorkingMemory, at_s: u64, x: f64) {
        let position = Value::Vector(Vector::new(Frame::root(), &Vector3::new(x, 0.5, 1.0)));
        let attributes = vec![("class", Value::from("cup")), ("pose", pose(x)), ("position", position)];
        put(memory, "ObjectInstances/me/cup", at_s, attributes).await;
    }

    #[tokio::test]
    async fn what_is_not_seen_becomes_uncertain_and_what_a_hand_holds_does_not_count() {
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(Transforms::new()));
        let remembered = Remembered { memory: &memory, transforms: &transforms };
        let mut attended = AttendedPlaces::default();
        cup(&memory, 10, 0.2).await;
        let reference =
            Value::Reference(Reference { kind: "Object".into(), id: "ObjectInstances/me/cup".into() });
        for thing in [reference, Value::from("cup"), Value::from("ObjectInstances/*/c*")] {
            let mut deviations = Vec::new();
            for now_s in [10, 11, 14] {
                let needs = [need(thing.clone()), need(Value::from("plate"))];
                let places = attended.watched(&needs, remembered, now_s * SECOND).await.unwrap();
                let [place] = &places[..] else { panic!("{places:?}") };
                assert_eq!((place.name.as_str(), place.place.x), ("cup", 0.2));
                assert_eq!((place.within, &place.needed_by), (0.01, &vec!["Grasp".to_owned()]));
                deviations.push(place.deviation);
            }
            let expected = |age: f64| (1e-6 + THING_DRIFT * THING_DRIFT * age).sqrt();
            assert!(deviations.iter().zip([0.0, 1.0, 4.0]).all(|(d, age)| (d - expected(age)).abs() < 1e-9));
        }
        let held = vec![
            ("class", Value::from("cup")),
            ("pose", pose(0.2)),
            ("attached_to", Value::from("me/right_hand")),
        ];
        put(&memory, "ObjectInstances/me/cup", 15, held).await;
        let places = attended.watched(&[need(Value::from("cup"))], remembered, 15 * SECOND).await.unwrap();
        assert_eq!(places, []);
    }

    #[tokio::test]
    async fn what_moves_again_and_again_becomes_uncertain_sooner_than_what_stands() {
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(Transforms::new()));
        let remembered = Remembered { memory: &memory, transforms: &transforms };
        let mut attended = AttendedPlaces::default();
        let mut gained = BTreeMap::new();
        for (way, from_s) in [(0.0, 10), (0.06, 30), (0.0, 50)] {
            for at_s in from_s..from_s + 20 {
                cup(&memory, at_s, 0.2 + way * (at_s % 2) as f64).await;
                attended.watched(&[need(Value::from("cup"))], remembered, at_s * SECOND).await.unwrap();
            }
            let needs = [need(Value::from("cup"))];
            let later = attended.watched(&needs, remembered, (from_s + 20) * SECOND).await.unwrap();
            gained.insert(from_s, later[0].deviation);
        }
        let [stood, moved, stands] = [10, 30, 50].map(|from_s| gained[&from_s]);
        assert!((stood - THING_DRIFT).abs() < 1e-3, "{stood}");
        assert!((moved - 0.06).abs() < 2e-3, "6 cm in each second: {moved}");
        assert!((stands - THING_DRIFT).abs() < 1e-3, "it stands again: {stands}");
    }

    #[tokio::test]
    async fn what_moves_and_people_are_stimuli_for_a_while() {
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(Transforms::new()));
        let remembered = Remembered { memory: &memory, transforms: &transforms };
        let mut attended = AttendedPlaces::default();
        let mut names = async |now_s: u64| -> Vec<String> {
            let places = attended.watched(&[], remembered, now_s * SECOND).await.unwrap();
            assert!(places.iter().all(|place| place.needed_by.is_empty() && place.class.is_none()));
            places.into_iter().map(|place| place.name).collect()
        };
        cup(&memory, 10, 0.2).await;
        assert_eq!(names(11).await, ["cup"], "it is new");
        cup(&memory, 14, 0.21).await;
        assert_eq!(names(14).await, Vec::<String>::new(), "it stands");
        cup(&memory, 20, 0.3).await;
        assert_eq!(names(20).await, ["cup"], "it has moved");
        assert_eq!(names(23).await, Vec::<String>::new());
        let at = Value::Vector(Vector::new(Frame::root(), &Vector3::new(0.1, 0.6, 1.1)));
        let shown = Value::record([("gesture", Value::from("fist")), ("seen_at", at)]);
        put(&memory, "HumanHands/me/hand", 30, vec![("gesture", "fist".into()), ("shown", shown)]).await;
        assert_eq!(names(31).await, ["hand"]);
        assert_eq!(names(33).await, Vec::<String>::new(), "gone");
    }

    #[tokio::test]
    async fn a_place_is_named_by_the_state_that_needs_it() {
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(Transforms::new()));
        let remembered = Remembered { memory: &memory, transforms: &transforms };
        let needs = [need(pose(0.4)), need(Value::Null)];
        let places = AttendedPlaces::default().watched(&needs, remembered, SECOND).await.unwrap();
        let [place] = &places[..] else { panic!("{places:?}") };
        assert_eq!((place.name.as_str(), place.place.x, place.deviation), ("Grasp", 0.4, ANYBODY));
    }
}
