//! The arrows between the boxes of one level, and the text lines inside the boxes.

use std::collections::BTreeMap;

use armarium_runtime::chart::{Outline, OutlineKind, OutlineTransition};

use super::measure::cut;

/// An arrow between two sibling states.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Arrow {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Vec<String>,
}

/// A chart's transitions, by how they are shown.
#[derive(Debug, Default)]
pub(super) struct Graph {
    /// Arrows, by the state that contains them.
    pub(super) arrows: BTreeMap<usize, Vec<Arrow>>,
    /// Text lines, by the state that shows them.
    pub(super) notes: BTreeMap<usize, Vec<String>>,
}

impl Graph {
    pub(super) fn of(outline: &Outline) -> Self {
        let mut graph = Self::default();
        for (at, state) in outline.states.iter().enumerate() {
            if !state.activities.is_empty() {
                let lines = state.activities.iter().map(|a| cut(a)).collect();
                graph.notes.insert(at, lines);
            }
        }
        for (at, state) in outline.states.iter().enumerate() {
            if matches!(state.kind, OutlineKind::History { .. }) {
                for target in &state.initial {
                    graph.connect(outline, at, *target, String::new());
                }
            }
        }
        for transition in &outline.transitions {
            graph.add(outline, transition);
        }
        graph
    }

    fn add(&mut self, outline: &Outline, transition: &OutlineTransition) {
        let label = label(transition);
        match transition.targets.as_slice() {
            [] => self.note(transition.source, &label),
            [target] if !transition.internal => {
                self.connect(outline, transition.source, *target, label);
            }
            targets => {
                // A transition to several states, or an internal one, becomes one line of text.
                let names: Vec<String> = targets.iter().map(|t| outline.path(*t)).collect();
                let arrow = if transition.internal { "⇢" } else { "→" };
                self.note(transition.source, &format!("{label} {arrow} {}", names.join(" + ")));
            }
        }
    }

    fn note(&mut self, state: usize, line: &str) {
        self.notes.entry(state).or_default().push(cut(line));
    }

    fn connect(&mut self, outline: &Outline, source: usize, target: usize, label: String) {
        let (sources, targets) = (outward(outline, source), outward(outline, target));
        let level = sources.iter().copied().find(|s| targets.contains(s));
        let below = |list: &[usize]| {
            let at = list.iter().position(|s| Some(*s) == level)?;
            at.checked_sub(1).map(|at| list[at])
        };
        let (Some(level), Some(from), Some(to)) = (level, below(&sources), below(&targets)) else {
            return self.note(source, &format!("{label} → {}", own_or_path(outline, source, target)));
        };
        if matches!(outline.states[level].kind, OutlineKind::Parallel) || from == to {
            return self.note(source, &format!("{label} → {}", outline.path(target)));
        }
        let mut text = label;
        if from != source {
            let inner = relative(outline, from, source);
            text = if text.is_empty() { inner } else { format!("{inner}: {text}") };
        }
        if to != target {
            let inner = relative(outline, to, target);
            text = format!("{text} ▸ {inner}");
        }
        let arrows = self.arrows.entry(level).or_default();
        let line = cut(text.trim());
        match arrows.iter_mut().find(|a| a.from == from && a.to == to) {
            Some(arrow) => arrow.label.extend((!line.is_empty()).then_some(line)),
            None => arrows.push(Arrow { from, to, label: if line.is_empty() { vec![] } else { vec![line] } }),
        }
    }
}

fn own_or_path(outline: &Outline, source: usize, target: usize) -> String {
    if source == target { "itself".into() } else { outline.path(target) }
}

/// A state and its ancestors, innermost first.
fn outward(outline: &Outline, state: usize) -> Vec<usize> {
    std::iter::successors(Some(state), |s| outline.states[*s].parent).collect()
}

/// The path of a state below another.
fn relative(outline: &Outline, outer: usize, inner: usize) -> String {
    let (outer, inner) = (outline.path(outer), outline.path(inner));
    inner.strip_prefix(&outer).map_or(inner.as_str(), |rest| rest.trim_start_matches('.')).to_owned()
}

fn label(transition: &OutlineTransition) -> String {
    let mut text = transition.event.clone();
    if let Some(guard) = &transition.guard {
        text.push_str(&format!(" [{guard}]"));
    }
    if !transition.actions.is_empty() {
        text.push_str(&format!(" / {}", transition.actions.join("; ")));
    }
    text.trim().to_owned()
}
