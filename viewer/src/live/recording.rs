//! A run that has ended, as a page shows it: read from its recording. Nothing in the file is trusted; what is damaged ends it there.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::{Path, PathBuf};

use foxglove::Decode;
use foxglove::messages as fg;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde_json::Value as Json;

use super::timeline::Timeline;
use crate::recorder::{MessageSink as _, RunMessage};

/// The attachment with the sections of the report.
pub const REPORT: &str = "report.json";
/// Longest record that is read, bytes.
const MOST_BYTES: usize = 256 << 20;

/// Why a recording cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum ShowError {
    /// The file cannot be opened.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: std::io::Error },
    /// It has nothing of a run; `damage` is what is wrong with the file, if anything.
    #[error("{}: is no recording of a run{}; `armarium run` writes one, `run.mcap` beside its report", path.display(), damage.as_deref().map_or(String::new(), |damage| format!(" ({damage})")))]
    NoRun { path: PathBuf, damage: Option<String> },
}

impl Timeline {
    /// Reads a recording. Says what is damaged, if something is: what came before is there.
    ///
    /// # Errors
    /// [`ShowError`] when there is nothing to show.
    pub fn of_recording(path: &Path) -> Result<(Self, Option<String>), ShowError> {
        let file = File::open(path).map_err(|source| ShowError::File { path: path.into(), source })?;
        let mut reading = Reading { timeline: Self::default(), channels: BTreeMap::new(), messages: 0 };
        let damage = reading.all(file).err().map(|error| error.to_string());
        if reading.messages == 0 {
            return Err(ShowError::NoRun { path: path.into(), damage });
        }
        let unknown = || serde_json::json!({"outcome": "not known", "reason": "the recording ends before the run", "chain": []});
        let ended = reading.timeline.finished().unwrap_or_else(unknown);
        reading.timeline.end(ended);
        Ok((reading.timeline, damage))
    }
}

struct Reading {
    timeline: Timeline,
    /// The topics by their number.
    channels: BTreeMap<u16, String>,
    messages: u64,
}

impl Reading {
    fn all(&mut self, file: File) -> Result<(), mcap::McapError> {
        let mut file = BufReader::with_capacity(1 << 16, file);
        let mut reader = LinearReader::new_with_options(
            LinearReaderOptions::default().with_record_length_limit(MOST_BYTES),
        );
        while let Some(event) = reader.next_event() {
            let (opcode, data) = match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    // A corrupt length must not allocate more than this at once.
                    let read = file.read(reader.insert(wanted.min(1 << 20)))?;
                    reader.notify_read(read);
                    continue;
                }
                LinearReadEvent::Record { opcode, data } => (opcode, data),
            };
            match mcap::parse_record(opcode, data)? {
                Record::Channel(channel) => _ = self.channels.insert(channel.id, channel.topic),
                Record::Message { header, data } => self.message(header.channel_id, header.log_time, &data),
                Record::Attachment { header, data, .. } if header.name == "run.json" => {
                    // One of another version is shown without its chart.
                    if let Ok(known) = serde_json::from_slice(&data) {
                        self.timeline.begin(&known);
                        self.messages += 1;
                    }
                }
                Record::Attachment { header, data, .. } if header.name == REPORT => {
                    if let Ok(sections) = serde_json::from_slice(&data) {
                        self.timeline.report(sections);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn message(&mut self, channel: u16, stamp_ns: u64, data: &[u8]) {
        let Some(topic) = self.channels.get(&channel) else { return };
        self.messages += 1;
        let timeline = &self.timeline;
        match topic.as_str() {
            "/tf" => {
                let Ok(fg::FrameTransform { child_frame_id, translation, rotation, .. }) =
                    Decode::decode(data)
                else {
                    return;
                };
                let pose = isometry(translation, rotation);
                timeline.take(stamp_ns, &RunMessage::Pose { topic: &child_frame_id, pose: &pose });
            }
            "/robot/joints" => {
                let Ok(fg::JointStates { joints, .. }) = Decode::decode(data) else { return };
                let position: Vec<f64> =
                    joints.iter().map(|joint| joint.position.unwrap_or(f64::NAN)).collect();
                let names: Vec<String> = joints.into_iter().map(|joint| joint.name).collect();
                timeline.take(stamp_ns, &RunMessage::Joints { names: &names, position: &position });
            }
            _ if data.first() == Some(&b'{') => {
                let Ok(text) = std::str::from_utf8(data) else { return };
                timeline.take(stamp_ns, &RunMessage::Json { topic, text });
            }
            _ if topic.starts_with("/camera/") => {
                let Ok(fg::CompressedImage { data, .. }) = Decode::decode(data) else { return };
                timeline.take(stamp_ns, &RunMessage::Image { topic, jpeg: &data });
            }
            _ => {}
        }
    }
}

fn isometry(translation: Option<fg::Vector3>, rotation: Option<fg::Quaternion>) -> Isometry3<f64> {
    let t = translation.unwrap_or_default();
    let q = rotation.unwrap_or(fg::Quaternion { w: 1.0, ..Default::default() });
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    let turn = UnitQuaternion::try_new(q, 1e-9).unwrap_or_else(UnitQuaternion::identity);
    Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), turn)
}

/// How a run ended, from its last event.
pub(super) fn how_it_ended(events: impl DoubleEndedIterator<Item = impl AsRef<str>>) -> Option<Json> {
    let finished = events.rev().take(50).find_map(|text| {
        let item = serde_json::from_str::<Json>(text.as_ref()).ok()?.get_mut("item")?.take();
        (item.get("what")? == "finished").then_some(item)
    })?;
    Some(serde_json::json!({
        "outcome": finished.get("outcome"),
        "reason": finished.get("reason"),
        "chain": finished.get("chain"),
    }))
}
