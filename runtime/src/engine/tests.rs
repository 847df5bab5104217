//! The cases of `cases.txt`, and those that need more than a chart and its steps.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::time::Duration;

use super::*;
use crate::chart::testing::program;
use crate::skill::{Failure, Outcome};

/// Drives an engine by hand and logs its effects as text, one line per effect.
pub(super) struct Drive {
    pub(super) engine: Engine,
    log: String,
    pub(super) skills: BTreeMap<String, u64>,
    pub(super) timers: BTreeMap<u64, Duration>,
    pub(super) armed: BTreeMap<u32, u64>,
}

impl Drive {
    pub(super) fn new(text: &str) -> Self {
        Self::of(program(text))
    }

    pub(super) fn of(program: Arc<Program>) -> Self {
        let engine = Engine::new(program, &BTreeMap::new(), None).unwrap();
        let (skills, timers, armed) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let mut drive = Self { engine, log: String::new(), skills, timers, armed };
        let mut out = Vec::new();
        drive.engine.start(&NoSensors, &mut out);
        drive.take(out);
        drive
    }

    fn take(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            let line = match effect {
                Effect::StartSkill { activation, state, inputs, .. } => {
                    let path = self.engine.program().path(state).to_owned();
                    self.skills.insert(path.clone(), activation);
                    let force = inputs.get("force").and_then(Value::as_f64).unwrap_or(0.0);
                    format!("start {path} {force}")
                }
                Effect::Cancel { activation, .. } => {
                    let path = self.skills.iter().find(|(_, a)| **a == activation).unwrap().0;
                    format!("cancel {path}")
                }
                Effect::StartTimer { timer, after, .. } => {
                    self.timers.insert(timer, after);
                    format!("timer {}", after.as_secs_f64())
                }
                Effect::CancelTimer { timer } => {
                    self.timers.remove(&timer);
                    "no timer".into()
                }
                Effect::ArmWatch { watch, entry } => {
                    self.armed.insert(watch, entry);
                    continue;
                }
                Effect::DisarmWatch { watch } => {
                    self.armed.remove(&watch);
                    continue;
                }
                Effect::Send { event, to, .. } => format!("send {event} to {to}"),
                Effect::Finished(r) => {
                    format!(
                        "finished {} {:?} {}",
                        r.outcome,
                        r.reason.unwrap_or_default(),
                        r.chain.join(" < ")
                    )
                }
                Effect::Trace(item) => match item {
                    TraceItem::Entered { state } => format!("+{state}"),
                    TraceItem::Exited { state } => format!("-{state}"),
                    TraceItem::Log { text, .. } => format!("log {text}"),
                    TraceItem::Dropped { name, .. } => format!("dropped {name}"),
                    TraceItem::Held { name, .. } => format!("held {name}"),
                    TraceItem::Done { state, outcome } => format!("done {state} {outcome}"),
                    TraceItem::Error { message, .. } => format!("error {message}"),
                    TraceItem::Retry { state, attempt, reason } => {
                        format!("retry {state} {attempt} {reason}")
                    }
                    _ => continue,
                },
            };
            writeln!(self.log, "{line}").unwrap();
        }
    }

    pub(super) fn input(&mut self, input: Input) {
        let mut out = Vec::new();
        self.engine.handle(input, &NoSensors, &mut out);
        self.take(out);
    }

    pub(super) fn event(&mut self, name: &str) -> String {
        self.input(Input::Event { name: name.into(), data: Value::Null });
        self.take_log()
    }

    pub(super) fn end(&mut self, state: &str, outcome: &str) -> String {
        let activation = self.skills[state];
        let result = match outcome {
            "failure" => Err(Failure::new("no luck")),
            name => Ok(Outcome::named(name).with("value", 7.0)),
        };
        self.input(Input::SkillEnded { activation, result });
        self.take_log()
    }

    pub(super) fn timer(&mut self) -> String {
        let (timer, _) = self.timers.pop_first().unwrap();
        self.input(Input::Timer { timer });
        self.take_log()
    }

    /// Plays one step of a case. Returns its effects, or the answer to what it asks.
    fn step(&mut self, step: &str) -> String {
        match step.split(' ').collect::<Vec<_>>()[..] {
            ["event", name] => return self.event(name),
            ["end", state, outcome] => return self.end(state, outcome),
            ["timer"] => return self.timer(),
            ["leaves"] => return self.leaves(),
            ["local", name] => return self.engine.locals()[name].to_json().to_string(),
            [count, "times", "event", name] => {
                let each: BTreeSet<String> =
                    (0..count.parse::<u32>().unwrap()).map(|_| self.event(name)).collect();
                return each.into_iter().collect::<Vec<_>>().join(" | ");
            }
            ["newest", "timer"] => {
                let (timer, _) = self.timers.pop_last().unwrap();
                self.input(Input::Timer { timer });
            }
            ["stuck", state] => self.input(Input::SkillStuck { activation: self.skills[state] }),
            ["choose", state, outcome] => {
                self.input(Input::Choose { state: state.into(), outcome: outcome.into() });
            }
            ["stop"] => self.input(Input::Stop { reason: "by hand".into() }),
            _ => panic!("`{step}` is no step"),
        }
        self.take_log()
    }

    /// The log since the last call, in one line.
    pub(super) fn take_log(&mut self) -> String {
        std::mem::take(&mut self.log).trim_end().replace('\n', "; ")
    }

    pub(super) fn leaves(&self) -> String {
        self.engine.leaves().iter().map(|s| self.engine.program().path(*s)).collect::<Vec<_>>().join(" ")
    }
}

