//! `armarium image process`: runs a processor on a provider. Its findings go out as lines of JSON and, through the
//! updater, into a memory; its annotated images become a provider.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use armarium_memoryx::updater::Updater;
use armarium_memoryx::{Memory, RemoteMemory};
use armarium_visionx::providers::{ProviderDescription, StereoPair, channel, offer};
use armarium_visionx::tracking::{FingerTipSettings, FingerTipTracking};
use armarium_visionx::{
    ColorMarkerObjectTracking, FindingSource, HandObserver, ImageError, ImageFinding, ImageProcessor,
    MarkerSettings, OfStereo, ProcessorLoop, ProcessorStatistics, ResultSink, TabletopSegmentation, Trigger,
    run_processor,
};
use async_trait::async_trait;
use nalgebra::UnitQuaternion;
use serde_json::json;
use tokio::sync::mpsc;

use super::{Failure, ProcessArgs, argument, failed, source};
use crate::stopped::stopped;
use armarium_host::{Connection, image_findings};
use parking_lot::Mutex;

/// Findings that may wait to be printed and committed.
const MAX_QUEUED: usize = 64;

/// What to look for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Look {
    /// A hand and its gesture.
    Hand,
    /// The fingertips of a hand, followed.
    Fingertips,
    /// An object of one colour.
    Marker,
    /// A table and the objects on it, by depth; the provider must give the camera's pose.
    Tabletop,
}

impl Look {
    fn processor(self, pair: StereoPair, color: [u8; 3]) -> Box<dyn ImageProcessor> {
        let calibration = pair.calibration();
        match self {
            Self::Hand => Box::new(OfStereo::new(HandObserver::new(calibration), pair)),
            Self::Fingertips => {
                let tracking = FingerTipTracking::new(calibration, FingerTipSettings::default());
                Box::new(OfStereo::new(tracking, pair))
            }
            Self::Marker => {
                let tracking = ColorMarkerObjectTracking::new(calibration, MarkerSettings::new(color), 1);
                Box::new(OfStereo::new(tracking, pair))
            }
            Self::Tabletop => Box::new(OfStereo::new(TabletopSegmentation::new(calibration.camera), pair)),
        }
    }
}

/// Passes findings on; the processor never waits for the printer or the memory.
struct HandOn {
    to: Mutex<Option<mpsc::Sender<(FindingSource, ImageFinding)>>>,
    dropped: AtomicU64,
    taken: AtomicBool,
    left: Mutex<Option<u64>>,
    /// The rotation from the findings' axes to those of the provider's left camera.
    camera_from_pair: UnitQuaternion<f64>,
}

#[async_trait]
impl ResultSink for HandOn {
    async fn take(&self, source: &FindingSource, finding: ImageFinding) -> bool {
        self.taken.store(true, Ordering::Relaxed);
        let to = self.to.lock().clone();
        let Some(to) = to else { return false };
        match to.try_send((source.clone(), turned(finding, &self.camera_from_pair))) {
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

/// Converts the positions of rectified pairs to the provider's left camera.
fn turned(mut finding: ImageFinding, camera_from_pair: &UnitQuaternion<f64>) -> ImageFinding {
    match &mut finding {
        ImageFinding::Hand(Some(hand)) => hand.palm_in_left = camera_from_pair * hand.palm_in_left,
        ImageFinding::Marker(Some(marker)) => {
            let rotation = camera_from_pair.to_rotation_matrix();
            marker.point_in_left = camera_from_pair * marker.point_in_left;
            marker.covariance = rotation * marker.covariance * rotation.transpose();
        }
        _ => {}
    }
    finding
}

/// Processes until the provider ends, the number of frames is reached, or Ctrl-C.
pub(super) async fn run(
    args: &ProcessArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    let (source, described, pair) = source::open_pair(&args.source, connection).await?;
    let trigger = match args.rate {
        None => Trigger::Next,
        Some(hz) if hz.is_finite() && hz > 0.0 => {
            Trigger::Every(Duration::from_secs_f64((1.0 / hz).min(1e6)))
        }
        Some(_) => return Err(argument("--rate is greater than 0")),
    };
    let camera_from_pair = pair.left_from_pair();
    let mut processor = args.look.processor(pair, args.color);
    let remembers = match &args.memory {
        Some(agent) => {
            let memory = Arc::new(RemoteMemory::connect(connection.session(), agent).await.map_err(failed)?);
            let updater = Updater::new(Arc::<RemoteMemory>::clone(&memory), processor.name());
            Some((memory, updater.map_err(failed)?))
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
        camera_from_pair,
    };
    let with = ProcessorLoop {
        inputs: vec![Arc::clone(&source.provider)],
        trigger,
        sink: &sink,
        annotated: args.offer.is_some().then_some(&drawn),
        statistics: &statistics,
    };
    let processing = async {
        let ended = run_processor(&mut *processor, &with).await;
        // No more findings come: close the queue, so that the receiver ends after the last one.
        sink.to.lock().take();
        match ended {
            Ok(()) | Err(ImageError::Gone { .. }) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    };
    let both = async {
        let (processed, told) = tokio::join!(processing, tell(told, remembers, &described.frame_id, out));
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

/// Prints and commits findings, until there are no more.
async fn tell(
    mut told: mpsc::Receiver<(FindingSource, ImageFinding)>,
    remembers: Option<(Arc<RemoteMemory>, Updater)>,
    frame_id: &str,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    while let Some((source, finding)) = told.recv().await {
        writeln!(out, "{}", image_findings::line(&source, &finding))?;
        let Some((memory, updater)) = &remembers else { continue };
        let observations = image_findings::observations(&source, &finding, frame_id);
        if !observations.is_empty() {
            updater.update(&observations).await.map_err(failed)?;
        }
        if let Some(commit) = image_findings::surroundings(&source, &finding).map_err(failed)? {
            memory.commit(vec![commit]).await.map_err(failed)?;
        }
    }
    Ok(())
}
