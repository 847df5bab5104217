//! What charts observe of memory, in runs with a memory that is only a table, and by hand.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::{Frame, Type, Vector};
use futures::FutureExt as _;

use super::*;
use crate::channels::{ObserveError, ObserveMemory};
use crate::chart::{ChannelSchema, MemorySegment, check, load_text, testing::registry};
use crate::observed::{ObservedPattern, match_of};
use crate::skill::Parameter;
use crate::stepping::Stepper;

/// A memory whose matches a test sets: the best first.
#[derive(Clone, Default)]
struct Table(Arc<Mutex<BTreeMap<String, Vec<Value>>>>);

impl Table {
    fn publish(&self, observed: &ObservedPattern, channels: &Channels) {
        let held = self.0.lock().get(&observed.pattern.to_string()).cloned().unwrap_or_default();
        let best = held.first().map(|value| (value.clone(), Duration::from_millis(300)));
        channels.publish_matches(observed, best, || held.clone());
    }
}

/// The table, and when what it holds changes.
struct Changing(Table, tokio::sync::watch::Receiver<()>);

impl ObserveMemory for Changing {
    fn observe(
        &self,
        patterns: Vec<ObservedPattern>,
        channels: Channels,
    ) -> BoxFuture<'static, Result<JoinSet<()>, ObserveError>> {
        let (table, mut changes) = (self.0.clone(), self.1.clone());
        async move {
            patterns.iter().for_each(|observed| table.publish(observed, &channels));
            let mut tasks = JoinSet::new();
            tasks.spawn(async move {
                while changes.changed().await.is_ok() {
                    patterns.iter().for_each(|observed| table.publish(observed, &channels));
                }
            });
            Ok(tasks)
        }
        .boxed()
    }
}

fn cup(name: &str, confidence: f64, x: f64) -> Value {
    let at = Vector { frame: Frame::root(), components: [x, 0.0, 0.0] };
    match_of(
        BTreeMap::from([("position".to_owned(), Value::Vector(at))]),
        confidence,
        &format!("Things/me/{name}"),
    )
}

fn schema() -> ChannelSchema {
    let attributes = vec![
        Parameter::new("position", Type::Vector, "Where it is."),
        Parameter::new("class", Type::String, "What it is."),
    ];
    let things = MemorySegment { name: "Things".into(), description: "Things.".into(), attributes };
    ChannelSchema::new().with_segment(things)
}

fn program(text: &str, others: &[(&str, &str)]) -> Arc<Program> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in others {
        std::fs::write(folder.path().join(name), text).expect("the folder can be written");
    }
    let library = load_text("test.yaml", text, &[folder.path().to_owned()]);
    let checked = check(&library, &registry(), &schema());
    let found: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
    assert_eq!(found, Vec::<String>::new());
    checked.program.expect("it is in order")
}

