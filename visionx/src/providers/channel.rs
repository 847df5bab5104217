//! Frames that the program itself makes, such as annotated images, as a provider.
//!
//! The sender never waits. A busy reader gets the newest frame when it reads again; its number says how many it missed.

use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::{Mutex, watch};

use super::{ImageProvider, ProviderDescription, RawFrame};
use crate::frame::ImageError;

/// The sending end.
#[derive(Debug)]
pub struct FrameSender {
    newest: watch::Sender<Option<Arc<RawFrame>>>,
}

/// The receiving end.
#[derive(Debug)]
pub struct FrameChannel {
    description: ProviderDescription,
    newest: Mutex<watch::Receiver<Option<Arc<RawFrame>>>>,
}

/// A sender and the provider of its frames.
pub fn channel(description: ProviderDescription) -> (FrameSender, FrameChannel) {
    let (newest, receiver) = watch::channel(None);
    (FrameSender { newest }, FrameChannel { description, newest: Mutex::new(receiver) })
}

impl FrameSender {
    /// Sends a frame and gives it the next number.
    pub fn send(&self, frame: RawFrame) {
        self.newest.send_modify(|newest| {
            let number = newest.as_ref().map_or(1, |before| before.number + 1);
            *newest = Some(Arc::new(RawFrame { number, ..frame }));
        });
    }

    /// Whether there is a reader.
    pub fn is_wanted(&self) -> bool {
        !self.newest.is_closed()
    }
}

#[async_trait]
impl ImageProvider for FrameChannel {
    fn description(&self) -> ProviderDescription {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let gone = || ImageError::Gone { provider: self.description.name.clone() };
        let mut newest = self.newest.lock().await;
        newest.changed().await.map_err(|_| gone())?;
        newest.borrow_and_update().clone().ok_or_else(gone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_reader_gets_the_newest_whose_number_says_what_it_missed() {
        let (sender, reader) =
            channel(ProviderDescription { name: "drawn".into(), ..ProviderDescription::default() });
        assert!(sender.is_wanted());
        for stamp_ns in [10, 20, 30] {
            sender.send(RawFrame { stamp_ns, ..RawFrame::default() });
        }
        let frame = reader.next().await.unwrap();
        assert_eq!((frame.stamp_ns, frame.number), (30, 3));
        sender.send(RawFrame::default());
        drop(sender);
        assert_eq!(reader.next().await.unwrap().number, 4);
        assert_eq!(reader.next().await.unwrap_err(), ImageError::Gone { provider: "drawn".into() });
    }
}
