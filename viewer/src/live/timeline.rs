//! What a page shows of a run: its events, the numbers, poses and images over time, what memory knows, and how it ended.
//!
//! A run that goes on writes it through the recorder ([`MessageSink`]); one that has ended is read from its recording. Memory is bounded:
//! numbers become sparser, the oldest events and images go.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use armarium_runtime::chart::Outline;
use armarium_values::report::Section;
use nalgebra::Isometry3;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::header::RunHeader;
use super::recording::how_it_ended;
use super::track::SampleTrack;
use crate::chart::{Format, Theme, close, levels_that_fit, render};
use crate::recorder::{MessageSink, RunMessage};
use crate::report::thinned;

/// Events that are kept.
const MOST_EVENTS: usize = 20_000;
/// Bytes of events that are kept.
const MOST_EVENT_BYTES: usize = 16 << 20;
/// Tracks of numbers or poses that are kept.
const MOST_TRACKS: usize = 512;
/// Entities of memory that are kept.
const MOST_ENTITIES: usize = 2000;
/// What is kept of one entity's history: versions, and bytes (the newest is kept in any case).
const MOST_VERSIONS: usize = 100;
const MOST_VERSION_BYTES: usize = 64 << 10;
/// Images of one topic that are kept.
const MOST_IMAGES: usize = 64;
/// Least time between two samples of numbers, and of poses, ns.
const PERIOD_NS: [u64; 2] = [20_000_000, 50_000_000];
/// Numbers of a pose: position, m, and quaternion x, y, z, w.
const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// The topic of what memory knows: `{"entity": ID, "known": WHAT}`, null for what was removed.
pub const MEMORY: &str = "/memory";

/// A run as a page shows it; clones are the same.
#[derive(Clone, Default)]
pub struct Timeline(Arc<Mutex<Run>>);

/// What a page has been told: what comes after it is new.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct PagePosition {
    /// The number of the next event.
    pub(super) event: u64,
    /// The number of the next change of memory.
    pub(super) change: u64,
    /// The last pose, ns.
    pub(super) pose_ns: Option<u64>,
    /// How the run ended.
    pub(super) end: bool,
    /// Whether time stands still.
    pub(super) paused: bool,
}

#[derive(Default)]
struct Run {
    /// What does not change: for the page, and the chart.
    header: Json,
    outline: Option<Arc<Outline>>,
    now_ns: u64,
    events: VecDeque<Event>,
    event_bytes: usize,
    /// Bytes of events that are kept, if less than usual.
    most_event_bytes: Option<usize>,
    /// The number of the first event that is kept.
    first: u64,
    /// Since when each active state is so, ns.
    active: BTreeMap<String, u64>,
    numbers: BTreeMap<String, SampleTrack>,
    poses: BTreeMap<String, SampleTrack>,
    images: BTreeMap<String, VecDeque<Jpeg>>,
    /// By address.
    entities: BTreeMap<String, Entity>,
    changes: u64,
    /// How it ended.
    ended: Option<Json>,
    /// The whole report.
    reported: Option<Arc<[Section]>>,
}

/// What memory knew of an entity.
#[derive(Default)]
struct Entity {
    /// The number of its last change.
    changed: u64,
    /// With the time, ns, as JSON; the oldest go.
    versions: VecDeque<(u64, Arc<str>)>,
    bytes: usize,
}

impl Entity {
    fn add(&mut self, number: u64, stamp_ns: u64, known: &str) {
        self.changed = number;
        self.bytes += known.len();
        self.versions.push_back((stamp_ns, known.into()));
        while self.versions.len() > 1
            && (self.versions.len() > MOST_VERSIONS || self.bytes > MOST_VERSION_BYTES)
        {
            let Some((_, oldest)) = self.versions.pop_front() else { break };
            self.bytes -= oldest.len();
        }
    }

    /// What was known of it at a time, ns.
    fn at(&self, stamp_ns: u64) -> Option<&Arc<str>> {
        let before = self.versions.partition_point(|(stamp, _)| *stamp <= stamp_ns);
        self.versions.get(before.checked_sub(1)?).map(|(_, known)| known)
    }
}

/// A change of memory as it is recorded.
#[derive(Deserialize)]
struct RecordedChange {
    entity: String,
    known: Json,
}

