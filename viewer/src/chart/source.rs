//! The chart for other tools: Mermaid (`stateDiagram-v2`) and PlantUML.

use std::fmt::Write as _;

use armarium_runtime::chart::{Outline, OutlineKind};

use super::graph::label;

/// A chart as a Mermaid state diagram.
pub(super) fn mermaid(outline: &Outline) -> String {
    let mut out = String::from("stateDiagram-v2\n");
    whole(outline, 1, &MERMAID, &mut out);
    transitions(outline, &MERMAID, &mut out);
    out
}

/// A chart as a PlantUML state diagram.
pub(super) fn plantuml(outline: &Outline) -> String {
    let mut out = format!("@startuml\ntitle {}\nhide empty description\n", outline.states[0].name);
    whole(outline, 0, &PLANTUML, &mut out);
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
    /// Writes a text so that the tool shows it as it is.
    text: fn(&str) -> String,
}

const MERMAID: Dialect = Dialect { parting: "--", end: "", history: "", deep: "", text: mermaid_text };
const PLANTUML: Dialect = Dialect {
    parting: "||",
    end: " <<end>>",
    history: " <<history>>",
    deep: " <<history*>>",
    text: |text| text.replace('"', "'"),
};

/// An identifier that is unique in the chart, and none of the words that have a meaning in the tools' languages.
fn id(outline: &Outline, state: usize) -> String {
    format!("s_{}", outline.path(state).replace('.', "__"))
}

/// The states. The chart is a state itself where it has transitions of its own or regions; else its states are enough.
fn whole(outline: &Outline, indent: usize, dialect: &Dialect, out: &mut String) {
    let alone = outline.states[0].kind == OutlineKind::Parallel;
    if alone || outline.transitions.iter().any(|t| t.source == 0) {
        write_state(outline, 0, indent, dialect, out);
    } else {
        inside(outline, 0, indent, dialect, out);
    }
}

fn write_state(outline: &Outline, state: usize, indent: usize, dialect: &Dialect, out: &mut String) {
    let pad = "    ".repeat(indent);
    let of = &outline.states[state];
    let mark = match of.kind {
        OutlineKind::Final(_) => dialect.end,
        OutlineKind::History { deep: true } => dialect.deep,
        OutlineKind::History { deep: false } => dialect.history,
        _ => "",
    };
    let (name, id) = (title(outline, state, dialect), id(outline, state));
    // Writing into a `String` cannot fail.
    if of.children.is_empty() {
        let _ = writeln!(out, "{pad}state \"{name}\" as {id}{mark}");
    } else {
        let _ = writeln!(out, "{pad}state \"{name}\" as {id} {{");
        inside(outline, state, indent + 1, dialect, out);
        let _ = writeln!(out, "{pad}}}");
    }
}

fn inside(outline: &Outline, state: usize, indent: usize, dialect: &Dialect, out: &mut String) {
    let pad = "    ".repeat(indent);
    let of = &outline.states[state];
    // Writing into a `String` cannot fail.
    for (number, child) in of.children.iter().enumerate() {
        if number > 0 && of.kind == OutlineKind::Parallel {
            let _ = writeln!(out, "{pad}{}", dialect.parting);
        }
        write_state(outline, *child, indent, dialect, out);
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
    (dialect.text)(&text)
}

/// Mermaid's grammar gives many characters a meaning, and it shows text as HTML: all but letters, digits and harmless
/// signs become entities, which Mermaid writes as `#lt;` or, by number, `#58;`.
fn mermaid_text(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '<' => out.push_str("#lt;"),
            '>' => out.push_str("#gt;"),
            '&' => out.push_str("#amp;"),
            '"' => out.push_str("#quot;"),
            c if c.is_ascii_punctuation() && !"._,()[]/=+'!?|".contains(c) => {
                let _ = write!(out, "#{};", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out
}

fn transitions(outline: &Outline, dialect: &Dialect, out: &mut String) {
    for transition in &outline.transitions {
        let source = id(outline, transition.source);
        let mut label = label(transition, ", ");
        if transition.targets.is_empty() {
            label.push_str(" (stays)");
        }
        let label = (dialect.text)(label.trim());
        let label = if label.is_empty() { String::new() } else { format!(" : {label}") };
        let stays = [transition.source];
        let targets = if transition.targets.is_empty() { &stays[..] } else { &transition.targets };
        for target in targets {
            let _ = writeln!(out, "{source} --> {}{label}", id(outline, *target));
        }
    }
    for (at, state) in outline.states.iter().enumerate() {
        for target in state.initial.iter().filter(|_| matches!(state.kind, OutlineKind::History { .. })) {
            let _ = writeln!(out, "{} --> {}", id(outline, at), id(outline, *target));
        }
    }
}
