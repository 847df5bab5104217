//! From a stream of frames to a stream of results: the processor, the sink that takes its results, the fan-out of one
//! provider to many readers in a process, and the loop that runs a processor.
//!
//! Transport between processes is not here: a provider behind a network or shared memory is another [`ImageSource`],
//! and a remote reader another [`ResultSink`].

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio::time::{Duration, Instant};

use crate::camera::StereoCalibration;
use crate::frame::{Image, ImageError, ImageSource, StereoFrame};
use crate::hand::{HandObservation, HandObserver};
use crate::localizer::{ObjectEstimate, ObjectLocalizer};
use crate::marker::{ColorMarkerObjectTracking, MarkerEstimate};

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
}

/// Which frame a finding speaks of, and who found it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FindingSource {
    /// The processor's name.
    pub processor: String,
    /// The provider's name.
    pub provider: String,
    /// The frame's stamp, ns.
    pub stamp_ns: u64,
}

/// A step from a frame to results. It may keep state from frame to frame and does not wait for anything.
pub trait ImageProcessor: Send {
    /// Its name.
    fn name(&self) -> &str;
    /// What is seen in this frame.
    fn process(&mut self, frame: &StereoFrame) -> Finding;
    /// The frame's left image with what was seen in it, for people.
    fn annotated(&self, frame: &StereoFrame, finding: &Finding) -> Image {
        let _ = finding;
        frame.left.clone()
    }
}

/// Where results go: into a memory, a report, a recorder. It must not wait for slow readers.
#[async_trait]
pub trait ResultSink: Send + Sync {
    /// Takes the result of one frame. Returns whether more is wanted; `false` ends the loop.
    async fn take(&self, source: &FindingSource, finding: Finding) -> bool;
}

/// Counts of a processor's loop. All may be read at any time.
#[derive(Debug, Default)]
pub struct ProcessorStatistics {
    frames: AtomicU64,
    skipped: AtomicU64,
    latency_ns: AtomicU64,
    worst_ns: AtomicU64,
}

/// Several readers of one provider in one process. The provider is asked only while a reader waits, once for all that
/// wait, and each reader gets the newest frame that it has not had; the ones that it missed are counted.
pub struct FanOut {
    source: Arc<dyn ImageSource>,
    newest: Mutex<(u64, Option<Arc<StereoFrame>>)>,
}

/// One reader's end of a [`FanOut`].
pub struct Subscription {
    shared: Arc<FanOut>,
    seen: AtomicU64,
    skipped: AtomicU64,
}

impl ProcessorStatistics {
    /// Frames processed.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames.load(Ordering::Relaxed)
    }

    /// Frames that the processor was too slow for.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
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

    fn count(&self, latency: Duration, skipped: u64) {
        let ns = u64::try_from(latency.as_nanos()).unwrap_or(u64::MAX);
        self.frames.fetch_add(1, Ordering::Relaxed);
        self.skipped.store(skipped, Ordering::Relaxed);
        self.latency_ns.fetch_add(ns, Ordering::Relaxed);
        self.worst_ns.fetch_max(ns, Ordering::Relaxed);
    }
}

impl FanOut {
    /// Shares a provider.
    #[must_use]
    pub fn new(source: Arc<dyn ImageSource>) -> Arc<Self> {
        Arc::new(Self { source, newest: Mutex::new((0, None)) })
    }

    /// A new reader. Its first frame is one that is taken after this call.
    pub async fn subscribe(self: &Arc<Self>) -> Subscription {
        let seen = self.newest.lock().await.0;
        Subscription { shared: Arc::clone(self), seen: AtomicU64::new(seen), skipped: AtomicU64::new(0) }
    }
}

impl Subscription {
    /// How many frames came and went while this reader was busy.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl ImageSource for Subscription {
    fn name(&self) -> &str {
        self.shared.source.name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.shared.source.calibration()
    }

    /// The newest frame that this reader has not had, or else the next one. When a waiting reader is dropped, the
    /// next one takes its place at the provider.
    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let mut newest = self.shared.newest.lock().await;
        let seen = self.seen.load(Ordering::Relaxed);
        if newest.0 <= seen {
            let frame = self.shared.source.next().await?;
            *newest = (newest.0 + 1, Some(frame));
        }
        let (number, Some(frame)) = &*newest else {
            return Err(ImageError::Gone { provider: self.name().into() });
        };
        self.skipped.fetch_add(number.saturating_sub(seen + 1), Ordering::Relaxed);
        self.seen.store(*number, Ordering::Relaxed);
        Ok(Arc::clone(frame))
    }
}

