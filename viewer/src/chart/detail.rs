//! How much of a chart is shown: charts that it uses are unfolded, and deep levels are folded.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_runtime::chart::{Chart, Outline, OutlineKind, OutlineState, OutlineTransition};

use super::graph::outward;

/// Most levels of charts in charts that are unfolded.
const MAX_NESTED: usize = 16;

/// Which of the charts that a chart uses are shown in their place.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Unfold {
    /// All that are there, and those that they use.
    All,
    /// Those of these names, and those in states of these names or paths.
    Named(BTreeSet<String>),
}

/// Puts the content of the charts that a chart uses into the states that use them. Returns names in `which` that stand
/// for no chart among `charts`.
pub fn unfold(
    outline: &mut Outline,
    charts: &BTreeMap<String, Arc<Chart>>,
    which: &Unfold,
) -> BTreeSet<String> {
    let mut unknown = match which {
        Unfold::All => BTreeSet::new(),
        Unfold::Named(names) => names.clone(),
    };
    // For each state, how many unfolded charts it is in.
    let mut levels = vec![0; outline.states.len()];
    let mut at = 0;
    while let Some(state) = outline.states.get(at) {
        if let OutlineKind::Chart(name) = &state.kind
            && let Some(chart) = charts.get(name)
        {
            let handles = [name.clone(), state.name.clone(), outline.path(at)];
            let wanted = match which {
                Unfold::All => true,
                Unfold::Named(names) => handles.iter().any(|handle| names.contains(handle)),
            };
            handles.iter().for_each(|handle| _ = unknown.remove(handle));
            // A chart that contains itself ends somewhere.
            if wanted && levels[at] < MAX_NESTED {
                graft(outline, at, Outline::of(chart));
                levels.resize(outline.states.len(), levels[at] + 1);
            }
        }
        at += 1;
    }
    unknown
}

/// Puts a chart into a state: the chart's own level becomes the state's.
fn graft(outline: &mut Outline, at: usize, inner: Outline) {
    let base = outline.states.len();
    let moved = |state: usize| if state == 0 { at } else { base + state - 1 };
    let all = |states: Vec<usize>| states.into_iter().map(moved).collect::<Vec<_>>();
    for (number, state) in inner.states.into_iter().enumerate() {
        let (children, initial) = (all(state.children), all(state.initial));
        if number == 0 {
            let into = &mut outline.states[at];
            into.activities.insert(0, format!("chart {}", state.name));
            into.activities.extend(state.activities);
            (into.kind, into.children, into.initial) = (state.kind, children, initial);
        } else {
            let parent = state.parent.map(moved);
            outline.states.push(OutlineState { parent, children, initial, ..state });
        }
    }
    outline.transitions.extend(inner.transitions.into_iter().map(|transition| OutlineTransition {
        source: moved(transition.source),
        targets: all(transition.targets),
        ..transition
    }));
}

/// How many levels of states a chart has.
#[must_use]
pub fn levels(outline: &Outline) -> usize {
    (0..outline.states.len()).map(|state| outward(outline, state).count() - 1).max().unwrap_or(0)
}

/// The chart with `depth` levels of states; as [`close`].
pub fn fold(outline: &Outline, depth: usize) -> Outline {
    close(outline, &|state| outward(outline, state).count() - 1 == depth)
}

/// The chart without the content of some states, which say how many states they have.
/// Transitions of states that are not shown start or end at the state around them that is.
pub fn close(outline: &Outline, is_closed: &dyn Fn(usize) -> bool) -> Outline {
    let shown: Vec<usize> =
        (0..outline.states.len()).filter(|s| !outward(outline, *s).skip(1).any(is_closed)).collect();
    let place = |state: usize| outward(outline, state).find_map(|s| shown.binary_search(&s).ok());
    let places = |states: &[usize]| {
        let mut list: Vec<usize> = Vec::new();
        for at in states.iter().filter_map(|s| place(*s)) {
            if !list.contains(&at) {
                list.push(at);
            }
        }
        list
    };
    let mut counts = vec![0; shown.len()];
    (0..outline.states.len()).filter_map(place).for_each(|at| counts[at] += 1);
    let states = shown.iter().zip(&counts).map(|(s, count)| {
        let mut state = outline.states[*s].clone();
        if is_closed(*s) && !state.children.is_empty() {
            state.activities.insert(0, format!("{} states inside", count - 1));
            (state.children, state.initial) = (Vec::new(), Vec::new());
        }
        state.parent = state.parent.and_then(place);
        state.children = places(&state.children);
        state.initial = places(&state.initial);
        state
    });
    let transitions = outline.transitions.iter().filter_map(|transition| {
        let source = place(transition.source)?;
        let targets = places(&transition.targets);
        let mut event = transition.event.clone();
        if shown[source] != transition.source {
            // What happens inside is not shown.
            if targets.iter().all(|target| *target == source) {
                return None;
            }
            let (outer, inner) = (outline.path(shown[source]), outline.path(transition.source));
            event =
                format!("{}: {event}", inner.strip_prefix(&outer).unwrap_or(&inner).trim_start_matches('.'));
        }
        Some(OutlineTransition { source, targets, event, ..transition.clone() })
    });
    let (states, transitions) = (states.collect(), transitions.collect());
    Outline { states, transitions }
}
