//! `armarium replay RUN`: a recorded run is fed to the engine again and must pass through the same states.
//!
//! A record (`run --record FILE`) is JSON lines: first the chart with its inputs, then each turn of the engine with
//! what it was told, what its expressions read, and what it did. [`Recorded`] writes them, [`run`] holds the engine
//! against them. Values are not compared: states, transitions and events are.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead as _, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use armarium_runtime::engine::{Effect, Engine, InputRecord};
use armarium_runtime::exec::TraceSink;
use armarium_runtime::trace::{TraceEvent, TraceItem};
use armarium_values::{Type, Value};
use serde::{Deserialize, Serialize};

use crate::catalog;

/// What `replay` takes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ReplayArgs {
    /// A record that `run --record FILE` wrote.
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Stop at this time of the run, for instance `12.5s`, and show what was active.
    #[arg(long, value_name = "TIME")]
    pub(crate) until: Option<String>,
    /// Show each turn and wait for Enter.
    #[arg(long)]
    pub(crate) step: bool,
}

/// The first line of a record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Beginning {
    /// The chart's file.
    pub(crate) chart: PathBuf,
    /// Folders of other charts.
    pub(crate) charts: Vec<PathBuf>,
    /// The inputs that were given.
    pub(crate) inputs: BTreeMap<String, Value>,
    /// The profile that was chosen.
    pub(crate) profile: Option<String>,
}

/// Every other line: one turn of the engine.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Turn {
    turn: InputRecord,
    did: Vec<String>,
}

/// A sink that writes a record beside what another sink does.
pub(crate) struct Recorded {
    inner: Box<dyn TraceSink>,
    file: BufWriter<File>,
    turn: Option<Turn>,
    failed: bool,
}

impl Recorded {
    /// Begins a record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn begin(file: &Path, beginning: &Beginning, inner: Box<dyn TraceSink>) -> io::Result<Self> {
        let mut file = BufWriter::new(File::create(file)?);
        serde_json::to_writer(&mut file, beginning)?;
        writeln!(file)?;
        Ok(Self { inner, file, turn: None, failed: false })
    }

    fn write(&mut self) -> io::Result<()> {
        if let Some(turn) = self.turn.take() {
            serde_json::to_writer(&mut self.file, &turn)?;
            writeln!(self.file)?;
        }
        Ok(())
    }

    fn write_or_warn(&mut self) {
        if self.write().is_err() && !std::mem::replace(&mut self.failed, true) {
            tracing::warn!("the record of the run cannot be written any more");
        }
    }
}

impl TraceSink for Recorded {
    fn record(&mut self, event: &TraceEvent) {
        if let Some(turn) = &mut self.turn {
            turn.did.extend(told(&event.item));
        }
        self.inner.record(event);
    }

    fn input(&mut self, record: &InputRecord) {
        self.write_or_warn();
        self.turn = Some(Turn { turn: record.clone(), did: Vec::new() });
        self.inner.input(record);
    }
}

impl Drop for Recorded {
    fn drop(&mut self) {
        self.write_or_warn();
        if self.file.flush().is_err() {
            tracing::warn!("the end of the run's record is lost");
        }
    }
}

/// What of a trace is compared, in words.
fn told(item: &TraceItem) -> Option<String> {
    Some(match item {
        TraceItem::Event { name, from: Some(from), .. } => format!("event {name} from {from}"),
        TraceItem::Event { name, from: None, .. } => format!("event {name}"),
        TraceItem::Transition { source, target, .. } => {
            format!("transition {source} -> {}", target.as_deref().unwrap_or("(stays)"))
        }
        TraceItem::Exited { state } => format!("left {state}"),
        TraceItem::Entered { state } => format!("entered {state}"),
        TraceItem::Configuration { leaves } => format!("active {}", leaves.join(" | ")),
        TraceItem::Finished { outcome, .. } => format!("ended {outcome}"),
        _ => return None,
    })
}

/// Feeds the record to the engine. Returns the exit status: 0 when it passes through the same states, 1 when it does
/// not, 2 when the record or its chart cannot be used.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &ReplayArgs, out: &mut dyn Write) -> io::Result<u8> {
    match replay(args, out)? {
        Ok(status) => Ok(status),
        Err(message) => writeln!(out, "error: {message}").map(|()| 2),
    }
}

fn replay(args: &ReplayArgs, out: &mut dyn Write) -> io::Result<Result<u8, String>> {
    let (mut engine, lines, until) = match open(args) {
        Ok(opened) => opened,
        Err(message) => return Ok(Err(message)),
    };
    let mut effects = Vec::new();
    let mut active = String::from("nothing");
    let mut count = 0usize;
    for (number, line) in lines.enumerate() {
        let turn =
            line.map_err(|e| e.to_string()).and_then(|l| serde_json::from_str(&l).map_err(|e| e.to_string()));
        let recorded: Turn = match turn {
            Ok(turn) => turn,
            Err(error) => return Ok(Err(format!("turn {} of the record: {error}", number + 1))),
        };
        let seconds = recorded.turn.at_ns as f64 * 1e-9;
        if until.is_some_and(|until| seconds > until) {
            break;
        }
        effects.clear();
        engine.replay(&recorded.turn, &mut effects);
        let did: Vec<String> = effects
            .iter()
            .filter_map(|effect| if let Effect::Trace(item) = effect { told(item) } else { None })
            .collect();
        if did != recorded.did {
            differ(number + 1, seconds, &recorded.did, &did, out)?;
            return Ok(Ok(1));
        }
        if let Some(last) = did.iter().rev().find_map(|d| d.strip_prefix("active ")) {
            active = if last.is_empty() { "nothing".into() } else { last.to_owned() };
        }
        count += 1;
        if args.step {
            writeln!(out, "[{seconds:.3} s] {}", did.join("; "))?;
            out.flush()?;
            if io::stdin().lock().read_line(&mut String::new())? == 0 {
                break;
            }
        }
    }
    writeln!(out, "{count} turns, the same states; active at the end: {active}")?;
    Ok(Ok(0))
}

