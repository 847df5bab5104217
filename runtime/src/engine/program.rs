//! A chart as tables: every name resolved to a number, every expression compiled. The engine runs this.
//!
//! States are numbered in the order of the file, parents before children, so that the states inside `s` are
//! exactly `s + 1 ..= s.last`. State 0 stands for the run; its only child is the chart.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use armarium_values::expr::Expr;
use armarium_values::{Type, Value};

use crate::chart::{Declaration, Source};
use crate::skill::{Limits, SkillManifest};

/// Number of a state.
pub type StateId = u32;

/// Where something was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) source: u32,
    pub(crate) byte: u32,
}

/// A compiled chart with everything inside it.
pub struct Program {
    pub(crate) name: String,
    pub(crate) sources: Vec<Arc<Source>>,
    pub(crate) states: Vec<State>,
    pub(crate) transitions: Vec<Transition>,
    pub(crate) watches: Vec<Watch>,
    pub(crate) instances: Vec<Instance>,
    pub(crate) channels: Vec<String>,
    pub(crate) slots: u32,
    /// Inputs by profile, as written.
    pub(crate) profiles: BTreeMap<String, BTreeMap<String, Value>>,
}

impl fmt::Debug for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Program({}, {} states)", self.name, self.states.len())
    }
}

/// A use of a chart: its own variables.
#[derive(Debug)]
pub(crate) struct Instance {
    /// The state that the chart is the inside of.
    pub(crate) owner: StateId,
    pub(crate) inputs: Vec<Variable>,
    pub(crate) locals: Vec<Variable>,
    pub(crate) outputs: Vec<Variable>,
    /// All places of data that belong to this use: variables, outputs of its states, loop variables.
    pub(crate) first_slot: u32,
    pub(crate) end_slot: u32,
}

#[derive(Clone, Debug)]
pub(crate) struct Variable {
    pub(crate) declaration: Declaration,
    pub(crate) slot: u32,
}

#[derive(Debug)]
pub(crate) enum Kind {
    Atomic,
    Skill {
        manifest: Arc<SkillManifest>,
    },
    /// Another chart as this state's inside: one child.
    Chart {
        instance: u32,
    },
    Composite {
        initial: StateId,
    },
    Parallel,
    Final {
        outcome: String,
    },
    History {
        deep: bool,
        default: Option<StateId>,
    },
}

pub(crate) struct State {
    /// Its own name.
    pub(crate) name: String,
    /// From the chart down; the outermost chart itself has its own name.
    pub(crate) path: String,
    pub(crate) kind: Kind,
    pub(crate) parent: Option<StateId>,
    /// The last state inside it, itself when there is none.
    pub(crate) last: StateId,
    pub(crate) depth: u16,
    pub(crate) children: Vec<StateId>,
    pub(crate) histories: Vec<StateId>,
    /// Whether it is a region of a parallel state.
    pub(crate) region: bool,
    /// Whether it is the inside of a `statechart:` state, and so shares its path.
    pub(crate) chart_root: bool,
    pub(crate) transitions: Vec<u32>,
    pub(crate) always: Vec<u32>,
    pub(crate) after: Vec<u32>,
    pub(crate) watches: Vec<u32>,
    pub(crate) enter: Vec<Action>,
    pub(crate) exit: Vec<Action>,
    pub(crate) with: Vec<Binding>,
    pub(crate) retry: Option<(u32, f64)>,
    pub(crate) limits: Limits,
    pub(crate) unbreakable: bool,
    /// Places of what it gives with its outcome.
    pub(crate) outputs: Vec<(String, u32)>,
    pub(crate) place: Place,
}

/// Which events a transition takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Pattern {
    /// `always`, or `after`: taken by its own timer.
    None,
    Exact(Arc<str>),
    /// `error.*`: the tokens before the star.
    Prefix(Arc<str>),
    Any,
}

impl Pattern {
    /// Whether an event that all states see is meant.
    pub(crate) fn matches(&self, name: &str) -> bool {
        match self {
            Self::None => false,
            Self::Any => true,
            Self::Exact(n) => **n == *name,
            Self::Prefix(p) => {
                name.strip_prefix(&**p).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            }
        }
    }

