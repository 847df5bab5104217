//! Cases where the language had to choose one meaning, each under its name, and the forms that SCXML has.

use armarium_values::Value;

use super::Input;
use super::tests::Drive;
use crate::skill::Outcome;

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
    d.said();
    let (activation, entry) = (d.skills["A"], d.armed[&0]);
    assert_eq!(d.event("out"), "cancel A");
    // All of these arrive while the state is waiting to be left.
    let (timer, _) = d.timers.pop_first().unwrap();
    d.input(Input::Timer { timer });
    d.input(Input::Watch { watch: 0, entry });
    d.input(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
    assert_eq!(d.said(), "-A; +B; dropped after; dropped w");
    d.event("out");
    d.input(Input::Watch { watch: 0, entry });
    assert_eq!(d.said().split("; ").last(), Some("dropped w"), "it belongs to another stay in the state");
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
    d.said();
    let said = |n: Value| Input::Event { name: "said".into(), data: Value::record([("n", n)]) };
    d.input(said("3000 mm".into()));
    assert_eq!(d.said(), "-A; +B", "what is given in another unit is converted");
    d.input(said(Value::Int(1)));
    d.said();
    d.input(said("3 kg".into()));
    assert_eq!(d.said(), "dropped said; -A; +C");
}

#[test]
fn an_outcome_of_a_state_left_before_it_is_taken_is_dropped() {
    let mut d = Drive::new(
        "
statechart: T
initial: P
states:
  P:
    parallel:
      L: {initial: A, states: {A: {skill: Act, transitions: {success: B}}, B: {enter: [{raise: now}]}}}
      R: {initial: C, states: {C: {skill: Act, transitions: {blocked: D}}, D: {}}}
    transitions: {now: Q}
  Q: {}
",
    );
    d.said();
    let right = d.skills["P.R.C"];
    // Both end at one instant. The first outcome leaves the parallel state before the second is taken.
    assert_eq!(d.end("P.L.A", "success"), "-P.L.A; +P.L.B; cancel P.R.C");
    d.input(Input::SkillEnded { activation: right, result: Ok(Outcome::named("blocked")) });
    assert_eq!(d.said(), "-P.R.C; -P.R; -P.L.B; -P.L; -P; +Q");
}

#[test]
fn an_outcome_other_than_failure_that_nobody_handles_leaves_the_state_active() {
    let mut d = Drive::new("statechart: T\ninitial: A\nstates: {A: {skill: Act}}\n");
    d.said();
    assert_eq!(d.end("A", "blocked"), "done A blocked");
    assert_eq!(d.leaves(), "A");
}

#[test]
fn an_output_before_its_outcome_is_an_execution_error() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {transitions: {direct: C, around: B}}
  B: {skill: Act, transitions: {success: C}}
  C: {enter: [{log: \"${B.value}\"}], transitions: {\"error.*\": D}}
  D: {}
events: {direct: {}, around: {}}
",
    );
    d.said();
    assert_eq!(d.event("direct"), "-A; +C; error this has no value yet; -C; +D");
}

#[test]
fn after_survives_targetless_transitions_and_restarts_on_re_entry() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {enter: [{log: in}], after: {5s: B}, transitions: {stay: {do: [{log: stays}]}, again: A}}
  B: {}
events: {stay: {}, again: {}}
",
    );
    assert_eq!(d.said(), "+A; log in; timer 5", "it starts when the entry actions are done");
    assert_eq!(d.event("stay"), "log stays");
    assert_eq!(d.event("again"), "no timer; -A; +A; log in; timer 5");
}

