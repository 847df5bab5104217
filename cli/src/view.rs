//! `armarium view FILE`: shows the recording of a run in the browser.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_viewer::live::{LiveConfig, LivePage, Timeline};

use crate::stopped::stopped;

/// Arguments of `view`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    armarium view report/run.mcap              the last run: play it, jump from transition to transition\n  \
    armarium view run.mcap --port 8080")]
pub(crate) struct ViewArgs {
    /// The recording, `run.mcap` beside a report.
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// The port of this machine; 0 is any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(crate) port: u16,
}

/// Serves the page until Ctrl-C. Returns the exit status: 2 when the recording cannot be shown.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &ViewArgs, out: &mut dyn Write) -> io::Result<u8> {
    let (timeline, damage) = match Timeline::of_recording(&args.file) {
        Ok(read) => read,
        Err(error) => return writeln!(out, "error: {error}").map(|()| 2),
    };
    if let Some(damage) = damage {
        writeln!(out, "warning: the recording is damaged, and shown up to there: {damage}")?;
    }
    let page = match LivePage::open(LiveConfig { port: args.port, timeline, ..LiveConfig::default() }, None) {
        Ok(page) => page,
        Err(error) => {
            return writeln!(out, "error: port {} of this machine: {error}", args.port).map(|()| 2);
        }
    };
    writeln!(out, "{}", page.url())?;
    writeln!(out, "open it in a browser; Ctrl-C ends it")?;
    out.flush()?;
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(stopped());
    Ok(0)
}
