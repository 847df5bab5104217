//! Records a run while it happens: the recording, the digest that shows whether two runs are identical, and a few
//! camera images for the report.
//!
//! The recording has the referee's truth beside what the robot sensed; nothing flows back.

use std::path::Path;
use std::sync::Arc;

use armarium_bus::codec;
use armarium_robot::{Kinematics, Robot};
use armarium_simulator::physics::PressedLoad;
use armarium_simulator::truth::FrameTruth;
use armarium_simulator::{TruthEvent, TruthSample, TruthSink, World};
use armarium_values::report::{Block, Section};
use armarium_viewer::live::{REPORT, RunHeader};
use armarium_viewer::recorder::{Recorder, RecorderError, TrueContact, WrenchSample};
use nalgebra::Isometry3;
use parking_lot::Mutex;
use serde::Serialize;
use sha2::{Digest as _, Sha256};
use tokio::task::JoinHandle;

/// The recording of a run, which several tasks write to; clones are the same recording. A write that fails, or one over
/// the limit, ends it with one warning. The run goes on.
#[derive(Clone, Default)]
pub(crate) struct SharedRecorder(Arc<Mutex<Recording>>);

#[derive(Default)]
struct Recording {
    recorder: Option<Recorder>,
    /// Whether it ended because it could not be written.
    failed: bool,
}

impl SharedRecorder {
    pub(crate) fn begin(&self, recorder: Recorder) {
        self.0.lock().recorder = Some(recorder);
    }

    /// Writes to it, while there is one.
    pub(crate) fn write(&self, write: impl FnOnce(&mut Recorder) -> Result<(), RecorderError>) {
        let mut recording = self.0.lock();
        let Some(recorder) = recording.recorder.as_mut() else { return };
        if let Err(error) = write(recorder).and_then(|()| recorder.health()) {
            tracing::warn!("the recording ends here: {}", with_causes(&error));
            *recording = Recording { recorder: None, failed: true };
        }
    }

    /// Ends it before the run does, and says why.
    pub(crate) fn end(&self, why: &str) {
        let ended = self.0.lock().recorder.take();
        if let Some(recorder) = ended {
            match recorder.finish() {
                Ok(()) => tracing::warn!("the recording ends here: {why}"),
                Err(error) => tracing::warn!("the recording ends here: {why}; {}", with_causes(&error)),
            }
        }
    }

    /// Ends it. Returns whether all of it was written.
    pub(crate) fn finish(&self) -> bool {
        let mut recording = self.0.lock();
        if let Some(recorder) = recording.recorder.take()
            && let Err(error) = recorder.finish()
        {
            tracing::warn!("the end of the recording is missing: {}", with_causes(&error));
            recording.failed = true;
        }
        !recording.failed
    }
}

/// An error with what caused it: `cannot write the recording: no space left on device`.
fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let mut said: Vec<String> = Vec::new();
    for cause in causes.map(ToString::to_string) {
        if !said.iter().any(|said| said.contains(&cause)) {
            said.push(cause);
        }
    }
    said.join(": ")
}

/// SHA-256 over the canonical CBOR of all engine events, configurations and joint commands.
#[derive(Clone, Default)]
pub(crate) struct RunDigest {
    state: Arc<Mutex<Sha256>>,
}

impl RunDigest {
    pub(crate) fn add(&self, what: &impl Serialize) {
        // Encoding fails only for values that CBOR cannot hold; these are missing from the digest of every run.
        if let Ok(bytes) = codec::encode(what) {
            self.state.lock().update(&bytes);
        }
    }

