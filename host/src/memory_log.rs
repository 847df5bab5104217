//! What the memories of several agents knew of one object, and when: a log that is written during the run, and the
//! report section made from it.
//!
//! The log subscribes to each memory's published changes; only the report compares it with the referee's truth.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_knowledge::{Origin, WORLD};
use armarium_memoryx::{Change, Follower, Memory, Pattern, Snapshot, place_of};
use armarium_simulator::referee::TruthLog;
use armarium_simulator::{Handle, World};
use armarium_values::Value;
use armarium_values::report::{Block, Cell, Section, Series, Table, TimePlot};
use nalgebra::{Isometry3, Point3};
use parking_lot::Mutex;
use serde_json::{Value as Json, json};

const MAX_ENTRIES: usize = 100_000;
/// Positions closer than this share a line of the report, m.
const SAME_PLACE: f64 = 0.01;
/// Time step of the plot, s.
const PLOT_STEP: f64 = 0.05;

const NOTE: &str = "What each agent's memory came to know, as it told others. Places are in the robot's root frame, set beside \
                    the simulator's truth of that moment; the plot takes what speaks of the latest time.";

/// A change in a memory.
#[derive(Clone, Debug)]
pub(crate) struct LoggedChange {
    /// The agent whose memory it is.
    pub(crate) agent: String,
    /// When it arrived, s of the run.
    pub(crate) at_s: f64,
    pub(crate) snapshot: Arc<Snapshot>,
}

/// Changes in memories, in order.
pub(crate) type MemoryLog = Arc<Mutex<Vec<LoggedChange>>>;

/// Logs a memory's changes of objects and their relations, until the memory closes.
pub(crate) async fn keep(agent: String, memory: Arc<dyn Memory>, clock: Handle, log: MemoryLog) {
    let mut follower = match Follower::from_start(memory, Pattern::any()).await {
        Ok(follower) => follower,
        Err(error) => {
            return tracing::warn!("the report has no section on the memory of `{agent}`: {error}");
        }
    };
    loop {
        let snapshot = match follower.next().await {
            Ok(Some(Change::New(snapshot))) => snapshot,
            Ok(Some(Change::Missed { .. })) => continue,
            Ok(None) => return,
            Err(error) => {
                tracing::warn!("the report's section on the memory of `{agent}` ends here: {error}");
                return;
            }
        };
        let at_s = clock.now_ns() as f64 * 1e-9;
        let mut log = log.lock();
        if ["ObjectInstances", "ObjectRelations"].contains(&snapshot.id.segment()) && log.len() < MAX_ENTRIES
        {
            log.push(LoggedChange { agent: agent.clone(), at_s, snapshot });
        }
    }
}

/// The report's section on the object that the robot grasped, by its index in the world's `objects`, for programs and for people.
pub(crate) fn section(
    log: &[LoggedChange],
    world: &World,
    object: Option<usize>,
    truth: &TruthLog,
) -> Option<(Json, Section)> {
    let object = object.or_else(|| world.first_object())?;
    let subject = world.body_name(object)?.to_owned();
    let truth = &TrueObject { log: truth, object };
    let frames = Frames::of(world);
    let known: Vec<Knowledge> =
        log.iter().filter_map(|e| Knowledge::of(e, &subject, &frames, truth)).collect();
    let rows: Vec<Json> = known.iter().map(Knowledge::json).collect();
    let mut blocks: Vec<Block> = distance(&known, truth).map(Block::Plot).into_iter().collect();
    blocks.push(Block::Table(table(&known)));
    let section = Section::new(&format!("Memories of the {subject}"), NOTE, blocks);
    Some((json!({"subject": subject, "rows": rows}), section))
}

/// The agents' root frames in the robot's root frame.
struct Frames(BTreeMap<String, Isometry3<f64>>);

impl Frames {
    fn of(world: &World) -> Self {
        let others = world.agents.iter().map(|agent| (agent.name.clone(), agent.root_from_agent()));
        Self(others.chain([(world.robot.name.clone(), Isometry3::identity())]).collect())
    }

