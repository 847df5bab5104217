//! `armarium vision figures`: the quality of fingertip tracking and gesture recognition in the simulator, and the
//! effect of each part of the tracking.

use std::io::{self, Write};

use armarium_experiments::fingertips;

use super::FiguresArgs;

/// Prints the figures. Returns the exit status 0.
pub(super) fn run(args: FiguresArgs, out: &mut dyn Write) -> io::Result<u8> {
    let (rows, gestures) = fingertips::figures(args.seeds, args.frames, !args.whole);
    writeln!(
        out,
        "| tracking | median px | 95 % px | within 6 px | lost | wrong tracks | found again, worst frame | after 5 blind frames, median px |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|")?;
    for row in rows {
        let blind = if row.blind_px.is_finite() { format!("{:.1}", row.blind_px) } else { "none".into() };
        writeln!(
            out,
            "| {} | {:.2} | {:.2} | {:.1} % | {:.2} % | {:.2} % | {} | {blind} |",
            row.name,
            row.median_px,
            row.most_px,
            100.0 * row.within,
            100.0 * row.lost,
            100.0 * row.wrong,
            row.again,
        )?;
    }
    writeln!(
        out,
        "\ngestures: {:.1} % of {} steady frames right; {} changes, noticed after {:.2} s at the latest",
        100.0 * gestures.right,
        gestures.steady,
        gestures.changes,
        gestures.latest_s,
    )?;
    Ok(0)
}
