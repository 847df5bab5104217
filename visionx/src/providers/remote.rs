//! A provider of another process, seen from this one.
//!
//! Frames come through shared memory where both processes support it, otherwise over the network. After a restart of
//! the provider its readers continue. Gaps in the frame numbers are counted; a reader that wants all frames requests
//! the missing ones again.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::bulk::{Bulk, BulkBytes, BulkReader, remove_orphans};
use armarium_bus::keys::{self, Key};
use armarium_bus::stream::{Arrival, LostItems, StreamPosition, StreamReader};
use armarium_bus::{Reply, Session, SessionError};
use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio::time::Instant;

use super::discovery::{RemoteError, describe};
use super::frame::PixelOwner;
use super::wire::{ENCODING, Header, ImageCoding, PACKED, WireError, unpack};
use super::{ImageProvider, ProviderDescription, RawFrame};
use crate::counter::{Counter, Latency};
use crate::frame::ImageError;

/// A provider without frames for this long counts as gone, and its shared memory is removed.
const SILENCE_WARNING: Duration = Duration::from_secs(5);
/// Timeout of a request for missing frames.
const QUERY_TIMEOUT: Duration = Duration::from_secs(1);
/// Most frames requested again at once.
const MAX_REQUESTED: usize = 64;

/// Which frames a reader gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// The newest, for live use. The queue holds one frame.
    Newest,
    /// All, up to the queue's capacity, for recording. They are copied out of shared memory, and lost frames are
    /// requested again.
    All {
        /// Capacity of the queue, frames.
        waiting: usize,
    },
}

/// A provider in another process.
pub struct RemoteProvider {
    session: Session,
    key: Key,
    /// `AGENT/PROVIDER`, for people.
    name: String,
    description: Arc<ProviderDescription>,
    reader: BulkReader,
    again: bool,
    state: Mutex<Intake>,
    statistics: RemoteStatistics,
}

#[derive(Default)]
struct Intake {
    /// Position in the stream of frames.
    stream: StreamReader,
    /// Frames ready to be returned, including those requested again.
    ready: VecDeque<Arc<RawFrame>>,
    /// When the last frame came; `None` before the first.
    heard: Option<Instant>,
    /// Whether the timeout since the last frame was already handled.
    quiet: bool,
}

/// Counts of a reader. All may be read at any time.
#[derive(Debug, Default)]
pub struct RemoteStatistics {
    /// Frames received, including those requested again.
    pub received: Counter,
    /// Frames lost for good, by the gaps in their numbers: provider, network or this reader was too slow.
    pub missed: Counter,
    /// Frames received only after they were requested again.
    pub again: Counter,
    /// Messages that are not valid frames.
    pub malformed: Counter,
    /// How often the provider started, as seen from here: 1, plus 1 for each restart.
    pub lives: Counter,
    /// Frames received through shared memory.
    pub shared: Counter,
    /// Bytes of the frames as received; for encoded images, the size of their files.
    pub bytes: Counter,
    /// Time from sending a frame to taking it here, by both processes' wall clocks, so valid only on one machine.
    pub latency: Latency,
}

impl PixelOwner for BulkBytes {
    fn bytes(&self) -> &[u8] {
        self.as_ref()
    }

    fn is_intact(&self) -> bool {
        BulkBytes::is_intact(self)
    }
}

impl RemoteProvider {
    /// Connects to `{agent}/image/{provider}` and waits at most `wait` for its answer.
    ///
    /// # Errors
    /// [`SessionError::NoReply`] without an answer, [`RemoteError::Description`] when the answer cannot be
    /// read.
    pub async fn connect(
        session: &Session,
        agent: &str,
        provider: &str,
        delivery: Delivery,
        coding: ImageCoding,
        wait: Duration,
    ) -> Result<Self, RemoteError> {
        let key = keys::image(agent, provider).map_err(SessionError::from)?;
        let frames = match coding {
            ImageCoding::Raw => key.clone(),
            ImageCoding::Png => keys::image_coded(agent, provider, "png").map_err(SessionError::from)?,
            ImageCoding::Jpeg => keys::image_coded(agent, provider, "jpeg").map_err(SessionError::from)?,
        };
        let (capacity, all) = match delivery {
            Delivery::Newest => (1, false),
            Delivery::All { waiting } => (waiting, true),
        };
        let name = format!("{agent}/{provider}");
        let description = Arc::new(describe(session, &key, &name, wait).await?);
        let reader = session.bulk_reader(frames, capacity, all).await?;
        let again = all && coding == ImageCoding::Raw;
        let (state, statistics) = (Mutex::default(), RemoteStatistics::default());
        Ok(Self { session: session.clone(), key, name, description, reader, again, state, statistics })
    }

    /// Counts so far.
    pub fn statistics(&self) -> &RemoteStatistics {
        &self.statistics
    }

    /// The newest frame if there is a new one; does not wait. Callers that need no frames for now must still call
    /// this every few seconds, because it frees the pixels of a provider that is gone.
    pub async fn newest(&self) -> Option<Arc<RawFrame>> {
        let mut state = self.state.lock().await;
        loop {
            if let Some(frame) = state.ready.pop_front() {
                return Some(frame);
            }
            let Some(bulk) = self.reader.try_next() else {
                let silent = state.heard.is_some_and(|heard| heard.elapsed() >= SILENCE_WARNING);
                if silent && !std::mem::replace(&mut state.quiet, true) {
                    sweep().await;
                }
                return None;
            };
            self.take(&bulk, &mut state).await;
        }
    }

