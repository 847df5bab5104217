//! The rooms' warnings during a command for people without robot and clock: printed to standard error, one line each,
//! without a prefix. `RUST_LOG`, if set, can show more.

use std::fmt;

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// The default filter: warnings of our own rooms.
const DEFAULT_FILTER: &str = "off,armarium=warn";

/// Formats a line for people.
struct Plain;

impl<S, N> FormatEvent<S, N> for Plain
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let what = match *event.metadata().level() {
            Level::ERROR => "error",
            Level::WARN => "warning",
            _ => "note",
        };
        write!(writer, "{what}: ")?;
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// Installs the subscriber; a second call in one process changes nothing.
pub(crate) fn show() -> Result<(), String> {
    let wanted = std::env::var("RUST_LOG").unwrap_or_default();
    let wanted = if wanted.trim().is_empty() { DEFAULT_FILTER } else { &wanted };
    let filter = EnvFilter::try_new(wanted).map_err(|e| format!("RUST_LOG={wanted}: {e}"))?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(false)
        .event_format(Plain)
        .with_writer(std::io::stderr)
        .finish();
    // An existing subscriber is a test's.
    drop(tracing::subscriber::set_global_default(subscriber));
    Ok(())
}
