//! From streams of frames to a stream of results: the processor, the sink that takes its results, and the loop that runs
//! it.
//!
//! Where frames come from is not known here: [`crate::providers`] does that.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio::time::{Duration, Instant, sleep_until};

use crate::frame::{Image, ImageError};
use crate::hand::HandObservation;
use crate::localizer::ObjectEstimate;
use crate::marker::MarkerEstimate;
use crate::providers::{Frame, FrameImage, FrameSender, ImageProvider, PixelFormat};
use crate::tabletop::Tabletop;
use crate::tracking::TrackedFingertip;

/// What a processor saw of one thing in one frame.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// A marker of known colour; `None`: not seen.
    Marker(Option<MarkerEstimate>),
    /// An object's pose; `None`: not seen.
    Object(Option<ObjectEstimate>),
    /// A person's hand; `None`: no hand.
    Hand(Option<HandObservation>),
    /// A table with what stands on it; `None`: no table.
    Tabletop(Option<Tabletop>),
    /// The fingertips that are followed.
    Fingertips(Vec<TrackedFingertip>),
}

/// Which frame a finding speaks of, and who found it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FindingSource {
    /// The processor's name.
    pub processor: String,
    /// The first provider's name.
    pub provider: String,
    /// The first provider's frame's stamp, ns.
    pub stamp_ns: u64,
}

/// A step from frames to results, one frame of each of its providers at a time. It may keep state from one to the next
/// and does not wait for anything.
pub trait ImageProcessor: Send {
    /// Its name.
    fn name(&self) -> &str;

    /// What is seen in these frames, one of each provider.
    ///
    /// # Errors
    /// [`ImageError`] when they are not what it works on; the next may be.
    fn process(&mut self, frames: &[Arc<Frame>]) -> Result<Finding, ImageError>;

    /// A picture of the frames with what was seen in them, for people; `None` when it draws none.
    fn annotated(&self, frames: &[Arc<Frame>], finding: &Finding) -> Option<Image> {
        let _ = (frames, finding);
        None
    }
}

/// Where results go: into a memory, a report, a recorder. It must not wait for slow readers.
#[async_trait]
pub trait ResultSink: Send + Sync {
    /// Takes the result of one frame. Returns whether more is wanted; `false` ends the loop.
    async fn take(&self, source: &FindingSource, finding: Finding) -> bool;
}

/// When a processor takes frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// Each time the first provider has a new one, with the newest of the others.
    Next,
    /// The newest of each, at this interval; no new ones, no step.
    Every(Duration),
}

/// What a loop works with beside its processor.
pub struct ProcessorLoop<'a> {
    /// Who gives the frames. A processor that is too slow gets the newest.
    pub inputs: Vec<Arc<dyn ImageProvider>>,
    /// When it takes them.
    pub trigger: Trigger,
    /// Where results go.
    pub sink: &'a dyn ResultSink,
    /// Where annotated images go, if anywhere.
    pub annotated: Option<&'a FrameSender>,
    /// What is counted.
    pub statistics: &'a ProcessorStatistics,
}

/// Counts of a processor's loop. All may be read at any time.
#[derive(Debug, Default)]
pub struct ProcessorStatistics {
    frames: AtomicU64,
    skipped: AtomicU64,
    unusable: AtomicU64,
    torn: AtomicU64,
    latency_ns: AtomicU64,
    worst_ns: AtomicU64,
    span_ns: AtomicU64,
}

impl ProcessorStatistics {
    /// Frames processed.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames.load(Ordering::Relaxed)
    }

    /// Frames of the first provider that were never looked at, by their numbers: the processor or the way to it was
    /// too slow.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }

    /// Frames that were spoilt, or not what the processor works on.
    #[must_use]
    pub fn unusable(&self) -> u64 {
        self.unusable.load(Ordering::Relaxed)
    }

    /// Results that were thrown away because the frame's memory was taken away meanwhile.
    #[must_use]
    pub fn torn(&self) -> u64 {
        self.torn.load(Ordering::Relaxed)
    }

    /// Mean time from receiving a frame to handing over its result, s of tokio's clock (zero in virtual time).
    #[must_use]
    pub fn mean_latency_s(&self) -> f64 {
        self.latency_ns.load(Ordering::Relaxed) as f64 * 1e-9 / self.frames().max(1) as f64
    }

    /// The longest such time, s.
    #[must_use]
    pub fn worst_latency_s(&self) -> f64 {
        self.worst_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Frames processed per second of tokio's clock, from the first to the last; 0 before the second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        let span_s = self.span_ns.load(Ordering::Relaxed) as f64 * 1e-9;
        if span_s > 0.0 { self.frames().saturating_sub(1) as f64 / span_s } else { 0.0 }
    }

    fn count(&self, began: Instant, received: Instant) {
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let latency = ns(received.elapsed());
        self.frames.fetch_add(1, Ordering::Relaxed);
        self.latency_ns.fetch_add(latency, Ordering::Relaxed);
        self.worst_ns.fetch_max(latency, Ordering::Relaxed);
        self.span_ns.store(ns(received.duration_since(began)), Ordering::Relaxed);
    }
}

