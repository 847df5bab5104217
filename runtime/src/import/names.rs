//! Maps SCXML's ids to unique names that the language allows.

use std::collections::{BTreeMap, BTreeSet};

use super::read::{Document, Index, ScxmlKind};
use crate::chart::is_name;

/// The names of a document's states.
pub(super) struct ScxmlNames {
    pub(super) chart: String,
    names: Vec<String>,
    by_id: BTreeMap<String, Index>,
}

impl ScxmlNames {
    /// Names for all states; `fallback` for the chart where the document has no name.
    pub(super) fn of(document: &Document, fallback: &str) -> Self {
        let mut taken: BTreeSet<String> = BTreeSet::new();
        // Allowed ids keep their names. Only then do the other ids get names, different from those.
        let ids = document.states.iter().filter_map(|s| s.id.as_ref());
        taken.extend(ids.filter(|id| is_name(id)).cloned());
        let mut by_id = BTreeMap::new();
        let mut names = vec![String::new()];
        for (index, state) in document.states.iter().enumerate().skip(1) {
            let name = match &state.id {
                Some(id) if is_name(id) => id.clone(),
                Some(id) => unused(&allowed(id), &mut taken),
                None => unused(&format!("{}_{index}", word(state.kind)), &mut taken),
            };
            if let Some(id) = &state.id {
                by_id.entry(id.clone()).or_insert(index);
            }
            names.push(name);
        }
        let chart = document.name.as_deref().filter(|n| !n.is_empty()).unwrap_or(fallback);
        let chart = if is_name(chart) { chart.to_owned() } else { allowed(chart) };
        let chart = unused(&chart, &mut taken);
        names[0].clone_from(&chart);
        Self { chart, names, by_id }
    }

    pub(super) fn name(&self, state: Index) -> &str {
        &self.names[state]
    }

    pub(super) fn find(&self, id: &str) -> Option<Index> {
        self.by_id.get(id).copied()
    }

    /// The shortest path from `from` to `state`.
    pub(super) fn path(&self, document: &Document, from: Index, state: Index) -> String {
        let around: BTreeSet<Index> = ancestors(document, from).collect();
        let mut parts = Vec::new();
        for part in ancestors(document, state) {
            parts.push(self.name(part));
            if document.states[part].parent.is_none_or(|p| around.contains(&p)) {
                break;
            }
        }
        parts.reverse();
        parts.join(".")
    }

    /// SCXML's ids by the names that replace them, where the two differ.
    pub(super) fn renamed(&self, document: &Document) -> BTreeMap<String, String> {
        let named = document.states.iter().zip(&self.names);
        let differ =
            named.filter_map(|(s, n)| s.id.as_ref().filter(|id| *id != n).map(|id| (n.clone(), id.clone())));
        differ.collect()
    }
}

/// A state and the states around it.
pub(super) fn ancestors(document: &Document, state: Index) -> impl Iterator<Item = Index> + '_ {
    std::iter::successors(Some(state), |s| document.states[*s].parent)
}

fn word(kind: ScxmlKind) -> &'static str {
    match kind {
        ScxmlKind::State => "state",
        ScxmlKind::Parallel => "parallel",
        ScxmlKind::Final => "final",
        ScxmlKind::History { .. } => "history",
    }
}

/// A name made from an id: characters that are not allowed become `_`.
fn allowed(id: &str) -> String {
    let mut name: String = id.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
    if !name.starts_with(|c: char| c.is_alphabetic() || c == '_') {
        name.insert(0, '_');
    }
    if !is_name(&name) {
        name.push('_');
    }
    name
}

fn unused(name: &str, taken: &mut BTreeSet<String>) -> String {
    let numbered = (2..).map(|n| format!("{name}_{n}"));
    let free = std::iter::once(name.to_owned()).chain(numbered).find(|n| !taken.contains(n));
    let free = free.unwrap_or_default();
    taken.insert(free.clone());
    free
}
