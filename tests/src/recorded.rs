//! Reads a run from `run.mcap` with independent code, as anyone with an MCAP library could.
//!
//! [`read`] gives the truth, the marks and the vision results. The referee's pure functions recompute the figures
//! from them, and [`disagreements`] compares those with a report. Reading never uses `report.json`.

use std::collections::BTreeMap;
use std::path::Path;

use armarium_simulator::coach::{ActionEvent, ActionKind, EventKind};
use armarium_simulator::referee::{Record, TruthLog, measure};
use armarium_simulator::truth::FrameTruth;
use armarium_simulator::world::Gesture;
use armarium_simulator::{Milestone, World};
use nalgebra::{Isometry3, Quaternion, Translation3, Unit};
use serde_json::Value;

/// The contents of a recording.
#[derive(Debug)]
pub struct Recorded {
    /// The world, from its attachment.
    pub world: World,
    /// The truth at every step.
    pub log: TruthLog,
    /// When the parts of the scenario began and ended, from the chart's events.
    pub marks: Vec<(u64, Milestone)>,
    /// Gestures that vision recognised, by the frame's time, ns.
    pub seen: Vec<(u64, Option<String>)>,
}

impl Recorded {
    /// The recomputed figures.
    pub fn figures(&self) -> Value {
        measure(&self.world, &self.log, &self.marks, &self.seen).into()
    }
}

/// Reads a recording.
///
/// # Errors
/// What is wrong with the file, as a sentence.
pub fn read(path: &Path) -> Result<Recorded, String> {
    let data = std::fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut steps: BTreeMap<u64, Step> = BTreeMap::new();
    let mut grasped: BTreeMap<u64, String> = BTreeMap::new();
    let mut recorded =
        Recorded { world: world(&data)?, log: TruthLog::default(), marks: Vec::new(), seen: Vec::new() };
    for message in mcap::MessageStream::new(&data).map_err(|e| e.to_string())? {
        let message = message.map_err(|e| e.to_string())?;
        let t = message.log_time;
        let json = || serde_json::from_slice::<Value>(&message.data).map_err(|e| e.to_string());
        match message.channel.topic.as_str() {
            "/truth/tcp" => steps.entry(t).or_default().tcp = pose(&message.data),
            "/truth/sponge" => steps.entry(t).or_default().object = pose(&message.data),
            "/truth/contact" => {
                let contact = json()?;
                let step = steps.entry(t).or_default();
                step.normal = contact["normal_n"].as_f64();
                step.tangential = contact["tangential_n"].as_f64();
            }
            "/truth/hand" => recorded.log.frames.extend(frame(&json()?)),
            "/truth/events" => {
                let event = json()?;
                grasped.extend(name_of_grasped(&event).map(|name| (t, name)));
                recorded.log.coach.extend(action(&event));
            }
            "/truth/marks" => recorded.marks.extend(mark(&json()?).map(|mark| (t, mark))),
            "/vision/hand" => {
                let seen = json()?["gesture"].as_str().filter(|g| *g != "none").map(str::to_owned);
                recorded.seen.push((t, seen));
            }
            _ => {}
        }
    }
    let world = &recorded.world;
    let object = |t: u64| match grasped.range(..=t).next_back() {
        Some((_, name)) => world.objects.iter().position(|object| object.name == *name),
        None => world.first_object(),
    };
    recorded.log.records = steps.into_iter().filter_map(|(t, step)| step.record(t, object(t))).collect();
    Ok(recorded)
}

fn world(data: &[u8]) -> Result<World, String> {
    let summary = mcap::Summary::read(data).map_err(|e| e.to_string())?.ok_or("there is no summary")?;
    let index = summary.attachment_indexes.iter().find(|a| a.name == "world.json");
    let attached = mcap::read::attachment(data, index.ok_or("no world is attached")?);
    let attached = attached.map_err(|e| e.to_string())?;
    let text = std::str::from_utf8(&attached.data).map_err(|e| e.to_string())?;
    World::parse(Path::new("world.json"), text).map_err(|errors| format!("{errors:?}"))
}