/// Keeps the newest frame of a provider while a processor works.
struct Newest {
    frame: Arc<Mutex<Option<Arc<Frame>>>>,
    task: tokio::task::JoinHandle<ImageError>,
}

impl Newest {
    fn of(provider: &Arc<dyn ImageProvider>) -> Self {
        let frame = Arc::new(Mutex::new(None));
        let (kept, provider) = (Arc::clone(&frame), Arc::clone(provider));
        let task = tokio::spawn(async move {
            loop {
                match provider.next().await {
                    Ok(frame) => *kept.lock().await = Some(frame),
                    Err(error @ ImageError::Gone { .. }) => return error,
                    Err(_) => tokio::task::yield_now().await,
                }
            }
        });
        Self { frame, task }
    }

    async fn get(&self) -> Option<Arc<Frame>> {
        self.frame.lock().await.clone()
    }
}

impl Drop for Newest {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Feeds frames to `processor` and its results to the sink, until the sink wants no more.
///
/// # Errors
/// [`ImageError::Gone`] when a provider has gone.
pub async fn run_processor(
    processor: &mut dyn ImageProcessor,
    with: &ProcessorLoop<'_>,
) -> Result<(), ImageError> {
    let gone = || ImageError::Gone { provider: String::new() };
    let (first, others) = with.inputs.split_first().ok_or_else(gone)?;
    let provider = first.description().name;
    let others: Vec<Newest> = others.iter().map(Newest::of).collect();
    let leader = matches!(with.trigger, Trigger::Every(_)).then(|| Newest::of(first));
    let (mut last, mut began, mut due) = (None::<u64>, None, Instant::now());
    loop {
        let frame = match (&leader, with.trigger) {
            (Some(newest), Trigger::Every(interval)) => {
                due += interval;
                sleep_until(due).await;
                match newest.get().await {
                    Some(frame) if last != Some(frame.number) => frame,
                    _ if newest.task.is_finished() => return Err(ImageError::Gone { provider }),
                    _ => continue,
                }
            }
            _ => match first.next().await {
                Ok(frame) => frame,
                Err(error @ ImageError::Gone { .. }) => return Err(error),
                Err(_) => {
                    with.statistics.unusable.fetch_add(1, Ordering::Relaxed);
                    tokio::task::yield_now().await;
                    continue;
                }
            },
        };
        let received = Instant::now();
        let began = *began.get_or_insert(received);
        // A number that is not larger belongs to the provider's next life.
        let missed = last.map_or(0, |last| frame.number.saturating_sub(last.saturating_add(1)));
        with.statistics.skipped.fetch_add(missed, Ordering::Relaxed);
        last = Some(frame.number);
        let mut frames = vec![frame];
        for other in &others {
            frames.extend(other.get().await);
        }
        if frames.len() < with.inputs.len() {
            // Another provider has not begun yet.
            with.statistics.skipped.fetch_add(1, Ordering::Relaxed);
            continue;
        }
        let more = step(processor, with, &provider, &frames).await;
        with.statistics.count(began, received);
        if !more {
            return Ok(());
        }
    }
}

/// One step; whether more is wanted.
async fn step(
    processor: &mut dyn ImageProcessor,
    with: &ProcessorLoop<'_>,
    provider: &str,
    frames: &[Arc<Frame>],
) -> bool {
    let finding = match processor.process(frames) {
        Ok(finding) => finding,
        Err(error) => {
            if with.statistics.unusable.fetch_add(1, Ordering::Relaxed) == 0 {
                tracing::warn!("{}: {error}", processor.name());
            }
            return true;
        }
    };
    if let Some(annotated) = with.annotated.filter(|to| to.is_wanted())
        && let Some(image) = processor.annotated(frames, &finding)
    {
        annotated.send(drawn(&frames[0], image));
    }
    if !frames.iter().all(|frame| frame.is_intact()) {
        with.statistics.torn.fetch_add(1, Ordering::Relaxed);
        return true;
    }
    let source = FindingSource {
        processor: processor.name().into(),
        provider: provider.into(),
        stamp_ns: frames[0].stamp_ns,
    };
    with.sink.take(&source, finding).await
}

/// An annotated image as a frame of its own.
fn drawn(of: &Frame, image: Image) -> Frame {
    let size = (image.width(), image.height());
    let image = FrameImage::new("image", PixelFormat::Rgb8, size, image.into_data());
    Frame {
        number: 0,
        stamp_ns: of.stamp_ns,
        frame_id: of.frame_id.clone(),
        root_from_camera: of.root_from_camera,
        images: image.into_iter().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::ImageSource;
    use crate::hand::HandObserver;
    use crate::providers::{Description, StereoProvider, channel};
    use crate::scenes::{CALIBRATION, empty_frames};
    use crate::steps::OfStereo;
    use crate::{StereoCalibration, StereoFrame};

    /// Gives a frame each 66 ms, `frames` in all.
    struct Camera {
        frames: u64,
        given: AtomicU64,
    }

    #[async_trait]
    impl ImageSource for Camera {
        fn name(&self) -> &str {
            "camera"
        }

        fn calibration(&self) -> StereoCalibration {
            CALIBRATION
        }

        async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
            tokio::time::sleep(Duration::from_millis(66)).await;
            let i = self.given.fetch_add(1, Ordering::Relaxed);
            if i >= self.frames {
                return Err(ImageError::Gone { provider: "camera".into() });
            }
            let frame = empty_frames().swap_remove(3);
            Ok(Arc::new(StereoFrame { stamp_ns: i, ..frame }))
        }
    }

    fn camera(frames: u64) -> Arc<dyn ImageProvider> {
        let camera = Camera { frames, given: AtomicU64::new(0) };
        Arc::new(StereoProvider::new(Arc::new(camera), "camera_left"))
    }

    struct Count {
        wanted: u64,
        taken: AtomicU64,
    }

    #[async_trait]
    impl ResultSink for Count {
        async fn take(&self, source: &FindingSource, _: Finding) -> bool {
            assert_eq!(source.provider, "camera");
            self.taken.fetch_add(1, Ordering::Relaxed) + 1 < self.wanted
        }
    }

    async fn run(
        processor: &mut dyn ImageProcessor,
        inputs: Vec<Arc<dyn ImageProvider>>,
        trigger: Trigger,
        wanted: u64,
        annotated: Option<&FrameSender>,
    ) -> (Result<(), ImageError>, ProcessorStatistics) {
        let statistics = ProcessorStatistics::default();
        let sink = Count { wanted, taken: AtomicU64::new(0) };
        let with = ProcessorLoop { inputs, trigger, sink: &sink, annotated, statistics: &statistics };
        let ended = run_processor(processor, &with).await;
        (ended, statistics)
    }

    #[tokio::test(start_paused = true)]
    async fn a_processor_runs_until_its_sink_has_enough_and_draws_what_it_saw() {
        let (drawn, pictures) = channel(Description { name: "drawn".into(), ..Description::default() });
        let mut hand = OfStereo(HandObserver::new(CALIBRATION));
        let (ended, counts) = run(&mut hand, vec![camera(4)], Trigger::Next, 3, Some(&drawn)).await;
        assert!(ended.is_ok());
        assert_eq!((counts.frames(), counts.skipped(), counts.unusable()), (3, 0, 0));
        assert!((counts.rate_hz() - 1.0 / 0.066).abs() < 1e-6);
        assert_eq!(pictures.next().await.unwrap().stamp_ns, 2);
        let (ended, counts) = run(&mut hand, vec![camera(2)], Trigger::Next, 9, None).await;
        assert_eq!((ended, counts.frames()), (Err(ImageError::Gone { provider: "camera".into() }), 2));
    }

    /// Takes anything.
    struct Look(Vec<Vec<u64>>);

    impl ImageProcessor for Look {
        fn name(&self) -> &str {
            "look"
        }

        fn process(&mut self, frames: &[Arc<Frame>]) -> Result<Finding, ImageError> {
            self.0.push(frames.iter().map(|frame| frame.number).collect());
            Ok(Finding::Hand(None))
        }
    }

    #[tokio::test(start_paused = true)]
    async fn several_providers_give_a_frame_each_and_polling_takes_the_newest() {
        let mut look = Look(Vec::new());
        let every = Trigger::Every(Duration::from_millis(150));
        let (_, counts) = run(&mut look, vec![camera(20), camera(20)], every, 4, None).await;
        assert_eq!(look.0, [[2, 2], [4, 4], [6, 6], [9, 9]]);
        assert_eq!((counts.frames(), counts.skipped()), (4, 4));
        let mut look = Look(Vec::new());
        let (ended, _) = run(&mut look, vec![camera(3)], every, 40, None).await;
        assert!(matches!(ended, Err(ImageError::Gone { .. })));
        assert_eq!(look.0, [[2], [3]]);
    }
}
