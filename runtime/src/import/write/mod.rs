//! Writes the tree as the chart's text: names and paths resolved, transitions grouped by their events.

mod actions;

use std::collections::BTreeSet;

use super::ImportError;
use super::expression::{self, Expr, ScxmlScope};
use super::names::{ScxmlNames, ancestors};
use super::read::{Code, Document, Index, ScxmlEntry, ScxmlKind, ScxmlState, ScxmlTransition, Text};
use super::yaml::{cel_string, comment, literal, quoted, scalar};

/// SCXML's own events, which a chart need not declare.
const KNOWN: [&str; 2] = ["error.execution", "error.communication"];

/// Writes the chart. What cannot be converted is appended to `errors`.
pub(super) fn chart(document: &Document, names: &ScxmlNames, errors: &mut Vec<ImportError>) -> String {
    let mut writer = ChartWriter { document, names, errors, out: String::new() };
    writer.chart();
    writer.out
}

struct ChartWriter<'d> {
    document: &'d Document,
    names: &'d ScxmlNames,
    errors: &'d mut Vec<ImportError>,
    out: String,
}

impl ChartWriter<'_> {
    fn error(&mut self, line: u32, message: impl Into<String>) {
        self.errors.push(ImportError { line, message: message.into() });
    }

    fn line(&mut self, indent: usize, text: &str) {
        self.out.push_str(&"  ".repeat(indent));
        self.out.push_str(text);
        self.out.push('\n');
    }

    fn chart(&mut self) {
        self.line(0, "# Made from SCXML by `armarium import`. A pattern such as `done.*` is SCXML's `done`: it matches");
        self.line(
            0,
            "# by token prefix. States whose names the language does not allow have SCXML's beside them.",
        );
        for (line, name) in &self.document.foreign {
            self.line(0, &format!("# `<{}>` (line {line}) is not SCXML: it is left out.", comment(name)));
        }
        let chart = scalar(&self.names.chart);
        self.line(0, &format!("statechart: {chart}"));
        let events = self.events();
        if !events.is_empty() {
            self.line(0, "events:");
            for event in events {
                self.line(1, &format!("{}: {{}}", scalar(&event)));
            }
        }
        self.twice();
        self.inside(0, 0);
    }

    /// Reports ids that are used for two states.
    fn twice(&mut self) {
        let mut seen = BTreeSet::new();
        let states = self.document.states.iter();
        let named = states.filter_map(|s| s.id.as_ref().map(|id| (s.line, id)));
        for (line, id) in named.collect::<Vec<_>>() {
            if !seen.insert(id) {
                self.error(line, format!("two states have the id `{id}`"));
            }
        }
    }

    /// The events that transitions name. Those from outside have to be declared, but the document does not say
    /// which they are.
    fn events(&self) -> BTreeSet<String> {
        let transitions = self.document.states.iter().flat_map(|s| &s.transitions);
        let named = transitions.flat_map(|t| &t.events).filter(|e| *e != "*");
        let known = |event: &str| {
            let done = event.strip_prefix("done.state.").is_some_and(|id| self.names.find(id).is_some());
            done || KNOWN.contains(&event) || KNOWN.iter().any(|k| k.starts_with(&format!("{event}.")))
        };
        named.filter(|e| !known(e)).map(|e| self.event(e)).collect()
    }

    /// An event's name; in `done.state.ID` the id becomes the state's name.
    fn event(&self, event: &str) -> String {
        let state = event.strip_prefix("done.state.").and_then(|id| self.names.find(id));
        state.map_or_else(|| event.to_owned(), |s| format!("done.state.{}", self.names.name(s)))
    }

    /// Writes everything of a state but its name.
    fn inside(&mut self, at: Index, indent: usize) {
        let state = &self.document.states[at];
        let inner: Vec<Index> = state.children.clone();
        let entered = |i: &&Index| !matches!(self.document.states[**i].kind, ScxmlKind::History { .. });
        let first = inner.iter().find(entered).copied();
        match state.kind {
            ScxmlKind::Final => {
                self.line(indent, "final: success");
                self.data(at, indent);
            }
            ScxmlKind::History { deep } => {
                self.line(indent, if deep { "history: deep" } else { "history: shallow" });
                match &state.initial {
                    Some(entry) => self.entry("default", at, entry, indent),
                    None => self.error(state.line, "a `<history>` needs a `<transition>` to its default"),
                }
            }
            ScxmlKind::State => match (&state.initial, first) {
                (None, None) if inner.is_empty() => {}
                (Some(entry), None) => {
                    self.error(entry.line, "a state without states inside has no initial state")
                }
                (None, None) => self.error(state.line, "a state with a history has no states inside"),
                (Some(entry), Some(_)) => self.entry("initial", at, entry, indent),
                (None, Some(first)) => {
                    let name = scalar(self.names.name(first));
                    self.line(indent, &format!("initial: {name}"));
                }
            },
            ScxmlKind::Parallel => {}
        }
        for (key, blocks) in [("enter", &state.enter), ("exit", &state.exit)] {
            if blocks.iter().any(|actions| !actions.is_empty()) {
                self.line(indent, &format!("{key}:"));
                blocks.iter().for_each(|actions| self.actions(at, actions, indent + 1));
            }
        }
        self.transitions(at, indent);
        if first.is_some() {
            self.line(indent, if state.kind == ScxmlKind::Parallel { "parallel:" } else { "states:" });
            for child in inner {
                self.state(child, indent + 1);
            }
        }
    }

    fn state(&mut self, at: Index, indent: usize) {
        let state: &ScxmlState = &self.document.states[at];
        let name = self.names.name(at);
        let note = match &state.id {
            Some(id) if id != name => format!("  # `{}` in SCXML", comment(id)),
            _ => String::new(),
        };
        let before = self.out.len();
        let head = format!("{}:{note}", scalar(name));
        self.line(indent, &head);
        let after = self.out.len();
        self.inside(at, indent + 1);
        if self.out.len() == after {
            self.out.truncate(before);
            self.line(indent, &format!("{}: {{}}{note}", scalar(name)));
        }
    }

    fn data(&mut self, at: Index, indent: usize) {
        let state: &ScxmlState = &self.document.states[at];
        if !state.data.is_empty() {
            let fields = self.fields(at, &state.data);
            self.line(indent, &format!("with: {fields}"));
        }
    }

    fn fields(&mut self, at: Index, data: &[(String, Code)]) -> String {
        let mut fields = Vec::new();
        for (name, code) in data {
            if let Some(value) = self.expression(at, code) {
                fields.push(format!("{}: {}", scalar(name), value_of(&value)));
            }
        }
        format!("{{{}}}", fields.join(", "))
    }

    fn entry(&mut self, key: &str, at: Index, entry: &ScxmlEntry, indent: usize) {
        let targets = self.targets(at, &entry.targets, entry.line);
        let owner = match self.document.states[at].kind {
            ScxmlKind::History { .. } => self.document.states[at].parent.unwrap_or(0),
            _ => at,
        };
        for id in &entry.targets {
            let inside =
                self.names.find(id).is_some_and(|s| ancestors(self.document, s).skip(1).any(|a| a == owner));
            if self.names.find(id).is_some() && !inside {
                self.error(entry.line, format!("`{id}` is not inside the state that it is the {key} of"));
            }
        }
        if entry.actions.is_empty() {
            self.line(indent, &format!("{key}: {targets}"));
        } else {
            self.line(indent, &format!("{key}:"));
            self.line(indent + 1, &format!("target: {targets}"));
            self.line(indent + 1, "do:");
            self.actions(at, &entry.actions, indent + 2);
        }
    }

    /// One target as a name or path, several as a list.
    fn targets(&mut self, from: Index, ids: &[String], line: u32) -> String {
        let mut paths = Vec::new();
        for id in ids {
            match self.names.find(id) {
                Some(state) => paths.push(scalar(&self.names.path(self.document, from, state))),
                None => self.error(line, format!("there is no state with the id `{id}`")),
            }
        }
        match paths.as_slice() {
            [one] => one.clone(),
            several => format!("[{}]", several.join(", ")),
        }
    }

    // Transitions.

    fn transitions(&mut self, at: Index, indent: usize) {
        let state: &ScxmlState = &self.document.states[at];
        let always: Vec<&ScxmlTransition> =
            state.transitions.iter().filter(|t| t.events.is_empty()).collect();
        if !always.is_empty() {
            self.line(indent, "always:");
            for transition in always {
                self.transition(at, transition, None, indent + 1);
            }
        }
        let groups = groups(&state.transitions);
        if groups.is_empty() {
            return;
        }
        self.line(indent, "transitions:");
        for Group { pattern, transitions } in groups {
            let exact = pattern.starts_with("done.state.");
            let key = match pattern.as_str() {
                "*" => quoted("*"),
                other if exact => scalar(&self.event(other)),
                other => scalar(&format!("{other}.*")),
            };
            if let [(only, None)] = transitions.as_slice()
                && only.condition.is_none()
                && only.actions.is_empty()
                && only.targets.len() == 1
            {
                let target = self.targets(at, &only.targets, only.line);
                if !self.internal(at, only) {
                    self.line(indent + 1, &format!("{key}: {target}"));
                    continue;
                }
            }
            self.line(indent + 1, &format!("{key}:"));
            for (transition, event) in transitions {
                self.transition(at, transition, event.as_deref(), indent + 2);
            }
        }
    }

    /// Whether a transition is internal: SCXML requires a composite source and all targets inside it.
    fn internal(&self, at: Index, transition: &ScxmlTransition) -> bool {
        let inside = |id: &String| {
            self.names.find(id).is_some_and(|s| ancestors(self.document, s).skip(1).any(|a| a == at))
        };
        transition.internal
            && self.document.states[at].kind == ScxmlKind::State
            && !transition.targets.is_empty()
            && transition.targets.iter().all(inside)
    }

    /// One item of a list of transitions. `event` adds a guard on the event's name.
    fn transition(&mut self, at: Index, transition: &ScxmlTransition, event: Option<&str>, indent: usize) {
        let mut parts = Vec::new();
        if !transition.targets.is_empty() {
            parts.push(format!("target: {}", self.targets(at, &transition.targets, transition.line)));
        }
        if self.internal(at, transition) {
            parts.push("internal: true".into());
        }
        let mut guards: Vec<String> = event.map(named).into_iter().collect();
        if let Some(code) = &transition.condition
            && let Some(condition) = self.expression(at, code)
            && condition.truth() != Some(true)
        {
            let condition = condition.truth().map_or_else(|| condition.cel(), |truth| truth.to_string());
            guards.push(if guards.is_empty() { condition } else { format!("({condition})") });
        }
        if !guards.is_empty() {
            parts.push(format!("if: {}", quoted(&guards.join(" && "))));
        }
        if transition.actions.is_empty() {
            self.line(indent, &format!("- {{{}}}", parts.join(", ")));
            return;
        }
        parts.push("do:".into());
        for (number, part) in parts.iter().enumerate() {
            let lead = if number == 0 { "- " } else { "  " };
            self.line(indent, &format!("{lead}{part}"));
        }
        self.actions(at, &transition.actions, indent + 2);
    }

    // Expressions.

    fn expression(&mut self, at: Index, code: &Code) -> Option<Expr> {
        let (document, names) = (self.document, self.names);
        let path = |id: &str| names.find(id).map(|state| names.path(document, at, state));
        let scope = ScxmlScope { chart: &names.chart, path: &path };
        match expression::parse(&code.text, &scope) {
            Ok(expr) => Some(expr),
            Err(error) => {
                self.error(code.line, error.to_string());
                None
            }
        }
    }

    fn text(&mut self, at: Index, text: &Text) -> Option<String> {
        match text {
            Text::Plain(text) => Some(text.clone()),
            Text::Expr(code) => {
                let words = self.expression(at, code)?.words();
                if words.is_none() {
                    let message = format!("`{}` has to be a literal to be carried over", code.text.trim());
                    self.error(code.line, message);
                }
                words
            }
        }
    }
}

