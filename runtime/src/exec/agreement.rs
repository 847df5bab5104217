//! Random charts with random events, channels and skills: executor and stepper give the same trace, with the same
//! times.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use proptest::prelude::*;

use super::*;
use crate::chart::testing::{program, registry};
use crate::stepping::Stepper;

/// A list of numbers that determines a random chart.
struct RandomNumbers<'n> {
    numbers: &'n [usize],
    at: usize,
}

impl RandomNumbers<'_> {
    fn below(&mut self, bound: usize) -> usize {
        self.at += 1;
        // The position is added, so that a short list does not repeat itself.
        (self.numbers[self.at % self.numbers.len()] + self.at / self.numbers.len()) % bound
    }
}

const CONDITIONS: [&str; 7] = [
    "channels.wrist.push[0] > 3.0",
    "norm(channels.wrist.push) < 6.0",
    "channels.hand.gesture == 'fist'",
    "channels.hand.gesture == 'fist' && age('hand') > 0.05",
    "locals.n % 2 == 0",
    "6 / (locals.n % 3) > 2",
    "channels.wrist.push[1] > 0.0",
];

/// The states of a chart's regions.
const STATES: [[&str; 3]; 2] = [["A", "B", "C"], ["D", "E", "F"]];

fn chart(picks: &mut RandomNumbers<'_>) -> String {
    let mut text = String::from(
        "statechart: T\nevents: {a: {}, b: {}}\nlocals: {n: {type: int, default: 1}}\ninitial: P\nstates:\n  P:\n    parallel:\n",
    );
    for (region, states) in STATES.iter().enumerate() {
        write!(text, "      R{region}:\n        initial: {}\n        states:\n", states[0]).unwrap();
        for state in states {
            writeln!(text, "          {state}: {}", one_state(states, picks)).unwrap();
        }
    }
    text + "    transitions: {failure: P}\n"
}

fn one_state(states: &[&str], picks: &mut RandomNumbers<'_>) -> String {
    // A loop that keeps cancelling skills gets a minimum duration; without it such a run takes very long to reach
    // its bound.
    let mut least = 0;
    let mut parts = vec!["enter: [{assign: {locals.n: \"${(locals.n + 1) % 60}\"}}]".to_owned()];
    let mut events = vec!["a", "b"];
    if picks.below(3) > 0 {
        let end = ["success", "blocked", "failure", "never"][picks.below(4)];
        let time = 1 + picks.below(300);
        least = 3;
        parts.push(format!("skill: Act, with: {{end: {end}, for: {time}ms}}"));
        events.extend(["success", "blocked", "failure"]);
    }
    if picks.below(3) == 0 {
        let time = [least, 1, 70, 333][picks.below(4)] + picks.below(3);
        parts.push(format!("after: {{{time}ms: {}}}", states[picks.below(3)]));
    }
    if picks.below(3) > 0 {
        let (condition, hold) = (CONDITIONS[picks.below(7)], [least, least, 25, 110][picks.below(4)]);
        let until = [String::new(), format!(", until: \"{}\"", CONDITIONS[picks.below(7)])];
        let until = &until[picks.below(2)];
        parts.push(format!("watch: {{w: {{if: \"{condition}\", for: {hold}ms{until}}}}}"));
        events.push("w");
    }
    if picks.below(2) == 0 {
        events.push("error.execution");
    }
    let taken = events.into_iter().filter(|_| picks.below(3) > 0).collect::<Vec<_>>();
    let each = taken.iter().map(|event| format!("{event}: {}", states[picks.below(3)]));
    let transitions = each.collect::<Vec<_>>().join(", ");
    parts.push(format!("transitions: {{{transitions}}}"));
    format!("{{{}}}", parts.join(", "))
}

