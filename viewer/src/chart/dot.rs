//! The chart for Graphviz.

use std::fmt::Write as _;

use armarium_runtime::chart::{Outline, OutlineKind};

use super::font::wrap;
use super::graph::{label, outward};

/// Longest line of a text, px.
const WIDTH: f64 = 220.0;

/// A chart as a directed graph: states with content are clusters, each with a point at which arrows of the whole state
/// start and end.
pub(super) fn dot(outline: &Outline) -> String {
    let mut out = String::from(
        "digraph {\n  compound=true\n  fontname=\"Arial\"\n  node [shape=box style=\"rounded\" fontname=\"Arial\" \
         fontsize=12]\n  edge [fontname=\"Arial\" fontsize=11]\n",
    );
    state(outline, 0, 1, &mut out);
    // Writing into a `String` cannot fail.
    for transition in &outline.transitions {
        let stays = [transition.source];
        let targets = if transition.targets.is_empty() { &stays[..] } else { &transition.targets };
        for target in targets {
            edge(outline, transition.source, *target, &label(transition, "; "), &mut out);
        }
    }
    for (at, of) in outline.states.iter().enumerate() {
        for target in of.initial.iter().filter(|target| **target != at) {
            edge(outline, at, *target, "", &mut out);
        }
    }
    out.push_str("}\n");
    out
}

fn state(outline: &Outline, at: usize, indent: usize, out: &mut String) {
    let pad = "  ".repeat(indent);
    let of = &outline.states[at];
    let mut lines = vec![of.name.clone()];
    lines.extend(match &of.kind {
        OutlineKind::Skill(name) => Some(format!("skill {name}")),
        OutlineKind::Chart(name) => Some(format!("chart {name}")),
        OutlineKind::Remote(name) => Some(format!("remote {name}")),
        OutlineKind::Final(outcome) => Some(format!("ends {outcome}")),
        _ => None,
    });
    let text = quoted(&lines.into_iter().chain(of.activities.iter().cloned()).collect::<Vec<_>>());
    if of.children.is_empty() {
        let more = match of.kind {
            OutlineKind::Final(_) => " peripheries=2",
            OutlineKind::History { .. } => " shape=circle",
            _ => "",
        };
        let _ = writeln!(out, "{pad}n{at} [label={text}{more}]");
        return;
    }
    let style = if of.kind == OutlineKind::Parallel { "dashed" } else { "rounded" };
    let _ = writeln!(out, "{pad}subgraph cluster_{at} {{\n{pad}  label={text}\n{pad}  style=\"{style}\"");
    let _ = writeln!(out, "{pad}  n{at} [shape=point]");
    of.children.iter().for_each(|child| state(outline, *child, indent + 1, out));
    let _ = writeln!(out, "{pad}}}");
}

/// An arrow; at a cluster that does not contain its other end it stops at the border.
fn edge(outline: &Outline, source: usize, target: usize, label: &str, out: &mut String) {
    let mut attributes = Vec::new();
    if !label.is_empty() {
        attributes.push(format!("label={}", quoted(&[label.to_owned()])));
    }
    for (end, other, name) in [(source, target, "ltail"), (target, source, "lhead")] {
        let mut around_other = outward(outline, other);
        if !outline.states[end].children.is_empty() && around_other.all(|s| s != end) {
            attributes.push(format!("{name}=cluster_{end}"));
        }
    }
    let _ = writeln!(out, "  n{source} -> n{target} [{}]", attributes.join(" "));
}

/// Texts as a quoted label, each on lines of its own.
fn quoted(texts: &[String]) -> String {
    let lines: Vec<String> = texts.iter().flat_map(|text| wrap(text, WIDTH)).collect();
    format!("\"{}\"", lines.join("\n").replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
