//! The chart for other tools: Mermaid (`stateDiagram-v2`) and PlantUML.

use std::fmt::Write as _;

use armarium_runtime::chart::{Outline, OutlineKind, OutlineTransition};

use super::measure::cut;

/// A chart as a Mermaid state diagram.
#[must_use]
pub fn mermaid(outline: &Outline) -> String {
    let mut out = String::from("stateDiagram-v2\n");
    inside(outline, 0, 1, &MERMAID, &mut out);
    transitions(outline, &MERMAID, &mut out);
    out
}

/// A chart as a PlantUML state diagram.
#[must_use]
pub fn plantuml(outline: &Outline) -> String {
    let mut out = format!("@startuml\ntitle {}\nhide empty description\n", outline.states[0].name);
    inside(outline, 0, 0, &PLANTUML, &mut out);
    transitions(outline, &PLANTUML, &mut out);
    out.push_str("@enduml\n");
    out
}

/// The syntax differences of a tool.
struct Dialect {
    parting: &'static str,
    /// A stereotype after the name of a final or history state.
    end: &'static str,
    history: &'static str,
    deep: &'static str,
    /// Characters that are not allowed in a label.
    unsafe_in_label: &'static [char],
}

const MERMAID: Dialect = Dialect {
    parting: "--",
    end: "",
    history: "",
    deep: "",
    unsafe_in_label: &[':', ';', '#', '{', '}', '<', '>', '"'],
};
const PLANTUML: Dialect = Dialect {
    parting: "||",
    end: " <<end>>",
    history: " <<history>>",
    deep: " <<history*>>",
    unsafe_in_label: &[],
};

/// An identifier that is unique in the chart.
fn id(outline: &Outline, state: usize) -> String {
    outline.path(state).replace('.', "__")
}

fn inside(outline: &Outline, state: usize, indent: usize, dialect: &Dialect, out: &mut String) {
    let pad = "    ".repeat(indent);
    let of = &outline.states[state];
    // Writing into a `String` cannot fail.
    for (number, child) in of.children.iter().enumerate() {
        let inner = &outline.states[*child];
        if number > 0 && of.kind == OutlineKind::Parallel {
            let _ = writeln!(out, "{pad}{}", dialect.parting);
        }
        let mark = match inner.kind {
            OutlineKind::Final(_) => dialect.end,
            OutlineKind::History { deep: true } => dialect.deep,
            OutlineKind::History { deep: false } => dialect.history,
            _ => "",
        };
        let (name, id) = (title(outline, *child, dialect), id(outline, *child));
        if inner.children.is_empty() {
            let _ = writeln!(out, "{pad}state \"{name}\" as {id}{mark}");
        } else {
            let _ = writeln!(out, "{pad}state \"{name}\" as {id} {{");
            inside(outline, *child, indent + 1, dialect, out);
            let _ = writeln!(out, "{pad}}}");
        }
    }
    if of.kind == OutlineKind::Composite {
        for target in &of.initial {
            let _ = writeln!(out, "{pad}[*] --> {}", id(outline, *target));
        }
    }
}

fn title(outline: &Outline, state: usize, dialect: &Dialect) -> String {
    let of = &outline.states[state];
    let text = match &of.kind {
        OutlineKind::Skill(name) => format!("{} ({name})", of.name),
        OutlineKind::Chart(name) | OutlineKind::Remote(name) => format!("{} [{name}]", of.name),
        OutlineKind::Final(outcome) => format!("{} (ends {outcome})", of.name),
        OutlineKind::History { .. } => format!("{} (history)", of.name),
        _ => of.name.clone(),
    };
    safe(&text, dialect)
}

fn safe(text: &str, dialect: &Dialect) -> String {
    text.chars().map(|c| if c == '"' || dialect.unsafe_in_label.contains(&c) { '\'' } else { c }).collect()
}

fn transitions(outline: &Outline, dialect: &Dialect, out: &mut String) {
    for transition in &outline.transitions {
        let source = if transition.source == 0 { "[*]".into() } else { id(outline, transition.source) };
        let label = safe(&cut(&label(transition)), dialect);
        let label = if label.is_empty() { String::new() } else { format!(" : {label}") };
        let stays = [transition.source];
        let targets = if transition.targets.is_empty() { &stays[..] } else { &transition.targets };
        for target in targets.iter().filter(|_| transition.source != 0) {
            let _ = writeln!(out, "{source} --> {}{label}", id(outline, *target));
        }
    }
    for (at, state) in outline.states.iter().enumerate() {
        for target in state.initial.iter().filter(|_| matches!(state.kind, OutlineKind::History { .. })) {
            let _ = writeln!(out, "{} --> {}", id(outline, at), id(outline, *target));
        }
    }
}

fn label(transition: &OutlineTransition) -> String {
    let mut text = transition.event.clone();
    if let Some(guard) = &transition.guard {
        text.push_str(&format!(" [{guard}]"));
    }
    if !transition.actions.is_empty() {
        text.push_str(&format!(" / {}", transition.actions.join(", ")));
    }
    if transition.targets.is_empty() {
        text.push_str(" (stays)");
    }
    text.trim().to_owned()
}
