//! Random charts under random events: the configuration is legal after every input, and entries and exits balance.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use armarium_values::Value;
use proptest::prelude::*;

use super::{Effect, Engine, Input, NoSensors, TraceItem};
use crate::chart::testing::program;
use crate::program::Kind;
use crate::skill::{Failure, Outcome};

/// The shape of a random state.
#[derive(Clone, Debug)]
enum Shape {
    Leaf,
    Skill,
    Final,
    Composite(Vec<Shape>, bool),
    Parallel(Vec<Shape>),
}

fn shape() -> impl Strategy<Value = Shape> {
    let leaf = prop_oneof![3 => Just(Shape::Leaf), 3 => Just(Shape::Skill), 1 => Just(Shape::Final)];
    leaf.prop_recursive(4, 24, 4, |inner| {
        let inner = inner.boxed();
        prop_oneof![
            (prop::collection::vec(inner.clone(), 1..4), any::<bool>())
                .prop_map(|(s, h)| Shape::Composite(s, h)),
            prop::collection::vec(inner, 1..4).prop_map(Shape::Parallel),
        ]
    })
}

fn not_final(shapes: Vec<Shape>) -> Vec<Shape> {
    shapes.into_iter().map(|s| if matches!(s, Shape::Final) { Shape::Leaf } else { s }).collect()
}

/// The outermost states of a chart.
fn shapes() -> impl Strategy<Value = Vec<Shape>> {
    prop::collection::vec(shape(), 1..4).prop_map(not_final)
}

fn child_name(path: &str, number: usize) -> String {
    if path.is_empty() { format!("S{number}") } else { format!("{path}_{number}") }
}

/// The outcome of a final state.
fn outcome(path: &str) -> &'static str {
    ["success", "blocked", "failure"][path.bytes().map(usize::from).sum::<usize>() % 3]
}

/// Whether the `success` of a skill may come to a state; a chart that waits for one that cannot come is refused.
fn may_succeed(shape: &Shape) -> bool {
    match shape {
        Shape::Skill => true,
        Shape::Composite(shapes, _) => shapes.iter().any(may_succeed),
        // The outcomes of regions are their own.
        Shape::Leaf | Shape::Final | Shape::Parallel(_) => false,
    }
}

/// Writes a state as YAML in flow style; `picks` chooses targets.
fn write(shape: &Shape, path: &str, paths: &[String], picks: &mut dyn FnMut() -> usize, out: &mut String) {
    let children = |shapes: &[Shape], picks: &mut dyn FnMut() -> usize, out: &mut String| {
        for (i, s) in shapes.iter().enumerate() {
            let child = child_name(path, i);
            write!(out, "{}{child}: ", if i == 0 { "" } else { ", " }).unwrap();
            write(s, &child, paths, picks, out);
        }
    };
    out.push('{');
    match shape {
        Shape::Leaf => {}
        Shape::Skill => out.push_str("skill: Act, "),
        Shape::Final => {
            write!(out, "final: {}}}", outcome(path)).unwrap();
            return;
        }
        Shape::Composite(shapes, history) => {
            write!(out, "initial: {path}_0, states: {{").unwrap();
            children(shapes, picks, out);
            if *history {
                let deep = ["deep", "shallow"][picks() % 2];
                write!(out, ", {path}_H: {{history: {deep}, default: {path}_0}}").unwrap();
            }
            out.push_str("}, ");
        }
        Shape::Parallel(shapes) => {
            // Regions that are themselves final states are left out.
            let regions = not_final(shapes.clone());
            out.push_str("parallel: {");
            children(&regions, picks, out);
            out.push_str("}, ");
        }
    }
    out.push_str("transitions: {");
    for (i, event) in ["a", "b", "success", "failure"].iter().enumerate() {
        let possible = match i {
            0 | 1 => true,
            2 => may_succeed(shape),
            _ => matches!(shape, Shape::Skill | Shape::Composite(..)),
        };
        if picks().is_multiple_of(3) && possible {
            let target = &paths[picks() % paths.len()];
            write!(out, "{event}: {{target: {target}}}, ").unwrap();
        }
    }
    out.push_str("}}");
}

/// The paths of all states that a shape will be written with.
fn list(shape: &Shape, name: &str, prefix: &str, paths: &mut Vec<String>) {
    let path = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
    paths.push(path.clone());
    match shape {
        Shape::Composite(shapes, history) => {
            shapes.iter().enumerate().for_each(|(i, s)| list(s, &format!("{name}_{i}"), &path, paths));
            if *history {
                paths.push(format!("{path}.{name}_H"));
            }
        }
        Shape::Parallel(shapes) => {
            shapes.iter().enumerate().for_each(|(i, s)| list(s, &format!("{name}_{i}"), &path, paths));
        }
        _ => {}
    }
}

fn chart(shapes: &[Shape], numbers: &[usize]) -> String {
    let mut paths = Vec::new();
    shapes.iter().enumerate().for_each(|(i, s)| list(s, &format!("S{i}"), "", &mut paths));
    let mut at = 0;
    let mut picks = || {
        at += 1;
        numbers[at % numbers.len()]
    };
    let mut text = String::from("statechart: T\nevents: {a: {}, b: {}}\ninitial: S0\nstates: {");
    for (i, s) in shapes.iter().enumerate() {
        write!(text, "{}S{i}: ", if i == 0 { "" } else { ", " }).unwrap();
        write(s, &format!("S{i}"), &paths, &mut picks, &mut text);
    }
    text + "}\n"
}

