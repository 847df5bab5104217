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
        self.said()
    }

    pub(super) fn end(&mut self, state: &str, outcome: &str) -> String {
        let activation = self.skills[state];
        let result = match outcome {
            "failure" => Err(Failure::new("no luck")),
            name => Ok(Outcome::named(name).with("value", 7.0)),
        };
        self.input(Input::SkillEnded { activation, result });
        self.said()
    }

    pub(super) fn timer(&mut self) -> String {
        let (timer, _) = self.timers.pop_first().unwrap();
        self.input(Input::Timer { timer });
        self.said()
    }

    /// The log since the last call, in one line.
    pub(super) fn said(&mut self) -> String {
        std::mem::take(&mut self.log).trim_end().replace('\n', "; ")
    }

    pub(super) fn leaves(&self) -> String {
        self.engine.leaves().iter().map(|s| self.engine.program().path(*s)).collect::<Vec<_>>().join(" ")
    }
}

const TWO: &str = "
statechart: T
initial: A
states:
  A: {skill: Act, exit: [{log: out}], transitions: {success: {target: B, do: [{log: between}]}, failure: F}}
  B: {skill: Act, with: {force: \"${A.value}\"}, enter: [{log: in}], after: {2s: A}, transitions: {blocked: Done}}
  Done: {final: success}
  F: {final: failure}
";

#[test]
fn a_transition_leaves_acts_and_enters_in_order() {
    let mut d = Drive::new(TWO);
    assert_eq!(d.said(), "+A; start A 1");
    assert_eq!(d.end("A", "success"), "log out; -A; log between; +B; log in; timer 2; start B 7");
    assert_eq!(d.end("B", "success"), "done B success", "an outcome that nobody handles");
    assert_eq!(d.leaves(), "B");
}

#[test]
fn leaving_waits_until_the_skill_has_returned() {
    let mut d = Drive::new(TWO);
    d.end("A", "success");
    assert_eq!(d.timer(), "cancel B");
    assert_eq!(d.leaves(), "B", "the old configuration stands");
    assert_eq!(d.end("B", "blocked"), "-B; +A; start A 1", "what a cancelled skill says is not heard");
}

#[test]
fn a_failure_ends_the_run_with_its_reason_and_chain() {
    let mut d = Drive::new(TWO);
    d.said();
    let said = d.end("A", "failure");
    assert_eq!(said, "log out; -A; +F; -F; finished failure \"no luck\" A < T");
}

const NESTED: &str = "
statechart: T
initial: P
states:
  P:
    parallel:
      L: {initial: L1, states: {L1: {skill: Act, transitions: {go: L2}}, L2: {final: success}}}
      R:
        initial: R1
        states:
          R1: {transitions: {go: R2}}
          R2: {skill: Act, transitions: {success: R3}}
          R3: {final: blocked}
    transitions: {blocked: Q, out: Q}
  Q: {}
events: {go: {}, out: {}}
";

#[test]
fn regions_take_an_event_together_and_end_their_parallel_state() {
    let mut d = Drive::new(NESTED);
    assert_eq!(d.said(), "+P; +P.L; +P.L.L1; +P.R; +P.R.R1; start P.L.L1 1");
    assert_eq!(d.event("go"), "cancel P.L.L1");
    assert_eq!(
        d.end("P.L.L1", "success"),
        "-P.R.R1; -P.L.L1; +P.L.L2; +P.R.R2; done P.L success; start P.R.R2 1"
    );
    assert_eq!(
        d.end("P.R.R2", "success"),
        "-P.R.R2; +P.R.R3; done P.R blocked; -P.R.R3; -P.R; -P.L.L2; -P.L; -P; +Q"
    );
}

#[test]
fn all_skills_of_a_parallel_state_are_cancelled_together() {
    let mut d = Drive::new(NESTED);
    d.event("go");
    d.end("P.L.L1", "success");
    d.said();
    assert_eq!(d.event("out"), "cancel P.R.R2");
    assert_eq!(d.event("go"), "", "what arrives meanwhile is queued");
    assert_eq!(d.end("P.R.R2", "success"), "-P.R.R2; -P.R; -P.L.L2; -P.L; -P; +Q");
}

#[test]
fn a_failure_in_one_region_goes_outward_at_once_and_a_final_one_does_not() {
    let chart = "
statechart: T
initial: P
states:
  P:
    parallel:
      L: {initial: L1, states: {L1: {skill: Act}}}
      R: {initial: R1, states: {R1: {skill: Act, transitions: {blocked: R2}}, R2: {final: failure}}}
    transitions: {failure: Q}
  Q: {}
";
    let mut d = Drive::new(chart);
    d.said();
    assert_eq!(d.end("P.R.R1", "failure"), "cancel P.L.L1");
    assert_eq!(d.end("P.L.L1", "failure"), "-P.R.R1; -P.R; -P.L.L1; -P.L; -P; +Q");
    let mut d = Drive::new(chart);
    d.said();
    assert_eq!(d.end("P.R.R1", "blocked"), "-P.R.R1; +P.R.R2; done P.R failure");
}

#[test]
fn an_unhandled_failure_ends_the_run_with_the_chain_of_states() {
    let mut d = Drive::new(
        "
statechart: T
initial: O
states:
  O:
    parallel:
      L: {initial: I, states: {I: {skill: Act}}}
      R: {skill: Act}
",
    );
    d.said();
    assert_eq!(d.end("O.L.I", "failure"), "cancel O.R");
    assert_eq!(
        d.end("O.R", "success"),
        "-O.R; -O.L.I; -O.L; -O; finished failure \"no luck\" O.L.I < O.L < O < T"
    );
}

#[test]
fn outcomes_of_states_that_have_been_left_are_dropped() {
    let mut d = Drive::new(NESTED);
    d.said();
    let activation = d.skills["P.L.L1"];
    // The skill has ended, but the event that leaves the state is before the outcome in the queue.
    let mut out = Vec::new();
    d.engine.handle(Input::Event { name: "out".into(), data: Value::Null }, &NoSensors, &mut out);
    d.take(out);
    d.input(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
    assert_eq!(d.said(), "cancel P.L.L1; -P.R.R1; -P.R; -P.L.L1; -P.L; -P; +Q");
    d.input(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
    assert_eq!(d.said(), "");
}

#[test]
fn retry_starts_the_inside_again_and_then_reports() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {skill: Act, retry: {times: 1, wait: 1s}, after: {60s: B}, transitions: {failure: B}}
  B: {}
",
    );
    assert_eq!(d.said(), "+A; timer 60; start A 1");
    assert_eq!(d.end("A", "failure"), "retry A 1 no luck; timer 1");
    let (timer, _) = d.timers.pop_last().unwrap();
    d.input(Input::Timer { timer });
    assert_eq!(d.said(), "start A 1");
    assert_eq!(d.end("A", "failure"), "no timer; -A; +B");
}

#[test]
fn history_remembers_states() {
    let chart = |deep: &str| {
        format!(
            "
statechart: T
initial: C
states:
  C:
    initial: A
    states:
      H: {{history: {deep}, default: A}}
      A: {{transitions: {{go: B}}}}
      B: {{initial: X, states: {{X: {{transitions: {{go: Y}}}}, Y: {{}}}}}}
    transitions: {{out: D}}
  D: {{transitions: {{back: C.H}}}}
events: {{go: {{}}, out: {{}}, back: {{}}}}
"
        )
    };
    for (deep, expected) in [("deep", "C.B.Y"), ("shallow", "C.B.X")] {
        let mut d = Drive::new(&chart(deep));
        for event in ["go", "go", "out", "back"] {
            d.event(event);
        }
        assert_eq!(d.leaves(), expected);
    }
}

#[test]
fn inner_states_win_and_targetless_transitions_leave_nothing() {
    let mut d = Drive::new(
        "
statechart: T
locals: {n: {type: int, default: 0}}
initial: O
states:
  O:
    initial: I
    states:
      I:
        after: {9s: I}
        transitions:
          t: {if: \"locals.n < 2\", do: [{assign: {locals.n: \"${locals.n + 1}\"}}, {log: \"n = ${locals.n}\"}]}
    transitions: {t: {target: Q, do: [{log: outer}]}}
  Q: {}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "log n = 1");
    assert_eq!(d.event("t"), "log n = 2");
    assert_eq!(d.event("t"), "no timer; -O.I; -O; log outer; +Q");
}

#[test]
fn always_and_raised_events_run_before_the_next_event() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {transitions: {t: {target: B, do: [{raise: inner}]}}}
  B: {always: [{target: C, if: \"active('B')\"}]}
  C: {transitions: {inner: D, t: Wrong}}
  D: {}
  Wrong: {}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "-A; +B; -B; +C; -C; +D");
}

#[test]
fn an_expression_that_fails_raises_an_error_and_unhandled_is_a_failure() {
    let chart = |handler: &str| {
        format!(
            "
statechart: T
locals: {{x: {{type: float}}}}
initial: A
states:
  A: {{transitions: {{t: {{target: B, if: \"locals.x > 1.0\"}}{handler}}}}}
  B: {{}}
events: {{t: {{}}}}
"
        )
    };
    let mut d = Drive::new(&chart(", \"error.*\": B"));
    d.said();
    assert_eq!(d.event("t"), "error this has no value yet; -A; +B");
    let mut d = Drive::new(&chart(""));
    d.said();
    let said = d.event("t");
    assert!(
        said.starts_with("error this has no value yet; -A; finished failure \"this has no value yet"),
        "{said}"
    );
    assert!(said.contains("test.yaml:6:40"), "{said}");
}

#[test]
fn with_that_fails_does_not_start_the_skill() {
    let mut d = Drive::new(
        "
statechart: T
locals: {x: {type: float}}
initial: A
states:
  A: {skill: Act, with: {force: \"${locals.x}\"}, transitions: {failure: B}}
  B: {}
",
    );
    assert_eq!(d.said(), "+A; error this has no value yet; -A; +B");
}

#[test]
fn a_loop_without_rest_fails_the_run() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states: {A: {always: [B]}, B: {always: [A]}}
",
    );
    let said = d.said();
    assert!(said.contains("finished failure \"1000 microsteps without rest: `A`, `B`\""), "{said}");
}

#[test]
fn unbreakable_states_hold_events_back_until_they_have_ended() {
    let mut d = Drive::new(
        "
statechart: T
initial: P
states:
  P:
    parallel:
      L: {initial: U, states: {U: {skill: Act, unbreakable: true, transitions: {success: V}}, V: {}}}
      R: {initial: X, states: {X: {transitions: {t: Y}}, Y: {}}}
    transitions: {out: Q}
  Q: {}
events: {t: {}, out: {}}
",
    );
    d.said();
    assert_eq!(d.event("out"), "held out");
    assert_eq!(d.event("t"), "-P.R.X; +P.R.Y", "disjoint regions still get their events");
    assert_eq!(d.end("P.L.U", "success"), "-P.L.U; +P.L.V; -P.R.Y; -P.R; -P.L.V; -P.L; -P; +Q");
    let mut stop = Drive::new(TWO);
    stop.said();
    stop.input(Input::Stop { reason: "by hand".into() });
    assert_eq!(stop.said(), "cancel A", "a stop is not held back");
    assert_eq!(stop.end("A", "success"), "log out; -A; finished stopped \"by hand\"");
}

#[test]
fn a_stuck_skill_fails_the_run() {
    let mut d = Drive::new(NESTED);
    d.said();
    d.event("out");
    let activation = d.skills["P.L.L1"];
    d.input(Input::SkillStuck { activation });
    let said = d.said();
    assert!(said.contains("finished failure \"the skill of `P.L.L1` did not return"), "{said}");
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

#[test]
fn a_transition_into_one_region_enters_the_others_by_default() {
    let mut d = Drive::new(
        "
statechart: T
initial: S
states:
  S: {transitions: {t: P.L.L2}}
  P:
    parallel:
      L: {initial: L1, states: {L1: {}, L2: {}}}
      R: {initial: R1, states: {R1: {transitions: {t: P.L.L1}}}}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "-S; +P; +P.L; +P.L.L2; +P.R; +P.R.R1");
    assert_eq!(d.event("t"), "-P.R.R1; -P.R; -P.L.L2; -P.L; -P; +P; +P.L; +P.L.L1; +P.R; +P.R.R1");
}

#[test]
fn actions_have_their_effects() {
    let mut d = Drive::new(
        "
statechart: T
locals: {sum: {type: int, default: 0}}
initial: A
states:
  A:
    enter:
      - foreach: {in: [1, 2, 3], as: i, do: [{assign: {locals.sum: \"${locals.sum + i}\"}}]}
      - if: {cond: \"locals.sum == 6\", then: [{log: six}], else: [{log: other}]}
      - send: {event: later, delay: 2s, id: x}
      - send: {event: never, delay: 3s, id: y}
      - cancel: y
      - send: {event: out, to: bob}
    transitions: {later: B}
  B: {}
",
    );
    assert_eq!(d.said(), "+A; log six; timer 2; timer 3; no timer; send out to bob");
    assert_eq!(d.timer(), "-A; +B");
}

#[test]
fn a_deep_history_restores_every_region() {
    let mut d = Drive::new(
        "
statechart: T
initial: C
states:
  C:
    initial: P
    states:
      H: {history: deep, default: P}
      P:
        parallel:
          L: {initial: L1, states: {L1: {transitions: {go: L2}}, L2: {}}}
          R: {initial: R1, states: {R1: {transitions: {go: R2}}, R2: {}}}
    transitions: {out: D}
  D: {transitions: {back: C.H}}
events: {go: {}, out: {}, back: {}}
",
    );
    for event in ["go", "out", "back"] {
        d.event(event);
    }
    assert_eq!(d.leaves(), "C.P.L.L2 C.P.R.R2");
}
