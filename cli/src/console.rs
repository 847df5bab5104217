//! The terminal output of a run and an agent: a progress line, notes, and findings with their places.

use std::io::{self, IsTerminal as _, Write};
use std::process;
use std::sync::Arc;

use armarium_host::{Console, HostError, WorldClock};
use armarium_source::Finding;
use armarium_viewer::progress::{Progress, ProgressLine};

use crate::connection_args::explained;
use crate::logging;
use crate::render_findings::{render, summary};

/// The terminal. Notes go to standard output, or to standard error if that shows the progress.
pub(crate) struct Terminal {
    progress: Progress,
    shows_progress: bool,
    verbose: bool,
}

impl Terminal {
    /// A terminal that shows a run's progress.
    pub(crate) fn with_progress(verbose: bool) -> Arc<dyn Console> {
        let progress = Progress::new(Box::new(io::stderr()), io::stderr().is_terminal());
        Arc::new(Self { progress, shows_progress: true, verbose })
    }

    /// A terminal that only shows notes and warnings.
    pub(crate) fn for_notes(verbose: bool) -> Self {
        Self { progress: Progress::new(Box::new(io::stderr()), false), shows_progress: false, verbose }
    }

    fn colour(&self) -> bool {
        self.shows_progress && io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
    }
}

impl Console for Terminal {
    fn note(&self, text: &str) {
        if self.shows_progress {
            self.progress.print(text);
        } else {
            let mut out = io::stdout();
            // A closed output does not stop the agent.
            let _ = writeln!(out, "{text}").and_then(|()| out.flush()).is_ok();
        }
    }

    fn page(&self, url: &str) {
        self.note(url);
    }

    fn happened(&self, line: &str) {
        if self.verbose {
            self.progress.print(line);
        }
    }

    fn progress(&self, status: &ProgressLine) {
        self.progress.update(status);
    }

    fn finished(&self, status: &ProgressLine) {
        self.progress.finish(status);
    }

    fn warnings(&self, findings: &[Finding]) {
        self.note(render(findings, self.colour(), 100).trim_end_matches('\n'));
        if self.shows_progress {
            self.note(&summary(findings));
        }
    }

    fn blocked(&self, state: &str) {
        let what = "blocks the program; the robot stands, no report is written";
        self.progress.print(&format!("the skill of `{state}` {what}"));
        process::exit(1);
    }

    fn world_begins(&self, clock: WorldClock) {
        if let Err(error) = logging::install(&self.progress, clock, self.verbose, self.colour()) {
            self.note(&format!("warning: {error}"));
        }
    }
}

/// A run for programs: each item of its trace is a line of JSON on standard output; notes go to standard error.
pub(crate) struct JsonLines;

impl Console for JsonLines {
    fn note(&self, text: &str) {
        // A closed output does not stop the run.
        let _ = writeln!(io::stderr(), "{text}").is_ok();
    }

    fn page(&self, url: &str) {
        self.note(url);
    }

    fn traced(&self, event: &serde_json::Value) {
        let mut out = io::stdout().lock();
        let _ = writeln!(out, "{event}").and_then(|()| out.flush()).is_ok();
    }

    fn warnings(&self, findings: &[Finding]) {
        self.note(render(findings, false, 100).trim_end_matches('\n'));
    }

    fn blocked(&self, state: &str) {
        self.note(&format!(
            "the skill of `{state}` blocks the program; the robot stands, no report is written"
        ));
        process::exit(1);
    }
}

/// Prints why nothing was done. Returns the exit status 2.
pub(crate) fn refuse(error: &HostError, out: &mut dyn Write) -> io::Result<u8> {
    match error {
        HostError::Findings(findings) => show(findings, out)?,
        HostError::Session(error) => writeln!(out, "error: {}", explained(error))?,
        error => writeln!(out, "error: {error}")?,
    }
    Ok(2)
}

/// Prints findings with their places, and their number.
pub(crate) fn show(findings: &[Finding], out: &mut dyn Write) -> io::Result<()> {
    let colour = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    write!(out, "{}", render(findings, colour, 100))?;
    writeln!(out, "{}", summary(findings))
}
