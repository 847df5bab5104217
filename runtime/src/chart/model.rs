//! A chart as it was written: every name with its place, nothing resolved yet.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::{Type, Value};

use super::finding::{Source, Span};
use super::yaml::{Named, Node};
use crate::skill::Limits;

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
    pub inputs: Vec<Declaration>,
    /// What it gives.
    pub outputs: Vec<Declaration>,
    /// What it remembers while it runs.
    pub locals: Vec<Declaration>,
    pub(crate) events: Vec<(Named, Option<Type>)>,
    pub(crate) profiles: BTreeMap<String, Vec<(Named, Node)>>,
    pub(crate) root: State,
}

/// An input, an output or a local.
#[derive(Clone, Debug, PartialEq)]
pub struct Declaration {
    /// Its name.
    pub name: String,
    /// Its type, with the unit.
    pub ty: Type,
    /// Its value when none is given.
    pub default: Option<Value>,
    /// Smallest number that is allowed, SI.
    pub minimum: Option<f64>,
    /// Largest number that is allowed, SI.
    pub maximum: Option<f64>,
    /// For people.
    pub description: String,
    pub(crate) span: Span,
}

impl Declaration {
    /// Whether a value is as declared already; false where only [`accept`](Self::accept) can tell.
    pub(crate) fn holds(&self, value: &Value) -> bool {
        let within = |x: f64| {
            !x.is_nan() && self.minimum.is_none_or(|m| x >= m) && self.maximum.is_none_or(|m| x <= m)
        };
        match (&self.ty, value) {
            (Type::Bool, Value::Bool(_)) | (Type::String, Value::String(_)) => true,
            (Type::Int, Value::Int(i)) => within(*i as f64),
            (Type::Float(_), Value::Float(x)) | (Type::Duration, Value::Duration(x)) => within(*x),
            _ => false,
        }
    }

    /// The value as declared: converted to the type and within the bounds; otherwise what is wrong with it.
    ///
    /// # Errors
    /// One sentence for people.
    pub fn accept(&self, value: Value) -> Result<Value, String> {
        let value = self.ty.convert(value).map_err(|e| e.to_string())?;
        let outside = value.as_f64().filter(|x| {
            x.is_nan() || self.minimum.is_some_and(|m| *x < m) || self.maximum.is_some_and(|m| *x > m)
        });
        match outside {
            None => Ok(value),
            Some(x) => {
                let bound = |b: Option<f64>| b.map_or("any".into(), |b| b.to_string());
                let (low, high) = (bound(self.minimum), bound(self.maximum));
                Err(format!("{x} is outside of the allowed range, {low} to {high}"))
            }
        }
    }
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
