//! The arrows between the boxes of one level, and the text lines inside the boxes.

use std::collections::{BTreeMap, BTreeSet};

use armarium_runtime::chart::{Outline, OutlineKind, OutlineTransition};

use super::font::{Weight, width, wrap};

/// Longest line of an arrow's label, px.
const LABEL: f64 = 190.0;
/// Longest line of text inside a box, px.
const NOTE: f64 = 250.0;
/// A final state that so many states go to gets no arrows: each of them names it instead.
const COMMON: usize = 3;
/// A level with more states is drawn in columns of `COLUMN` states, in the order of the file. Arrows lead within a column; a
/// state names those of other columns that it goes to. A level that is drawn inside of others has room for fewer.
const CROWDED: usize = 24;
const CROWDED_INSIDE: usize = 12;
const COLUMN: usize = 10;

/// An arrow between two sibling states.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Arrow {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Vec<String>,
}

/// Transitions to a state far away, or to a final state that many states go to, written into the state that they leave.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Exit {
    pub(super) label: Vec<String>,
    pub(super) target: usize,
}

/// A chart's transitions, by how they are shown.
#[derive(Debug, Default)]
pub(super) struct Graph {
    /// Arrows, by the state that contains them.
    pub(super) arrows: BTreeMap<usize, Vec<Arrow>>,
    /// Lines of text, by the state that shows them.
    pub(super) notes: BTreeMap<usize, Vec<String>>,
    /// Exits, by the state that they leave.
    pub(super) exits: BTreeMap<usize, Vec<Exit>>,
    /// The column of a state, where its level has columns.
    columns: BTreeMap<usize, usize>,
}

impl Graph {
    pub(super) fn of(outline: &Outline) -> Self {
        let mut graph = Self { columns: columns(outline), ..Self::default() };
        for (at, state) in outline.states.iter().enumerate() {
            for activity in &state.activities {
                graph.note(at, activity);
            }
            if matches!(state.kind, OutlineKind::History { .. }) {
                for target in &state.initial {
                    graph.connect(outline, at, *target, String::new());
                }
            }
        }
        let common = common_finals(outline);
        for transition in &outline.transitions {
            graph.add(outline, transition, &common);
        }
        graph.exits.values_mut().for_each(join);
        graph
    }

    /// The column that a state is drawn in.
    pub(super) fn column(&self, state: usize) -> usize {
        self.columns.get(&state).copied().unwrap_or(0)
    }

    fn add(&mut self, outline: &Outline, transition: &OutlineTransition, common: &BTreeSet<usize>) {
        let label = label(transition, "; ");
        let source = transition.source;
        match transition.targets.as_slice() {
            [] => self.note(source, &label),
            [target] if common.contains(target) => self.exit(source, *target, &label),
            [target] if !transition.internal => self.connect(outline, source, *target, label),
            targets => {
                // A transition to several states, or an internal one, becomes text.
                let names: Vec<String> = targets.iter().map(|t| outline.path(*t)).collect();
                let internal = if transition.internal { " (internal)" } else { "" };
                self.note(source, &format!("{label} → {}{internal}", names.join(" + ")));
            }
        }
    }

    /// Draws a transition as an exit instead of an arrow.
    fn exit(&mut self, source: usize, target: usize, label: &str) {
        let label = wrap(label, LABEL);
        self.exits.entry(source).or_default().push(Exit { label, target });
    }

    fn note(&mut self, state: usize, text: &str) {
        // Lines after the first are indented, so that each note can be told from the next.
        let lines = wrap(text, NOTE).into_iter().enumerate();
        let lines = lines.map(|(n, line)| if n == 0 { line } else { format!("\u{a0}\u{a0}\u{a0}{line}") });
        self.notes.entry(state).or_default().extend(lines);
    }

