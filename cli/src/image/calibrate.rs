//! `armarium image calibrate-check`: checks a stereo provider's calibration with its images.

use std::io::Write;

use armarium_visionx::{EpipolarCheck, ImageError};
use serde_json::json;

use super::{CalibrateArgs, ImageFailure, failed, source};
use armarium_host::Connection;

/// Largest accepted row difference, px, median.
const ROWS_PX: f64 = 0.5;
/// Largest accepted relative depth error, median.
const DEPTH: f64 = 0.02;
const MIN_CORNERS: usize = 30;

/// Checks some frames; a wrong calibration is a failure.
pub(super) async fn run(
    args: &CalibrateArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    let (source, described, pair) = source::open_pair(&args.source, connection).await?;
    let calibration = pair.calibration();
    let mut check = EpipolarCheck::default();
    for _ in 0..args.frames.max(1) {
        let frame = match source.provider.next().await {
            Ok(frame) => frame,
            Err(ImageError::Spoilt { .. }) => continue,
            Err(_) => break,
        };
        let Ok(stereo) = pair.frame(&frame) else { continue };
        let seen = tokio::task::spawn_blocking(move || EpipolarCheck::of(&stereo, &calibration)).await;
        check.add(seen.map_err(failed)?);
    }
    let corners = check.rows_px.len();
    let rows = EpipolarCheck::median(&check.rows_px);
    let spread = rows.and_then(|middle| {
        let away: Vec<f64> = check.rows_px.iter().map(|row| (row - middle).abs()).collect();
        EpipolarCheck::median(&away)
    });
    let depth = EpipolarCheck::median(&check.depth_ratio).filter(|_| check.depth_ratio.len() >= MIN_CORNERS);
    let verdict = match rows {
        None => "nothing to see",
        Some(_) if corners < MIN_CORNERS => "too little to see",
        Some(rows) if rows.abs() > ROWS_PX => "the eyes do not see in the same rows",
        Some(_) if depth.is_some_and(|ratio| (ratio - 1.0).abs() > DEPTH) => {
            "focal length or baseline do not fit the depth image"
        }
        Some(_) => "fits",
    };
    if args.json {
        let said = json!({
            "provider": described.name, "corners": corners, "rows_px": rows, "rows_spread_px": spread,
            "depth_ratio": depth, "verdict": verdict,
        });
        writeln!(out, "{said}")?;
    } else {
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
        let camera = calibration.camera;
        writeln!(
            out,
            "{}: focal {:.1} px, baseline {:.4} m",
            described.name, camera.focal, calibration.baseline
        )?;
        writeln!(out, "corners seen by both eyes      {corners}")?;
        writeln!(
            out,
            "lower in the right eye, px     {} (median), {} (spread)",
            number(rows),
            number(spread)
        )?;
        writeln!(out, "stereo depth / depth image     {}", number(depth))?;
    }
    if verdict == "fits" {
        Ok(())
    } else {
        Err(failed(format!("the calibration of `{}`: {verdict}", described.name)))
    }
}
