//! Many readers of one provider in one process.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use tokio::sync::Mutex;

use super::{ImageProvider, ProviderDescription, RawFrame};
use crate::frame::ImageError;

/// Several readers of one provider in one process. The provider is read only while a reader waits, once for all
/// waiting readers. Each reader gets the newest frame that it has not had; the frames it missed are counted.
pub struct FanOut {
    provider: Arc<dyn ImageProvider>,
    newest: Mutex<(u64, Option<Arc<RawFrame>>)>,
}

/// One reader's end of a [`FanOut`].
pub struct FrameSubscription {
    shared: Arc<FanOut>,
    seen: AtomicU64,
    skipped: AtomicU64,
}

impl FanOut {
    /// Shares a provider.
    pub fn new(provider: Arc<dyn ImageProvider>) -> Arc<Self> {
        Arc::new(Self { provider, newest: Mutex::new((0, None)) })
    }

    /// A new reader. Its first frame is taken after this call.
    pub async fn subscribe(self: &Arc<Self>) -> FrameSubscription {
        let seen = self.newest.lock().await.0;
        FrameSubscription { shared: Arc::clone(self), seen: AtomicU64::new(seen), skipped: AtomicU64::new(0) }
    }
}

impl FrameSubscription {
    /// The number of frames that this reader missed while it was busy.
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl ImageProvider for FrameSubscription {
    fn description(&self) -> ProviderDescription {
        self.shared.provider.description()
    }

    /// The newest frame that this reader has not had, or else the next one. When a reader is dropped while it
    /// waits, another waiting reader takes over reading from the provider.
    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let mut newest = self.shared.newest.lock().await;
        let seen = self.seen.load(Ordering::Relaxed);
        if newest.0 <= seen {
            let frame = self.shared.provider.next().await?;
            *newest = (newest.0 + 1, Some(frame));
        }
        let (number, Some(frame)) = &*newest else {
            return Err(ImageError::Gone { provider: self.description().name });
        };
        self.skipped.fetch_add(number.saturating_sub(seen + 1), Ordering::Relaxed);
        self.seen.store(*number, Ordering::Relaxed);
        Ok(Arc::clone(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::{Duration, sleep, timeout};

    /// Makes a frame every 66 ms, `frames` in all.
    struct Camera {
        frames: u64,
        given: AtomicU64,
    }

    #[async_trait]
    impl ImageProvider for Camera {
        fn description(&self) -> ProviderDescription {
            ProviderDescription { name: "camera".into(), ..ProviderDescription::default() }
        }

        async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
            sleep(Duration::from_millis(66)).await;
            let number = self.given.fetch_add(1, Ordering::Relaxed);
            if number >= self.frames {
                return Err(ImageError::Gone { provider: "camera".into() });
            }
            Ok(Arc::new(RawFrame { number, ..RawFrame::default() }))
        }
    }

    fn camera(frames: u64) -> (Arc<Camera>, Arc<FanOut>) {
        let camera = Arc::new(Camera { frames, given: AtomicU64::new(0) });
        (Arc::clone(&camera), FanOut::new(camera))
    }

    #[tokio::test(start_paused = true)]
    async fn all_who_wait_get_the_same_frame() {
        let (camera, shared) = camera(5);
        let (a, b) = (shared.subscribe().await, shared.subscribe().await);
        for i in 0..5 {
            let (x, y) = tokio::join!(a.next(), b.next());
            assert_eq!((x.unwrap().number, y.unwrap().number), (i, i));
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
        assert_eq!(slow.next().await.unwrap().number, 3);
        assert_eq!((slow.skipped(), quick.skipped()), (3, 0));
        // A reader that stops waiting does not block the others.
        let gave_up = timeout(Duration::from_millis(10), slow.next()).await;
        assert!(gave_up.is_err());
        assert_eq!(quick.next().await.unwrap().number, 4);
        assert_eq!(camera.given.load(Ordering::Relaxed), 5);
    }
}
