//! `armarium image view`: a provider in a browser page, or as PNG files.

use std::io::Write;
use std::path::Path;

use armarium_visionx::ImageError;
use armarium_visionx::annotate::png;
use armarium_visionx::providers::convert::rgb_of;
use armarium_visionx::providers::{Frame, ImageCoding};

use super::{Failure, ViewArgs, argument, failed, page, source};
use crate::connection::Connection;

/// Shows the page until Ctrl-C, or writes as many frames as are asked for.
pub(super) async fn run(
    args: &ViewArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    let coding = if args.jpeg { ImageCoding::Jpeg } else { ImageCoding::Raw };
    // A page shows files as they were taken; of what is written as PNG none waits.
    let speed = args.png.is_none().then_some(1.0);
    let source = source::open(&args.source, connection, coding, speed).await?;
    let Some(folder) = &args.png else {
        return page::show(source.provider, args.port, out).await;
    };
    std::fs::create_dir_all(folder)
        .map_err(|e| argument(format!("the folder `{}` cannot be made: {e}", folder.display())))?;
    let mut written = 0;
    while written < args.frames {
        match source.provider.next().await {
            Ok(frame) => {
                write(folder, &frame, out)?;
                written += 1;
            }
            Err(error @ ImageError::Spoilt { .. }) => writeln!(out, "warning: {error}")?,
            Err(_) => break,
        }
    }
    if written == 0 { Err(failed("the provider gave no frame")) } else { Ok(()) }
}

fn write(folder: &Path, frame: &Frame, out: &mut dyn Write) -> Result<(), Failure> {
    for image in &frame.images {
        let Some(picture) = rgb_of(image) else {
            writeln!(out, "`{}` is a list of points: there is no picture of it", image.role())?;
            continue;
        };
        // A role may come from another process: it names no folder.
        let role: String = image.role().chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
        let file = folder.join(format!("{:06}_{role}.png", frame.number));
        let bytes = png(&picture).map_err(failed)?;
        std::fs::write(&file, bytes).map_err(|e| failed(format!("{}: {e}", file.display())))?;
        writeln!(out, "{}", file.display())?;
    }
    Ok(())
}
