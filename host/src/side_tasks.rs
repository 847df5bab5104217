//! Tasks beside a run's chart: they record observations and motion for the report, show the progress, and handle
//! Ctrl-C.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use armarium_memoryx::{Memory as _, Pattern, Query, Snapshot, WorkingMemory};
use armarium_runtime::exec::Controller;
use armarium_simulator::{Handle, KnownHypothesis, KnownSurface, KnownThing, KnownTouch};
use armarium_states::Equipment;
use armarium_values::Value;
use armarium_viewer::live::MEMORY;
use armarium_viewer::progress::ProgressLine;
use armarium_visionx::BulkEstimate;
use parking_lot::Mutex;
use tokio::sync::broadcast::error::RecvError;

use crate::console::{Console, WorldClock};
use crate::recording::SharedRecorder;
use crate::report::JointLog;
use crate::run_log::RunLog;
use crate::signals::signalled;

/// Passes the gesture that vision recognises in each frame to the referee, and records it; and what memory tells of surfaces and things,
/// with the time by `clock`.
pub(crate) async fn watch_perception(
    memory: Arc<WorkingMemory>,
    referee: armarium_simulator::Referee,
    recorder: SharedRecorder,
    clock: WorldClock,
) {
    let mut changes = memory.changes(&Pattern::any());
    loop {
        match changes.recv().await {
            Ok(snapshot) if snapshot.id.segment() == "HumanHands" => {
                let gesture = snapshot.attribute("gesture").and_then(Value::as_str);
                referee.gesture_seen(snapshot.referenced_ns, gesture.filter(|g| *g != "none"));
                let seen = snapshot.instance().map(|i| Value::Map(i.attributes.to_map()).to_json());
                if let Some(seen) = seen {
                    recorder.write(|recorder| recorder.json("/vision/hand", snapshot.referenced_ns, &seen));
                }
            }
            Ok(snapshot) if snapshot.id.segment() == "EnvironmentModels" => {
                referee.surface_known(snapshot.referenced_ns, snapshot.id.entity(), surface(&snapshot));
            }
            Ok(snapshot) if snapshot.id.segment() == "ObjectInstances" => {
                if let Some(known) = thing(&snapshot) {
                    referee.thing_known(clock(), snapshot.id.entity(), known);
                }
            }
            Ok(snapshot) if snapshot.id.segment() == "ObjectHypotheses" => {
                let (stamp_ns, name) = (snapshot.referenced_ns, snapshot.id.entity());
                referee.hypothesis_known(stamp_ns, name, hypothesis(&snapshot));
            }
            Ok(snapshot) if snapshot.id.segment() == "Touches" => {
                let text =
                    |name| snapshot.attribute(name).and_then(Value::as_str).unwrap_or_default().to_owned();
                referee.touch_known(clock(), KnownTouch { finger: text("finger"), by: text("by") });
            }
            Ok(snapshot) if snapshot.id.segment() == "Slips" => referee.slip_known(clock()),
            Ok(_) | Err(RecvError::Lagged(_)) => {}
            Err(_) => return,
        }
    }
}

/// What memory takes for one thing in a picture; `None` of what it has dropped.
fn hypothesis(snapshot: &Snapshot) -> Option<KnownHypothesis> {
    let number = |value: &Value| value.as_f64().map(|number| number as u32);
    let mask: Vec<u32> = snapshot.attribute("mask")?.as_list()?.iter().filter_map(number).collect();
    Some(KnownHypothesis {
        mask: mask.as_chunks().0.to_vec(),
        confirmed: snapshot.attribute("confirmed").is_some_and(|value| *value == Value::Bool(true)),
        class: snapshot.attribute("class").and_then(Value::as_str).map(str::to_owned),
    })
}

/// A thing, as memory knows it; `None` of what is gone.
fn thing(snapshot: &Snapshot) -> Option<KnownThing> {
    let class = snapshot.attribute("class")?.as_str()?.to_owned();
    let Some(Value::Pose(pose)) = snapshot.attribute("pose") else { return None };
    Some(KnownThing { class, place: pose.isometry().translation.vector, seen_ns: snapshot.referenced_ns })
}

/// A surface or a bulk of the model of the surroundings, as memory knows it; `None` of what is gone, is something else, or was seen in a
/// single look.
fn surface(snapshot: &Snapshot) -> Option<KnownSurface> {
    let class = snapshot.attribute("class")?.as_str()?.to_owned();
    (snapshot.attribute("plane_covariance").is_some() || class == BulkEstimate::CLASS).then_some(())?;
    let probability = snapshot.instance()?.confidence;
    let Some(Value::Pose(pose)) = snapshot.attribute("pose") else { return None };
    let size = snapshot.attribute("size")?.as_vector3()?;
    Some(KnownSurface { class, root_from_surface: pose.isometry(), size, probability })
}

