use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::providers::{ProviderDescription, StereoPair, StereoProvider, channel};
use crate::scenes::{CALIBRATION, TestCamera};
use crate::steps::{HandStep, OfStereo};
use crate::tracking::hand::HandObserver;

fn camera(frames: u64) -> Arc<dyn ImageProvider> {
    Arc::new(StereoProvider::new(TestCamera::new(frames, None), "camera_left"))
}

const NEXT: (Trigger, Workers) = (Trigger::Next, Workers::Joined);

fn pair() -> StereoPair {
    StereoPair::of(&ProviderDescription::of_stereo("camera", "camera_left", &CALIBRATION)).unwrap()
}

/// Wants so many results.
struct Count(AtomicU64);

#[async_trait]
impl ResultSink for Count {
    async fn take(&self, source: &SeenBy, _: Seen) -> bool {
        assert_eq!(source.provider, "camera");
        self.0.fetch_sub(1, Ordering::Relaxed) > 1
    }
}

async fn run(
    processor: impl ImageProcessor + 'static,
    inputs: Vec<Arc<dyn ImageProvider>>,
    (trigger, workers): (Trigger, Workers),
    wanted: u64,
    annotated: Option<&FrameSender>,
) -> (Result<(), ImageError>, ProcessorStatistics) {
    let statistics = ProcessorStatistics::default();
    let sink = Count(AtomicU64::new(wanted));
    let with = ProcessorLoop { inputs, trigger, workers, sink: &sink, annotated, statistics: &statistics };
    let ended = run_processor(Box::new(processor), &with).await;
    (ended, statistics)
}

#[tokio::test(start_paused = true)]
async fn a_processor_runs_until_its_sink_has_enough_and_draws_what_it_saw() {
    let (drawn, pictures) =
        channel(ProviderDescription { name: "drawn".into(), ..ProviderDescription::default() });
    let hand = || OfStereo::new(HandStep::new(HandObserver::new(CALIBRATION)), pair());
    let (ended, counts) = run(hand(), vec![camera(4)], NEXT, 3, Some(&drawn)).await;
    assert!(ended.is_ok());
    assert_eq!((counts.frames.get(), counts.skipped.get(), counts.unusable.get()), (3, 0, 0));
    assert!((counts.rate_hz() - 1.0 / 0.066).abs() < 1e-6);
    assert_eq!(pictures.next().await.unwrap().stamp_ns, 2);
    let (ended, counts) = run(hand(), vec![camera(2)], NEXT, 9, None).await;
    assert_eq!((ended, counts.frames.get()), (Err(ImageError::Gone { provider: "camera".into() }), 2));
}

/// Accepts any frame.
#[derive(Clone, Default)]
struct Look(Arc<Mutex<Vec<Vec<u64>>>>);

impl ImageProcessor for Look {
    fn name(&self) -> &str {
        "look"
    }

    fn process(&mut self, frames: &[Arc<RawFrame>]) -> Result<Seen, ImageError> {
        let numbers = frames.iter().map(|frame| frame.number).collect();
        self.0.try_lock().expect("nobody else reads it meanwhile").push(numbers);
        Ok(Seen::default())
    }
}

#[tokio::test(start_paused = true)]
async fn several_providers_give_a_frame_each_and_polling_takes_the_newest() {
    let look = Look::default();
    let every = (Trigger::Every(Duration::from_millis(150)), Workers::Joined);
    let (_, counts) = run(look.clone(), vec![camera(20), camera(20)], every, 4, None).await;
    assert_eq!(*look.0.lock().await, [[2, 2], [4, 4], [6, 6], [9, 9]]);
    assert_eq!((counts.frames.get(), counts.skipped.get()), (4, 4));
    let look = Look::default();
    let (ended, _) = run(look.clone(), vec![camera(3)], every, 40, None).await;
    assert!(matches!(ended, Err(ImageError::Gone { .. })));
    assert_eq!(*look.0.lock().await, [[2], [3]]);
}

/// Sends pairs of these sizes, one after the other.
struct Sizes(Vec<(u32, u32)>, AtomicU64);

#[async_trait]
impl ImageProvider for Sizes {
    fn description(&self) -> ProviderDescription {
        ProviderDescription { name: "camera".into(), ..ProviderDescription::default() }
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let at = self.1.fetch_add(1, Ordering::Relaxed);
        let size = self.0.get(at as usize).ok_or(ImageError::Gone { provider: "camera".into() })?;
        let eye = |role| {
            let bytes = PixelFormat::Rgb8.bytes(size.0, size.1).unwrap();
            RawImage::new(role, PixelFormat::Rgb8, *size, vec![9; bytes]).unwrap()
        };
        Ok(Arc::new(RawFrame {
            number: at + 1,
            images: vec![eye("left"), eye("right")],
            ..RawFrame::default()
        }))
    }
}

#[tokio::test]
async fn frames_of_another_size_than_the_calibration_s_are_counted_and_the_next_is_looked_at() {
    let size = (CALIBRATION.camera.width, CALIBRATION.camera.height);
    let sizes = vec![size, (1, 1), (size.0 + 1, size.1), (1, 480), size];
    let camera: Arc<dyn ImageProvider> = Arc::new(Sizes(sizes, AtomicU64::new(0)));
    let hand = OfStereo::new(HandStep::new(HandObserver::new(CALIBRATION)), pair());
    let (ended, counts) = run(hand, vec![camera], NEXT, 9, None).await;
    assert!(ended.is_err(), "the provider has gone");
    assert_eq!((counts.frames.get(), counts.unusable.get()), (5, 3));
    assert!(counts.why_unusable().is_some_and(|why| why.contains("1 x 1")), "{counts:?}");
}

/// Takes a second of the machine's time for each frame, and of nobody else's.
struct Slow;

impl ImageProcessor for Slow {
    fn name(&self) -> &str {
        "slow"
    }

    #[expect(clippy::disallowed_methods, reason = "it is busy, as a program is that computes for long")]
    fn process(&mut self, _: &[Arc<RawFrame>]) -> Result<Seen, ImageError> {
        std::thread::sleep(Duration::from_millis(300));
        Ok(Seen::default())
    }
}

#[tokio::test]
async fn a_slow_processor_holds_up_nothing_and_gets_the_newest_frame() {
    // Everything else goes on in this thread meanwhile: here, a clock that ticks.
    let ticks = AtomicU64::new(0);
    let tick = async {
        loop {
            tokio::time::sleep(Duration::from_millis(10)).await;
            ticks.fetch_add(1, Ordering::Relaxed);
        }
    };
    tokio::select! {
        biased;
        (ended, _) = run(Slow, vec![camera(1000)], (Trigger::Next, Workers::Threads), 3, None) => ended.unwrap(),
        () = tick => {}
    }
    let ticks = ticks.into_inner();
    assert!(ticks > 45, "the clock ticked {ticks} times beside three frames of 0.3 s");
}
