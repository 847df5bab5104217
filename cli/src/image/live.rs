//! `armarium image process`: a processor on a provider. What it finds goes out as lines of JSON and, through the updater,
//! into a memory; what it draws is a provider of its own.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use armarium_memoryx::RemoteMemory;
use armarium_memoryx::updater::{Observation, Updater};
use armarium_values::{Frame, Value, Vector};
use armarium_visionx::providers::{Description, StereoPair, channel, offer};
use armarium_visionx::tracking::{FingerTipSettings, FingerTipTracking};
use armarium_visionx::{
    ColorMarkerObjectTracking, Finding, FindingSource, HandObserver, ImageError, ImageProcessor,
    MarkerSettings, OfStereo, ProcessorLoop, ProcessorStatistics, ResultSink, Trigger, run_processor,
};
use async_trait::async_trait;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde_json::{Value as Json, json};
use tokio::sync::mpsc;

use super::{Failure, ProcessArgs, argument, failed, source};
use crate::agent::stopped;
use crate::connection::Connection;

/// Findings that may wait to be printed and committed.
const WAITING: usize = 64;
/// Variance of a palm's place along each axis, m²: the observer gives none, and the palm's middle is known to about 1 cm.
const PALM: f64 = 1e-4;

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Look {
    /// A hand and its gesture.
    Hand,
    /// The fingertips of a hand, followed.
    Fingertips,
    /// A thing of one colour.
    Marker,
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
        }
    }
}

/// Hands findings on; the processor never waits for the printer or the memory.
struct HandOn {
    to: Mutex<Option<mpsc::Sender<(FindingSource, Finding)>>>,
    dropped: AtomicU64,
    left: Mutex<Option<u64>>,
    /// From the axes that findings are in to those of the provider's left camera.
    camera_from_pair: UnitQuaternion<f64>,
}

#[async_trait]
impl ResultSink for HandOn {
    async fn take(&self, source: &FindingSource, finding: Finding) -> bool {
        let to = self.to.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Some(to) = to else { return false };
        match to.try_send((source.clone(), turned(finding, &self.camera_from_pair))) {
            Ok(()) => {}
            Err(mpsc::error::TrySendError::Full(_)) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
            // Whoever printed or committed has ended.
            Err(mpsc::error::TrySendError::Closed(_)) => return false,
        }
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        *left = left.map(|left| left.saturating_sub(1));
        *left != Some(0)
    }
}

/// Places of pairs that were rectified, in the provider's left camera.
fn turned(mut finding: Finding, camera_from_pair: &UnitQuaternion<f64>) -> Finding {
    match &mut finding {
        Finding::Hand(Some(hand)) => hand.palm_in_left = camera_from_pair * hand.palm_in_left,
        Finding::Marker(Some(marker)) => {
            let rotation = camera_from_pair.to_rotation_matrix();
            marker.point_in_left = camera_from_pair * marker.point_in_left;
            marker.covariance = rotation * marker.covariance * rotation.transpose();
        }
        _ => {}
    }
    finding
}

/// Processes until the provider ends, enough frames were looked at, or Ctrl-C.
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
    let updater = match &args.memory {
        Some(agent) => {
            let memory = RemoteMemory::connect(&connection.session, agent).await.map_err(failed)?;
            Some(Updater::new(Arc::new(memory), processor.name()).map_err(failed)?)
        }
        None => None,
    };
    let about = format!("what `{}` sees in {}", processor.name(), described.name);
    let description = Description { name: processor.name().into(), about, ..Description::default() };
    let (drawn, pictures) = channel(description);
    let _offered = match &args.offer {
        Some(agent) => Some(offer(&connection.session, agent, Arc::new(pictures)).await.map_err(failed)?),
        None => None,
    };
    let statistics = ProcessorStatistics::default();
    let (to, findings) = mpsc::channel(WAITING);
    let sink = HandOn {
        to: Mutex::new(Some(to)),
        dropped: AtomicU64::new(0),
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
        // No further finding comes: what waits is told, and that ends too.
        sink.to.lock().unwrap_or_else(PoisonError::into_inner).take();
        match ended {
            Ok(()) | Err(ImageError::Gone { .. }) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    };
    let both = async {
        let (processed, told) = tokio::join!(processing, tell(findings, updater, &described.frame_id, out));
        told.and(processed)
    };
    let ended = tokio::select! {
        biased;
        () = stopped() => Ok(()),
        ended = both => ended,
    };
    let counts = json!({
        "frames": statistics.frames(), "skipped": statistics.skipped(), "unusable": statistics.unusable(),
        "torn": statistics.torn(), "not_told": sink.dropped.load(Ordering::Relaxed),
        "frames_per_s": statistics.rate_hz(), "latency_mean_ms": statistics.mean_latency_s() * 1e3,
        "latency_worst_ms": statistics.worst_latency_s() * 1e3,
    });
    writeln!(out, "{counts}")?;
    ended
}

/// Prints findings and commits them, until there are no more.
async fn tell(
    mut findings: mpsc::Receiver<(FindingSource, Finding)>,
    updater: Option<Updater>,
    frame_id: &str,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    while let Some((source, finding)) = findings.recv().await {
        writeln!(out, "{}", line(&source, &finding))?;
        if let (Some(updater), Some(observation)) = (&updater, observation(&source, &finding, frame_id)) {
            updater.update(&[observation]).await.map_err(failed)?;
        }
    }
    Ok(())
}

fn line(source: &FindingSource, finding: &Finding) -> Json {
    let mut line = json!({"provider": source.provider, "stamp_ns": source.stamp_ns});
    line[source.processor.as_str()] = match finding {
        Finding::Hand(Some(hand)) => json!({
            "gesture": hand.gesture.to_string(), "confidence": hand.confidence,
            "palm_m": hand.palm_in_left.coords.as_slice(), "palm_px": hand.palm_px.coords.as_slice(),
        }),
        Finding::Marker(Some(marker)) => json!({
            "position_m": marker.point_in_left.coords.as_slice(), "visible": marker.visible,
        }),
        Finding::Fingertips(tips) => tips
            .iter()
            .map(|tip| {
                json!({
                    "id": tip.id, "x": tip.px.x, "y": tip.px.y, "score": tip.score,
                })
            })
            .collect(),
        _ => Json::Null,
    };
    line
}

/// What a finding says of a place; nothing was seen without one.
fn observation(source: &FindingSource, finding: &Finding, frame_id: &str) -> Option<Observation> {
    let (position, covariance, confidence, attributes): (Vector3<f64>, Matrix3<f64>, f64, _) = match finding {
        Finding::Hand(Some(hand)) => {
            let gesture = Value::from(hand.gesture.to_string().as_str());
            let attributes = BTreeMap::from([("gesture".to_owned(), gesture)]);
            (hand.palm_in_left.coords, Matrix3::identity() * PALM, hand.confidence, attributes)
        }
        Finding::Marker(Some(marker)) => {
            (marker.point_in_left.coords, marker.covariance, marker.visible, BTreeMap::new())
        }
        _ => return None,
    };
    Some(Observation {
        class: source.processor.clone(),
        stamp_ns: source.stamp_ns,
        position: Vector::new(Frame::from(frame_id), &position),
        covariance: covariance.transpose().as_slice().try_into().ok()?,
        confidence: confidence.clamp(0.0, 1.0),
        attributes,
    })
}