/// An event from outside.
#[derive(Clone, Copy, Debug)]
enum ExternalInput {
    Event(&'static str),
    Push(f64),
    Gesture(&'static str),
}

fn outside() -> impl Strategy<Value = ExternalInput> {
    prop_oneof![
        Just(ExternalInput::Event("a")),
        Just(ExternalInput::Event("b")),
        prop_oneof![Just(0.0), Just(4.0), Just(9.0), Just(f64::NAN)].prop_map(ExternalInput::Push),
        prop_oneof![Just("fist"), Just("none")].prop_map(ExternalInput::Gesture),
    ]
}

fn published(what: ExternalInput) -> Option<(&'static str, Value)> {
    match what {
        ExternalInput::Event(_) => None,
        ExternalInput::Push(x) => Some(("wrist", Value::record([("push", vec![x, 4.0 - x].into())]))),
        ExternalInput::Gesture(word) => Some(("hand", Value::record([("gesture", word.into())]))),
    }
}

/// How long a run is compared after the last event from outside.
const AFTER: Duration = Duration::from_millis(400);

fn executed(program: &Arc<Program>, script: &[(Duration, ExternalInput)]) -> Vec<TraceEvent> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
    runtime.unwrap().block_on(async {
        let trace = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&trace);
        let sink = move |event: &TraceEvent| seen.lock().push(event.clone());
        let options = ExecOptions { sink: Some(Box::new(sink)), ..ExecOptions::default() };
        let channels = Channels::new();
        let executor = Executor::new(Arc::clone(program), registry(), channels.clone(), options).unwrap();
        let controller = executor.controller();
        let script = script.to_vec();
        let began = Instant::now();
        let controlling = tokio::spawn(async move {
            let mut at = began;
            for (gap, what) in script {
                at += gap;
                sleep_until(at).await;
                match (what, published(what)) {
                    (ExternalInput::Event(name), _) => assert!(controller.raise(name, Value::Null)),
                    (_, Some((channel, value))) => channels.publish(channel, value),
                    _ => {}
                }
            }
            sleep_until(at + AFTER).await;
            controller.stop("that is all");
        });
        executor.run().await;
        controlling.abort();
        trace.lock().clone()
    })
}

/// The same run by the stepper. `None` if two events fall on one instant, as their order is then not defined.
fn stepped(program: &Arc<Program>, script: &[(Duration, ExternalInput)]) -> Option<Vec<TraceEvent>> {
    let mut stepper = Stepper::new(Arc::clone(program), &BTreeMap::new(), None).unwrap();
    let mut endings: BTreeMap<Duration, (u64, String, String)> = BTreeMap::new();
    let mut known = BTreeSet::new();
    let mut at = Duration::ZERO;
    let mut outside: BTreeMap<Duration, Option<ExternalInput>> = BTreeMap::new();
    for (gap, what) in script {
        at += *gap;
        outside.insert(at, Some(*what));
    }
    outside.insert(at + AFTER, None);
    stepper.start();
    loop {
        plan(&stepper, &mut known, &mut endings)?;
        let own = stepper.next_instant();
        let (ending, coming) = (endings.keys().next().copied(), outside.keys().next().copied()?);
        let first = [own, ending, Some(coming)].into_iter().flatten().min()?;
        let at_once = [own, ending, Some(coming)].into_iter().flatten().filter(|at| *at == first).count();
        if at_once > 1 {
            return None;
        }
        stepper.advance(first - stepper.now());
        if let Some((activation, path, outcome)) = endings.remove(&first) {
            if stepper.running().iter().any(|running| running.activation == activation) {
                let data = match outcome.as_str() {
                    "failure" => Value::record([("reason", "it did not work".into())]),
                    _ => Value::record([("value", 1.0.into())]),
                };
                stepper.report(&path, &outcome, data).unwrap();
            }
        } else if let Some(what) = outside.remove(&first) {
            match (what, what.and_then(published)) {
                (None, _) => return Some(std::mem::take(&mut stepper.trace)),
                (Some(ExternalInput::Event(name)), _) => stepper.event(name, Value::Null),
                (_, Some((channel, value))) => stepper.publish(channel, value, Duration::ZERO),
                _ => {}
            }
        }
    }
}