/// Records what memory knows, and what changes in it; times are those of `clock`.
pub(crate) async fn record_memory(memory: Arc<WorkingMemory>, recorder: SharedRecorder, clock: WorldClock) {
    let record = |snapshot: &Snapshot| {
        let (now_ns, age_ns) = (clock(), memory.now_ns().saturating_sub(snapshot.referenced_ns));
        let instance = snapshot.instance();
        let known = instance.map(|instance| {
            serde_json::json!({
                "version": snapshot.version,
                "referenced_ns": now_ns.saturating_sub(age_ns),
                "confidence": instance.confidence,
                "attributes": Value::Map(instance.attributes.to_map()).to_json(),
            })
        });
        let change = serde_json::json!({"entity": snapshot.id.to_string(), "known": known});
        recorder.write(|recorder| recorder.json(MEMORY, now_ns, &change));
    };
    loop {
        let mut changes = memory.changes(&Pattern::any());
        if let Ok(known) = memory.query(&Query::latest(Pattern::any())).await {
            known.iter().for_each(|snapshot| record(snapshot));
        }
        loop {
            match changes.recv().await {
                Ok(snapshot) => record(&snapshot),
                // Too much at once: all is looked at again.
                Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
    }
}

/// Records the joint angles with which the arm that works reaches for the report, 20 times a second.
pub(crate) async fn log_joints(equipment: Equipment, log: Arc<Mutex<JointLog>>) {
    let model = equipment.robot.model();
    let chosen = equipment.works.as_deref().map_or_else(Vec::new, |arm| model.reaching_joints(arm));
    let mut sensed = equipment.robot.sensed();
    // There is no sensor value before the first sample.
    let begun = sensed.changed().await;
    let mut tick = tokio::time::interval(Duration::from_millis(50));
    while begun.is_ok() {
        tick.tick().await;
        let sample = Arc::clone(&sensed.borrow());
        log.lock().add(sample.stamp_ns as f64 * 1e-9, &sample.position, &chosen);
    }
}

pub(crate) async fn show_progress(
    console: Arc<dyn Console>,
    equipment: Equipment,
    log: Arc<Mutex<RunLog>>,
    began: Instant,
) {
    let robot = &equipment.robot;
    let sensor = sensor_of(&equipment);
    let mut tick = tokio::time::interval(Duration::from_millis(100));
    loop {
        tick.tick().await;
        let sample = Arc::clone(&robot.sensed().borrow());
        console.progress(&ProgressLine {
            simulated_s: sample.stamp_ns as f64 * 1e-9,
            wall_s: began.elapsed().as_secs_f64(),
            states: log.lock().status.lines(),
            force_n: sensor
                .and_then(|sensor| sample.wrenches.get(sensor))
                .map(|felt| felt.external.force.norm()),
        });
    }
}

/// The wrench sensor of the arm that works, as an index into the model's.
pub(crate) fn sensor_of(equipment: &Equipment) -> Option<usize> {
    equipment.robot.model().find_limb(equipment.works.as_deref()?)?.wrench
}

/// A signal stops the robot first: all skills are cancelled and have returned before the report is written. It is heard from the call on.
pub(crate) fn stop_on_signal(controller: Controller) -> impl Future<Output = ()> {
    let signalled = signalled();
    async move { controller.stop(format!("stopped by {}", signalled.await)) }
}

/// Ends the run after a time of the robot, which goes more slowly than real time on a busy machine.
pub(crate) async fn stop_after(longest: Duration, clock: Handle, controller: Controller) {
    while let Some(left) = longest.checked_sub(Duration::from_nanos(clock.now_ns())).filter(|l| !l.is_zero())
    {
        tokio::time::sleep(left).await;
    }
    controller.stop(format!("the run was to last {} s at most", longest.as_secs_f64()));
}

/// What is written at the end of a recording at most, bytes: the chunk that is being collected, and what says what its topics hold.
const AT_THE_END: u64 = (1 << 20) + (1 << 17);
/// A recording's index is at most this part of it.
const INDEX: u64 = 200;

/// Ends the recording while its file, with its end and its index, still has at most `most` bytes.
pub(crate) async fn bound_recording(file: PathBuf, most: u64, recorder: SharedRecorder) {
    let mut tick = tokio::time::interval(Duration::from_millis(100));
    loop {
        tick.tick().await;
        if std::fs::metadata(&file).is_ok_and(|file| file.len() + file.len() / INDEX + AT_THE_END >= most) {
            return recorder.end(&format!("its file may have {most} bytes"));
        }
    }
}