#[derive(Default)]
struct Step {
    tcp: Option<Isometry3<f64>>,
    object: Option<Isometry3<f64>>,
    normal: Option<f64>,
    tangential: Option<f64>,
}

impl Step {
    fn record(self, stamp_ns: u64, object: Option<usize>) -> Option<Record> {
        let (normal, tangential) = (self.normal?, self.tangential?);
        let object = object.zip(self.object);
        // The true speeds of the joints are not in the recording.
        let fastest_joint = f64::INFINITY;
        Some(Record { stamp_ns, tcp: self.tcp?, object, normal, tangential, tool: None, fastest_joint })
    }
}

/// A field of a protobuf message: its number and its content.
enum Content<'a> {
    Double(f64),
    Bytes(&'a [u8]),
    Other,
}

/// The fields of a protobuf message, up to the first damaged one.
fn fields(mut data: &[u8]) -> Vec<(u64, Content<'_>)> {
    let mut found = Vec::new();
    while let Some((key, rest)) = varint(data) {
        let (content, rest) = match key & 7 {
            0 => match varint(rest) {
                Some((_, rest)) => (Content::Other, rest),
                None => break,
            },
            1 => match rest.split_first_chunk::<8>() {
                Some((bytes, rest)) => (Content::Double(f64::from_le_bytes(*bytes)), rest),
                None => break,
            },
            2 => match varint(rest) {
                Some((length, rest)) if length <= rest.len() as u64 => {
                    let (bytes, rest) = rest.split_at(length as usize);
                    (Content::Bytes(bytes), rest)
                }
                _ => break,
            },
            5 if rest.len() >= 4 => (Content::Other, &rest[4..]),
            _ => break,
        };
        found.push((key >> 3, content));
        data = rest;
    }
    found
}

fn varint(data: &[u8]) -> Option<(u64, &[u8])> {
    let mut value = 0;
    for (i, byte) in data.iter().enumerate().take(10) {
        value |= u64::from(byte & 127) << (7 * i);
        if byte & 128 == 0 {
            return Some((value, &data[i + 1..]));
        }
    }
    None
}

fn inner(data: &[u8], number: u64) -> Option<&[u8]> {
    fields(data).into_iter().find_map(|(n, content)| match content {
        Content::Bytes(bytes) if n == number => Some(bytes),
        _ => None,
    })
}

/// Fields 1 to `N` as numbers; a missing field is 0.
fn numbers<const N: usize>(data: &[u8]) -> [f64; N] {
    let mut numbers = [0.0; N];
    for (n, content) in fields(data) {
        if let (Content::Double(value), Some(i)) = (content, n.checked_sub(1))
            && let Some(number) = numbers.get_mut(i as usize)
        {
            *number = value;
        }
    }
    numbers
}

