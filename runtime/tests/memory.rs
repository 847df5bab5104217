//! A chart that runs for a long time uses no more memory than at the beginning.

use std::collections::BTreeMap;

use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Engine, NoSensors};
use armarium_values::Value;

const CHART: &str = "
statechart: Long
locals: {n: {type: int, default: 0}, text: {type: string, default: ''}}
events: {next: {}}
initial: A
states:
  A:
    after: {1h: B}
    transitions:
      next: {target: B, do: [{assign: {locals.n: \"${locals.n + 1}\"}}, {assign: {locals.text: \"n ${locals.n}\"}}, {raise: inner}]}
  B:
    enter: [{send: {event: later, delay: 1h, id: x}}]
    exit: [{cancel: x}]
    transitions: {next: A, later: A}
    initial: C
    states:
      H: {history: deep, default: C}
      C: {transitions: {inner: D}}
      D: {}
";

/// Resident memory of this process, bytes.
fn resident() -> Option<u64> {
    let pages: u64 = std::fs::read_to_string("/proc/self/statm").ok()?.split(' ').nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

#[test]
fn a_million_events_leave_no_memory_behind() {
    let checked = check(&load_text("long.yaml", CHART, &[]), &Registry::new(), &ChannelSchema::new());
    let program = checked.program.unwrap_or_else(|| panic!("{:?}", checked.findings));
    let next = program.event("next").unwrap();
    let mut engine = Engine::new(program, &BTreeMap::new(), None).unwrap();
    engine.set_tracing(false);
    let mut out = Vec::new();
    engine.start(&NoSensors, &mut out);
    let mut drive = |count: u32| {
        for _ in 0..count {
            engine.raise(next, Value::Int(1), &NoSensors, &mut out);
            out.clear();
        }
    };
    drive(10_000);
    let before = resident();
    drive(1_000_000);
    if let (Some(before), Some(after)) = (before, resident()) {
        assert!(after < before + 1_000_000, "{before} bytes became {after}");
    }
    assert_eq!(engine.locals()["n"], Value::Int(505_000));
}