/// Feeds each frame that `source` gives to `processor` and its result to `sink`, until the sink wants no more.
///
/// # Errors
/// [`ImageError::Gone`] when the provider has gone.
pub async fn run_processor(
    source: &Subscription,
    processor: &mut dyn ImageProcessor,
    sink: &dyn ResultSink,
    statistics: &ProcessorStatistics,
) -> Result<(), ImageError> {
    loop {
        let frame = source.next().await?;
        let received = Instant::now();
        let finding = processor.process(&frame);
        let from = FindingSource {
            processor: processor.name().into(),
            provider: source.name().into(),
            stamp_ns: frame.stamp_ns,
        };
        let more = sink.take(&from, finding).await;
        statistics.count(received.elapsed(), source.skipped());
        if !more {
            return Ok(());
        }
    }
}

impl ImageProcessor for ColorMarkerObjectTracking {
    fn name(&self) -> &str {
        "marker"
    }

    fn process(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Marker(self.update(frame))
    }

    fn annotated(&self, frame: &StereoFrame, finding: &Finding) -> Image {
        let mut image = frame.left.clone();
        if let Finding::Marker(Some(marker)) = finding {
            crate::annotate::marker(&mut image, marker);
        }
        image
    }
}

impl ImageProcessor for ObjectLocalizer {
    fn name(&self) -> &str {
        "object"
    }

    fn process(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Object(self.localize(frame))
    }

    fn annotated(&self, frame: &StereoFrame, finding: &Finding) -> Image {
        let mut image = frame.left.clone();
        if let Finding::Object(Some(object)) = finding {
            crate::annotate::object(&mut image, object);
        }
        image
    }
}

impl ImageProcessor for HandObserver {
    fn name(&self) -> &str {
        "hand"
    }

    fn process(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Hand(self.update(frame))
    }

    fn annotated(&self, frame: &StereoFrame, finding: &Finding) -> Image {
        let mut image = frame.left.clone();
        if let Finding::Hand(Some(hand)) = finding {
            crate::annotate::hand(&mut image, hand);
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, empty_frames};
    use std::sync::atomic::AtomicUsize;

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

    fn camera(frames: u64) -> (Arc<Camera>, Arc<FanOut>) {
        let camera = Arc::new(Camera { frames, given: AtomicU64::new(0) });
        (Arc::clone(&camera), FanOut::new(camera))
    }

    struct Count {
        wanted: usize,
        taken: AtomicUsize,
    }

    #[async_trait]
    impl ResultSink for Count {
        async fn take(&self, source: &FindingSource, finding: Finding) -> bool {
            assert_eq!((source.processor.as_str(), source.provider.as_str()), ("hand", "camera"));
            assert_eq!(finding, Finding::Hand(None));
            self.taken.fetch_add(1, Ordering::Relaxed) + 1 < self.wanted
        }
    }

    #[tokio::test(start_paused = true)]
    async fn all_who_wait_get_the_same_frame() {
        let (camera, shared) = camera(5);
        let (a, b) = (shared.subscribe().await, shared.subscribe().await);
        for i in 0..5 {
            let (x, y) = tokio::join!(a.next(), b.next());
            assert_eq!((x.unwrap().stamp_ns, y.unwrap().stamp_ns), (i, i));
        }
        assert_eq!(camera.given.load(Ordering::Relaxed), 5);
        assert!(matches!(a.next().await, Err(ImageError::Gone { .. })));
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_reader_gets_the_newest_and_knows_what_it_missed() {
        let (camera, shared) = camera(9);
        let (quick, slow) = (shared.subscribe().await, shared.subscribe().await);
        for _ in 0..4 {
            quick.next().await.unwrap();
        }
        assert_eq!(slow.next().await.unwrap().stamp_ns, 3);
        assert_eq!((slow.skipped(), quick.skipped()), (3, 0));
        // A reader that gives up waiting does not hold up the others.
        let gave_up = tokio::time::timeout(Duration::from_millis(10), slow.next()).await;
        assert!(gave_up.is_err());
        assert_eq!(quick.next().await.unwrap().stamp_ns, 4);
        assert_eq!(camera.given.load(Ordering::Relaxed), 5);
    }

    #[tokio::test(start_paused = true)]
    async fn a_processor_runs_until_its_sink_has_enough() {
        let (_, shared) = camera(4);
        let source = shared.subscribe().await;
        let mut observer = HandObserver::new(CALIBRATION);
        let statistics = ProcessorStatistics::default();
        let sink = Count { wanted: 3, taken: AtomicUsize::new(0) };
        run_processor(&source, &mut observer, &sink, &statistics).await.unwrap();
        assert_eq!((statistics.frames(), statistics.skipped()), (3, 0));
        let gone = run_processor(&source, &mut observer, &sink, &statistics).await;
        assert!(gone.is_ok() || matches!(gone, Err(ImageError::Gone { .. })));
        assert!(statistics.mean_latency_s() <= statistics.worst_latency_s());
    }
}