/// Looks up when and how the started skills end.
fn plan(
    stepper: &Stepper,
    known: &mut BTreeSet<u64>,
    endings: &mut BTreeMap<Duration, (u64, String, String)>,
) -> Option<()> {
    for running in stepper.running() {
        if !known.insert(running.activation) {
            continue;
        }
        let started = stepper.trace.iter().find_map(|event| match &event.item {
            TraceItem::SkillStarted { activation, inputs, .. } if *activation == running.activation => {
                Some(inputs)
            }
            _ => None,
        })?;
        let end = started["end"].as_str().unwrap_or("never").to_owned();
        if end == "never" {
            continue;
        }
        let takes = Duration::from_secs_f64(started["for"].as_f64().unwrap_or(0.0));
        let took = endings.insert(stepper.now() + takes, (running.activation, running.path, end));
        // A skill whose state has been left meanwhile no longer ends.
        if took.is_some_and(|(other, ..)| stepper.running().iter().any(|r| r.activation == other)) {
            return None;
        }
    }
    Some(())
}

/// The trace as text. Skills that were cancelled together and return at one instant are sorted: in the executor, a
/// skill that has not started yet returns before one that waits.
fn lines(trace: &[TraceEvent], until_ns: u64) -> Vec<String> {
    let returned =
        |item: &TraceItem| matches!(item, TraceItem::SkillEnded { outcome, .. } if outcome == "cancelled");
    let mut before: Vec<&TraceEvent> = trace.iter().filter(|event| event.at_ns < until_ns).collect();
    for together in before.chunk_by_mut(|a, b| returned(&a.item) && returned(&b.item)) {
        together.sort_by_key(|event| format!("{:?}", event.item));
    }
    before.iter().map(|event| format!("{} {:?}", event.at_ns / 1000, event.item)).collect()
}

/// Both traces up to the end of the script, as text.
fn both(program: &Arc<Program>, script: &[(Duration, ExternalInput)]) -> Option<[Vec<String>; 2]> {
    let stepped = stepped(program, script)?;
    let end = script.iter().map(|(gap, _)| *gap).sum::<Duration>() + AFTER;
    let until_ns = u64::try_from(end.as_nanos()).unwrap();
    Some([lines(&executed(program, script), until_ns), lines(&stepped, until_ns)])
}

#[test]
fn firings_are_counted_alike_where_nothing_is_armed_between_them() {
    // A's watch fires once and fails, which leaves A and clears the agenda; after that it fires without rest.
    let chart = "
statechart: T
locals: {n: {type: int, default: 4}}
initial: A
states:
  A:
    enter: [{assign: {locals.n: '${locals.n + 2}'}}]
    watch: {w: {if: locals.n % 2 == 0, for: 0ms, until: 6 / (locals.n % 3) > 2}}
    transitions: {error.execution: B}
  B: {skill: Act, with: {end: success, for: 2ms}, transitions: {success: A, blocked: A, failure: A}}
";
    let [executed, stepped] =
        both(&program(chart), &[(Duration::from_millis(1), ExternalInput::Push(0.0))]).unwrap();
    assert!(executed.last().unwrap().contains("firings of watches without rest"), "{executed:#?}");
    assert_eq!(executed, stepped);
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 300,
        failure_persistence: None,
        max_global_rejects: 4000,
        ..ProptestConfig::default()
    })]

    #[test]
    fn executor_and_stepper_give_the_same_trace(
        numbers in prop::collection::vec(0_usize..1000, 20..80),
        script in prop::collection::vec((1_u64..400, outside()), 1..20),
    ) {
        let text = chart(&mut RandomNumbers { numbers: &numbers, at: 0 });
        let program = program(&text);
        let script: Vec<_> = script.iter().map(|(gap, what)| (Duration::from_millis(*gap), *what)).collect();
        let Some([executed, stepped]) = both(&program, &script) else {
            return Err(TestCaseError::reject("at once"));
        };
        let same = executed.iter().zip(&stepped).take_while(|(a, b)| a == b).count();
        let near = |lines: &[String]| lines[same.saturating_sub(6)..].iter().take(10).cloned().collect::<Vec<_>>();
        if executed != stepped {
            let (executed, stepped) = (near(&executed), near(&stepped));
            return Err(TestCaseError::fail(format!("{text}{executed:#?}\nis not\n{stepped:#?}")));
        }
    }
}
