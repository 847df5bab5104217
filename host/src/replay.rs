//! Feeds a recorded run to the engine again, which must pass through the same states.
//!
//! A record is JSON lines: first the chart with its inputs, then each turn of the engine with its input, the values
//! that its expressions read, and its effects. [`TurnRecorder`] writes records, [`Replay`] compares the engine with
//! them. States, transitions and events are compared, values are not.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead as _, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use armarium_runtime::engine::{Effect, Engine, InputRecord};
use armarium_runtime::exec::TraceSink;
use armarium_runtime::trace::{TraceEvent, TraceItem};
use armarium_values::Value;
use serde::{Deserialize, Serialize};

use crate::catalog;
use crate::error::HostError;

/// The source of a run: the first line of a record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSource {
    /// The chart's file.
    pub chart: PathBuf,
    /// Additional folders of charts.
    pub charts: Vec<PathBuf>,
    /// The given inputs.
    pub inputs: BTreeMap<String, Value>,
    /// The selected profile.
    pub profile: Option<String>,
}

/// Every other line: one turn of the engine.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RecordedTurn {
    turn: InputRecord,
    did: Vec<String>,
}

/// A sink that writes a record and passes everything to another sink.
pub struct TurnRecorder {
    inner: Box<dyn TraceSink>,
    file: BufWriter<File>,
    turn: Option<RecordedTurn>,
    failed: bool,
}

impl TurnRecorder {
    /// Starts a record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn begin(file: &Path, source: &RunSource, inner: Box<dyn TraceSink>) -> io::Result<Self> {
        let mut file = BufWriter::new(File::create(file)?);
        serde_json::to_writer(&mut file, source)?;
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

impl TraceSink for TurnRecorder {
    fn record(&mut self, event: &TraceEvent) {
        if let Some(turn) = &mut self.turn {
            turn.did.extend(describe(&event.item));
        }
        self.inner.record(event);
    }

    fn input(&mut self, record: &InputRecord) {
        self.write_or_warn();
        self.turn = Some(RecordedTurn { turn: record.clone(), did: Vec::new() });
        self.inner.input(record);
    }
}

impl Drop for TurnRecorder {
    fn drop(&mut self) {
        self.write_or_warn();
        if self.file.flush().is_err() {
            tracing::warn!("the end of the run's record is lost");
        }
    }
}

/// The compared part of a trace item, as text.
fn describe(item: &TraceItem) -> Option<String> {
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

/// A replayed turn.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayedTurn {
    /// Its number, from 1.
    pub number: usize,
    /// Its time, s of the run.
    pub at_s: f64,
    /// The recorded effects, as text.
    pub expected: Vec<String>,
    /// The engine's effects now.
    pub found: Vec<String>,
    /// The innermost active states after it, if they have changed.
    pub active: Option<Vec<String>>,
}

impl ReplayedTurn {
    /// Whether the engine behaves as recorded.
    pub fn is_same(&self) -> bool {
        self.expected == self.found
    }
}

/// Replays a record: an iterator over its turns.
pub struct Replay {
    engine: Engine,
    lines: io::Lines<BufReader<File>>,
    path: PathBuf,
    number: usize,
    effects: Vec<Effect>,
}

impl Replay {
    /// Opens a record and its chart.
    ///
    /// # Errors
    /// [`HostError::File`] and [`HostError::Record`] when it cannot be read; [`HostError::Findings`] when its chart is not in
    /// order any more; [`HostError::Inputs`] when the chart does not take the run's inputs any more.
    pub fn open(path: &Path) -> Result<Self, HostError> {
        let unreadable =
            |source| HostError::File { what: "the record cannot be read:", path: path.to_owned(), source };
        let no_record = |why: String| HostError::Record { path: path.to_owned(), line: 1, why };
        let mut lines = BufReader::new(File::open(path).map_err(unreadable)?).lines();
        let first = lines.next().ok_or_else(|| no_record("the file is empty".into()))?.map_err(unreadable)?;
        let source: RunSource = serde_json::from_str(&first)
            .map_err(|error| no_record(format!("this is not the record of a run: {error}")))?;
        let checked = catalog::load_idle(&source.chart, &source.charts);
        let program = checked.program.ok_or(HostError::Findings(checked.findings))?;
        let engine = Engine::new(program, &source.inputs, source.profile.as_deref())?;
        Ok(Self { engine, lines, path: path.to_owned(), number: 0, effects: Vec::new() })
    }

