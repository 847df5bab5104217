//! Frames that the program itself makes, such as annotated images, as a provider.
//!
//! The sender never waits. A busy reader gets the newest frame when it reads again, and the count of the frames it
//! missed.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use tokio::sync::{Mutex, watch};

use super::{ImageProvider, ProviderDescription, RawFrame};
use crate::frame::ImageError;

/// The sending end.
#[derive(Debug)]
pub struct FrameSender {
    newest: watch::Sender<(u64, Option<Arc<RawFrame>>)>,
}

/// The receiving end; a clone is another reader.
#[derive(Debug)]
pub struct FrameChannel {
    description: Arc<ProviderDescription>,
    newest: Mutex<watch::Receiver<(u64, Option<Arc<RawFrame>>)>>,
    seen: AtomicU64,
    missed: AtomicU64,
}

/// A sender and the provider of its frames.
pub fn channel(description: ProviderDescription) -> (FrameSender, FrameChannel) {
    let (newest, receiver) = watch::channel((0, None));
    let description = Arc::new(description);
    (FrameSender { newest }, FrameChannel::reader(description, receiver, 0))
}

impl FrameSender {
    /// Sends a frame to all readers and gives it the next number.
    pub fn send(&self, mut frame: RawFrame) {
        self.newest.send_modify(|(count, newest)| {
            *count += 1;
            frame.number = *count;
            *newest = Some(Arc::new(frame));
        });
    }

    /// Whether there is a reader.
    pub fn is_wanted(&self) -> bool {
        !self.newest.is_closed()
    }
}

impl FrameChannel {
    fn reader(
        description: Arc<ProviderDescription>,
        newest: watch::Receiver<(u64, Option<Arc<RawFrame>>)>,
        seen: u64,
    ) -> Self {
        Self {
            description,
            newest: Mutex::new(newest),
            seen: AtomicU64::new(seen),
            missed: AtomicU64::new(0),
        }
    }

    /// The number of frames that this reader missed while it was busy.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl ImageProvider for FrameChannel {
    fn description(&self) -> ProviderDescription {
        (*self.description).clone()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let gone = || ImageError::Gone { provider: self.description.name.clone() };
        let mut newest = self.newest.lock().await;
        newest.changed().await.map_err(|_| gone())?;
        let (count, frame) = newest.borrow_and_update().clone();
        let seen = self.seen.swap(count, Ordering::Relaxed);
        self.missed.fetch_add(count.saturating_sub(seen + 1), Ordering::Relaxed);
        frame.ok_or_else(gone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_reader_gets_the_newest_and_knows_what_it_missed() {
        let (sender, reader) =
            channel(ProviderDescription { name: "drawn".into(), ..ProviderDescription::default() });
        assert!(sender.is_wanted());
        for stamp_ns in [10, 20, 30] {
            sender.send(RawFrame { stamp_ns, ..RawFrame::default() });
        }
        let frame = reader.next().await.unwrap();
        assert_eq!((frame.stamp_ns, frame.number, reader.missed()), (30, 3, 2));
        sender.send(RawFrame::default());
        drop(sender);
        assert_eq!(reader.next().await.unwrap().number, 4);
        assert_eq!(reader.next().await.unwrap_err(), ImageError::Gone { provider: "drawn".into() });
        assert_eq!(reader.missed(), 2);
    }
}
