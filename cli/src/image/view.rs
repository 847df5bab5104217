//! `armarium image view`: shows a provider in a browser page, or writes PNG files.

use std::io::Write;
use std::path::Path;

use armarium_visionx::ImageError;
use armarium_visionx::annotate::png;
use armarium_visionx::providers::convert::{depth_png, rgb_of};
use armarium_visionx::providers::{ImageCoding, RawFrame};

use armarium_viewer::image_page;
use tokio::net::TcpListener;

use super::{ImageFailure, ImageViewArgs, argument, failed, source};
use crate::stopped::stopped;
use armarium_host::Connection;

/// Shows the page until Ctrl-C, or writes the requested number of frames.
pub(super) async fn run(
    args: &ImageViewArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    let coding = if args.jpeg { ImageCoding::Jpeg } else { ImageCoding::Raw };
    // The page plays files at their own speed; writing PNG files needs no waiting.
    let speed = args.png.is_none().then_some(1.0);
    let source = source::open(&args.source, connection, coding, speed).await?;
    let Some(folder) = &args.png else {
        return show(source, args.port, out).await;
    };
    std::fs::create_dir_all(folder)
        .map_err(|e| argument(format!("the folder `{}` cannot be made: {e}", folder.display())))?;
    let (mut taken, mut written) = (0, 0);
    while taken < args.frames {
        match source.provider.next().await {
            Ok(frame) => {
                written += write(folder, &frame, out)?;
                taken += 1;
            }
            Err(error @ ImageError::Spoilt { .. }) => writeln!(out, "warning: {error}")?,
            Err(_) => break,
        }
    }
    let source = &args.source.source;
    match (taken, written) {
        (0, _) => Err(failed(format!("`{source}` gave no frame"))),
        (_, 0) => Err(failed(format!(
            "nothing was written: `{source}` has no pictures, only lists of points; `armarium image record` keeps those"
        ))),
        _ => Ok(()),
    }
}

async fn show(source: source::OpenedProvider, port: u16, out: &mut dyn Write) -> Result<(), ImageFailure> {
    let listener = TcpListener::bind(("127.0.0.1", port)).await;
    let listener = listener.map_err(|e| failed(format!("the page cannot be at port {port}: {e}")))?;
    let address = listener.local_addr().map_err(failed)?;
    writeln!(out, "http://{address}/ shows {}; Ctrl-C ends it", source.provider.description().name)?;
    out.flush()?;
    tokio::select! {
        biased;
        () = stopped() => {}
        () = image_page::serve(listener, source.provider, source.remote) => {}
    }
    Ok(())
}

/// Writes the images of a frame; returns their number.
fn write(folder: &Path, frame: &RawFrame, out: &mut dyn Write) -> Result<u64, ImageFailure> {
    let mut written = 0;
    for image in &frame.images {
        // A role may come from another process, and must not name a folder.
        let role: String = image.role().chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
        let (name, bytes) = match (depth_png(image).map_err(failed)?, rgb_of(image)) {
            (Some(depth), _) => (role, depth),
            // A colour picture with this name would be taken for distances.
            (None, Some(picture)) if role == "depth" => {
                (format!("{role}_colors"), png(&picture).map_err(failed)?)
            }
            (None, Some(picture)) => (role, png(&picture).map_err(failed)?),
            (None, None) => {
                writeln!(out, "`{}` is a list of points: there is no picture of it", image.role())?;
                continue;
            }
        };
        let file = folder.join(format!("{:06}_{name}.png", frame.number));
        std::fs::write(&file, bytes).map_err(|e| failed(format!("{}: {e}", file.display())))?;
        writeln!(out, "{}", file.display())?;
        written += 1;
    }
    Ok(written)
}
