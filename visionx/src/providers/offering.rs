//! Publishes a provider to other processes.
//!
//! Frames are published on `{agent}/image/{provider}` while there is a subscriber, through shared memory on one
//! machine; on `.../png` and `.../jpeg` they are encoded only while there is a subscriber. A query on the key returns
//! the description. A query with `lost=EPOCH:FROM:TO` returns those of the last frames that are still kept, for readers
//! that want all.

use std::collections::VecDeque;
use std::sync::Arc;

use armarium_bus::bulk::BulkSender;
use armarium_bus::stream::{LostItems, StreamPosition};
use armarium_bus::{IncomingQuery, Key, Queryable, Session, SessionError, keys};
use parking_lot::Mutex;
use tokio::task::JoinHandle;

use super::convert::coded;
use super::fan_out::FanOut;
use super::wire::{ENCODING, Header, ImageCoding, PACKED, pack};
use super::{ImageProvider, RawFrame};
use crate::counter::Counter;
use crate::frame::ImageError;

/// The schema of a description.
pub(super) const DESCRIPTION: armarium_bus::Schema = armarium_bus::Schema::new("image/description", 1);
/// Frames kept for readers that missed some.
const MAX_KEPT: usize = 16;
/// Limit of the kept frames, bytes.
const MAX_KEPT_BYTES: usize = 64 << 20;
/// The first so many failed frames are logged, each one.
const MAX_LOGGED: u64 = 10;
/// Capacity of the query queue.
const MAX_WAITING: usize = 64;

/// A published provider; dropping this ends it.
#[derive(Debug)]
#[must_use = "the provider is offered until this is dropped"]
pub struct Offered {
    tasks: Vec<JoinHandle<()>>,
    statistics: Arc<OfferedStatistics>,
}

/// Counts of a published provider. All may be read at any time.
#[derive(Debug, Default)]
pub struct OfferedStatistics {
    /// Frames sent raw.
    pub sent: Counter,
    /// Frames that the provider could not make or whose memory was reused before they were sent.
    pub spoilt: Counter,
    /// Frames for which shared memory had no room; they were sent as copies.
    pub unshared: Counter,
}

impl Offered {
    /// Counts so far.
    pub fn statistics(&self) -> &OfferedStatistics {
        &self.statistics
    }

    /// Waits until the provider gives no more frames.
    pub async fn ended(&mut self) {
        if let Some(raw) = self.tasks.first_mut() {
            // A task that was aborted has ended too.
            let _ = raw.await.is_ok();
        }
    }
}

impl Drop for Offered {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

/// State shared by the tasks of a published provider.
struct Offering {
    provider: FanOut,
    session: Session,
    epoch: u64,
    kept: Mutex<VecDeque<Arc<RawFrame>>>,
    statistics: Arc<OfferedStatistics>,
}

/// Publishes a provider as `{agent}/image/{its name}`.
///
/// # Errors
/// [`SessionError`] when the session has ended or the names cannot be part of a key.
pub async fn offer(
    session: &Session,
    agent: &str,
    provider: Arc<dyn ImageProvider>,
) -> Result<Offered, SessionError> {
    let name = provider.description().name;
    let key = keys::image(agent, &name)?;
    let statistics = Arc::new(OfferedStatistics::default());
    let offering = Arc::new(Offering {
        session: session.clone(),
        epoch: session.now_ns(),
        kept: Mutex::new(VecDeque::new()),
        statistics: Arc::clone(&statistics),
        provider: FanOut::of(provider),
    });
    let sender = session.bulk_sender(&key, ENCODING).await?;
    let mut tasks = vec![tokio::spawn(Arc::clone(&offering).send_raw(sender))];
    for (coding, word) in [(ImageCoding::Png, "png"), (ImageCoding::Jpeg, "jpeg")] {
        let key = keys::image_coded(agent, &name, word)?;
        let sender = session.bulk_sender(&key, ENCODING).await?;
        tasks.push(tokio::spawn(Arc::clone(&offering).send_coded(sender, coding)));
    }
    let questions = session.declare_queryable(key.clone(), MAX_WAITING).await?;
    tasks.push(tokio::spawn(offering.answer(questions, key)));
    Ok(Offered { tasks, statistics })
}

impl Offering {
    /// The next frame after the `seen`th; errors are counted and skipped. `None` when there are no more frames.
    async fn next(&self, seen: &mut u64) -> Option<Arc<RawFrame>> {
        loop {
            match self.provider.next(seen).await {
                Ok(frame) => return Some(frame),
                Err(ImageError::Gone { .. }) => return None,
                Err(error) => {
                    if self.statistics.spoilt.add(1) < MAX_LOGGED {
                        tracing::warn!("{error}");
                    }
                    // A provider that fails repeatedly must not starve other tasks.
                    tokio::task::yield_now().await;
                }
            }
        }
    }