    fn play(&mut self, line: io::Result<String>) -> Result<ReplayedTurn, HostError> {
        self.number += 1;
        let number = self.number;
        let wrong = |why: String| HostError::Record { path: self.path.clone(), line: number + 1, why };
        let line = line.map_err(|error| wrong(error.to_string()))?;
        let RecordedTurn { turn, did } =
            serde_json::from_str(&line).map_err(|error| wrong(error.to_string()))?;
        self.effects.clear();
        self.engine.replay(&turn, &mut self.effects);
        let items = self.effects.iter().filter_map(|effect| match effect {
            Effect::Trace(item) => Some(item),
            _ => None,
        });
        let found = items.clone().filter_map(describe).collect();
        let active = items.rev().find_map(|item| match item {
            TraceItem::Configuration { leaves } => Some(leaves.clone()),
            _ => None,
        });
        Ok(ReplayedTurn { number, at_s: turn.at_ns as f64 * 1e-9, expected: did, found, active })
    }
}

impl Iterator for Replay {
    type Item = Result<ReplayedTurn, HostError>;

    fn next(&mut self) -> Option<Self::Item> {
        let line = self.lines.next()?;
        Some(self.play(line))
    }
}

#[cfg(test)]
mod tests {
    use armarium_runtime::channels::Channels;
    use armarium_runtime::chart::Registry;
    use armarium_runtime::exec::{ExecOptions, Executor};

    use super::*;

    const CHART: &str = "statechart: C\nevents: {go: {}}\ninitial: A\nstates:\n  A: {transitions: {go: {target: B, if: \"norm(channels.wrist.push) > 1.0\"}}}\n  B: {final: success}\n";

    /// A sink for tests.
    struct Nowhere;

    impl TraceSink for Nowhere {
        fn record(&mut self, _: &TraceEvent) {}
    }

    /// Records a run of the chart in a folder; a push on the wrist makes it go.
    async fn record(folder: &Path) -> PathBuf {
        let (chart, file) = (folder.join("c.yaml"), folder.join("run.jsonl"));
        std::fs::write(&chart, CHART).expect("the folder can be written");
        let program = catalog::load_idle(&chart, &[]).program.expect("the chart is in order");
        let source = RunSource { chart, charts: Vec::new(), inputs: BTreeMap::new(), profile: None };
        let sink = TurnRecorder::begin(&file, &source, Box::new(Nowhere)).expect("the folder can be written");
        let channels = Channels::new();
        channels.publish("wrist", Value::record([("push", vec![2.5, 0.0, 0.0].into())]));
        let options = ExecOptions { sink: Some(Box::new(sink)), ..Default::default() };
        let run = Executor::new(program, Registry::new(), channels, options);
        let run = run.expect("the chart has no inputs");
        assert!(run.controller().raise("go", Value::Null));
        assert_eq!(run.run().await.outcome, "success");
        file
    }

    #[tokio::test(start_paused = true)]
    async fn a_run_replays_with_what_its_guards_read_and_a_changed_chart_is_seen() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = record(folder.path()).await;
        let turns: Vec<_> = Replay::open(&file).unwrap().map(Result::unwrap).collect();
        assert!(turns.iter().all(ReplayedTurn::is_same), "{turns:?}");
        let changed = CHART.replace("> 1.0", "> 3.0");
        std::fs::write(folder.path().join("c.yaml"), changed).expect("the folder can be written");
        let mut turns = Replay::open(&file).unwrap().map(Result::unwrap);
        let differs = turns.find(|turn| !turn.is_same()).expect("the changed guard is seen");
        assert!(differs.expected.contains(&"transition A -> B".to_owned()), "{differs:?}");
        assert!(matches!(
            Replay::open(&folder.path().join("c.yaml")),
            Err(HostError::Record { line: 1, .. })
        ));
    }
}
