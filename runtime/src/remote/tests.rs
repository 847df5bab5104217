//! Two sessions on loopback in one process: one offers, the other starts.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use armarium_bus::{Session, SessionConfig, keys};
use armarium_values::{Type, Value};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

use super::wire::{Manifest, Status, packed};
use super::*;
use crate::channels::Channels;
use crate::chart::testing::{Act, program};
use crate::chart::{self, ChannelSchema, Registry};
use crate::exec::{ChartSkill, ExecOptions, Executor, RunResult};
use crate::skill::{Skill, SkillManifest};
use crate::trace::{TraceEvent, TraceItem};

const DANCE: &str = "
statechart: Dance
inputs: {steps: {type: int, minimum: 1, maximum: 1000}}
outputs: {danced: {type: int}}
initial: Turning
states:
  Turning: {after: [{for: 30ms, target: Done, do: [{assign: {outputs.danced: \"${inputs.steps * 2}\"}}]}]}
  Done: {final: success}
";

/// Two sessions that reach each other.
pub(super) async fn pair() -> (Session, Session) {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let two = Session::open(&SessionConfig::connected_to(&one.endpoints().await)).await.unwrap();
    (one, two)
}

/// Offers the chart and the skill `Act` as `bob`.
fn bob(session: &Session) -> JoinHandle<Result<(), ServeError>> {
    let mut offers = Offers::new("bob", session, Channels::new(), Arc::new(|_| {}));
    let dance = ChartSkill::new(program(DANCE), "Dances.", Registry::new(), Arc::new(|_| {}));
    offers.add(Arc::new(dance)).unwrap();
    offers.add(Arc::new(Act("Act"))).unwrap();
    assert_eq!(offers.names().collect::<Vec<_>>(), ["Act", "Dance"]);
    let session = session.clone();
    tokio::spawn(async move { serve(&session, offers).await })
}

/// Checks a chart with what other agents offer. Returns the program with its skills, or the findings.
async fn checked(session: &Session, text: &str) -> Result<(Arc<crate::program::Program>, Registry), String> {
    checked_within(session, text, Duration::from_secs(5)).await
}

/// The same; what is not there yet is waited for so long.
async fn checked_within(
    session: &Session,
    text: &str,
    within: Duration,
) -> Result<(Arc<crate::program::Program>, Registry), String> {
    let library = chart::load_text("t.yaml", text, &[]);
    let agents = Agents::new(session.clone(), "test", Handle::current());
    let mut registry = Registry::new();
    agents.resolve(&library.remote_names(), within, &mut registry).await;
    let checked = chart::check(&library, &registry, &ChannelSchema::new());
    let said: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
    checked.program.map(|program| (program, registry)).ok_or(said.join("\n"))
}

/// Runs a chart. Returns its result and a part of the trace: entered states, insides and ends of skills.
async fn run(session: &Session, text: &str) -> (RunResult, Vec<String>) {
    let (program, registry) = checked(session, text).await.expect("the chart is in order");
    let told = Arc::new(Mutex::new(Vec::new()));
    let lines = Arc::clone(&told);
    let sink = move |event: &TraceEvent| {
        let line = match &event.item {
            TraceItem::Inside { state, leaves } => format!("{state} [{}]", leaves.join(" ")),
            TraceItem::SkillEnded { state, outcome, .. } => format!("{state}: {outcome}"),
            TraceItem::Entered { state } => format!("entered {state}"),
            TraceItem::Event { name, .. } => format!("event {name}"),
            _ => return,
        };
        lines.lock().unwrap().push(line);
    };
    let options = ExecOptions { sink: Some(Box::new(sink)), ..ExecOptions::default() };
    let result = Executor::new(program, registry, Channels::new(), options).unwrap().run().await;
    let told = told.lock().unwrap().clone();
    (result, told)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn inputs_go_over_and_outcome_outputs_and_active_states_come_back() {
    let (one, two) = pair().await;
    let _bob = bob(&one);
    let (result, told) = run(
        &two,
        "
statechart: T
outputs: {n: {type: int}}
initial: A
states:
  A:
    remote: bob/Dance
    with: {steps: 21}
    transitions: {success: {target: Done, do: [{assign: {outputs.n: \"${A.danced}\"}}]}}
  Done: {final: success}
",
    )
    .await;
    assert_eq!((result.outcome.as_str(), &result.outputs["n"]), ("success", &Value::Int(42)), "{result:?}");
    assert!(told.contains(&"A [Turning]".to_owned()), "{told:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancel_is_passed_on_and_waited_for_and_events_come_over() {
    let (one, two) = pair().await;
    let _bob = bob(&one);
    let (result, told) = run(
        &two,
        "
statechart: T
initial: A
states:
  A: {remote: bob/Act, with: {end: ping, force: 3 N}, transitions: {ping: B}}
  B: {remote: bob/Act, with: {end: never, late: 300ms}, after: {100ms: Done}}
  Done: {final: success}
",
    )
    .await;
    assert_eq!(result.outcome, "success", "{result:?}");
    let ends = |line: &str| told.iter().position(|l| l == line);
    assert!(ends("event ping").is_some(), "{told:?}");
    assert!(ends("B: cancelled").expect("it returned") < ends("entered Done").expect("it ended"), "{told:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn failures_of_the_other_agent_are_failures_here_with_their_reason() {
    let (one, two) = pair().await;
    let _bob = bob(&one);
    for (end, reason) in [("failure", "it did not work"), ("panic", "panicked"), ("odd", "does not declare")]
    {
        let chart =
            format!("statechart: T\ninitial: A\nstates: {{A: {{remote: bob/Act, with: {{end: {end}}}}}}}\n");
        let (result, _) = run(&two, &chart).await;
        let said = result.reason.unwrap();
        assert_eq!(result.outcome, "failure");
        assert!(said.contains(reason), "{said}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_does_not_fit_is_said_at_load() {
    let (one, two) = pair().await;
    let _bob = bob(&one);
    let one_state = |state: &str| format!("statechart: T\ninitial: A\nstates: {{A: {state}}}\n");
    let there = one_state("{remote: bob/Dance, with: {steps: 1}}");
    assert!(checked(&two, &there).await.is_ok(), "he is there, and waiting for him is over");
    for (state, said) in [
        ("{remote: bob/Dnce, with: {steps: 1}}", "did you mean `Dance`"),
        ("{remote: bob/Dance, with: {steps: many}}", "expected int"),
        ("{remote: bob/Dance}", "needs the input `steps`"),
        ("{remote: bob/Dance, with: {steps: 1001}}", "1001 is outside of the allowed range, 1 to 1000"),
        ("{remote: bob/Dance, with: {steps: 1, speed: 2}}", "no input `speed`"),
        ("{remote: carol/Dance, with: {steps: 1}}", "no agent `carol` answers"),
    ] {
        let checked = checked_within(&two, &one_state(state), Duration::from_millis(300)).await;
        let found = checked.map(|_| ()).unwrap_err();
        assert!(found.contains(said), "{state}: {found}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_agents_of_one_name_are_named() {
    let (one, two) = pair().await;
    let _bob = bob(&one);
    let chart = "statechart: T\ninitial: A\nstates: {A: {remote: bob/Act, with: {end: never}}}\n";
    assert!(checked(&two, chart).await.is_ok());
    let three = Session::open(&SessionConfig::connected_to(&two.endpoints().await)).await.unwrap();
    let _impostor = bob(&three);
    // The other agent appears as soon as the network knows it.
    let found = loop {
        if let Err(found) = checked(&two, chart).await {
            break found;
        }
    };
    assert!(found.contains("two agents are called `bob` and offer `Act`"), "{found}");
}

/// Options of a run that reports the start of each skill.
fn telling_starts() -> (ExecOptions, tokio::sync::mpsc::UnboundedReceiver<()>) {
    let (started, starts) = tokio::sync::mpsc::unbounded_channel();
    let sink = move |event: &TraceEvent| {
        if matches!(event.item, TraceItem::SkillStarted { .. }) {
            started.send(()).unwrap();
        }
    };
    let options = ExecOptions { sink: Some(Box::new(sink)), ..ExecOptions::default() };
    (options, starts)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_that_falls_silent_is_lost_within_a_second() {
    let (one, two) = pair().await;
    let serving = bob(&one);
    let chart = "statechart: T\ninitial: A\nstates: {A: {remote: bob/Act, with: {end: never}}}\n";
    let (program, registry) = checked(&two, chart).await.expect("the chart is in order");
    let (options, mut starts) = telling_starts();
    let running = tokio::spawn(Executor::new(program, registry, Channels::new(), options).unwrap().run());
    starts.recv().await.expect("the skill is started");
    serving.abort();
    let result = running.await.unwrap();
    let reason = result.reason.unwrap();
    assert!(reason.contains("the agent `bob` is lost: it has not answered for 0."), "{reason}");
    assert_eq!(result.chain, ["A", "T"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_agent_counts_as_returned_where_its_state_is_left() {
    let (one, two) = pair().await;
    let serving = bob(&one);
    let chart = "statechart: T\nevents: {go: {}}\ninitial: A\nstates:\n  A: {remote: bob/Act, with: {end: never}, \
                 transitions: {go: Done}}\n  Done: {final: success}\n";
    let (program, registry) = checked(&two, chart).await.expect("the chart is in order");
    let (options, mut starts) = telling_starts();
    let executor = Executor::new(program, registry, Channels::new(), options).unwrap();
    let controller = executor.controller();
    let running = tokio::spawn(executor.run());
    starts.recv().await.expect("the skill is started");
    serving.abort();
    assert!(controller.raise("go", Value::Null));
    let result = running.await.unwrap();
    assert_eq!((result.outcome.as_str(), result.reason), ("success", None), "it is not taken for stuck");
}

/// An agent in another language that declares `Act` with one version, and refuses to start it.
async fn stranger(session: Session, manifest: Manifest, told: BTreeMap<String, (String, Vec<u8>)>) {
    let key = keys::chart("eve", &manifest.name).unwrap();
    let mut questions = session.declare_queryable(key.clone(), 16).await.unwrap();
    while let Some(question) = questions.next().await {
        let schema = question.encoding.split(';').nth(1).unwrap_or_default();
        let (encoding, bytes) = match told.get(schema) {
            Some(answer) => answer.clone(),
            None => packed(&manifest).unwrap(),
        };
        question.reply(&key, &encoding, bytes).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_of_another_version_are_named() {
    let (one, two) = pair().await;
    let skill = SkillManifest::new("Act", "Acts.").input("x", Type::Int, "Any.");
    let status =
        packed(&Status { revision: 1, leaves: Vec::new(), events: Vec::new(), dropped: 0, ended: None })
            .unwrap();
    let newer = (status.0.replace(";v1", ";v7"), status.1);
    let told = BTreeMap::from([("runtime/start".to_owned(), newer)]);
    tokio::spawn(stranger(one, Manifest::of(&skill, "p"), told));
    let chart = "statechart: T\ninitial: A\nstates: {A: {remote: eve/Act, with: {x: 1}}}\n";
    let (result, _) = run(&two, chart).await;
    let reason = result.reason.unwrap();
    assert!(reason.contains("version 7 of `runtime/status`"), "{reason}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_skill_that_has_changed_since_the_check_is_not_started() {
    let (one, two) = pair().await;
    let first = bob(&one);
    let chart = "statechart: T\ninitial: A\nstates: {A: {remote: bob/Act}}\n";
    let (program, registry) = checked(&two, chart).await.expect("the chart is in order");
    first.abort();
    assert!(first.await.is_err(), "it was told to end");
    let mut offers = Offers::new("bob", &one, Channels::new(), Arc::new(|_| {}));
    struct Other;
    impl Skill for Other {
        fn manifest(&self) -> SkillManifest {
            Act("Act").manifest().input("more", Type::Int, "Was added.")
        }
        fn run(
            &self,
            context: crate::skill::SkillContext,
        ) -> futures::future::BoxFuture<'static, crate::skill::SkillResult> {
            Act("Act").run(context)
        }
    }
    offers.add(Arc::new(Other)).unwrap();
    tokio::spawn(async move { serve(&one, offers).await });
    let run = Executor::new(program, registry, Channels::new(), ExecOptions::default()).unwrap().run();
    let reason = run.await.reason.unwrap();
    assert!(reason.contains("this chart was checked with version"), "{reason}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_agent_offers_a_name_once() {
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let mut offers = Offers::new("bob", &session, Channels::new(), Arc::new(|_| {}));
    offers.add(Arc::new(Act("Act"))).unwrap();
    assert_eq!(offers.add(Arc::new(Act("Act"))), Err(ServeError::Twice { name: "Act".into() }));
}

#[test]
fn what_charts_want_of_others_is_listed() {
    let text =
        "statechart: T\nparallel: {A: {remote: bob/X}, B: {initial: C, states: {C: {remote: carol/Y}}}}\n";
    let library = chart::load_text("t.yaml", text, &[]);
    assert_eq!(library.remote_names(), BTreeSet::from(["bob/X".to_owned(), "carol/Y".to_owned()]));
    let checked = chart::check(&library, &Registry::new(), &ChannelSchema::new());
    let codes: Vec<&str> = checked.findings.iter().map(|f| f.code).collect();
    assert_eq!(codes[0], armarium_source::code::UNASKED, "nobody was asked: a warning");
    assert!(checked.program.is_some(), "it can be stepped and tested");
}