#[test]
fn history_records_states_and_not_data_and_evaluates_with_anew() {
    let mut d = Drive::new(
        "
statechart: T
locals: {f: {type: float, default: 1.0}}
initial: C
states:
  C:
    initial: A
    states:
      H: {history: shallow, default: A}
      A: {transitions: {go: B}}
      B: {skill: Act, with: {force: \"${locals.f}\"}}
    transitions: {out: {target: D, do: [{assign: {locals.f: 4.0}}]}}
  D: {transitions: {back: C.H}}
events: {go: {}, out: {}, back: {}}
",
    );
    d.event("go");
    d.said();
    assert_eq!(d.event("out"), "cancel C.B");
    assert_eq!(d.end("C.B", "success"), "-C.B; -C; +D");
    assert_eq!(d.event("back"), "-D; +C; +C.B; start C.B 4", "the skill starts anew, with what holds now");
}

#[test]
fn history_is_recorded_before_exit_actions_run() {
    let mut d = Drive::new(
        "
statechart: T
initial: C
states:
  C:
    initial: A
    states:
      H: {history: deep, default: A}
      A: {transitions: {go: B}}
      B: {exit: [{raise: left}]}
    transitions: {out: D}
  D: {transitions: {back: C.H, left: {do: [{log: seen}]}}}
events: {go: {}, out: {}, back: {}}
",
    );
    d.event("go");
    d.said();
    assert_eq!(d.event("out"), "-C.B; -C; +D; log seen");
    assert_eq!(d.event("back"), "-D; +C; +C.B");
}

#[test]
fn what_an_unbreakable_state_holds_back_reaches_disjoint_regions_once() {
    let mut d = Drive::new(
        "
statechart: T
locals: {n: {type: int, default: 0}}
initial: P
states:
  P:
    parallel:
      L:
        initial: W
        states:
          W:
            initial: U
            states: {U: {skill: Act, unbreakable: true, transitions: {success: V}}, V: {}}
            transitions: {t: X}
          X: {}
      R: {initial: Y, states: {Y: {transitions: {t: {target: Y, do: [{assign: {locals.n: \"${locals.n + 1}\"}}]}}}}}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "held t; -P.R.Y; +P.R.Y");
    assert_eq!(d.end("P.L.W.U", "success"), "-P.L.W.U; +P.L.W.V; -P.L.W.V; -P.L.W; +P.L.X");
    assert_eq!(d.engine.locals()["n"], Value::Int(1));
}

#[test]
fn an_unbreakable_state_holds_64_events_and_then_error_queue() {
    let mut d = Drive::new(
        "
statechart: T
initial: O
states:
  O:
    initial: U
    states: {U: {skill: Act, unbreakable: true}}
    transitions: {out: Q, error.queue: {do: [{log: \"${event.data.event}\"}]}}
  Q: {}
events: {out: {}}
",
    );
    d.said();
    for _ in 0..64 {
        assert_eq!(d.event("out"), "held out");
    }
    assert_eq!(d.event("out"), "dropped out; log out");
    assert_eq!(d.leaves(), "O.U");
    assert_eq!(d.end("O.U", "success"), "done O.U success; -O.U; -O; +Q");
}

#[test]
fn an_error_while_an_error_is_matched_raises_nothing_more() {
    let mut d = Drive::new(
        "
statechart: T
locals: {x: {type: float}}
initial: A
states:
  A:
    transitions:
      t: {target: B, if: \"locals.x > 1.0\"}
      \"error.*\": [{target: B, if: \"locals.x > 2.0\"}, C]
  B: {}
  C: {}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "error this has no value yet; error this has no value yet; -A; +C");
}

#[test]
fn a_final_state_of_the_chart_ends_the_run_before_anything_else() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {transitions: {t: {target: Done, do: [{raise: late}]}}}
  Done: {final: success}
transitions: {late: A}
events: {t: {}}
",
    );
    d.said();
    assert_eq!(d.event("t"), "-A; +Done; -Done; finished success \"\"");
}

#[test]
fn an_internal_transition_does_not_leave_its_source() {
    let chart = |internal: bool| {
        format!(
            "
statechart: T
initial: O
states:
  O:
    initial: A
    states: {{A: {{}}, B: {{}}}}
    transitions: {{t: {{target: O.B, internal: {internal}}}}}
events: {{t: {{}}}}
"
        )
    };
    for (internal, expected) in [(true, "-O.A; +O.B"), (false, "-O.A; -O; +O; +O.B")] {
        let mut d = Drive::new(&chart(internal));
        d.said();
        assert_eq!(d.event("t"), expected);
    }
}

const REGIONS: &str = "
statechart: T
initial: S
states:
  S: {transitions: {t: {target: [P.L.L2, P.R.R2]}}}
  P:
    parallel:
      L: {initial: L1, states: {L1: {}, L2: {}}}
      R: {initial: R1, states: {R1: {}, R2: {}}}
      M: {}
events: {t: {}}
";

#[test]
fn several_targets_are_entered_together() {
    let mut d = Drive::new(REGIONS);
    d.said();
    assert_eq!(d.event("t"), "-S; +P; +P.L; +P.L.L2; +P.R; +P.R.R2; +P.M");
    let mut d = Drive::new(&REGIONS.replace("initial: S", "initial: [P.L.L2, P.R.R2]"));
    assert_eq!(d.said(), "+P; +P.L; +P.L.L2; +P.R; +P.R.R2; +P.M");
}

#[test]
fn actions_of_initial_and_default_run_between_entry_and_what_is_inside() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A: {transitions: {t: O, h: O.H}}
  O:
    enter: [{log: in}]
    initial: {target: B, do: [{log: initial}]}
    states:
      H: {history: shallow, default: {target: C, do: [{log: default}]}}
      B: {transitions: {out: A}}
      C: {transitions: {out: A}}
events: {t: {}, h: {}, out: {}}
",
    );
    d.said();
    assert_eq!(d.event("h"), "-A; +O; log in; log default; +O.C");
    d.event("out");
    d.said();
    assert_eq!(d.event("t"), "-A; +O; log in; log initial; +O.B");
    d.event("out");
    d.said();
    assert_eq!(d.event("h"), "-A; +O; log in; +O.B", "a history that remembers has no default");
}

#[test]
fn transitions_in_a_list_are_tried_in_their_order() {
    let mut d = Drive::new(
        "
statechart: T
initial: A
states:
  A:
    transitions:
      - {event: a.b, target: B, if: \"false\"}
      - {event: a.*, target: C}
      - {event: a.b, target: D}
  B: {}
  C: {}
  D: {}
events: {a.b: {}}
",
    );
    d.said();
    assert_eq!(d.event("a.b"), "-A; +C");
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
    d.said();
    struct Nan;
    impl super::Sensors for Nan {
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
    assert_eq!(d.said(), "log blind");
    assert!(!d.engine.observe(0, &super::NoSensors).holds, "a channel that was never published is false");
}