/// The transitions of one pattern, in the document's order, each with the event name that its guard requires, if
/// any.
struct Group<'t> {
    pattern: String,
    transitions: Vec<(&'t ScxmlTransition, Option<String>)>,
}

/// Groups transitions by pattern. A chart tries patterns in the order of the file, so a pattern that appears again
/// after an overlapping one would be tried too early. In that case all transitions are written under `*`, with
/// guards on the event's name.
fn groups(transitions: &[ScxmlTransition]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for transition in transitions {
        for event in &transition.events {
            let Some(known) = groups.iter().position(|g| g.pattern == *event) else {
                groups.push(Group { pattern: event.clone(), transitions: vec![(transition, None)] });
                continue;
            };
            if groups[known + 1..].iter().any(|g| overlap(&g.pattern, event)) {
                return vec![under_star(transitions)];
            }
            groups[known].transitions.push((transition, None));
        }
    }
    groups
}

fn under_star(transitions: &[ScxmlTransition]) -> Group<'_> {
    let each = transitions.iter().flat_map(|t| t.events.iter().map(move |e| (t, e)));
    let transitions = each.map(|(t, e)| (t, (e != "*").then(|| e.clone()))).collect();
    Group { pattern: "*".into(), transitions }
}

fn overlap(a: &str, b: &str) -> bool {
    let inside =
        |a: &str, b: &str| a.strip_prefix(b).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    a == "*" || b == "*" || inside(a, b) || inside(b, a)
}

/// A guard that is true for this event name and for names that begin with its tokens.
fn named(event: &str) -> String {
    let (exact, prefix) = (cel_string(event), cel_string(&format!("{event}.")));
    format!("(event.name == {exact} || event.name.startsWith({prefix}))")
}

/// A literal or an expression as the value of a field.
fn value_of(value: &Expr) -> String {
    match value {
        Expr::Text(text) => literal(text),
        Expr::Null | Expr::Bool(_) | Expr::Number(_) => value.cel(),
        other => quoted(&format!("${{{}}}", other.cel())),
    }
}