/// Runs a chart; `act` changes the table meanwhile. Returns the outcome, and the states with the times at which they were active.
async fn run(
    program: Arc<Program>,
    begins: &[(&str, Vec<Value>)],
    changes: Vec<(u64, &'static str, Vec<Value>)>,
) -> (RunResult, Vec<String>, Vec<InputRecord>) {
    let table = Table::default();
    let (changed, changing) = tokio::sync::watch::channel(());
    for (pattern, values) in begins {
        table.0.lock().insert((*pattern).to_owned(), values.clone());
    }
    let channels = Channels::new().with_memory(Arc::new(Changing(table.clone(), changing)));
    let seen = Arc::new(Mutex::new((Vec::new(), Vec::new())));
    let options = ExecOptions { sink: Some(Box::new(Sink(Arc::clone(&seen)))), ..ExecOptions::default() };
    let executor = Executor::new(program, registry(), channels, options).expect("there are no inputs");
    let acting = tokio::spawn(async move {
        let began = Instant::now();
        for (at, pattern, values) in changes {
            sleep_until(began + Duration::from_millis(at)).await;
            table.0.lock().insert(pattern.to_owned(), values);
            changed.send_replace(());
        }
        std::future::pending::<()>().await;
    });
    let result = executor.run().await;
    acting.abort();
    let (states, turns) = seen.lock().clone();
    (result, states, turns)
}

type Seen = (Vec<String>, Vec<InputRecord>);

struct Sink(Arc<Mutex<Seen>>);

impl TraceSink for Sink {
    fn record(&mut self, event: &TraceEvent) {
        match &event.item {
            TraceItem::Configuration { leaves } if !leaves.is_empty() => {
                self.0.lock().0.push(format!("{} {}", event.at_ns / 1_000_000, leaves.join(" ")));
            }
            TraceItem::Error { message, .. } => self.0.lock().0.push(format!("error {message}")),
            _ => {}
        }
    }
    fn input(&mut self, turn: &InputRecord) {
        self.0.lock().1.push(turn.clone());
    }
}

const WAITS: &str = "
statechart: T
observe: {cup: \"Things/*/cup*\"}
outputs: {many: {type: int}, at: {type: Vector}}
initial: Wait
states:
  Wait:
    always: {target: Known, if: \"channels.cup.confidence > 0.9\"}
    watch:
      near: {if: \"norm(channels.cup.position) < 0.5\"}
      gone: {if: \"age('cup') > 2.0\"}
    transitions:
      near: {target: Near, do: [{assign: {outputs.many: \"${size(channels.cup_all)}\", outputs.at: \"${channels.cup.position}\"}}]}
      gone: Gone
  Known: {final: known}
  Near:
    watch: {empty: \"size(channels.cup_all) == 0\"}
    transitions: {empty: Empty}
  Gone:  {final: gone}
  Empty: {final: success}
";

const CUPS: &str = "Things/*/cup*";

#[tokio::test(start_paused = true)]
async fn what_memory_holds_is_there_when_a_chart_starts() {
    let (result, states, _) =
        run(program(WAITS, &[]), &[(CUPS, vec![cup("cup1", 0.95, 3.0)])], Vec::new()).await;
    assert_eq!(result.outcome, "known", "{states:?}");
}

#[tokio::test(start_paused = true)]
async fn watches_see_what_changes_and_what_is_removed_is_absent_again() {
    let changes = vec![
        (500, CUPS, vec![cup("cup1", 0.5, 3.0)]),
        (1000, CUPS, vec![cup("cup2", 0.8, 0.1), cup("cup1", 0.5, 3.0)]),
        (1500, CUPS, Vec::new()),
    ];
    let (result, states, _) = run(program(WAITS, &[]), &[], changes.clone()).await;
    assert_eq!(result.outcome, "success", "{states:?}");
    assert_eq!(states, ["0 Wait", "1000 Near", "1500 Empty"]);
    assert_eq!(result.outputs["many"], Value::Int(2));
    let again = run(program(WAITS, &[]), &[], changes).await;
    assert_eq!((again.0, again.1), (result, states), "under virtual time a run is repeatable");
}

#[tokio::test(start_paused = true)]
async fn the_age_is_the_time_since_it_was_referenced() {
    // It is 0.3 s old when it arrives at 1 s, and 2 s old 1.7 s later; age is sampled every 20 ms.
    let (result, states, _) =
        run(program(WAITS, &[]), &[], vec![(1000, CUPS, vec![cup("cup1", 0.5, 3.0)])]).await;
    assert_eq!(result.outcome, "gone");
    let last = states.last().and_then(|line| line.split(' ').next()?.parse::<u64>().ok()).unwrap_or(0);
    assert!((2700..=2720).contains(&last), "{states:?}");
}

#[tokio::test(start_paused = true)]
async fn a_run_replays_from_its_record_without_the_memory() {
    let changes = vec![(1000, CUPS, vec![cup("cup2", 0.8, 0.1)]), (1500, CUPS, Vec::new())];
    let (_, _, turns) = run(program(WAITS, &[]), &[], changes).await;
    let mut engine = Engine::new(program(WAITS, &[]), &BTreeMap::new(), None).expect("there are no inputs");
    let mut effects = Vec::new();
    turns.iter().for_each(|turn| engine.replay(turn, &mut effects));
    let leaves: Vec<String> = effects
        .iter()
        .filter_map(|effect| match effect {
            Effect::Trace(TraceItem::Configuration { leaves }) => Some(leaves.join(" ")),
            _ => None,
        })
        .collect();
    assert_eq!(leaves, ["Wait", "Near", "Empty", ""]);
    assert_eq!(engine.outputs()["many"], Value::Int(1));
}

const INNER: &str = "
statechart: Inner
observe: {thing: \"Things/*/mug*\"}
initial: Wait
states:
  Wait:
    watch: {seen: \"channels.thing.confidence > 0.1\"}
    transitions: {seen: Done}
  Done: {final: success}
";

const OUTER: &str = "
statechart: Outer
observe: {thing: \"Things/*/cup*\"}
initial: Look
states:
  Look:
    statechart: Inner
    transitions: {success: {target: Near, if: \"channels.thing.confidence > 0.1\"}, failure: Failed}
  Near: {final: success}
  Failed: {final: failure}
";

#[tokio::test(start_paused = true)]
async fn one_name_in_two_charts_is_what_each_observes() {
    let both = [("inner.yaml", INNER)];
    let mugs = || vec![(1000, "Things/*/mug*", vec![cup("mug", 0.5, 0.0)])];
    let found = run(program(OUTER, &both), &[(CUPS, vec![cup("cup", 0.5, 0.0)])], mugs()).await;
    assert_eq!(
        (found.0.outcome.as_str(), found.1),
        ("success", vec!["0 Look.Wait".into(), "1000 Near".into()])
    );
    // Without a cup the guard is false, and nothing is raised.
    let (_, states, _) = tokio::time::timeout(
        Duration::from_secs(1),
        run(program(OUTER, &both), &[(CUPS, Vec::new())], vec![(10, "Things/*/mug*", Vec::new())]),
    )
    .await
    .map_or_else(|_| (None, vec!["waits".to_owned()], ()), |(result, states, _)| (Some(result), states, ()));
    assert_eq!(states, ["waits"]);
}

#[tokio::test(start_paused = true)]
async fn by_hand_and_without_a_memory_a_chart_does_the_same() {
    let (program, none) = (program(OUTER, &[("inner.yaml", INNER)]), BTreeMap::new());
    let mut stepper = Stepper::new(Arc::clone(&program), &none, None).expect("there are no inputs");
    stepper.start();
    let seen = |confidence: f64| Value::record([("confidence", confidence.into())]);
    stepper.publish("thing", seen(0.5), Duration::ZERO);
    assert_eq!(stepper.snapshot().configuration, ["Wait"], "the outer chart's thing is not the inner one's");
    stepper.publish("thing", Value::Null, Duration::ZERO);
    stepper.publish("Inner.thing", seen(0.5), Duration::ZERO);
    assert_eq!(stepper.snapshot().configuration, ["Done"], "the guard reads what is not there any more");
    assert!(stepper.result().is_none());
    let executor = Executor::new(
        program,
        registry(),
        Channels::new(),
        ExecOptions { closed: true, ..ExecOptions::default() },
    );
    let result = executor.expect("there are no inputs").run().await;
    assert!(result.reason.is_some_and(|reason| reason.starts_with("stuck: for 1 h")));
}
