//! Records which transitions of a chart have been taken, to list those that no test takes.

use std::collections::BTreeSet;

use crate::program::{Pattern, Program, StateId};
use crate::trace::TraceItem;

/// A transition as in the trace: source, event and target.
type TakenTransition = (String, Option<String>, Option<String>);

/// The transitions that were taken in one or several runs of a program.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    seen: BTreeSet<TakenTransition>,
}

/// A transition of a program, as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Described {
    /// Path of the state that it is written at.
    pub source: String,
    /// Its event, `after` or `always`.
    pub event: String,
    /// Its target; empty when no state is left.
    pub target: String,
    /// Whether it has a condition.
    pub guarded: bool,
}

impl Coverage {
    /// Records a trace item.
    pub(super) fn note(&mut self, item: &TraceItem) {
        if let TraceItem::Transition { source, event, target } = item {
            self.seen.insert((source.clone(), event.clone(), target.clone()));
        }
    }

    /// Adds the transitions of another coverage.
    pub fn extend(&mut self, other: Self) {
        self.seen.extend(other.seen);
    }

    /// The transitions of a chart in the order of the file, and whether each was taken. Transitions of the charts
    /// inside are not included. Transitions that differ only by their condition or actions count as taken together.
    pub fn of(&self, program: &Program) -> Vec<(Described, bool)> {
        let inner =
            |state: &StateId| program.is_root(*state) && program.parent_of(*state) != Some(0) && *state != 0;
        let own = program.transitions.iter().filter(|t| !program.outward(t.source).any(|s| inner(&s)));
        let each = own.map(|transition| {
            let source = program.path(transition.source).to_owned();
            let targets: Vec<&str> = transition.targets.iter().map(|t| program.path(*t)).collect();
            let target = targets.join(" ");
            let (event, timed) = match &transition.pattern {
                Pattern::None if transition.delay.is_some() => ("after".to_owned(), true),
                Pattern::None => ("always".to_owned(), false),
                Pattern::Exact(name) => (name.to_string(), false),
                Pattern::Prefix(name) => (format!("{name}.*"), false),
                Pattern::Any => ("*".to_owned(), false),
            };
            let taken = self.seen.iter().any(|(from, seen, to)| {
                let fits = match (seen, &transition.pattern) {
                    (None, Pattern::None) => !timed,
                    (Some(name), Pattern::None) => timed && name == "after",
                    (Some(name), pattern) => pattern.matches(name),
                    (None, _) => false,
                };
                *from == source && to.as_deref().unwrap_or("") == target && fits
            });
            (Described { source, event, target, guarded: transition.guard.is_some() }, taken)
        });
        each.collect()
    }
}
