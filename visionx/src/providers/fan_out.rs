//! Many readers of one provider in one process.

use std::sync::Arc;

use tokio::sync::Mutex;

use super::{ImageProvider, ProviderDescription, RawFrame};
use crate::frame::ImageError;

/// Shares a provider. It is read only while a reader waits, once for all waiting readers.
pub(super) struct FanOut {
    provider: Arc<dyn ImageProvider>,
    /// How many frames it has given, and the newest.
    newest: Mutex<(u64, Arc<RawFrame>)>,
}

impl FanOut {
    pub(super) fn of(provider: Arc<dyn ImageProvider>) -> Self {
        Self { provider, newest: Mutex::default() }
    }

    pub(super) fn description(&self) -> ProviderDescription {
        self.provider.description()
    }

    /// The newest frame that a reader has not had, who has seen the `seen`th last, or else the next one. When a reader is dropped while
    /// it waits, another waiting reader takes over reading from the provider.
    pub(super) async fn next(&self, seen: &mut u64) -> Result<Arc<RawFrame>, ImageError> {
        let mut newest = self.newest.lock().await;
        if newest.0 <= *seen {
            let frame = self.provider.next().await?;
            *newest = (newest.0 + 1, frame);
        }
        *seen = newest.0;
        Ok(Arc::clone(&newest.1))
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::{Duration, timeout};

    use super::super::StereoProvider;
    use super::*;
    use crate::scenes::TestCamera;

    #[tokio::test(start_paused = true)]
    async fn all_who_wait_get_the_same_frame_and_who_is_slow_the_newest() {
        let camera = StereoProvider::new(TestCamera::new(5, None), "camera_left");
        let shared = FanOut::of(Arc::new(camera));
        let (mut one, mut other, mut slow) = (0, 0, 0);
        for number in 1..=4 {
            let (a, b) = tokio::join!(shared.next(&mut one), shared.next(&mut other));
            assert_eq!((a.unwrap().number, b.unwrap().number), (number, number));
        }
        assert_eq!(shared.next(&mut slow).await.unwrap().number, 4);
        // A reader that stops waiting does not block the others.
        assert!(timeout(Duration::from_millis(10), shared.next(&mut slow)).await.is_err());
        assert_eq!(shared.next(&mut one).await.unwrap().number, 5);
        assert!(matches!(shared.next(&mut one).await, Err(ImageError::Gone { .. })));
    }
}