    /// The position in a memory's snapshot, in the robot's root frame.
    fn place(&self, agent: &str, snapshot: &Snapshot) -> Option<Point3<f64>> {
        let (frame, place) = place_of(snapshot)?;
        let whose = match frame.0.strip_suffix("/root") {
            Some(other) => other,
            None if frame.0 == "root" => agent,
            // The simulated world's frame is the robot's root frame.
            None if frame.0 == WORLD => return Some(Point3::from(place)),
            None => return None,
        };
        Some(self.0.get(whose)? * Point3::from(place))
    }
}

/// An entry about the object.
struct Knowledge<'d> {
    agent: &'d str,
    at_s: f64,
    seen_s: f64,
    id: &'d str,
    origin: &'d str,
    says: String,
    place: Option<Point3<f64>>,
    confidence: f64,
    error_m: Option<f64>,
}

impl<'d> Knowledge<'d> {
    fn of(entry: &'d LoggedChange, subject: &str, frames: &Frames, truth: &TrueObject<'_>) -> Option<Self> {
        let snapshot = &*entry.snapshot;
        let text = |name: &str| snapshot.attribute(name).and_then(Value::as_str);
        let says = if text("class") == Some(subject) {
            text("attached_to").map_or("seen".to_owned(), |hand| format!("in {hand}"))
        } else {
            let of = text("subject")?;
            (of.rsplit('/').next() == Some(subject)).then_some(())?;
            format!("{subject} {} {}", text("relation")?, text("object")?)
        };
        let place = frames.place(&entry.agent, snapshot);
        let error_m = place.and_then(|place| Some((place - truth.place(entry.at_s)?).norm()));
        Some(Self {
            agent: &entry.agent,
            at_s: entry.at_s,
            seen_s: snapshot.referenced_ns as f64 * 1e-9,
            id: snapshot.id.as_str(),
            origin: Origin::agent_of(snapshot).unwrap_or(&entry.agent),
            says,
            place,
            confidence: snapshot.instance().map_or(0.0, |instance| instance.confidence),
            error_m,
        })
    }

    fn json(&self) -> Json {
        json!({
            "agent": self.agent,
            "at_s": self.at_s,
            "seen_s": self.seen_s,
            "id": self.id,
            "origin": self.origin,
            "says": self.says,
            "position": self.place.map(|p| [p.x, p.y, p.z]),
            "confidence": self.confidence,
            "error_m": self.error_m,
        })
    }
}

/// Where the object truly is.
struct TrueObject<'t> {
    log: &'t TruthLog,
    object: usize,
}

impl TrueObject<'_> {
    fn place(&self, t_s: f64) -> Option<Point3<f64>> {
        let pose = self.log.object_at(self.object, (t_s.max(0.0) * 1e9) as u64)?;
        Some(Point3::from(pose.translation.vector))
    }
}

/// A change that a memory received once, or several times in a row.
struct RepeatedChange<'k> {
    first: &'k Knowledge<'k>,
    until_s: f64,
    count: usize,
}

