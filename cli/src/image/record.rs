//! `armarium image record`: records providers into an MCAP file.

use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

use armarium_visionx::ImageError;
use armarium_visionx::providers::{
    Delivery, ImageCoding, ImageProvider, ProviderDescription, RawFrame, RecordingWriter, RemoteProvider,
};
use tokio::sync::mpsc;

use super::{ImageFailure, RecordArgs, argument, failed, source};
use crate::stopped::stopped;
use armarium_host::Connection;

/// Frames of one provider that may wait to be written.
const MAX_QUEUED: usize = 64;

/// Records until the requested length, or Ctrl-C.
pub(super) async fn run(
    args: &RecordArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    if args.output.exists() && !args.force {
        let shown = args.output.display();
        return Err(argument(format!(
            "{shown}: is there already and is left as it is; give another file, or --force to replace it"
        )));
    }
    let (sender, mut frames) = mpsc::channel::<(String, Arc<RawFrame>)>(MAX_QUEUED);
    let (mut providers, mut reading): (Vec<Arc<RemoteProvider>>, Vec<_>) = (Vec::new(), Vec::new());
    let mut named: Vec<ProviderDescription> = Vec::new();
    for name in &args.providers {
        let all = Delivery::All { waiting: MAX_QUEUED };
        let provider = Arc::new(source::remote(name, connection, all, ImageCoding::Raw).await?);
        let mut described = provider.description();
        if named.iter().any(|other| other.name == described.name) {
            // Providers of two agents may have the same name.
            described.name = name.replace('/', "_");
        }
        providers.push(provider);
        named.push(described);
    }
    // Only now: an existing recording must stay when a provider is missing.
    let mut recording = RecordingWriter::create(&args.output).map_err(argument)?;
    for (provider, described) in providers.iter().zip(named) {
        recording.add_provider(&described).map_err(failed)?;
        reading.push(tokio::spawn(read(Arc::clone(provider), described.name, sender.clone())));
    }
    drop(sender);
    writeln!(out, "recording into {}; Ctrl-C ends it", args.output.display())?;
    out.flush()?;
    let until = args.seconds.and_then(|s| Duration::try_from_secs_f64(s).ok()).unwrap_or(Duration::MAX);
    let writing = async {
        while args.frames.is_none_or(|most| recording.frames() < most) {
            let Some((provider, frame)) = frames.recv().await else { return Ok(()) };
            recording.add(&provider, &frame).map_err(failed)?;
        }
        Ok(())
    };
    let written: Result<(), ImageFailure> = tokio::select! {
        biased;
        () = stopped() => Ok(()),
        written = tokio::time::timeout(until, writing) => written.unwrap_or(Ok(())),
    };
    reading.iter().for_each(tokio::task::JoinHandle::abort);
    written?;
    let count = recording.frames();
    recording.finish().map_err(failed)?;
    let (missed, again) = providers.iter().fold((0, 0), |(missed, again), provider| {
        (missed + provider.statistics().missed.get(), again + provider.statistics().again.get())
    });
    writeln!(out, "{count} frames, {missed} missed, {again} asked for again")?;
    Ok(())
}

/// Passes on the frames of one provider; if writing is too slow, they wait at the reader.
async fn read(provider: Arc<RemoteProvider>, name: String, to: mpsc::Sender<(String, Arc<RawFrame>)>) {
    loop {
        let frame = match provider.next().await {
            Ok(frame) => frame,
            Err(ImageError::Spoilt { .. }) => continue,
            Err(_) => return,
        };
        if to.send((name.clone(), frame)).await.is_err() {
            return;
        }
    }
}