/// Checks the configuration: one child of each active composite, all regions of each active parallel state, no
/// state without its parent.
fn legal(engine: &Engine) -> Result<(), String> {
    let active: BTreeSet<u32> = engine.configuration().iter().copied().collect();
    for id in &active {
        let state = engine.program().state(*id);
        if state.parent.is_some_and(|p| !active.contains(&p)) {
            return Err(format!("`{}` without its parent", state.path));
        }
        let inside = state.children.iter().filter(|c| active.contains(c)).count();
        let wanted = match state.kind {
            Kind::Composite { .. } | Kind::Chart { .. } => 1,
            Kind::Parallel => state.children.len(),
            Kind::History { .. } => return Err(format!("the history `{}` is active", state.path)),
            _ => 0,
        };
        if inside != wanted {
            return Err(format!("`{}` has {inside} active states inside, not {wanted}", state.path));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn configurations_are_legal_and_entries_balance(
        shapes in shapes(),
        numbers in prop::collection::vec(0_usize..1000, 8..64),
        inputs in prop::collection::vec(0_usize..6, 1..40),
    ) {
        let text = chart(&shapes, &numbers);
        let mut engine = Engine::new(program(&text), &BTreeMap::new(), None).unwrap();
        let mut entered: BTreeMap<String, i32> = BTreeMap::new();
        let mut running: BTreeSet<u64> = BTreeSet::new();
        let mut out = Vec::new();
        engine.start(&NoSensors, &mut out);
        for input in inputs.iter().map(Some).chain([None]) {
            for effect in out.drain(..) {
                match effect {
                    Effect::StartSkill { activation, .. } => prop_assert!(running.insert(activation)),
                    Effect::Cancel { activation, .. } => prop_assert!(running.contains(&activation)),
                    Effect::Trace(TraceItem::Entered { state }) => {
                        let count = entered.entry(state).or_default();
                        *count += 1;
                        prop_assert_eq!(*count, 1);
                    }
                    Effect::Trace(TraceItem::Exited { state }) => {
                        let count = entered.entry(state).or_default();
                        *count -= 1;
                        prop_assert_eq!(*count, 0);
                    }
                    Effect::Finished(_) => {
                        prop_assert!(running.is_empty(), "skills run after the end");
                        prop_assert!(entered.values().all(|n| *n == 0), "states are left behind");
                        prop_assert!(engine.configuration().is_empty());
                    }
                    _ => {}
                }
            }
            if engine.finished() {
                break;
            }
            if let Err(wrong) = legal(&engine) {
                return Err(TestCaseError::fail(format!("{wrong}\n{text}")));
            }
            let skill = |n: usize| running.iter().nth(n % running.len().max(1)).copied();
            let input = match (input, skill(input.copied().unwrap_or(0))) {
                (Some(0 | 1), _) => Input::Event { name: "a".into(), data: Value::Null },
                (Some(2), _) => Input::Event { name: "b".into(), data: Value::Null },
                (Some(n), Some(activation)) => {
                    running.remove(&activation);
                    let result =
                        if *n == 3 { Err(Failure::new("no")) } else { Ok(Outcome::success()) };
                    Input::SkillEnded { activation, result }
                }
                (Some(_), None) => continue,
                (None, _) => break,
            };
            engine.handle(input, &NoSensors, &mut out);
        }
    }

    /// A run that is recorded, written as JSON and read back goes through the same states with the same effects.
    /// Turning tracing off only removes the trace.
    #[test]
    fn a_replay_equals_its_run(
        shapes in shapes(),
        numbers in prop::collection::vec(0_usize..1000, 8..64),
        inputs in prop::collection::vec(0_usize..6, 1..40),
    ) {
        let program = program(&chart(&shapes, &numbers));
        let new = || Engine::new(std::sync::Arc::clone(&program), &BTreeMap::new(), None).unwrap();
        let (mut run, mut replay, mut quiet) = (new(), new(), new());
        quiet.set_tracing(false);
        let mut running = BTreeSet::new();
        for n in std::iter::once(6).chain(inputs) {
            let input = match (n, running.iter().nth(n % running.len().max(1)).copied()) {
                (6, _) => None,
                (0..=2, _) => Some(Input::Event { name: ["a", "b", "c"][n].into(), data: Value::Int(1) }),
                (_, Some(activation)) => {
                    running.remove(&activation);
                    let result = if n == 3 { Err(Failure::new("no")) } else { Ok(Outcome::success()) };
                    Some(Input::SkillEnded { activation, result })
                }
                _ => continue,
            };
            let turn = super::InputRecord { at_ns: 0, input, seen: Vec::new() };
            let read: super::InputRecord =
                serde_json::from_str(&serde_json::to_string(&turn).unwrap()).unwrap();
            let (mut first, mut second, mut third) = (Vec::new(), Vec::new(), Vec::new());
            run.replay(&turn, &mut first);
            replay.replay(&read, &mut second);
            quiet.replay(&turn, &mut third);
            prop_assert_eq!(&first, &second);
            prop_assert_eq!(run.configuration(), replay.configuration());
            prop_assert_eq!(run.configuration(), quiet.configuration());
            first.retain(|effect| !matches!(effect, Effect::Trace(_)));
            prop_assert_eq!(&first, &third);
            running.extend(first.iter().filter_map(|effect| match effect {
                Effect::StartSkill { activation, .. } => Some(*activation),
                _ => None,
            }));
        }
    }
}
