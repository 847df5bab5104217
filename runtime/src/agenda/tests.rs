//! Runs that never rest fail and name the states that they cycle through; failures of watches are reported.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::Value;

use super::{MAX_ENDS, MAX_FIRINGS};
use crate::chart::testing::program;
use crate::stepping::Stepper;

fn stepper(text: &str) -> Stepper {
    let mut stepper = Stepper::new(program(text), &BTreeMap::new(), None).unwrap();
    stepper.start();
    stepper
}

/// The reason why the run failed.
fn failed(stepper: &Stepper) -> &str {
    let result = stepper.result().expect("the run has ended");
    assert_eq!(result.outcome, "failure");
    result.reason.as_deref().unwrap()
}

const ROUND: &str = "
statechart: T
events: {go: {}}
locals: {n: {type: int, default: 1}}
initial: Idle
states:
  Idle: {transitions: {go: A}}
  A: {watch: {w: {if: \"locals.n > 0\"}}, transitions: {w: B}}
  B: {watch: {w: {if: \"locals.n > 0\"}}, transitions: {w: A}}
";

#[test]
fn watches_that_lead_to_each_other_fail_the_run_with_their_states() {
    let mut s = stepper(ROUND);
    s.event("go", Value::Null);
    assert_eq!(failed(&s), format!("{MAX_FIRINGS} firings of watches without rest: `A`, `B`"));
}

#[test]
fn watches_and_timers_of_no_time_that_lead_to_each_other_fail_the_run() {
    let text =
        ROUND.replace("B: {watch: {w: {if: \"locals.n > 0\"}}, transitions: {w: A}}", "B: {after: {0s: A}}");
    let mut s = stepper(&text);
    s.event("go", Value::Null);
    assert_eq!(failed(&s), format!("{MAX_FIRINGS} firings of watches without rest: `A`"));
}

#[test]
fn watches_that_fail_again_and_again_fail_the_run() {
    let text = ROUND
        .replace("locals.n > 0", "1 / (locals.n - 1) > 0")
        .replace("transitions: {w:", "transitions: {error.execution:");
    let mut s = stepper(&text);
    s.event("go", Value::Null);
    assert_eq!(failed(&s), format!("{MAX_FIRINGS} firings of watches without rest: `A`, `B`"));
}

#[test]
fn skills_that_are_cancelled_again_and_again_without_time_fail_the_run() {
    let mut s = stepper(
        "
statechart: T
initial: A
states:
  A: {parallel: {Act: {skill: Act}, Leave: {after: {0s: B}}}}
  B: {watch: {w: {if: \"active('B')\"}}, transitions: {w: A}}
",
    );
    s.advance(Duration::ZERO);
    assert_eq!(failed(&s), format!("{MAX_ENDS} skills ended without any time between them: `A.Act`"));
}

#[test]
fn a_watch_that_fires_with_time_between_is_no_circle() {
    let text = ROUND.replace("{if: \"locals.n > 0\"}", "{if: \"locals.n > 0\", for: 1ms}");
    let mut s = stepper(&text);
    s.event("go", Value::Null);
    s.advance(Duration::from_secs(3));
    assert!(s.result().is_none());
}

#[test]
fn an_expression_that_fails_in_a_watch_fails_the_state() {
    for condition in ["10 / locals.zero > 0", "locals.list[3] > 0"] {
        let s = stepper(&format!(
            "
statechart: T
locals: {{zero: {{type: int, default: 0}}, list: {{type: list<int>, default: [1]}}}}
initial: A
states: {{A: {{watch: {{w: \"{condition}\"}}, transitions: {{w: B}}}}, B: {{}}}}
"
        ));
        let reason = failed(&s);
        assert!(reason.contains("test.yaml:5:"), "{condition}: {reason}");
    }
}

#[test]
fn what_is_due_comes_in_its_order() {
    let mut s = stepper(
        "
statechart: T
initial: A
states:
  A:
    parallel:
      P: {after: [{for: 1s, do: [{log: outer}]}], initial: Q, states: {Q: {after: [{for: 1s, do: [{log: inner}]}]}}}
      R: {watch: {w: {if: \"active('A')\", for: 1s}}, transitions: {w: {do: [{log: watch}]}}}
",
    );
    s.advance(Duration::from_millis(999));
    assert_eq!(s.take_logs(), [""; 0]);
    s.advance(Duration::from_millis(1));
    assert_eq!(s.take_logs(), ["inner", "outer", "watch"]);
}

#[test]
fn a_watch_whose_condition_and_until_both_hold_fails_the_run_though_a_skill_has_to_return() {
    let s = stepper(
        "
statechart: T
locals: {n: {type: int, default: 1}}
initial: A
states:
  A:
    skill: Act
    watch: {w: {if: \"locals.n > 0\", until: \"locals.n > 0\"}}
    transitions: {w: {do: [{assign: {locals.n: 2}}]}}
",
    );
    assert_eq!(failed(&s), format!("{MAX_FIRINGS} firings of watches without rest: `A`"));
}