/// One row for a change that a memory received repeatedly.
fn table(known: &[Knowledge<'_>]) -> Table {
    let mut heard: Vec<RepeatedChange<'_>> = Vec::new();
    let mut last: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for k in known {
        let same = last.get(&(k.agent, k.id)).and_then(|&at| heard.get_mut(at)).filter(|heard| {
            let moved = heard.first.place.zip(k.place).map_or(0.0, |(a, b)| (a - b).norm());
            heard.first.says == k.says && moved < SAME_PLACE
        });
        if let Some(same) = same {
            (same.until_s, same.count) = (k.at_s, same.count + 1);
            continue;
        }
        last.insert((k.agent, k.id), heard.len());
        heard.push(RepeatedChange { first: k, until_s: k.at_s, count: 1 });
    }
    let titles =
        ["Memory of", "#When", "#Times", "Entity", "Found by", "Says", "#At x, y, z", "#Trusted", "#Off by"];
    Table { rows: heard.iter().map(RepeatedChange::row).collect(), ..Table::new(&titles) }
}

impl RepeatedChange<'_> {
    fn row(&self) -> Vec<Cell> {
        let k = self.first;
        let when = if self.count > 1 {
            format!("{:.1}\u{a0}–\u{a0}{:.1}\u{a0}s", k.at_s, self.until_s)
        } else {
            format!("{:.1}\u{a0}s", k.at_s)
        };
        // The core segment is omitted: the content shows whether it is an object or a relation.
        let entity = k.id.split_once('/').map_or(k.id, |(_, entity)| entity);
        let place =
            k.place.map(|p| Cell::Numbers { values: vec![p.x, p.y, p.z], unit: "m".into(), digits: 3 });
        vec![
            Cell::Text(k.agent.into()),
            Cell::Text(when),
            Cell::number(self.count as f64, "", 0),
            Cell::Code(entity.into()),
            Cell::Text(k.origin.into()),
            Cell::Text(k.says.clone()),
            place.unwrap_or(Cell::Absent),
            Cell::number(k.confidence * 100.0, "%", 0),
            Cell::optional(k.error_m.map(|e| e * 1e3), "mm", 0),
        ]
    }
}