/// An image of a time, ns.
type Jpeg = (u64, Arc<[u8]>);

/// Its time, ns, and its text.
type Event = (u64, Arc<str>);

/// What is known of some entities, by address, as JSON.
type Entities = BTreeMap<String, Arc<str>>;

/// Numbers by topic or frame.
type Samples = BTreeMap<String, Vec<f32>>;

/// What a page needs only at first.
#[derive(Debug)]
struct First {
    header: Json,
    /// Since when each active state is so, ns.
    active: BTreeMap<String, u64>,
    /// The names of each topic's numbers.
    numbers: BTreeMap<String, Vec<String>>,
    /// The topics of images.
    images: Vec<String>,
}

/// What a page is told: all that it needs at first, or what is new.
#[derive(Debug, Default)]
pub(super) struct Update {
    first: Option<First>,
    now_ns: u64,
    /// The number of the first event; more than was expected if some are gone.
    from: u64,
    events: Vec<Event>,
    poses: Samples,
    last: Samples,
    entities: Entities,
    ended: Option<Json>,
    told: PagePosition,
}

impl Update {
    /// As JSON. What came as JSON is not read again.
    pub(super) fn json(&self) -> String {
        let mut fields = Vec::new();
        if let Some(First { header, active, numbers, images }) = &self.first {
            fields.extend([
                ("header", header.to_string()),
                ("active", text(active)),
                ("numbers", text(numbers)),
                ("images", text(images)),
            ]);
        }
        let events: Vec<String> =
            self.events.iter().map(|(stamp, item)| format!("[{stamp},{item}]")).collect();
        let entities: Vec<String> =
            self.entities.iter().map(|(id, known)| format!("{}:{known}", text(id))).collect();
        fields.extend([
            ("now_ns", self.now_ns.to_string()),
            ("from", self.from.to_string()),
            ("events", format!("[{}]", events.join(","))),
            ("poses", text(&self.poses)),
            ("last", text(&self.last)),
            ("entities", format!("{{{}}}", entities.join(","))),
            ("ended", text(&self.ended)),
            ("told", text(&self.told)),
        ]);
        let fields: Vec<String> =
            fields.into_iter().map(|(name, value)| format!("\"{name}\":{value}")).collect();
        format!("{{{}}}", fields.join(","))
    }
}

/// Plain data as JSON; numbers that are not finite are null.
pub(super) fn text(data: &impl Serialize) -> String {
    serde_json::to_string(data).unwrap_or_else(|_| "null".to_owned())
}

impl std::fmt::Debug for Timeline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Timeline")
    }
}

impl Timeline {
    /// One of very many: it keeps so many bytes of events.
    #[must_use]
    pub fn bounded(event_bytes: usize) -> Self {
        let run = Run { most_event_bytes: Some(event_bytes), ..Run::default() };
        Self(Arc::new(Mutex::new(run)))
    }

    /// Begins with what does not change during a run.
    pub fn begin(&self, header: &RunHeader) {
        let mut run = self.0.lock();
        run.header = header.for_page();
        run.outline = Some(Arc::new(header.outline.clone()));
    }

    /// Says how the run ended.
    pub fn end(&self, ended: Json) {
        self.0.lock().ended = Some(ended);
    }

    /// The run's title, and its outcome when it has ended.
    pub(super) fn named(&self) -> (String, Option<String>) {
        let run = self.0.lock();
        let word = |data: &Json, key: &str| data.get(key).and_then(Json::as_str).map(str::to_owned);
        (
            word(&run.header, "title").unwrap_or_default(),
            run.ended.as_ref().and_then(|end| word(end, "outcome")),
        )
    }

    /// How the run ended, as its last events say.
    pub(super) fn finished(&self) -> Option<Json> {
        how_it_ended(self.0.lock().events.iter().map(|(_, text)| text))
    }

    /// Gives the whole report.
    pub fn report(&self, sections: Vec<Section>) {
        self.0.lock().reported = Some(sections.into());
    }

    /// The whole report, if it is known.
    pub(super) fn reported(&self) -> Option<Arc<[Section]>> {
        self.0.lock().reported.clone()
    }

    /// What memory knew at a time, ns: by address, as JSON.
    pub(super) fn memory(&self, stamp_ns: u64) -> String {
        let run = self.0.lock();
        let known = run.entities.iter().filter_map(|(id, entity)| Some((id, entity.at(stamp_ns)?)));
        let known: Vec<String> = known.map(|(id, known)| format!("{}:{known}", text(id))).collect();
        format!("{{{}}}", known.join(","))
    }

