//! Charts that would never rest or use ever more memory: each one is stopped, in bounded time and memory.

use super::tests::Drive;
use super::{MAX_ANSWER, MAX_MICROSTEPS};

fn chart(rest: &str) -> Drive {
    Drive::new(&format!("statechart: T\ninitial: A\n{rest}"))
}

/// Whether the run is in this state.
fn is_in(d: &Drive, state: &str) -> bool {
    d.engine.leaves().iter().any(|leaf| d.engine.program().path(*leaf) == state)
}

#[test]
fn a_chart_that_sends_itself_events_without_end_fails() {
    let mut d = chart("states: {A: {enter: [{send: go}], transitions: {go: A}}}\n");
    let said = d.take_log();
    assert!(said.contains(&format!("finished failure \"{MAX_ANSWER} microsteps without rest")), "{said}");
}

#[test]
fn timers_without_time_between_them_fail_the_run() {
    for states in [
        "states: {A: {after: {0s: A}}}\n",
        "states: {A: {enter: [{send: {event: go, delay: 0s}}], transitions: {go: A}}}\n",
    ] {
        let mut d = chart(states);
        for _ in 0..MAX_MICROSTEPS {
            d.timer();
        }
        assert!(!d.engine.finished());
        let said = d.timer();
        let reason = format!("{MAX_MICROSTEPS} timers without any time between them");
        assert!(said.contains(&reason), "{said}");
    }
    // Transitions with time between them are no endless loop, however short the time.
    let mut d = chart("states: {A: {after: {0.000001ms: A}}}\n");
    for _ in 0..2 * MAX_MICROSTEPS {
        d.timer();
    }
    assert!(!d.engine.finished());
}

#[test]
fn what_doubles_itself_is_an_error_before_it_is_large() {
    for (ty, first, next) in [
        ("string", "'0123456789'", "${locals.x + locals.x}"),
        ("list<any>", "[1, 2]", "${locals.x + locals.x}"),
        ("list<any>", "[1, 2]", "${[locals.x, locals.x]}"),
        ("any", "{a: 1}", "${{'a': locals.x, 'b': locals.x}}"),
        ("list<any>", "[1, 2]", "${locals.x.map(i, locals.x)}"),
        ("list<any>", "[1]", "${[locals.x]}"),
        ("list<any>", "[1]", "[\"${locals.x}\", \"${locals.x}\", \"${locals.x}\"]"),
    ] {
        let value = if next.starts_with('[') { next.to_owned() } else { format!("\"{next}\"") };
        let mut d = chart(&format!(
            "locals: {{x: {{type: {ty}, default: {first}}}}}\nevents: {{go: {{}}}}\nstates:\n  A:\n    \
             transitions: {{go: {{do: [{{assign: {{locals.x: {value}}}}}]}}, error.execution: B}}\n  B: {{}}\n"
        ));
        let mut rounds = 0;
        while is_in(&d, "A") && rounds < 100 {
            d.event("go");
            rounds += 1;
        }
        assert!(
            is_in(&d, "B") && rounds > 1 && d.engine.locals()["x"].parts() <= 100_000,
            "{next}: {rounds}"
        );
    }
}

#[test]
fn events_carry_no_more_than_there_is_room_for() {
    let text = "x".repeat(900_000);
    let mut d = chart(&format!(
        "locals: {{x: {{type: string, default: '{text}'}}}}\nevents: {{go: {{}}}}\nstates:\n  A:\n    \
         transitions: {{go: {{do: [{{foreach: {{in: \"${{[1, 2, 3, 4, 5, 6, 7, 8].map(i, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10])}}\", \
         as: n, do: [{{foreach: {{in: \"${{n}}\", as: m, do: [{{raise: {{event: go2, data: \"${{locals.x}}\"}}}}]}}}}]}}}}]}}, \
         error.execution: B}}\n  B: {{}}\n"
    ));
    assert!(d.event("go").contains("error too many events are waiting"));
    assert!(is_in(&d, "B"));
}

#[test]
fn loops_in_loops_end() {
    let ten = "${[0,1,2,3,4,5,6,7,8,9].map(i, 0)}";
    let mut body = "[{assign: {locals.n: \"${locals.n + 1}\"}}]".to_owned();
    for level in 0..8 {
        body = format!("[{{foreach: {{in: \"{ten}\", as: v{level}, do: {body}}}}}]");
    }
    let mut d = chart(&format!(
        "locals: {{n: {{type: int, default: 0}}}}\nstates:\n  A: {{enter: {body}, transitions: {{error.execution: B}}}}\n  B: {{}}\n"
    ));
    assert!(d.take_log().contains("more than 100000 actions in answer to one event"));
    assert!(is_in(&d, "B"));
}