/// Whether a text is as expected; `…` stands for any text.
fn fits(found: &str, expected: &str) -> bool {
    let Some((first, rest)) = expected.split_once('…') else { return found == expected };
    found.strip_prefix(first).is_some_and(|found| {
        (0..=found.len()).any(|at| found.get(at..).is_some_and(|found| fits(found, rest)))
    })
}

#[test]
fn cases_go_as_written() {
    let (mut chart, mut wrong) = (String::new(), Vec::new());
    for case in include_str!("cases.txt").split("\n## ").skip(1) {
        let (name, text) = case.split_once('\n').unwrap();
        let in_chart = |line: &&str| !line.starts_with(['>', '#']);
        let steps: usize = text.split_inclusive('\n').take_while(in_chart).map(str::len).sum();
        if steps > 0 {
            chart = format!("statechart: T\n{}", &text[..steps]);
        }
        let mut d = Drive::new(&chart);
        let start = d.take_log();
        for step in text.lines().filter_map(|line| line.strip_prefix("> ")) {
            let (step, expected) = step.split_once(" =>").map_or((step, "…"), |(s, e)| (s, e.trim()));
            let found = match step {
                "start" => start.clone(),
                "restart" => {
                    d = Drive::new(&chart);
                    d.take_log()
                }
                _ => d.step(step),
            };
            if !fits(&found, expected) {
                wrong.push(format!("{name}: {step} => {found} instead of {expected}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn timers_of_one_instant_are_ordered_inner_first() {
    let mut engine = Engine::new(
        program(
            "
statechart: T
initial: O
states:
  O: {initial: I, states: {I: {after: {1s: I}}}, after: {1s: O}}
",
        ),
        &BTreeMap::new(),
        None,
    )
    .unwrap();
    let mut out = Vec::new();
    engine.start(&NoSensors, &mut out);
    let orders: Vec<u64> = out
        .iter()
        .filter_map(|e| if let Effect::StartTimer { order, .. } = e { Some(*order) } else { None })
        .collect();
    assert!(orders[0] > orders[1], "the outer state's timer was started first and comes second");
}

const LEFT: &str = "
statechart: T
initial: A
states:
  A: {skill: Act, after: {1s: B}, watch: {w: \"locals.n > 0\"}, transitions: {out: B, success: C, w: C}}
  B: {transitions: {out: A}}
  C: {}
locals: {n: {type: int, default: 0}}
events: {out: {}}
";

#[test]
fn outcome_timer_or_watch_of_a_state_that_has_been_left_is_dropped_and_seen() {
    let mut d = Drive::new(LEFT);
    d.take_log();
    let (activation, entry) = (d.skills["A"], d.armed[&0]);
    assert_eq!(d.event("out"), "cancel A");
    // All of these arrive while the state is waiting to be left.
    let (timer, _) = d.timers.pop_first().unwrap();
    d.input(Input::Timer { timer });
    d.input(Input::Watch { watch: 0, entry });
    d.input(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
    assert_eq!(d.take_log(), "-A; +B; dropped after; dropped w");
    d.event("out");
    d.input(Input::Watch { watch: 0, entry });
    assert_eq!(d.take_log().split("; ").last(), Some("dropped w"), "it belongs to another stay in the state");
    assert_eq!(d.leaves(), "A");
}

#[test]
fn an_event_whose_data_is_not_as_declared_is_not_heard_and_an_error_says_so() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {transitions: {said: [{target: B, if: \"event.data.n == 3\"}], error.communication: C}}
  B: {transitions: {said: A}}
  C: {}
events: {said: {data: {n: {type: float, unit: m}}}}
",
    );
    d.take_log();
    let said = |n: Value| Input::Event { name: "said".into(), data: Value::record([("n", n)]) };
    d.input(said("3000 mm".into()));
    assert_eq!(d.take_log(), "-A; +B", "what is given in another unit is converted");
    d.input(said(Value::Int(1)));
    d.take_log();
    d.input(said("3 kg".into()));
    assert_eq!(d.take_log(), "dropped said; -A; +C");
}

#[test]
fn a_watch_that_sees_nan_raises_one_error_and_is_false() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {watch: {w: \"norm(channels.wrist.push) > 6.0\"}, transitions: {w: B, error.channel: {do: [{log: blind}]}}}
  B: {}
",
    );
    d.take_log();
    struct Nan;
    impl Sensors for Nan {
        fn channel(&self, _: u32, _: &[String]) -> Option<Value> {
            Some(vec![f64::NAN, 0.0, 0.0].into())
        }
        fn age(&self, _: u32) -> Option<f64> {
            None
        }
    }
    let seen = d.engine.observe(0, &Nan);
    assert!(!seen.holds && seen.error.is_none());
    let (message, place) = seen.blind.unwrap();
    d.input(Input::WatchBlind { watch: 0, message, place });
    assert_eq!(d.take_log(), "log blind");
    assert!(!d.engine.observe(0, &NoSensors).holds, "a channel that was never published is false");
}