    /// What was known of an entity: a list of times, s, and JSON.
    pub(super) fn history(&self, id: &str) -> Option<String> {
        let run = self.0.lock();
        let versions = run.entities.get(id)?.versions.iter();
        let versions: Vec<String> =
            versions.map(|(stamp, known)| format!("[{},{known}]", *stamp as f64 * 1e-9)).collect();
        Some(format!("[{}]", versions.join(",")))
    }

    /// All that a page needs at first, and what it has been told with it.
    pub(super) fn all(&self, paused: bool) -> Update {
        let run = self.0.lock();
        let numbers = run.numbers.iter().map(|(topic, track)| (topic.clone(), track.names.clone())).collect();
        let images = run.images.keys().cloned().collect();
        let first = First { header: run.header.clone(), active: run.active.clone(), numbers, images };
        let all = run.since(&PagePosition::default());
        Update { first: Some(first), told: PagePosition { paused, ..all.told }, ..all }
    }

    /// What is new since `told`, which goes on to now; `None` if nothing is.
    pub(super) fn news(&self, told: &mut PagePosition, paused: bool) -> Option<Update> {
        let run = self.0.lock();
        let before = std::mem::replace(told, PagePosition { paused, ..run.told() });
        (before != *told).then(|| Update { told: *told, ..run.since(&before) })
    }

    /// Where everything was at a time, ns.
    pub(super) fn poses(&self, stamp_ns: u64) -> Samples {
        self.0.lock().poses_at(stamp_ns, None)
    }

    /// A number over time, thinned to so many points, in pieces of `[s, value]`.
    pub(super) fn series(
        &self,
        topic: &str,
        name: &str,
        range: [f64; 2],
        points: usize,
    ) -> Option<Vec<Vec<[f64; 2]>>> {
        let (times, values) = self.0.lock().numbers.get(topic)?.series(name)?;
        Some(thinned(&times, &values, range, points))
    }

    /// The picture of the chart with these states closed, whose paths are joined by commas; without them as many are closed as a
    /// screen needs. Which these are, and SVG.
    pub(super) fn chart(&self, closed: Option<&str>) -> Option<(String, Vec<u8>)> {
        let outline = self.0.lock().outline.clone()?;
        let paths: Vec<String> = (0..outline.states.len()).map(|state| outline.path(state)).collect();
        let closed: BTreeSet<usize> = match closed {
            Some(list) => {
                let list: BTreeSet<&str> = list.split(',').collect();
                (1..paths.len()).filter(|state| list.contains(paths[*state].as_str())).collect()
            }
            None => levels_that_fit(&outline).map_or_else(BTreeSet::new, |levels| {
                let level = |state: usize| paths[state].split('.').count();
                (1..paths.len())
                    .filter(|s| level(*s) == levels && !outline.states[*s].children.is_empty())
                    .collect()
            }),
        };
        let shown = close(&outline, &|state| closed.contains(&state));
        let picture = render(&shown, Format::Svg, Theme::Auto).ok()?;
        let names: Vec<&str> = closed.iter().map(|state| paths[*state].as_str()).collect();
        Some((names.join(","), picture))
    }

    /// The topics that have images.
    pub(super) fn images(&self) -> Vec<String> {
        self.0.lock().images.keys().cloned().collect()
    }

    /// The image of a topic at a time, ns.
    pub(super) fn image(&self, topic: &str, stamp_ns: u64) -> Option<Jpeg> {
        let run = self.0.lock();
        let images = run.images.get(topic)?;
        let at = images.partition_point(|(stamp, _)| *stamp <= stamp_ns).saturating_sub(1);
        images.get(at).cloned()
    }
}

impl Run {
    fn told(&self) -> PagePosition {
        PagePosition {
            event: self.first + self.events.len() as u64,
            change: self.changes,
            pose_ns: self.poses.values().filter_map(|track| Some(track.last()?.0)).max(),
            end: self.ended.is_some(),
            paused: false,
        }
    }

