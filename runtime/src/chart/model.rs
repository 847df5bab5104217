//! A chart as it was written: every name with its place, nothing resolved yet.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::{Named, Node};
use armarium_source::{Source, Span};
use armarium_values::Type;

use crate::skill::{Limits, Parameter};

/// One chart file.
#[derive(Debug)]
pub struct Chart {
    /// Its text.
    pub source: Arc<Source>,
    /// The name that others use.
    pub name: String,
    /// For people.
    pub description: String,
    /// What it takes.
    pub inputs: Vec<Parameter>,
    /// What it gives.
    pub outputs: Vec<Parameter>,
    /// What it remembers while it runs.
    pub locals: Vec<Parameter>,
    pub(crate) events: Vec<(Named, Option<Type>)>,
    pub(crate) profiles: BTreeMap<String, Vec<(Named, Node)>>,
    pub(crate) root: State,
}

#[derive(Debug)]
pub(crate) struct State {
    pub(crate) name: Named,
    pub(crate) kind: Kind,
    pub(crate) with: Vec<(Named, Node)>,
    pub(crate) enter: Vec<Action>,
    pub(crate) exit: Vec<Action>,
    pub(crate) watch: Vec<Watch>,
    pub(crate) after: Vec<Transition>,
    pub(crate) always: Vec<Transition>,
    pub(crate) transitions: Vec<Transition>,
    pub(crate) retry: Option<Retry>,
    pub(crate) limits: Limits,
    pub(crate) unbreakable: bool,
}

#[derive(Debug)]
pub(crate) enum Kind {
    Atomic,
    Skill(Named),
    Chart(Named),
    Remote(Named),
    Composite { initial: Entry, states: Vec<State> },
    Parallel(Vec<State>),
    Final(Named),
    History { deep: bool, default: Entry },
}

/// `initial` and a history's `default`: what is entered, and what is done then.
#[derive(Debug, Default)]
pub(crate) struct Entry {
    pub(crate) targets: Vec<Named>,
    pub(crate) actions: Vec<Action>,
}

impl Kind {
    pub(crate) fn children(&self) -> &[State] {
        match self {
            Self::Composite { states, .. } | Self::Parallel(states) => states,
            _ => &[],
        }
    }
}

#[derive(Debug)]
pub(crate) struct Transition {
    pub(crate) span: Span,
    /// The event that takes it; none for `always` and `after`.
    pub(crate) event: Option<Named>,
    pub(crate) delay: Option<Node>,
    pub(crate) targets: Vec<Named>,
    pub(crate) internal: bool,
    pub(crate) guard: Option<Node>,
    pub(crate) actions: Vec<Action>,
    pub(crate) with: Vec<(Named, Node)>,
}

#[derive(Debug)]
pub(crate) struct Watch {
    pub(crate) name: Named,
    pub(crate) condition: Node,
    pub(crate) hold_s: f64,
    pub(crate) until: Option<Node>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Retry {
    pub(crate) times: u32,
    pub(crate) wait_s: f64,
}

#[derive(Debug)]
pub(crate) struct Action {
    pub(crate) span: Span,
    pub(crate) kind: ActionKind,
}

#[derive(Debug)]
pub(crate) enum ActionKind {
    Assign(Vec<(Named, Node)>),
    Raise { event: Named, data: Option<Node> },
    Send { event: Named, to: Option<Node>, data: Option<Node>, delay: Option<Node>, id: Option<Named> },
    Cancel(Named),
    Log(Node),
    If { condition: Node, then: Vec<Action>, otherwise: Vec<Action> },
    Foreach { items: Node, variable: Named, body: Vec<Action> },
}