/// The engine before its start, the lines of the turns, and when to stop, s.
type Opened = (Engine, io::Lines<BufReader<File>>, Option<f64>);

fn open(args: &ReplayArgs) -> Result<Opened, String> {
    let shown = args.run.display();
    let until =
        args.until.as_ref().map(|text| Type::Duration.read(text)).transpose().map_err(|e| e.to_string())?;
    let file = File::open(&args.run).map_err(|e| format!("{shown}: {e}"))?;
    let mut lines = BufReader::new(file).lines();
    let first = lines.next().ok_or(format!("{shown} is empty"))?.map_err(|e| format!("{shown}: {e}"))?;
    let beginning: Beginning =
        serde_json::from_str(&first).map_err(|e| format!("{shown} is not the record of a run: {e}"))?;
    let checked = catalog::load_idle(&beginning.chart, &beginning.charts);
    let wrong =
        || checked.findings.iter().find(|f| f.is_error()).map_or_else(String::new, ToString::to_string);
    let program = checked.program.ok_or_else(|| format!("the chart cannot be used: {}", wrong()))?;
    let engine = Engine::new(program, &beginning.inputs, beginning.profile.as_deref());
    Ok((engine.map_err(|e| e.to_string())?, lines, until.and_then(|u| u.as_f64())))
}

/// Shows the first difference, with the event at which it began.
fn differ(
    turn: usize,
    seconds: f64,
    expected: &[String],
    found: &[String],
    out: &mut dyn Write,
) -> io::Result<()> {
    let event = expected.iter().chain(found).find(|d| d.starts_with("event "));
    let event = event.map_or("no event", String::as_str);
    writeln!(out, "the replay differs from turn {turn} on, at {seconds:.3} s, with {event}")?;
    let same = expected.iter().zip(found).take_while(|(a, b)| a == b).count();
    let rest =
        |list: &[String]| if list.len() > same { list[same..].join("; ") } else { "nothing more".into() };
    writeln!(out, "  in the run: {}", rest(expected))?;
    writeln!(out, "  now:        {}", rest(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHART: &str = "statechart: C\nevents: {go: {}}\ninitial: A\nstates:\n  A: {transitions: {go: {target: B, if: \"norm(channels.wrist.push) > 1.0\"}}}\n  B: {final: success}\n";

    /// A sink for tests.
    struct Nowhere;

    impl TraceSink for Nowhere {
        fn record(&mut self, _: &TraceEvent) {}
    }

    /// Records a run of the chart in a folder: it is told to go when the wrist feels a push.
    async fn record(folder: &Path) -> PathBuf {
        let (chart, file) = (folder.join("c.yaml"), folder.join("run.jsonl"));
        std::fs::write(&chart, CHART).expect("the folder can be written");
        let program = catalog::load_idle(&chart, &[]).program.expect("the chart is in order");
        let beginning = Beginning { chart, charts: Vec::new(), inputs: BTreeMap::new(), profile: None };
        let sink = Recorded::begin(&file, &beginning, Box::new(Nowhere)).expect("the folder can be written");
        let channels = armarium_runtime::channels::Channels::new();
        channels.publish("wrist", Value::record([("push", vec![2.5, 0.0, 0.0].into())]));
        let options =
            armarium_runtime::exec::ExecOptions { sink: Some(Box::new(sink)), ..Default::default() };
        let registry = armarium_runtime::chart::Registry::new();
        let run = armarium_runtime::exec::Executor::new(program, registry, channels, options);
        let run = run.expect("the chart has no inputs");
        assert!(run.controller().raise("go", Value::Null));
        assert_eq!(run.run().await.outcome, "success");
        file
    }

    fn replayed(file: &Path) -> (u8, String) {
        let args = ReplayArgs { run: file.to_owned(), until: None, step: false };
        let mut out = Vec::new();
        let status = run(&args, &mut out).expect("memory can be written");
        (status, String::from_utf8(out).expect("text is UTF-8"))
    }

    #[tokio::test(start_paused = true)]
    async fn a_run_replays_with_what_its_guards_read_and_a_changed_chart_is_seen() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = record(folder.path()).await;
        let (status, text) = replayed(&file);
        assert_eq!(status, 0, "{text}");
        assert!(text.contains("the same states"), "{text}");
        let changed = CHART.replace("> 1.0", "> 3.0");
        std::fs::write(folder.path().join("c.yaml"), changed).expect("the folder can be written");
        let (status, text) = replayed(&file);
        assert_eq!(status, 1, "{text}");
        assert!(text.contains("with event go") && text.contains("in the run: transition A -> B"), "{text}");
        assert_eq!(replayed(&folder.path().join("c.yaml")).0, 2);
    }
}