    /// The poses at a time, each with its own time, s; of those that have changed after `since_ns`.
    fn poses_at(&self, stamp_ns: u64, since_ns: Option<u64>) -> Samples {
        let newer = |track: &SampleTrack| {
            since_ns.is_none_or(|since| track.last().is_some_and(|(last, _)| last > since))
        };
        let tracks = self.poses.iter().filter(|(_, track)| newer(track));
        let sample = |track: &SampleTrack| {
            let (stamp_ns, pose) = track.at(stamp_ns)?;
            Some([pose, &[(stamp_ns as f64 * 1e-9) as f32]].concat())
        };
        tracks.filter_map(|(frame, track)| Some((frame.clone(), sample(track)?))).collect()
    }

    /// What a page has not been told yet.
    fn since(&self, before: &PagePosition) -> Update {
        let skipped = usize::try_from(before.event.saturating_sub(self.first)).unwrap_or(usize::MAX);
        let changed = self.entities.iter().filter(|(_, entity)| entity.changed >= before.change);
        let newest =
            |(id, entity): (&String, &Entity)| Some((id.clone(), Arc::clone(&entity.versions.back()?.1)));
        let last = |(topic, track): (&String, &SampleTrack)| Some((topic.clone(), track.last()?.1.to_vec()));
        Update {
            first: None,
            now_ns: self.now_ns,
            from: before.event.max(self.first),
            events: self.events.iter().skip(skipped).cloned().collect(),
            poses: self.poses_at(u64::MAX, before.pose_ns),
            last: self.numbers.iter().filter_map(last).collect(),
            entities: changed.filter_map(newest).collect(),
            ended: self.ended.clone(),
            told: self.told(),
        }
    }

    fn event(&mut self, stamp_ns: u64, text: &str) {
        // What is none would break what a page reads.
        let Ok(What { item }) = serde_json::from_str(text) else { return };
        match (item.what.as_str(), item.state) {
            ("entered", Some(state)) => _ = self.active.insert(state, stamp_ns),
            ("exited", Some(state)) => _ = self.active.remove(&state),
            _ => {}
        }
        self.event_bytes += text.len();
        self.events.push_back((stamp_ns, text.into()));
        while self.events.len() > MOST_EVENTS
            || self.event_bytes > self.most_event_bytes.unwrap_or(MOST_EVENT_BYTES)
        {
            let Some(oldest) = self.events.pop_front() else { break };
            self.event_bytes -= oldest.1.len();
            self.first += 1;
        }
    }

    fn change(&mut self, stamp_ns: u64, text: &str) {
        let Ok(RecordedChange { entity, known }) = serde_json::from_str(text) else { return };
        if self.entities.len() >= MOST_ENTITIES && !self.entities.contains_key(&entity) {
            return;
        }
        let number = self.changes;
        self.changes += 1;
        self.entities.entry(entity).or_default().add(number, stamp_ns, &known.to_string());
    }

    fn pose(&mut self, topic: &str, stamp_ns: u64, pose: &Isometry3<f64>) {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        let names = || POSE.map(str::to_owned).to_vec();
        let frame = topic.rsplit('/').next().unwrap_or(topic);
        if let Some(track) = track(&mut self.poses, frame, PERIOD_NS[1], names) {
            track.push(stamp_ns, [t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
        }
    }

    fn json(&mut self, topic: &str, stamp_ns: u64, text: &str) {
        if self.numbers.get(topic).is_some_and(|track| !track.is_due(stamp_ns)) {
            return;
        }
        let Ok(content) = serde_json::from_str::<Json>(text) else { return };
        let mut found = Vec::new();
        numbers(&content, String::new(), &mut found);
        if found.is_empty() {
            return;
        }
        let names = || found.iter().map(|(name, _)| name.clone()).collect();
        if let Some(track) = track(&mut self.numbers, topic, PERIOD_NS[0], names) {
            track.push(stamp_ns, found.iter().map(|(_, number)| *number));
        }
    }

    fn image(&mut self, topic: &str, stamp_ns: u64, jpeg: &[u8]) {
        let images = self.images.entry(topic.to_owned()).or_default();
        if images.len() >= MOST_IMAGES {
            let mut even = false;
            images.retain(|_| {
                even = !even;
                even
            });
        }
        images.push_back((stamp_ns, jpeg.into()));
    }
}

/// The track of a topic, which is begun if it is new and there is room.
fn track<'t>(
    tracks: &'t mut BTreeMap<String, SampleTrack>,
    topic: &str,
    period_ns: u64,
    names: impl FnOnce() -> Vec<String>,
) -> Option<&'t mut SampleTrack> {
    if !tracks.contains_key(topic) {
        if tracks.len() >= MOST_TRACKS {
            return None;
        }
        tracks.insert(topic.to_owned(), SampleTrack::new(names(), period_ns));
    }
    tracks.get_mut(topic)
}