    /// Queries the description of a restarted provider, and warns when its images changed, because readers still use
    /// the old description.
    fn compare_cameras(&self) {
        let (session, key, name) = (self.session.clone(), self.key.clone(), self.name.clone());
        let before = Arc::clone(&self.description);
        tokio::spawn(async move {
            let Ok(now) = describe(&session, &key, &name, SILENCE_WARNING).await else { return };
            if now.images != before.images {
                tracing::warn!(
                    "`{name}` has begun anew with other images or cameras than before, and is still read by the old \
                     ones: start this reader anew"
                );
            }
        });
    }

    /// Warns once that no frames arrive.
    fn warn_when_silent(&self, state: &mut Intake) {
        if std::mem::replace(&mut state.quiet, true) {
            return;
        }
        let (name, quiet) = (&self.name, SILENCE_WARNING.as_secs());
        if state.heard.is_some() {
            tracing::warn!(
                "no more frames for {quiet} s from `{name}`: it is waited for until it comes back"
            );
        } else {
            tracing::warn!(
                "no frame for {quiet} s from `{name}`, which answered: it has nothing to show yet, or has gone; it is \
                 waited for. `armarium cameras` gives frames only while a run is connected to it"
            );
        }
    }

    /// Decodes a message and queues its frames.
    async fn take(&self, bulk: &Bulk, state: &mut Intake) {
        let (header, frame) = match read(bulk) {
            Ok(read) => read,
            Err(error) => {
                if self.statistics.malformed.add(1) == 0 {
                    tracing::warn!("`{}` sends what cannot be read, and is left out: {error}", self.name);
                }
                return;
            }
        };
        let counts = &self.statistics;
        match state.stream.arrive(header.position(), 1) {
            Arrival::InOrder | Arrival::Again => {}
            Arrival::After(lost) if self.again => self.request_lost(lost, state).await,
            Arrival::After(lost) => {
                counts.missed.add(lost.count());
            }
            Arrival::First => {
                counts.lives.add(1);
            }
            Arrival::NewEpoch => {
                counts.lives.add(1);
                self.compare_cameras();
                sweep().await;
            }
        }
        counts.latency.add(Duration::from_nanos(self.session.now_ns().saturating_sub(header.sent_ns)));
        counts.shared.add(u64::from(bulk.payload.is_shared()));
        counts.received.add(1);
        counts.bytes.add(bulk.payload.as_ref().len() as u64);
        (state.heard, state.quiet) = (Some(Instant::now()), false);
        state.ready.push_back(Arc::new(frame));
    }

    /// Requests the lost frames again; those that are no longer kept count as missed.
    async fn request_lost(&self, lost: LostItems, state: &mut Intake) {
        let asked =
            self.session.query(self.key.clone(), &lost.to_string(), None, MAX_REQUESTED, QUERY_TIMEOUT).await;
        let mut found: Vec<RawFrame> = asked.unwrap_or_default().into_iter().filter_map(packed).collect();
        found.retain(|frame| lost.contains(StreamPosition { epoch: lost.epoch, number: frame.number }));
        found.sort_by_key(|frame| frame.number);
        found.dedup_by_key(|frame| frame.number);
        let count = found.len() as u64;
        self.statistics.again.add(count);
        self.statistics.received.add(count);
        self.statistics.bytes.add(found.iter().map(RawFrame::bytes).sum::<usize>() as u64);
        self.statistics.missed.add(lost.count().saturating_sub(count));
        state.ready.extend(found.into_iter().map(Arc::new));
    }
}

#[async_trait]
impl ImageProvider for RemoteProvider {
    fn description(&self) -> ProviderDescription {
        (*self.description).clone()
    }

    /// Waits without a limit, because a provider may come back. Warns once when no frames arrive.
    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let mut state = self.state.lock().await;
        loop {
            if let Some(frame) = state.ready.pop_front() {
                return Ok(frame);
            }
            let bulk = match tokio::time::timeout(SILENCE_WARNING, self.reader.next()).await {
                Ok(bulk) => bulk,
                Err(_) => {
                    self.warn_when_silent(&mut state);
                    sweep().await;
                    self.reader.next().await
                }
            };
            self.take(&bulk, &mut state).await;
        }
    }
}

/// Removes the shared memory of processes that were killed.
async fn sweep() {
    let _ = tokio::task::spawn_blocking(remove_orphans).await.is_ok();
}

fn read(bulk: &Bulk) -> Result<(Header, RawFrame), WireError> {
    if bulk.encoding != ENCODING {
        return Err(WireError::Encoding(bulk.encoding.clone()));
    }
    let header = Header::decode(&bulk.attachment)?;
    let owner: Arc<dyn PixelOwner> = Arc::new(bulk.payload.clone());
    let frame = header.frame(&owner)?;
    Ok((header, frame))
}

fn packed(answer: Reply) -> Option<RawFrame> {
    let Reply::Message(message) = answer else { return None };
    (message.encoding == PACKED).then(|| unpack(message.payload).ok()).flatten().map(|(_, frame)| frame)
}