/// The pose of a `foxglove.PoseInFrame`.
fn pose(data: &[u8]) -> Option<Isometry3<f64>> {
    let pose = inner(data, 3)?;
    let [x, y, z] = numbers(inner(pose, 1)?);
    let [qx, qy, qz, qw] = numbers(inner(pose, 2)?);
    let rotation = Unit::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6)?;
    Some(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn gesture(name: &str) -> Option<Gesture> {
    match name {
        "fist" => Some(Gesture::Fist),
        "point_one" => Some(Gesture::PointOne),
        "point_two" => Some(Gesture::PointTwo),
        "open_hand" => Some(Gesture::OpenHand),
        _ => None,
    }
}

fn frame(json: &Value) -> Option<FrameTruth> {
    Some(FrameTruth {
        stamp_ns: json["stamp_ns"].as_u64()?,
        gesture: json["gesture"].as_str().and_then(gesture),
        since_s: json["since_s"].as_f64()?,
        visible: json["visible"].as_bool()?,
        root_from_left: Isometry3::identity(),
    })
}

/// The object that the hand took.
fn name_of_grasped(json: &Value) -> Option<String> {
    Some(json.get("detail").filter(|_| json["what"] == "grasped")?.as_str()?.to_owned())
}

fn action(json: &Value) -> Option<ActionEvent> {
    let detail = json.get("detail").filter(|_| json["what"] == "coach")?;
    let kind = match detail["kind"]["gesture"].as_str() {
        Some(name) => ActionKind::Gesture(gesture(name)?),
        None => ActionKind::Push,
    };
    let event = match detail["event"].as_str() {
        Some("began") => EventKind::Began,
        Some("leaves") => EventKind::Leaves,
        Some("ended") => EventKind::Ended,
        _ => {
            let palm = &detail["event"]["arrived"]["palm"];
            EventKind::Arrived { palm: [palm[0].as_f64()?, palm[1].as_f64()?, palm[2].as_f64()?] }
        }
    };
    Some(ActionEvent {
        step: usize::try_from(detail["step"].as_u64()?).ok()?,
        kind,
        event,
        t: detail["t"].as_f64()?,
    })
}

/// A mark set by a skill.
fn mark(message: &Value) -> Option<Milestone> {
    let numbers = message["numbers"].as_object()?.iter();
    let numbers = numbers.filter_map(|(name, value)| Some((name.clone(), value.as_f64()?))).collect();
    Milestone::named(message["mark"].as_str()?, &numbers)
}

/// Figures whose values in a report and in the recomputation differ by more than the recording's rounding explains.
pub fn disagreements(report: &Value, again: &Value) -> Vec<String> {
    let mut found = Vec::new();
    for section in ["grasp", "imitation", "force", "wiped_fraction", "coaching", "gestures"] {
        compare(section, &report[section], &again[section], &mut found);
    }
    found
}

/// Tolerance of a figure: positions are rounded to a micrometre and forces to a millinewton, and a threshold may be
/// passed one step earlier.
fn tolerance(name: &str) -> f64 {
    match name {
        "wiped_fraction" | "slowed_to" | "contact_lost_s" => 2e-3,
        "direction_error_deg" => 0.05,
        _ if name.ends_with("_n") => 2e-3,
        _ => 2e-5,
    }
}

fn compare(name: &str, reported: &Value, again: &Value, found: &mut Vec<String>) {
    let last = name.rsplit('.').find(|part| part.parse::<usize>().is_err()).unwrap_or(name);
    match (reported, again) {
        (_, Value::Object(fields)) => {
            for (key, value) in fields {
                compare(&format!("{name}.{key}"), &reported[key.as_str()], value, found);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                compare(&format!("{name}.{i}"), a, b, found);
            }
        }
        (Value::Number(a), Value::Number(b)) => {
            let apart = a.as_f64().zip(b.as_f64()).map_or(f64::INFINITY, |(a, b)| (a - b).abs());
            if apart > tolerance(last) {
                found.push(format!("`{name}` is {a} in the report and {b} in the recording"));
            }
        }
        (a, b) if a == b => {}
        (a, b) => found.push(format!("`{name}` is {a} in the report and {b} in the recording")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_recording_of_an_earlier_version_is_still_read() {
        let file = crate::repository::root().join("tests/earlier/run.mcap");
        let recorded = read(&file).expect("it is a recording");
        assert!(recorded.log.records.len() > 50, "{} steps", recorded.log.records.len());
        assert_eq!(recorded.world.name, "kitchen");
    }

    #[test]
    fn a_figure_that_differs_is_named_and_rounding_is_not() {
        let again = json!({"wiped_fraction": 0.96});
        let report = |wiped: Value| json!({"wiped_fraction": wiped});
        assert_eq!(disagreements(&report(json!(0.9611)), &again), Vec::<String>::new());
        assert_eq!(disagreements(&report(json!(0.963)), &again).len(), 1);
        assert_eq!(disagreements(&report(Value::Null), &again).len(), 1);
        assert_eq!(disagreements(&json!({"wiped_fraction": 0.96, "coaching": [{}]}), &again).len(), 1);
    }

    #[test]
    fn what_is_cut_off_in_a_message_is_left_out() {
        let mut message = vec![9];
        message.extend(1.5_f64.to_le_bytes());
        assert_eq!(numbers::<2>(&message), [1.5, 0.0]);
        assert_eq!(numbers::<2>(&message[..5]), [0.0, 0.0]);
        assert!(inner(&[26, 200], 3).is_none() && pose(&[255; 12]).is_none());
    }
}
