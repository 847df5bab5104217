//! How fast the engine is on one core: events per second on a chart of two states with two leaves each, the time to
//! load a chart of 100 000 states, the cost of an event in small and large charts, and the latency from an event
//! through the executor to the start of a leaf's skill.
//!
//! Run with `cargo bench -p armarium-runtime`. A part of a case's name after `--` selects cases.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![expect(clippy::print_stdout, reason = "a benchmark shows what it measured")]

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Engine, NoSensors};
use armarium_runtime::exec::{ExecOptions, Executor};
use armarium_runtime::program::{EventId, Program};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Value;
use futures::FutureExt;
use futures::future::BoxFuture;

fn program(text: &str, registry: &Registry) -> Result<Arc<Program>, String> {
    let checked = check(&load_text("bench.yaml", text, &[]), registry, &ChannelSchema::new());
    checked.program.ok_or_else(|| checked.findings.iter().map(ToString::to_string).collect())
}

/// Two states with two leaves; `next` alternates the leaf, `switch` the state.
fn alternating(expressions: bool) -> String {
    let with = if expressions {
        ", if: \"locals.n < 1000000000\", do: [{assign: {locals.n: \"${locals.n + 1}\"}}]"
    } else {
        ""
    };
    let pair = |name: &str, other: &str| {
        format!(
            "  {name}:
    initial: {name}1
    states:
      {name}1: {{transitions: {{next: {{target: {name}2{with}}}}}}}
      {name}2: {{transitions: {{next: {{target: {name}1{with}}}}}}}
    transitions: {{switch: {other}}}
"
        )
    };
    let (a, b) = (pair("A", "B"), pair("B", "A"));
    format!(
        "statechart: Alternating\nlocals: {{n: {{type: int, default: 0}}}}\nevents: {{next: {{}}, switch: {{}}}}\ninitial: A\nstates:\n{a}{b}"
    )
}

/// A ring of many states, beside a part that alternates between two states.
fn wide(states: usize) -> String {
    let mut text = String::from("statechart: Wide\nevents: {next: {}, turn: {}}\nparallel:\n");
    text += "  P: {initial: A, states: {A: {transitions: {next: B}}, B: {transitions: {next: A}}}}\n";
    text += "  Q:\n    initial: S0\n    states:\n";
    for i in 0..states {
        let _ = writeln!(text, "      S{i}: {{transitions: {{turn: S{}}}}}", (i + 1) % states);
    }
    text
}

/// Sends the events of the list `count` times in a loop, without tracing. Returns events per second.
fn drive(program: &Arc<Program>, events: &[EventId], count: u32) -> Result<f64, String> {
    let mut engine = Engine::new(Arc::clone(program), &BTreeMap::new(), None).map_err(|e| e.to_string())?;
    engine.set_tracing(false);
    let mut out = Vec::new();
    engine.start(&NoSensors, &mut out);
    let began = Instant::now();
    for event in events.iter().cycle().take(count as usize) {
        engine.raise(*event, Value::Null, &NoSensors, &mut out);
        out.clear();
    }
    Ok(f64::from(count) / began.elapsed().as_secs_f64())
}

/// The best of several short rounds, to leave out disturbance by other processes.
fn best(rounds: usize, mut measure: impl FnMut() -> Result<f64, String>) -> Result<f64, String> {
    (0..rounds).try_fold(0.0_f64, |best, _| Ok(best.max(measure()?)))
}

fn events(program: &Program, names: &[&str]) -> Vec<EventId> {
    names.iter().filter_map(|name| program.event(name)).collect()
}

fn alternate() -> Result<(), String> {
    let list = ["next", "next", "next", "next", "next", "next", "next", "next", "next", "switch"];
    for (expressions, name) in [(true, "with expressions"), (false, "without expressions")] {
        let program = program(&alternating(expressions), &Registry::new())?;
        let list = events(&program, &list);
        let rate = best(60, || drive(&program, &list, 50_000))?;
        println!("alternate, {name}: {:.2} million events/s, {:.0} ns each", rate / 1e6, 1e9 / rate);
    }
    Ok(())
}

