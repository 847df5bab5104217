//! A chart as a picture needs it: its states with what is written at them, its transitions between them. Names that
//! stand for nothing are left out; finding them is the check's business.

use armarium_source::Span;
use armarium_source::yaml::{Node, Yaml};
use serde::{Deserialize, Serialize};

use super::model::{self, ActionKind, Chart, WrittenAction, WrittenKind, WrittenState};

/// A chart's states and transitions; state 0 is the chart itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// States in the order of the file, parents before children.
    pub states: Vec<OutlineState>,
    /// Transitions in the order of the file.
    pub transitions: Vec<OutlineTransition>,
}

/// What a state is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum OutlineKind {
    /// Nothing: it waits.
    Waits,
    /// A skill, by name.
    Skill(String),
    /// Another chart, by name.
    Chart(String),
    /// Another agent's chart or skill.
    Remote(String),
    /// Has states inside.
    Composite,
    /// Has regions inside.
    Parallel,
    /// Ends what it is in, with this outcome.
    Final(String),
    /// Stands for what was left last.
    History {
        /// All levels, not only the next.
        deep: bool,
    },
}

/// A state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutlineState {
    /// Its own name.
    pub name: String,
    /// What it is.
    pub kind: OutlineKind,
    /// The state around it.
    pub parent: Option<usize>,
    /// The states inside.
    pub children: Vec<usize>,
    /// What it is entered at, or a history's default.
    pub initial: Vec<usize>,
    /// What it does on its own: `enter / assign locals.n`, `watch pushed`.
    pub activities: Vec<String>,
    /// The names of its watches.
    pub watches: Vec<String>,
    /// For people.
    pub description: String,
    /// Where its name stands in the file.
    pub span: Span,
}

/// A transition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutlineTransition {
    /// Where it is written.
    pub source: usize,
    /// Where it goes; empty when no state is left.
    pub targets: Vec<usize>,
    /// The event, `after 2s`, or nothing for `always`.
    pub event: String,
    /// Its condition, as it is written.
    pub guard: Option<String>,
    /// Its actions, each in a few words.
    pub actions: Vec<String>,
    /// Whether it leaves only what is inside.
    pub internal: bool,
}

impl Outline {
    /// The outline of a chart; charts that it uses stay single states.
    pub fn of(chart: &Chart) -> Self {
        let mut outline = Self { states: Vec::new(), transitions: Vec::new() };
        let mut models = Vec::new();
        outline.add(&chart.root, None, &mut models);
        let observed = chart.observes().map(|(name, pattern)| format!("observe {name}: {pattern}"));
        outline.states[0].activities.splice(0..0, observed);
        for (at, model) in models.iter().enumerate() {
            outline.connect(at, model);
        }
        outline
    }

    /// The names from below the chart down to a state, joined by dots.
    pub fn path(&self, state: usize) -> String {
        let mut parts: Vec<&str> = Vec::new();
        let mut at = state;
        while let Some(parent) = self.states[at].parent {
            parts.push(&self.states[at].name);
            at = parent;
        }
        parts.reverse();
        parts.join(".")
    }

