//! From streams of frames to a stream of observations: the processor, the sink of what it observes, and the loop that runs it.
//!
//! It does not know where frames come from; see [`crate::providers`].

mod statistics;
mod workers;

use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio::time::{Duration, Instant, sleep_until};

use armarium_values::{Observation, Search};

use crate::frame::{ImageError, RgbImage};
use crate::providers::{FrameSender, ImageProvider, PixelFormat, RawFrame, RawImage};

pub use statistics::ProcessorStatistics;
pub use workers::Workers;

/// The frame and the processor of observations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeenBy {
    /// The processor's name.
    pub processor: String,
    /// The first provider's name.
    pub provider: String,
    /// The stamp of the first provider's frame, ns.
    pub stamp_ns: u64,
}

/// What a processor has seen in one frame of each of its providers.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// What it observed.
    pub observations: Vec<Observation>,
    /// What it looked for, and where that would have been seen; `None` where nothing follows from what it did not find.
    pub search: Option<Search>,
}

impl From<Vec<Observation>> for Seen {
    fn from(observations: Vec<Observation>) -> Self {
        Self { observations, search: None }
    }
}

/// A processing step: takes one frame of each of its providers and returns what it observes. It may keep state between steps.
pub trait ImageProcessor: Send {
    /// Its name.
    fn name(&self) -> &str;

    /// Processes these frames, one of each provider. Places are in `root` where the frames say where the camera was, else in
    /// the frames' own frame.
    ///
    /// # Errors
    /// [`ImageError`] when the frames do not suit this processor; later ones may.
    fn process(&mut self, frames: &[Arc<RawFrame>]) -> Result<Seen, ImageError>;

    /// A picture of the frames that were processed last with what was seen in them, for people; `None` when the processor draws
    /// nothing.
    fn annotated(&self, _frames: &[Arc<RawFrame>]) -> Option<RgbImage> {
        None
    }
}

/// Receives observations: a memory, a report, a recorder. It must not wait for slow readers.
#[async_trait]
pub trait ResultSink: Send + Sync {
    /// Takes what was observed in one frame. Returns whether more is wanted; `false` ends the loop.
    async fn take(&self, by: &SeenBy, seen: Seen) -> bool;
}

/// When a processor takes frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// On every new frame of the first provider, with the newest of the others.
    Next,
    /// The newest of each, at this interval; without new frames no step.
    Every(Duration),
}

/// The inputs and outputs of a processor's loop.
pub struct ProcessorLoop<'a> {
    /// The providers. A slow processor gets the newest frame.
    pub inputs: Vec<Arc<dyn ImageProvider>>,
    /// When it takes frames.
    pub trigger: Trigger,
    /// Where the processor works.
    pub workers: Workers,
    /// The receiver of what it observes.
    pub sink: &'a dyn ResultSink,
    /// The sender of annotated images, if any.
    pub annotated: Option<&'a FrameSender>,
    /// The counters.
    pub statistics: &'a ProcessorStatistics,
}

/// Keeps a provider's newest frame while the processor works.
struct NewestFrame {
    frame: Arc<Mutex<Option<Arc<RawFrame>>>>,
    task: tokio::task::JoinHandle<ImageError>,
}

impl NewestFrame {
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

    async fn get(&self) -> Option<Arc<RawFrame>> {
        self.frame.lock().await.clone()
    }
}

impl Drop for NewestFrame {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Feeds frames to `processor` and what it observes to the sink, until the sink wants no more.
///
/// # Errors
/// [`ImageError::Gone`] when a provider is gone.
pub async fn run_processor(
    mut processor: Box<dyn ImageProcessor>,
    with: &ProcessorLoop<'_>,
) -> Result<(), ImageError> {
    let gone = || ImageError::Gone { provider: String::new() };
    let (first, others) = with.inputs.split_first().ok_or_else(gone)?;
    let provider = first.description().name;
    let others: Vec<NewestFrame> = others.iter().map(NewestFrame::of).collect();
    let leader = matches!(with.trigger, Trigger::Every(_)).then(|| NewestFrame::of(first));
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
                Err(error) => {
                    with.statistics.count_unusable(processor.name(), &error);
                    tokio::task::yield_now().await;
                    continue;
                }
            },
        };
        let received = Instant::now();
        let began = *began.get_or_insert(received);
        // After a restart the provider counts from the beginning, so a number that is not larger is no gap.
        let missed = last.map_or(0, |last| frame.number.saturating_sub(last.saturating_add(1)));
        with.statistics.skipped.add(missed);
        last = Some(frame.number);
        let mut frames = vec![frame];
        for other in &others {
            frames.extend(other.get().await);
        }
        if frames.len() < with.inputs.len() {
            // Another provider has not sent a frame yet.
            with.statistics.skipped.add(1);
            continue;
        }
        let more;
        (processor, more) = step(processor, with, &provider, frames).await;
        with.statistics.count(began, received);
        if !more {
            return Ok(());
        }
    }
}

/// Runs one step; returns whether more is wanted.
async fn step(
    processor: Box<dyn ImageProcessor>,
    with: &ProcessorLoop<'_>,
    provider: &str,
    frames: Vec<Arc<RawFrame>>,
) -> (Box<dyn ImageProcessor>, bool) {
    let annotated = with.annotated.filter(|to| to.is_wanted());
    let (taken, draws) = (frames.clone(), annotated.is_some());
    let work = move |processor: &mut Box<dyn ImageProcessor>| {
        let seen = processor.process(&taken)?;
        Ok((seen, if draws { processor.annotated(&taken) } else { None }))
    };
    let (processor, processed) = with.workers.work(processor, work).await;
    let (seen, image) = match processed {
        Ok(processed) => processed,
        Err(error) => {
            with.statistics.count_unusable(processor.name(), &error);
            return (processor, true);
        }
    };
    if let (Some(annotated), Some(image)) = (annotated, image) {
        annotated.send(drawn(&frames[0], image));
    }
    if !frames.iter().all(|frame| frame.is_intact()) {
        with.statistics.torn.add(1);
        return (processor, true);
    }
    let stamp_ns = frames[0].stamp_ns;
    let source = SeenBy { processor: processor.name().into(), provider: provider.into(), stamp_ns };
    let more = with.sink.take(&source, seen).await;
    (processor, more)
}

/// The annotated image as a frame.
fn drawn(of: &RawFrame, image: RgbImage) -> RawFrame {
    let size = (image.width(), image.height());
    let image = RawImage::new("image", PixelFormat::Rgb8, size, image.into_data());
    let (frame_id, images) = (of.frame_id.clone(), image.into_iter().collect());
    RawFrame { number: 0, stamp_ns: of.stamp_ns, frame_id, root_from_camera: of.root_from_camera, images }
}

#[cfg(test)]
mod tests;