fn size() -> Result<(), String> {
    for states in [10, 1_000, 100_000] {
        let text = wide(states);
        let began = Instant::now();
        let program = program(&text, &Registry::new())?;
        let loaded = began.elapsed().as_secs_f64();
        let list = events(&program, &["next", "turn"]);
        let rate = best(40, || drive(&program, &list, 20_000))?;
        let size = text.len() as f64 / 1e6;
        println!(
            "size, {states} states ({size:.1} MB): loaded and checked in {loaded:.3} s, {:.0} ns an event",
            1e9 / rate
        );
    }
    Ok(())
}

/// Only loads and checks a chart, to measure the memory of the process.
fn load() -> Result<(), String> {
    let text = wide(100_000);
    let began = Instant::now();
    let library = load_text("bench.yaml", &text, &[]);
    let read = began.elapsed().as_secs_f64();
    let checked = check(&library, &Registry::new(), &ChannelSchema::new());
    let all = began.elapsed().as_secs_f64();
    let states = checked.program.map_or(0, |p| p.len());
    println!("load, {states} states: read in {read:.3} s, with checks {all:.3} s");
    Ok(())
}

/// Records the times at which it is started.
struct Mark(Arc<Mutex<Vec<Instant>>>);

impl Skill for Mark {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Mark", "Notes the time and waits.")
    }
    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let started = Instant::now();
        let marks = Arc::clone(&self.0);
        async move {
            if let Ok(mut marks) = marks.lock() {
                marks.push(started);
            }
            context.cancel.cancelled().await;
            Ok(Outcome::success())
        }
        .boxed()
    }
}

/// Latency from a raised event to the start of the skill of the leaf that it enters, through the executor.
async fn latency() -> Result<(), String> {
    let marks = Arc::new(Mutex::new(Vec::new()));
    let registry: Registry = [Arc::new(Mark(Arc::clone(&marks))) as Arc<dyn Skill>].into_iter().collect();
    let text = "statechart: L\nevents: {go: {}, end: {}}\ninitial: A\nstates:\n  A: {skill: Mark, transitions: {go: B, end: D}}\n  B: {skill: Mark, transitions: {go: A, end: D}}\n  D: {final: success}\n";
    let executor =
        Executor::new(program(text, &registry)?, registry, Channels::new(), ExecOptions::default())
            .map_err(|e| e.to_string())?;
    let controller = executor.controller();
    let run = tokio::spawn(executor.run());
    let mut times = Vec::new();
    let count = || marks.lock().map_or(0, |m| m.len());
    for _ in 0..2_000 {
        let before = count();
        let began = Instant::now();
        if !controller.raise("go", Value::Null) {
            return Err("the queue is full".into());
        }
        while count() == before {
            tokio::task::yield_now().await;
        }
        let newest = marks.lock().ok().and_then(|m| m.last().copied());
        times.extend(newest.map(|at| at.duration_since(began)));
    }
    let _ = controller.raise("end", Value::Null);
    run.await.map_err(|e| e.to_string())?;
    times.sort();
    let micro = |at: usize| times.get(at).map_or(f64::NAN, |t| t.as_secs_f64() * 1e6);
    println!(
        "latency, event to leaf started: median {:.1} us, 99 % {:.1} us",
        micro(times.len() / 2),
        micro(times.len() * 99 / 100)
    );
    Ok(())
}

fn main() -> Result<(), String> {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let asked = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    if asked("alternate") {
        alternate()?;
    }
    if asked("size") {
        size()?;
    }
    if asked("load") {
        load()?;
    }
    if asked("latency") {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
        runtime.map_err(|e| e.to_string())?.block_on(latency())?;
    }
    Ok(())
}