    /// The digest so far, in hexadecimal digits.
    pub(crate) fn hex(&self) -> String {
        let digest = self.state.lock().clone().finalize();
        digest.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl TruthSink for RunDigest {
    fn sample(&mut self, sample: &TruthSample) {
        self.add(&(sample.stamp_ns, &sample.command_position, &sample.command_velocity));
    }
}

/// Least time between two transforms of the same frame on `/tf`, ns.
const TRANSFORMS_NS: u64 = 50_000_000;

/// What a person who leads a hand of the robot does to it: force, N, and torque about its TCP, N m, root frame.
#[derive(Serialize)]
struct TrueLead {
    /// The robot's arm, by its index among its arms.
    arm: usize,
    force: [f64; 3],
    torque: [f64; 3],
}

/// What both hands do to what they press between them, and what else bears it.
#[derive(Serialize)]
struct TruePress {
    /// The body, by its index among the world's.
    body: usize,
    /// Where each hand presses, m, and its force on the body, N, root frame.
    at: [[f64; 3]; 2],
    force: [[f64; 3]; 2],
    /// The force upwards of what it stands on, the table or a static body, N.
    borne_n: f64,
}

/// The frame of a part of a person.
pub(crate) fn person_part(person: usize, part: usize) -> String {
    format!("person{person}_{part}")
}

/// Writes the truth into the recording.
pub(crate) struct TruthTopics {
    recorder: SharedRecorder,
    bodies: Vec<String>,
    /// When they are due again, ns.
    next_ns: u64,
}

impl TruthTopics {
    pub(crate) fn new(recorder: SharedRecorder, bodies: Vec<String>) -> Self {
        Self { recorder, bodies, next_ns: 0 }
    }
}

impl TruthSink for TruthTopics {
    fn sample(&mut self, sample: &TruthSample) {
        let t = sample.stamp_ns;
        let due = t >= self.next_ns;
        if due {
            self.next_ns = t + TRANSFORMS_NS;
        }
        let bodies = self.bodies.iter().zip(&sample.objects).filter(|_| due);
        self.recorder.write(|recorder| {
            bodies.for_each(|(body, pose)| recorder.transform(body, t, pose));
            for (person, parts) in sample.people_parts.iter().enumerate().filter(|_| due) {
                for (part, pose) in parts.iter().enumerate() {
                    recorder.transform(&person_part(person, part), t, pose);
                }
            }
            recorder.pose("/truth/tcp", t, &sample.tcp);
            if let Some((_, object)) = &sample.object_pose() {
                recorder.pose("/truth/sponge", t, object);
            }
            let coach = sample.coach.hand.as_ref().map(|hand| hand.root_from_hand).or(sample.coach.tool);
            if let Some(coach) = coach {
                let coach: Isometry3<f64> = coach;
                recorder.pose("/truth/coach", t, &coach);
            }
            if let Some(PressedLoad { body, hands, borne_n, .. }) = sample.pressed {
                let (at, force) = (hands.map(|hand| hand.at.into()), hands.map(|hand| hand.force.into()));
                recorder.json("/truth/pressed", t, &TruePress { body, at, force, borne_n })?;
            }
            for led in &sample.led {
                let led = TrueLead { arm: led.arm, force: led.force.into(), torque: led.torque.into() };
                recorder.json("/truth/led", t, &led)?;
            }
            let contact = TrueContact {
                normal_n: sample.contact.normal,
                tangential_n: sample.contact.tangential.norm(),
            };
            recorder.contact(t, &contact)
        });
    }

    fn frame(&mut self, frame: &FrameTruth) {
        self.recorder.write(|recorder| recorder.json("/truth/hand", frame.stamp_ns, frame));
    }

    fn event(&mut self, stamp_ns: u64, event: &TruthEvent) {
        self.recorder.write(|recorder| recorder.json("/truth/events", stamp_ns, event));
    }
}

/// Stores the sources of the run in the recording: the chart's text, the whole world with its defaults, as a file
/// that `--world` reads, and what a page needs to show the run.
pub(crate) fn attach_sources(
    recorder: &mut Recorder,
    chart: &Path,
    world: &World,
    header: &RunHeader,
) -> Result<(), RecorderError> {
    // The chart was read a moment ago; if it has been deleted since, the run continues.
    if let Ok(text) = std::fs::read(chart) {
        recorder.attach("chart.yaml", "application/yaml", &text)?;
    }
    recorder.attach("world.json", "application/json", world_text(world).as_bytes())?;
    let header = serde_json::to_vec(header).unwrap_or_default();
    recorder.attach("run.json", "application/json", &header)
}

/// Adds the report, so that it can be seen with the recording; its pictures are in the recording anyway.
pub(crate) fn attach_report(recorder: &mut Recorder, sections: &[Section]) -> Result<(), RecorderError> {
    let mut sections = sections.to_vec();
    for section in &mut sections {
        section.blocks.retain(|block| !matches!(block, Block::Pictures(_)));
    }
    sections.retain(|section| !section.blocks.is_empty());
    recorder.attach(REPORT, "application/json", &serde_json::to_vec(&sections).unwrap_or_default())
}

/// A world as the text of a world file.
pub(crate) fn world_text(world: &World) -> String {
    let mut world = serde_json::to_value(world).unwrap_or_default();
    omit_nulls(&mut world);
    format!("{world:#}")
}

/// Removes nulls: world files omit absent things, except a coach who never demonstrates.
fn omit_nulls(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Object(map) => {
            map.retain(|key, value| !value.is_null() || key == "demonstration");
            map.values_mut().for_each(omit_nulls);
        }
        serde_json::Value::Array(items) => items.iter_mut().for_each(omit_nulls),
        _ => {}
    }
}

/// Writes what the robot senses into the recording, until the robot stops: its joints, and the wrench sensor of the arm that
/// works.
pub(crate) fn record_robot(
    robot: &Arc<dyn Robot>,
    sensor: Option<usize>,
    recorder: SharedRecorder,
) -> JoinHandle<()> {
    let names: Vec<String> = robot.model().joints().iter().map(|joint| joint.name.clone()).collect();
    let mut sensed = robot.sensed();
    let mut links = Links { kinematics: Kinematics::new(robot.model()), next_ns: 0 };
    tokio::spawn(async move {
        while sensed.changed().await.is_ok() {
            let sample = Arc::clone(&sensed.borrow_and_update());
            let felt = sensor.and_then(|sensor| sample.wrenches.get(sensor));
            let wrench = felt.map(|felt| WrenchSample {
                force_raw: felt.raw.force.into(),
                torque_raw: felt.raw.torque.into(),
                force: felt.external.force.into(),
                torque: felt.external.torque.into(),
            });
            recorder.write(|recorder| {
                recorder.joints(sample.stamp_ns, &names, &sample.position, &sample.velocity);
                links.record(sample.stamp_ns, &sample.position, recorder);
                match &wrench {
                    Some(wrench) => recorder.wrench(sample.stamp_ns, wrench),
                    None => Ok(()),
                }
            });
        }
    })
}

/// Where the links are that can be seen.
struct Links {
    kinematics: Kinematics,
    /// When they are due again, ns.
    next_ns: u64,
}

impl Links {
    fn record(&mut self, stamp_ns: u64, position: &[f64], recorder: &mut Recorder) {
        if stamp_ns < self.next_ns {
            return;
        }
        self.next_ns = stamp_ns + TRANSFORMS_NS;
        self.kinematics.update(position);
        let model = self.kinematics.model();
        for link in model.links().iter().filter(|link| !link.visuals.is_empty()) {
            if let Some(id) = model.link(&link.name) {
                recorder.transform(&link.name, stamp_ns, self.kinematics.pose(id));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_attached_world_is_read_as_the_same_world() {
        let mut silent = World::default();
        silent.coach.demonstration = None;
        for world in [World::default(), silent] {
            assert_eq!(World::parse(Path::new("world.json"), &world_text(&world)), Ok(world));
        }
    }
}
