//! `armarium view FILE` and `armarium view AGENT`: shows the recording of a run, two beside each other, or the run of an agent
//! elsewhere, in the browser.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_host::{Connection, HostError, RemoteRun};
use armarium_viewer::live::{LivePage, PageAddress, ShownRun, ShownTimeline, Timeline};

use crate::connection_args::{ConnectionArgs, explained};
use crate::stopped::stopped;

#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    armarium view report/run.mcap              the last run: play it, jump from transition to transition\n  \
    armarium view report/run.mcap report-2/run.mcap      two runs beside each other\n  \
    armarium view bob --connect tcp/192.168.1.7:7447     a run that goes on elsewhere, `run --name bob --live --listen ...`")]
pub(crate) struct ViewArgs {
    /// The recording, `run.mcap` beside a report; or the name of an agent whose run goes on.
    #[arg(value_name = "FILE|AGENT")]
    pub(crate) shown: PathBuf,
    /// A second recording, to compare them.
    #[arg(value_name = "FILE")]
    pub(crate) other: Option<PathBuf>,
    /// The port of this machine; 0 is any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(crate) port: u16,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

/// Serves the page until Ctrl-C. Returns the exit status: 2 when there is nothing to show.
pub(crate) fn run(args: &ViewArgs, out: &mut dyn Write) -> io::Result<u8> {
    if args.other.is_none() && is_agent(&args.shown) {
        return follow(args, &args.shown.display().to_string(), out);
    }
    let mut runs = Vec::new();
    for file in [Some(&args.shown), args.other.as_ref()].into_iter().flatten() {
        let (timeline, damage) = match Timeline::of_recording(file) {
            Ok(read) => read,
            Err(error) => return writeln!(out, "error: {error}").map(|()| 2),
        };
        if let Some(damage) = damage {
            let file = file.display();
            writeln!(out, "warning: {file}: the recording is damaged, and shown up to there: {damage}")?;
        }
        runs.push(ShownTimeline { timeline, ..ShownTimeline::default() }.served() as Arc<dyn ShownRun>);
    }
    let Some(_page) = open(args.port, runs, out)? else { return Ok(2) };
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(stopped());
    Ok(0)
}

/// A name without a folder or an ending that is no file here.
fn is_agent(shown: &Path) -> bool {
    shown.components().count() == 1 && shown.extension().is_none() && !shown.exists()
}

fn follow(args: &ViewArgs, agent: &str, out: &mut dyn Write) -> io::Result<u8> {
    let found = (|| {
        let session = args.connection.config().map_err(|error| explained(&error))?;
        let said = |error: HostError| error.to_string();
        let connection = Connection::open(&session).map_err(said)?;
        let run = connection.runtime().block_on(RemoteRun::follow(&connection, agent)).map_err(said)?;
        Ok::<_, String>((connection, run))
    })();
    let (connection, run) = match found {
        Ok(found) => found,
        Err(error) => return writeln!(out, "error: {error}").map(|()| 2),
    };
    let Some(_page) = open(args.port, vec![Arc::clone(&run) as Arc<dyn ShownRun>], out)? else {
        return Ok(2);
    };
    let gone = connection.runtime().block_on(async {
        tokio::select! {
            biased;
            () = stopped() => false,
            () = run.gone() => true,
        }
    });
    if gone {
        writeln!(out, "`{agent}` has gone; pages that are open keep what they have")?;
    }
    Ok(0)
}

/// Serves a page, and says where; `None` when the port is taken.
fn open(port: u16, runs: Vec<Arc<dyn ShownRun>>, out: &mut dyn Write) -> io::Result<Option<LivePage>> {
    let page = match LivePage::open(&PageAddress::loopback(port), runs.into_iter().collect(), Vec::new()) {
        Ok(page) => page,
        Err(error) => return writeln!(out, "error: port {port} of this machine: {error}").map(|()| None),
    };
    writeln!(out, "{}", page.url())?;
    writeln!(out, "open it in a browser; Ctrl-C ends it")?;
    out.flush()?;
    Ok(Some(page))
}
