//! Log events of the rooms: printed to the terminal, above the progress line, with the simulated time.
//!
//! Warnings are shown; `-v` shows information too. `RUST_LOG`, if set, decides instead.

use armarium_host::WorldClock;
use armarium_viewer::progress::Progress;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;

/// Zenoh warns about a session without gossip, which is intended here. The recorder says itself, and once, that a recording
/// cannot be written; foxglove would say it for each message.
const QUIET: &str = "zenoh::net::routing::hat=error,foxglove=off";

/// Prints the simulated time of an event.
struct SimulatedTime(WorldClock);

impl FormatTime for SimulatedTime {
    fn format_time(&self, w: &mut Writer<'_>) -> std::fmt::Result {
        write!(w, "{:8.2} s", (self.0)() as f64 * 1e-9)
    }
}

/// The log filter; `wanted`: the content of `RUST_LOG`, if set.
fn filter(wanted: Option<&str>, verbose: bool) -> Result<EnvFilter, String> {
    match wanted.filter(|text| !text.trim().is_empty()) {
        Some(text) => EnvFilter::try_new(text).map_err(|e| format!("RUST_LOG={text}: {e}")),
        None => {
            Ok(EnvFilter::new(format!("{},{QUIET}", if verbose { "warn,armarium=info" } else { "warn" })))
        }
    }
}

/// A subscriber that writes lines above the progress line.
fn subscriber(
    progress: &Progress,
    clock: WorldClock,
    filter: EnvFilter,
    colour: bool,
) -> impl tracing::Subscriber + Send + Sync + use<> {
    let progress = progress.clone();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_timer(SimulatedTime(clock))
        .with_ansi(colour)
        .with_writer(move || progress.clone())
        .finish()
}

/// Checks that `RUST_LOG` can be parsed.
pub(crate) fn check_environment() -> Result<(), String> {
    filter(std::env::var("RUST_LOG").ok().as_deref(), false).map(drop)
}

/// Installs the subscriber; a second call in one process changes nothing.
pub(crate) fn install(
    progress: &Progress,
    clock: WorldClock,
    verbose: bool,
    colour: bool,
) -> Result<(), String> {
    let filter = filter(std::env::var("RUST_LOG").ok().as_deref(), verbose)?;
    // An existing subscriber is a test's, or that of an embedding program.
    drop(tracing::subscriber::set_global_default(subscriber(progress, clock, filter, colour)));
    Ok(())
}

/// Installs a subscriber that prints to the standard error output, with the time of day: for a program without a
/// robot.
pub(crate) fn install_dated() -> Result<(), String> {
    let filter = filter(std::env::var("RUST_LOG").ok().as_deref(), false)?;
    let dated =
        tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr);
    drop(tracing::subscriber::set_global_default(dated.finish()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::Arc;

    use armarium_viewer::progress::ProgressLine;
    use parking_lot::Mutex;

    use super::*;

    #[derive(Clone, Default)]
    struct Page(Arc<Mutex<Vec<u8>>>);

    impl Write for Page {
        fn write(&mut self, data: &[u8]) -> std::io::Result<usize> {
            self.0.lock().extend_from_slice(data);
            Ok(data.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// The output of a warning and a message under a filter, with a progress line on a terminal.
    fn written(wanted: Option<&str>, verbose: bool) -> String {
        let page = Page::default();
        let progress = Progress::new(Box::new(page.clone()), true);
        progress.update(&ProgressLine { states: vec!["Live".into()], ..ProgressLine::default() });
        let filter = filter(wanted, verbose).unwrap();
        tracing::subscriber::with_default(subscriber(&progress, Arc::new(|| 0), filter, false), || {
            tracing::warn!(target: "armarium_bus", "slippery");
            tracing::info!(target: "armarium_simulator::coach", "hello");
            tracing::info!(target: "somebody_else", "chatter");
        });
        let bytes = page.0.lock().clone();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn warnings_are_shown_and_verbose_shows_what_the_rooms_say() {
        let quiet = written(None, false);
        assert!(quiet.contains("0.00 s  WARN armarium_bus: slippery\n"), "{quiet:?}");
        assert!(!quiet.contains("hello") && !quiet.contains("chatter"));
        let verbose = written(Some(" "), true);
        assert!(verbose.contains("slippery") && verbose.contains("hello") && !verbose.contains("chatter"));
    }

    #[test]
    fn the_live_line_is_drawn_again_below_every_line() {
        let text = written(None, false);
        let after = text.rsplit_once('\n').map(|(_, after)| after).unwrap();
        assert!(after.contains("Live"), "{text:?}");
    }

    #[test]
    fn the_environment_decides_where_it_speaks() {
        let chosen = written(Some("somebody_else=info"), false);
        assert!(chosen.contains("chatter") && !chosen.contains("slippery"));
        assert!(filter(Some("a=b=c"), false).is_err());
    }
}