    pub(crate) fn is(&self, name: &str) -> bool {
        matches!(self, Self::Exact(n) if **n == *name)
    }
}

#[derive(Debug)]
pub(crate) struct Transition {
    pub(crate) source: StateId,
    pub(crate) pattern: Pattern,
    pub(crate) delay: Option<Term>,
    pub(crate) guard: Option<Code>,
    pub(crate) target: Option<StateId>,
    /// What is left and entered is inside this state; none for a transition without target.
    pub(crate) domain: Option<StateId>,
    pub(crate) actions: Vec<Action>,
    pub(crate) with: Vec<Binding>,
}

#[derive(Debug)]
pub(crate) struct Watch {
    pub(crate) state: StateId,
    pub(crate) name: Arc<str>,
    pub(crate) condition: Code,
    pub(crate) until: Option<Code>,
    pub(crate) hold_s: f64,
}

/// An expression and where it was written.
#[derive(Clone, Debug)]
pub(crate) struct Code {
    pub(crate) expr: Expr,
    pub(crate) place: Place,
}

/// A value to be computed: a literal, an expression, or text, lists and maps with expressions in them.
#[derive(Clone, Debug)]
pub(crate) enum Term {
    Literal(Value),
    Expr(Code),
    Text(Vec<Term>),
    List(Vec<Term>),
    Map(Vec<(String, Term)>),
}

#[derive(Clone, Debug)]
pub(crate) struct Binding {
    pub(crate) name: String,
    pub(crate) ty: Type,
    pub(crate) term: Term,
    pub(crate) place: Place,
}

#[derive(Debug)]
pub(crate) enum Action {
    Assign { slot: u32, declaration: Arc<Declaration>, variable: String, term: Term, place: Place },
    Raise { event: Arc<str>, data: Option<Term> },
    Send(Box<Send>),
    Cancel { id: String },
    Log { term: Term },
    If { condition: Code, then: Vec<Action>, otherwise: Vec<Action> },
    Foreach { items: Term, slot: u32, body: Vec<Action>, place: Place },
}

/// The action `send`.
#[derive(Debug)]
pub(crate) struct Send {
    pub(crate) event: Arc<str>,
    pub(crate) to: Option<Term>,
    pub(crate) data: Option<Term>,
    pub(crate) delay: Option<Term>,
    pub(crate) id: Option<String>,
    pub(crate) place: Place,
}

impl Program {
    /// The chart's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the chart takes.
    pub fn inputs(&self) -> impl Iterator<Item = &Declaration> {
        self.instances[0].inputs.iter().map(|v| &v.declaration)
    }

    /// What the chart gives.
    pub fn outputs(&self) -> impl Iterator<Item = &Declaration> {
        self.instances[0].outputs.iter().map(|v| &v.declaration)
    }

    /// The channels that expressions read; their numbers are their places here.
    #[must_use]
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// The names of the profiles.
    pub fn profiles(&self) -> impl Iterator<Item = &str> {
        self.profiles.keys().map(String::as_str)
    }

    /// The path of a state.
    #[must_use]
    pub fn path(&self, state: StateId) -> &str {
        &self.states[state as usize].path
    }

    /// How many states there are, with those of the charts inside.
    #[must_use]
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// Whether there is no state; a program always has one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    pub(crate) fn state(&self, state: StateId) -> &State {
        &self.states[state as usize]
    }

    /// Whether `inner` is `outer` or inside it.
    pub(crate) fn within(&self, inner: StateId, outer: StateId) -> bool {
        (outer..=self.state(outer).last).contains(&inner)
    }

    pub(crate) fn place(&self, place: Place) -> String {
        self.sources.get(place.source as usize).map_or_else(String::new, |s| s.place(place.byte as usize))
    }

    /// The states around `state`, itself first.
    pub(crate) fn outward(&self, state: StateId) -> impl Iterator<Item = StateId> + '_ {
        std::iter::successors(Some(state), |s| self.state(*s).parent)
    }
}
