//! `armarium image process`: runs a processor on a provider. What it observes goes out as lines of JSON and, through the
//! updater, into a memory; its annotated images become a provider.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use armarium_knowledge::updater::Updater;
use armarium_memoryx::RemoteMemory;
use armarium_values::Observation;
use armarium_visionx::providers::{ProviderDescription, StereoPair, channel, offer};
use armarium_visionx::tracking::{FingerTipSettings, FingerTipTracking};
use armarium_visionx::{
    BodyObserver, ColorMarkerObjectTracking, EnvironmentModel, EnvironmentStep, FingertipStep, HandDetection,
    HandStep, ImageError, ImageProcessor, MarkerStep, OfStereo, PeopleStep, ProcessorLoop,
    ProcessorStatistics, ResultSink, Seen, SeenBy, TabletopSegmentation, TabletopStep, Trigger, Workers,
    run_processor,
};
use async_trait::async_trait;
use serde_json::{Value as Json, json};
use tokio::sync::mpsc;

use super::{ImageFailure, ProcessArgs, argument, failed, source};
use crate::stopped::stopped;
use armarium_host::Connection;
use parking_lot::Mutex;

/// Frames whose observations may wait to be printed and committed.
const MAX_QUEUED: usize = 64;

/// What to look for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LookFor {
    /// A hand and its gesture.
    Hand,
    /// The fingertips of a hand, followed.
    Fingertips,
    /// An object of one colour.
    Marker,
    /// A table and the objects on it, by depth; the provider must give the camera's pose.
    Tabletop,
    /// Tables, shelves, walls and the floor, by depth, over time; the provider must give the camera's pose.
    Environment,
    /// Head, shoulders, elbows and wrists of a person.
    People,
}

impl LookFor {
    fn processor(self, pair: StereoPair, color: [u8; 3], hands: HandDetection) -> Box<dyn ImageProcessor> {
        let calibration = pair.calibration();
        match self {
            Self::Hand => Box::new(OfStereo::new(HandStep::new(hands.observer(calibration)), pair)),
            Self::Fingertips => {
                let tracking = FingerTipTracking::new(calibration, FingerTipSettings::default());
                Box::new(OfStereo::new(FingertipStep::new(tracking), pair))
            }
            Self::Marker => {
                let tracking = ColorMarkerObjectTracking::new(calibration, color, None, 1);
                Box::new(OfStereo::new(MarkerStep::new(tracking, "marker"), pair))
            }
            Self::Tabletop => Box::new(OfStereo::new(
                TabletopStep::new(TabletopSegmentation::new(calibration.camera)),
                pair,
            )),
            Self::Environment => {
                let model = EnvironmentModel::new(calibration.camera);
                Box::new(OfStereo::new(EnvironmentStep::new(model, calibration.camera), pair))
            }
            Self::People => {
                let step = PeopleStep::new(BodyObserver::new(calibration), |_| Vec::new());
                Box::new(OfStereo::new(step, pair))
            }
        }
    }
}

/// What was observed in a frame, and by whom.
type Queued = (SeenBy, Seen);

/// Passes observations on; the processor never waits for the printer or the memory.
struct HandOn {
    to: Mutex<Option<mpsc::Sender<Queued>>>,
    dropped: AtomicU64,
    taken: AtomicBool,
    left: Mutex<Option<u64>>,
}

#[async_trait]
impl ResultSink for HandOn {
    async fn take(&self, by: &SeenBy, seen: Seen) -> bool {
        self.taken.store(true, Ordering::Relaxed);
        let to = self.to.lock().clone();
        let Some(to) = to else { return false };
        match to.try_send((by.clone(), seen)) {
            Ok(()) => {}
            Err(mpsc::error::TrySendError::Full(_)) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
            // The receiver has ended.
            Err(mpsc::error::TrySendError::Closed(_)) => return false,
        }
        let mut left = self.left.lock();
        *left = left.map(|left| left.saturating_sub(1));
        *left != Some(0)
    }
}