/// The part of an event that says which states are active.
#[derive(Deserialize)]
struct What {
    item: WhatItem,
}

#[derive(Deserialize)]
struct WhatItem {
    what: String,
    state: Option<String>,
}

/// All numbers of a JSON value with their names: `force[0]`.
fn numbers(value: &Json, name: String, found: &mut Vec<(String, f64)>) {
    match value {
        Json::Number(number) => found.extend(number.as_f64().map(|number| (name, number))),
        Json::Bool(set) => found.push((name, f64::from(u8::from(*set)))),
        Json::Array(items) => {
            for (at, item) in items.iter().enumerate() {
                numbers(item, format!("{name}[{at}]"), found);
            }
        }
        Json::Object(fields) => {
            for (field, value) in fields {
                let inner = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
                numbers(value, inner, found);
            }
        }
        Json::Null | Json::String(_) => {}
    }
}

impl MessageSink for Timeline {
    fn take(&self, stamp_ns: u64, message: &RunMessage<'_>) {
        let mut run = self.0.lock();
        run.now_ns = run.now_ns.max(stamp_ns);
        match *message {
            RunMessage::Json { topic: "/chart/events", text } => run.event(stamp_ns, text),
            RunMessage::Json { topic: MEMORY, text } => run.change(stamp_ns, text),
            RunMessage::Json { topic, text } => run.json(topic, stamp_ns, text),
            RunMessage::Pose { topic, pose } => run.pose(topic, stamp_ns, pose),
            RunMessage::Joints { names, position, .. } => {
                let names = || names.iter().map(ToString::to_string).collect();
                if let Some(track) = track(&mut run.numbers, "/robot/joints", PERIOD_NS[0], names) {
                    track.push(stamp_ns, position.iter().copied());
                }
            }
            RunMessage::Image { topic, jpeg } => run.image(topic, stamp_ns, jpeg),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn event(timeline: &Timeline, at: u64, what: &str, state: &str) {
        let text = json!({"at_ns": at, "item": {"what": what, "state": state}}).to_string();
        timeline.take(at, &RunMessage::Json { topic: "/chart/events", text: &text });
    }

    #[test]
    fn a_page_is_told_each_event_once_and_what_is_active_though_the_oldest_are_gone() {
        let timeline = Timeline::default();
        event(&timeline, 1, "entered", "Long");
        let mut told = PagePosition::default();
        assert!(timeline.news(&mut told, false).unwrap().events[0].1.contains("Long"));
        assert!(timeline.news(&mut told, false).is_none());
        for k in 0..MOST_EVENTS as u64 {
            event(&timeline, 2 + k, "entered", "Short");
            event(&timeline, 2 + k, "exited", "Short");
        }
        let all = timeline.all(false);
        assert_eq!((all.events.len(), all.from), (MOST_EVENTS, MOST_EVENTS as u64 + 1));
        assert_eq!(all.first.as_ref().unwrap().active, BTreeMap::from([("Long".to_owned(), 1)]));
        assert_eq!(
            timeline.news(&mut told, false).unwrap().from,
            all.from,
            "it sees that it has missed some"
        );
    }

    #[test]
    fn numbers_have_the_names_of_their_places() {
        let timeline = Timeline::default();
        let text = r#"{"force":[1.5,2,null],"held":true,"deep":{"x":-1}}"#;
        timeline.take(5, &RunMessage::Json { topic: "/robot/wrench", text });
        let all = timeline.all(false);
        assert_eq!(all.first.unwrap().numbers["/robot/wrench"], ["deep.x", "force[0]", "force[1]", "held"]);
        assert_eq!(
            timeline.series("/robot/wrench", "force[0]", [0.0, 1.0], 10),
            Some(vec![vec![[5e-9, 1.5]]])
        );
        assert_eq!(timeline.series("/robot/wrench", "nothing", [0.0, 1.0], 10), None);
    }
}
