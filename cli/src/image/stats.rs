//! `armarium image stats`: measures a provider's frames.

use std::io::Write;
use std::time::Duration;

use armarium_visionx::ImageError;
use armarium_visionx::providers::ImageCoding;
use serde_json::json;

use super::{ImageFailure, StatsArgs, argument, source};
use armarium_host::Connection;
use tokio::time::Instant;

/// Most sizes that are printed.
const MAX_SIZES: usize = 32;

pub(super) async fn run(
    args: &StatsArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    let span = Duration::try_from_secs_f64(args.seconds).map_err(|_| argument("--seconds is at least 0"))?;
    let source = source::open(&args.source, connection, ImageCoding::Raw, None).await?;
    let (mut frames, mut bytes, mut spoilt, mut sizes) = (0u64, 0usize, 0u64, Vec::new());
    let (mut first, mut last) = (None, None);
    let counting = async {
        loop {
            match source.provider.next().await {
                Ok(frame) => {
                    frames += 1;
                    bytes += frame.bytes();
                    last = Some(Instant::now());
                    first = first.or(last);
                    let size: Vec<(u32, u32)> =
                        frame.images.iter().map(|i| (i.width(), i.height())).collect();
                    if sizes.len() < MAX_SIZES && !sizes.contains(&size) {
                        sizes.push(size);
                    }
                }
                Err(ImageError::Spoilt { .. }) => spoilt += 1,
                Err(_) => return,
            }
        }
    };
    // Ends with the time or with the provider.
    let _ = tokio::time::timeout(span, counting).await.is_ok();
    let elapsed_s =
        first.zip(last).map_or(0.0, |(first, last): (Instant, Instant)| (last - first).as_secs_f64());
    let rate = if elapsed_s > 0.0 { (frames.saturating_sub(1)) as f64 / elapsed_s } else { 0.0 };
    let mut said = json!({
        "provider": args.source.source, "frames": frames, "frames_per_s": rate,
        "bytes_per_frame": bytes as u64 / frames.max(1), "spoilt": spoilt, "sizes": sizes,
    });
    if let Some(remote) = &source.remote {
        let counts = remote.statistics();
        // The size on the link, not the decoded size.
        said["bytes_per_frame"] = (counts.bytes.get() / counts.received.get().max(1)).into();
        said["missed"] = counts.missed.get().into();
        said["malformed"] = counts.malformed.get().into();
        said["provider_starts"] = counts.lives.get().into();
        said["through_shared_memory"] = counts.shared.get().into();
        said["latency_mean_ms"] = (counts.latency.mean_s() * 1e3).into();
        said["latency_worst_ms"] = (counts.latency.worst_s() * 1e3).into();
    }
    if args.json {
        writeln!(out, "{said}")?;
    } else {
        for (name, value) in said.as_object().into_iter().flatten() {
            writeln!(out, "{:<22} {value}", name.replace('_', " "))?;
        }
    }
    Ok(())
}