    async fn send_raw(self: Arc<Self>, sender: BulkSender) {
        let mut seen = 0;
        loop {
            sender.wanted().await;
            let Some(frame) = self.next(&mut seen).await else { return };
            let Ok(header) = Header::raw(&frame, self.epoch, self.session.now_ns()).encode() else {
                continue;
            };
            let mut slot = sender.slot(frame.bytes());
            let mut at = 0;
            for image in &frame.images {
                let end = at + image.bytes().len();
                // A frame whose memory was reused meanwhile is not sent.
                let Some(part) = slot.get_mut(at..end) else { break };
                part.copy_from_slice(image.bytes());
                at = end;
            }
            if at != slot.len() || !frame.is_intact() {
                self.statistics.spoilt.add(1);
                continue;
            }
            self.keep(&frame);
            if let Err(error) = sender.send(slot, header).await {
                tracing::warn!("a frame was not sent: {error}");
                return;
            }
            self.statistics.sent.add(1);
            self.statistics.unshared.set(sender.unshared());
        }
    }

    async fn send_coded(self: Arc<Self>, sender: BulkSender, coding: ImageCoding) {
        let mut seen = 0;
        loop {
            sender.wanted().await;
            let Some(frame) = self.next(&mut seen).await else { return };
            let (epoch, sent_ns) = (self.epoch, self.session.now_ns());
            let made = tokio::task::spawn_blocking(move || coded(&frame, coding, epoch, sent_ns)).await;
            let Ok(Ok((header, bytes))) = made else {
                self.statistics.spoilt.add(1);
                continue;
            };
            let Ok(header) = header.encode() else { continue };
            let mut slot = sender.slot(bytes.len());
            slot.copy_from_slice(&bytes);
            if sender.send(slot, header).await.is_err() {
                return;
            }
        }
    }

    fn keep(&self, frame: &Arc<RawFrame>) {
        let mut kept = self.kept.lock();
        kept.push_back(Arc::clone(frame));
        let mut bytes: usize = kept.iter().map(|frame| frame.bytes()).sum();
        while kept.len() > MAX_KEPT || bytes > MAX_KEPT_BYTES {
            bytes -= kept.pop_front().map_or(bytes, |frame| frame.bytes());
        }
    }

    async fn answer(self: Arc<Self>, mut questions: Queryable, key: Key) {
        while let Some(question) = questions.next().await {
            if let Err(error) = self.reply(&question, &key).await {
                tracing::warn!("a question about images was not answered: {error}");
            }
        }
    }

    async fn reply(&self, question: &IncomingQuery, key: &Key) -> Result<(), SessionError> {
        if question.parameters.is_empty() {
            let description = armarium_bus::encode(&self.provider.description());
            let description = description.map_err(|e| SessionError::Config { what: e.to_string() })?;
            return question.reply(key, &DESCRIPTION.encoding(), description).await;
        }
        let lost = match question.parameters.parse::<LostItems>() {
            Ok(lost) => lost,
            Err(error) => return question.refuse("text/plain", error.to_string().into()).await,
        };
        let wanted: Vec<Arc<RawFrame>> = {
            let kept = self.kept.lock();
            let position = |frame: &RawFrame| StreamPosition { epoch: self.epoch, number: frame.number };
            let fits = |frame: &&Arc<RawFrame>| lost.contains(position(frame));
            kept.iter().filter(fits).cloned().collect()
        };
        for frame in wanted.iter().filter(|frame| frame.is_intact()) {
            if let Ok(packed) = pack(frame, self.epoch, self.session.now_ns()) {
                question.reply(key, PACKED, packed).await?;
            }
        }
        Ok(())
    }
}
