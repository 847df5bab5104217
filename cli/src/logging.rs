//! Where the rooms' log events go: to the terminal, above the progress line, with the simulated time before them.
//!
//! Warnings are shown; `-v` shows what happens too, and `RUST_LOG` decides instead where it is set.

use armarium_host::Clock;
use armarium_viewer::progress::Progress;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;

/// Zenoh warns whoever connects that his session does not gossip, which it is not to do.
const QUIET: &str = "zenoh::net::routing::hat=error";

/// Tells the simulated time of an event.
struct Simulated(Clock);

impl FormatTime for Simulated {
    fn format_time(&self, w: &mut Writer<'_>) -> std::fmt::Result {
        write!(w, "{:8.2} s", (self.0)() as f64 * 1e-9)
    }
}

/// What is shown: `wanted` is the content of `RUST_LOG`, if there is any.
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
    clock: Clock,
    filter: EnvFilter,
    colour: bool,
) -> impl tracing::Subscriber + Send + Sync + use<> {
    let progress = progress.clone();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_timer(Simulated(clock))
        .with_ansi(colour)
        .with_writer(move || progress.clone())
        .finish()
}

/// Whether `RUST_LOG` can be read.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn check_environment() -> Result<(), String> {
    filter(std::env::var("RUST_LOG").ok().as_deref(), false).map(drop)
}

/// From here on log events are shown; a second call in one process changes nothing.
///
/// # Errors
/// When `RUST_LOG` cannot be read.
pub(crate) fn install(progress: &Progress, clock: Clock, verbose: bool, colour: bool) -> Result<(), String> {
    let filter = filter(std::env::var("RUST_LOG").ok().as_deref(), verbose)?;
    // A subscriber that is there already is a test's, or that of an embedding program.
    drop(tracing::subscriber::set_global_default(subscriber(progress, clock, filter, colour)));
    Ok(())
}

/// From here on log events are shown on the standard error output, with the time of day: for a program that has no robot.
///
/// # Errors
/// When `RUST_LOG` cannot be read.
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

    use armarium_viewer::progress::Status;
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

    /// What is written of a warning and a message under a filter, with a live line on a terminal.
    fn written(wanted: Option<&str>, verbose: bool) -> String {
        let page = Page::default();
        let progress = Progress::new(Box::new(page.clone()), true);
        progress.update(&Status { states: vec!["Live".into()], ..Status::default() });
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