/// The distance of each agent's newest position from the true one.
fn distance(known: &[Knowledge<'_>], truth: &TrueObject<'_>) -> Option<TimePlot> {
    let end_s = truth.log.records.last()?.stamp_ns as f64 * 1e-9;
    let mut agents: Vec<&str> = known.iter().map(|k| k.agent).collect();
    agents.sort_unstable();
    agents.dedup();
    let series = agents.into_iter().map(|agent| {
        let mut heard = known.iter().filter(|k| k.agent == agent && k.place.is_some()).peekable();
        let mut newest: Option<&Knowledge<'_>> = None;
        let (mut t_s, mut y) = (Vec::new(), Vec::new());
        for step in 0..=((end_s / PLOT_STEP) as u32) {
            let t = f64::from(step) * PLOT_STEP;
            while let Some(k) = heard.next_if(|k| k.at_s <= t) {
                // The entry with the latest observation time counts, whichever agent observed it.
                newest = newest.filter(|n| n.seen_s > k.seen_s).or(Some(k));
            }
            let off = newest.and_then(|k| Some((k.place? - truth.place(t)?).norm() * 1e3));
            t_s.push(t);
            y.push(off.unwrap_or(f64::NAN));
        }
        Series { label: agent.to_owned(), t_s, y }
    });
    let in_hand = known.iter().filter(|k| k.place.is_some() && k.says.starts_with("in "));
    let mut marks: Vec<(f64, String)> = Vec::new();
    for k in in_hand {
        let name = format!("{}: {}", k.agent, k.says);
        if marks.iter().all(|(_, other)| *other != name) {
            marks.push((k.at_s, name));
        }
    }
    Some(TimePlot {
        title: "How far memory was from the truth".into(),
        y_label: "Distance, mm".into(),
        series: series.collect(),
        marks,
        ..TimePlot::default()
    })
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::Instance;
    use armarium_simulator::referee::Record;
    use armarium_simulator::world::AgentSpec;
    use armarium_values::Pose;

    use super::*;

    fn world() -> World {
        let (at, looks_at) = ([0.0, 2.0, 1.5], [0.0, 0.0, 1.0]);
        let alice = AgentSpec { name: "alice".into(), at, looks_at, rate: 5.0, runs: None };
        let mut world = World { agents: vec![alice], ..World::default() };
        world.robot.name = "bob".into();
        world
    }

    fn truth(end_ms: u64) -> TruthLog {
        let record = |ms: u64| Record {
            stamp_ns: ms * 1_000_000,
            tcp: Isometry3::identity(),
            object: Some((0, Isometry3::translation(0.3, 0.5, 1.0))),
            normal: 0.0,
            tangential: 0.0,
            tool: None,
            fastest_joint: 0.0,
        };
        let mut log = TruthLog::default();
        log.records.extend((0..=end_ms).map(record));
        log
    }

    /// An entry that arrived at `at_s` in an agent's memory, observed at that time.
    fn entry(agent: &str, id: &str, at_s: f64, place: [f64; 3], attached_to: Option<&str>) -> LoggedChange {
        let pose = Pose::new("root".into(), &Isometry3::translation(place[0], place[1], place[2]));
        let mut attributes = BTreeMap::from([
            ("class".to_owned(), Value::from("sponge")),
            ("pose".to_owned(), Value::Pose(pose)),
        ]);
        if let Some(hand) = attached_to {
            attributes.insert("attached_to".into(), Value::from(hand));
        }
        let snapshot = Snapshot {
            id: id.parse().unwrap(),
            version: 1,
            referenced_ns: (at_s * 1e9) as u64,
            sent_ns: 0,
            arrived_ns: 0,
            instances: vec![Instance::new(attributes)],
        };
        LoggedChange { agent: agent.into(), at_s, snapshot: Arc::new(snapshot) }
    }

    #[test]
    fn what_each_memory_knew_is_told_in_one_frame_and_held_against_the_truth() {
        let own = "ObjectInstances/alice/sponge";
        let log = [
            // Alice stands opposite: her x points to the robot's left, her y towards the robot.
            entry("alice", own, 0.5, [-0.3, 1.5, 1.01], None),
            entry("alice", own, 0.7, [-0.301, 1.5, 1.01], None),
            entry("bob", "ObjectInstances/alice.alice/sponge", 0.7, [0.3, 0.5, 1.02], None),
            entry("alice", "ObjectInstances/bob.bob/sponge", 1.2, [-0.3, 1.5, 1.0], Some("bob/right_hand")),
        ];
        let (json, page) = section(&log, &world(), None, &truth(2000)).unwrap();
        let rows = json["rows"].as_array().unwrap();
        assert!((rows[0]["error_m"].as_f64().unwrap() - 0.01).abs() < 1e-9, "{json}");
        assert!((rows[2]["error_m"].as_f64().unwrap() - 0.02).abs() < 1e-9, "{json}");
        assert_eq!(rows[3]["says"], "in bob/right_hand");
        let Some(Block::Table(table)) = page.blocks.last() else { panic!("there is a table") };
        let number = |value: f64| Cell::number(value, "", 0);
        let lines: Vec<_> = table.rows.iter().map(|row| (row[5].clone(), row[2].clone())).collect();
        let says = |what: &str, times: f64| (Cell::Text(what.into()), number(times));
        assert_eq!(lines, [says("seen", 2.0), says("seen", 1.0), says("in bob/right_hand", 1.0)]);
        assert_eq!(table.rows[0][1], Cell::Text("0.5\u{a0}–\u{a0}0.7\u{a0}s".into()));
        let Some(Block::Plot(plot)) = page.blocks.first() else { panic!("there is a plot") };
        assert_eq!(plot.series.iter().map(|s| s.label.as_str()).collect::<Vec<_>>(), ["alice", "bob"]);
        let alice = &plot.series[0].y;
        assert!(alice[0].is_nan() && (alice[12] - 10.0).abs() < 1e-6 && alice[30].abs() < 1e-6, "{alice:?}");
        assert_eq!(plot.marks, [(1.2, "alice: in bob/right_hand".to_owned())]);
    }

    #[test]
    fn other_things_are_left_out() {
        let mut other = entry("bob", "ObjectInstances/bob/cup", 0.5, [0.0; 3], None);
        let instance = Instance::new([("class", Value::from("cup"))]);
        other.snapshot = Arc::new(Snapshot { instances: vec![instance], ..(*other.snapshot).clone() });
        let (json, page) = section(&[other], &world(), Some(0), &truth(10)).unwrap();
        assert_eq!(json["rows"].as_array().map(Vec::len), Some(0));
        assert!(matches!(page.blocks.last(), Some(Block::Table(table)) if table.rows.is_empty()));
    }
}