    fn connect(&mut self, outline: &Outline, source: usize, target: usize, label: String) {
        let [sources, targets]: [Vec<usize>; 2] = [source, target].map(|s| outward(outline, s).collect());
        let level = sources.iter().copied().find(|s| targets.contains(s));
        let below = |list: &[usize]| {
            let at = list.iter().position(|s| Some(*s) == level)?;
            at.checked_sub(1).map(|at| list[at])
        };
        let (Some(level), Some(from), Some(to)) = (level, below(&sources), below(&targets)) else {
            let name = if source == target { "itself".into() } else { outline.path(target) };
            return self.note(source, &format!("{label} → {name}"));
        };
        if matches!(outline.states[level].kind, OutlineKind::Parallel) || from == to {
            return self.note(source, &format!("{label} → {}", outline.path(target)));
        }
        if self.column(from) != self.column(to) {
            return self.exit(source, target, &label);
        }
        let mut text = label;
        if from != source {
            let inner = relative(outline, from, source);
            text = if text.is_empty() { inner } else { format!("{inner}: {text}") };
        }
        if to != target {
            text = format!("{text} › {}", relative(outline, to, target));
        }
        let mut lines = if text.is_empty() { Vec::new() } else { wrap(&text, LABEL) };
        let arrows = self.arrows.entry(level).or_default();
        match arrows.iter_mut().find(|a| a.from == from && a.to == to) {
            Some(arrow) => append(&mut arrow.label, &mut lines),
            None => arrows.push(Arrow { from, to, label: lines }),
        }
    }
}

/// The column of each state whose level has too many states for one drawing.
fn columns(outline: &Outline) -> BTreeMap<usize, usize> {
    let levels = outline.states.iter().enumerate().map(|(at, state)| (at == 0, &state.children));
    let crowded =
        levels.filter(|(whole, states)| states.len() > if *whole { CROWDED } else { CROWDED_INSIDE });
    let columns = crowded.flat_map(|(_, children)| {
        let evenly = children.len().div_ceil(children.len().div_ceil(COLUMN));
        children.iter().enumerate().map(move |(at, child)| (*child, at / evenly))
    });
    columns.collect()
}

/// Final states that several states go to.
fn common_finals(outline: &Outline) -> BTreeSet<usize> {
    let mut sources: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for transition in &outline.transitions {
        if let [target] = transition.targets[..]
            && matches!(outline.states[target].kind, OutlineKind::Final(_))
        {
            sources.entry(target).or_default().insert(transition.source);
        }
    }
    sources.into_iter().filter(|(_, sources)| sources.len() >= COMMON).map(|(target, _)| target).collect()
}

/// Joins the exits to one target where they stand one after the other.
fn join(exits: &mut Vec<Exit>) {
    exits.dedup_by(|next, exit| {
        let same = next.target == exit.target;
        if same {
            append(&mut exit.label, &mut next.label);
        }
        same
    });
}

/// Appends a further label: to the last line where both are short, else in lines of its own.
fn append(label: &mut Vec<String>, more: &mut Vec<String>) {
    if let ([.., last], [first]) = (&mut label[..], &more[..])
        && width(last, Weight::Regular) + width(first, Weight::Regular) < LABEL / 2.0
    {
        last.push_str(&format!(", {first}"));
    } else {
        label.append(more);
    }
}

/// A state and its ancestors, innermost first.
pub(super) fn outward(outline: &Outline, state: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(state), |s| outline.states[*s].parent)
}

/// The path of a state below another.
fn relative(outline: &Outline, outer: usize, inner: usize) -> String {
    let (outer, inner) = (outline.path(outer), outline.path(inner));
    inner.strip_prefix(&outer).map_or(inner.as_str(), |rest| rest.trim_start_matches('.')).to_owned()
}

/// Event, guard and actions of a transition in one line.
pub(super) fn label(transition: &OutlineTransition, between_actions: &str) -> String {
    let mut text = transition.event.clone();
    if let Some(guard) = &transition.guard {
        text.push_str(&format!(" [{guard}]"));
    }
    if !transition.actions.is_empty() {
        text.push_str(&format!(" / {}", transition.actions.join(between_actions)));
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