/// Processes until the provider ends, the number of frames is reached, or Ctrl-C.
pub(super) async fn run(
    args: &ProcessArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    let (source, described, pair) = source::open_pair(&args.source, connection).await?;
    let trigger = match args.rate {
        None => Trigger::Next,
        Some(hz) if hz.is_finite() && hz > 0.0 => {
            Trigger::Every(Duration::from_secs_f64((1.0 / hz).min(1e6)))
        }
        Some(_) => return Err(argument("--rate is greater than 0")),
    };
    let processor = args.look.processor(pair, args.color, args.detector.into());
    let remembers = match &args.memory {
        Some(agent) => {
            let memory = Arc::new(RemoteMemory::connect(connection.session(), agent).await.map_err(failed)?);
            let updater = Updater::new(memory, processor.name());
            Some(updater.map_err(failed)?)
        }
        None => None,
    };
    let about = format!("what `{}` sees in {}", processor.name(), described.name);
    let description =
        ProviderDescription { name: processor.name().into(), about, ..ProviderDescription::default() };
    let (drawn, pictures) = channel(description);
    let _offered = match &args.offer {
        Some(agent) => Some(offer(connection.session(), agent, Arc::new(pictures)).await.map_err(failed)?),
        None => None,
    };
    let statistics = ProcessorStatistics::default();
    let (to, told) = mpsc::channel(MAX_QUEUED);
    let sink = HandOn {
        to: Mutex::new(Some(to)),
        dropped: AtomicU64::new(0),
        taken: AtomicBool::new(false),
        left: Mutex::new(args.frames),
    };
    let with = ProcessorLoop {
        inputs: vec![Arc::clone(&source.provider)],
        trigger,
        workers: Workers::Threads,
        sink: &sink,
        annotated: args.offer.is_some().then_some(&drawn),
        statistics: &statistics,
    };
    let processing = async {
        let ended = run_processor(processor, &with).await;
        // No more observations come: close the queue, so that the receiver ends after the last one.
        sink.to.lock().take();
        match ended {
            Ok(()) | Err(ImageError::Gone { .. }) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    };
    let both = async {
        let (processed, told) = tokio::join!(processing, tell(told, remembers, out));
        told.and(processed)
    };
    let ended = tokio::select! {
        biased;
        () = stopped() => Ok(()),
        ended = both => ended,
    };
    let counts = json!({
        "frames": statistics.frames.get(), "skipped": statistics.skipped.get(), "unusable": statistics.unusable.get(),
        "torn": statistics.torn.get(), "not_told": sink.dropped.load(Ordering::Relaxed),
        "frames_per_s": statistics.rate_hz(), "latency_mean_ms": statistics.latency.mean_s() * 1e3,
        "latency_worst_ms": statistics.latency.worst_s() * 1e3,
    });
    writeln!(out, "{counts}")?;
    ended?;
    match statistics.why_unusable() {
        Some(why) if !sink.taken.load(Ordering::Relaxed) => {
            let source = &args.source.source;
            Err(failed(format!("of `{source}` no frame could be used: {why}")))
        }
        _ => Ok(()),
    }
}

/// Prints observations and writes them to memory, until there are no more.
async fn tell(
    mut told: mpsc::Receiver<Queued>,
    remembers: Option<Updater>,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    while let Some((by, seen)) = told.recv().await {
        writeln!(out, "{}", line(&by, &seen.observations))?;
        if let Some(updater) = &remembers {
            updater.update_from(&seen.observations, seen.search.as_ref()).await.map_err(failed)?;
        }
    }
    Ok(())
}

/// What was observed in a frame, as a line of JSON.
fn line(by: &SeenBy, seen: &[Observation]) -> Json {
    let mut line = json!({"provider": by.provider, "stamp_ns": by.stamp_ns});
    line[by.processor.as_str()] = seen.iter().map(Observation::to_json).collect();
    line
}