    fn add<'m>(
        &mut self,
        model: &'m WrittenState,
        parent: Option<usize>,
        models: &mut Vec<&'m WrittenState>,
    ) -> usize {
        let at = self.states.len();
        models.push(model);
        self.states.push(OutlineState {
            name: model.name.text.clone(),
            kind: kind(&model.kind),
            parent,
            children: Vec::new(),
            initial: Vec::new(),
            activities: activities(model),
            watches: model.watch.iter().map(|watch| watch.name.text.clone()).collect(),
            description: model.description.clone(),
            span: model.name.span,
        });
        for child in model.kind.children() {
            let child = self.add(child, Some(at), models);
            self.states[at].children.push(child);
        }
        at
    }

    fn connect(&mut self, at: usize, model: &WrittenState) {
        let initial = match &model.kind {
            WrittenKind::Composite { initial, .. } => Some(initial),
            WrittenKind::History { default, .. } => Some(default),
            _ => None,
        };
        let names = initial.map_or(&[][..], |entry| &entry.targets);
        self.states[at].initial = names.iter().filter_map(|name| self.find(at, &name.text)).collect();
        let lists = [&model.transitions, &model.always, &model.after];
        for transition in lists.into_iter().flatten() {
            let targets = transition.targets.iter().filter_map(|name| self.find(at, &name.text)).collect();
            self.transitions.push(OutlineTransition {
                source: at,
                targets,
                event: event(transition),
                guard: transition.guard.as_ref().map(text),
                actions: transition.actions.iter().map(action).collect(),
                internal: transition.internal,
            });
        }
    }

    /// The states inside a state, and inside those.
    pub fn descendants(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        let inside = move |of: &usize| {
            std::iter::successors(self.states[*of].parent, |at| self.states[*at].parent).any(|at| at == state)
        };
        (state + 1..self.states.len()).take_while(inside)
    }

    /// A name or path, looked up from a state outward.
    #[must_use]
    pub fn find(&self, from: usize, path: &str) -> Option<usize> {
        let child = |of: usize, name: &str| {
            self.states[of].children.iter().copied().find(|c| self.states[*c].name == name)
        };
        let mut parts = path.split('.');
        let first = parts.next()?;
        let outward = std::iter::successors(Some(from), |s| self.states[*s].parent);
        let start = outward.into_iter().find_map(|around| child(around, first))?;
        parts.try_fold(start, child)
    }
}

fn kind(kind: &WrittenKind) -> OutlineKind {
    match kind {
        WrittenKind::Atomic => OutlineKind::Waits,
        WrittenKind::Skill(name) => OutlineKind::Skill(name.text.clone()),
        WrittenKind::Chart(name) => OutlineKind::Chart(name.text.clone()),
        WrittenKind::Remote(name) => OutlineKind::Remote(name.text.clone()),
        WrittenKind::Composite { .. } => OutlineKind::Composite,
        WrittenKind::Parallel(_) => OutlineKind::Parallel,
        WrittenKind::Final(outcome) => OutlineKind::Final(outcome.text.clone()),
        WrittenKind::History { deep, .. } => OutlineKind::History { deep: *deep },
    }
}

fn activities(model: &WrittenState) -> Vec<String> {
    let mut list = Vec::new();
    for (when, actions) in [("enter", &model.enter), ("exit", &model.exit)] {
        list.extend(actions.iter().map(|a| format!("{when} / {}", action(a))));
    }
    for watch in &model.watch {
        let hold = if watch.hold_s > 0.0 { format!(" for {} s", watch.hold_s) } else { String::new() };
        list.push(format!("watch {}: {}{hold}", watch.name.text, text(&watch.condition)));
    }
    if let Some(retry) = model.retry {
        list.push(format!("retry {} times", retry.times));
    }
    if model.unbreakable {
        list.push("unbreakable".into());
    }
    list
}

fn event(transition: &model::WrittenTransition) -> String {
    match (&transition.event, &transition.delay) {
        (Some(event), _) => event.text.clone(),
        (None, Some(delay)) => format!("after {}", text(delay)),
        (None, None) => String::new(),
    }
}

fn action(action: &WrittenAction) -> String {
    match &action.kind {
        ActionKind::Assign(entries) => {
            let each = entries.iter().map(|(name, value)| format!("{} = {}", name.text, text(value)));
            each.collect::<Vec<_>>().join(", ")
        }
        ActionKind::Raise { event, .. } => format!("raise {}", event.text),
        ActionKind::Send { event, .. } => format!("send {}", event.text),
        ActionKind::Cancel(id) => format!("cancel {}", id.text),
        ActionKind::Log(_) => "log".into(),
        ActionKind::If { condition, .. } => format!("if {}", text(condition)),
        ActionKind::Foreach { items, .. } => format!("foreach {}", text(items)),
    }
}

/// A value as it is written, without the marks of an expression.
fn text(node: &Node) -> String {
    match &node.value {
        Yaml::String(s) => match s.strip_prefix("${").and_then(|s| s.strip_suffix('}')) {
            Some(inner) => inner.trim().to_owned(),
            None => s.clone(),
        },
        _ => node.literal().to_json().to_string(),
    }
}
