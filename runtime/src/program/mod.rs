//! A chart as tables: every name is resolved to a number, every expression is compiled. `chart` builds a program
//! and `engine` runs it. This module reads no files and runs nothing.
//!
//! States are numbered in the order of the file, parents before children, so that the states inside `s` are exactly
//! `s + 1 ..= s.last`. State 0 stands for the run; its only child is the chart. Names of events are numbers as
//! well. The data that selecting transitions needs are stored side by side in `Tables`.

pub(crate) mod limbs;
mod tables;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_source::{Source, suggest};
use armarium_values::expr::{EvalContext, EvalError, Expr};
use armarium_values::{ConvertError, Type, Value};

use crate::observed::{MemoryPattern, ObservedPattern};
use crate::skill::{Limits, Parameter, SkillManifest};

pub(crate) use tables::{
    AFTER, ERROR_CHANNEL, ERROR_EXECUTION, ERROR_QUEUE, EventNames, EventNumber, FAILURE, RETRY, SUCCESS,
    Tables, UNKNOWN,
};

/// Number of a state.
pub type StateId = u32;

/// Number of an event's name in one program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct EventId(pub(crate) EventNumber);

/// Where something was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SourcePlace {
    pub(crate) source: u32,
    pub(crate) byte: u32,
}

/// A compiled chart with everything inside it.
#[derive(Default)]
pub struct Program {
    pub(crate) name: String,
    pub(crate) sources: Vec<Arc<Source>>,
    pub(crate) states: Vec<State>,
    pub(crate) transitions: Vec<Transition>,
    pub(crate) watches: Vec<Watch>,
    pub(crate) instances: Vec<Instance>,
    pub(crate) channels: Vec<String>,
    pub(crate) slots: u32,
    pub(crate) event_names: EventNames,
    pub(crate) tables: Tables,
    /// Input values by profile, as written.
    pub(crate) profiles: BTreeMap<String, BTreeMap<String, Value>>,
    /// The data types of the events that declare one.
    pub(crate) event_types: BTreeMap<String, Type>,
    /// What its charts observe of memory.
    pub(crate) observed: Vec<ObservedPattern>,
    /// The channels that hold it.
    pub(crate) observed_channels: BTreeSet<u32>,
    /// The channels by the names under which people say what is on them.
    pub(crate) named_channels: BTreeMap<String, NamedChannel>,
    /// The events from outside that charts declare.
    pub(crate) declared_events: BTreeSet<String>,
}

impl fmt::Debug for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Program({}, {} states)", self.name, self.states.len())
    }
}

/// A channel under the name that people use.
#[derive(Clone, Debug)]
pub(crate) struct NamedChannel {
    pub(crate) ty: Type,
    pub(crate) source: ChannelSource,
}

/// Who publishes a channel.
#[derive(Clone, Debug)]
pub(crate) enum ChannelSource {
    /// Observers and skills, under this name.
    Published(String),
    /// Whoever knows memory: the best match of the pattern, or all.
    Memory { pattern: MemoryPattern, all: bool },
}

/// One use of a chart, with its own variables.
#[derive(Clone, Debug)]
pub(crate) struct Instance {
    /// The state that contains the chart.
    pub(crate) owner: StateId,
    pub(crate) inputs: Vec<ChartVariable>,
    pub(crate) locals: Vec<ChartVariable>,
    pub(crate) outputs: Vec<ChartVariable>,
    /// The slots of this use and of those inside it: variables, and outputs of states.
    pub(crate) first_slot: u32,
    pub(crate) end_slot: u32,
}

#[derive(Clone, Debug)]
pub(crate) struct ChartVariable {
    pub(crate) declaration: Parameter,
    pub(crate) slot: u32,
}

/// What a state is. A chart is its state's only child.
#[derive(Debug)]
pub(crate) enum Kind {
    Atomic,
    Skill { manifest: Arc<SkillManifest> },
    Chart { instance: u32 },
    Composite { initial: Entry },
    Parallel,
    Final { outcome: EventNumber },
    History { deep: bool, default: Entry },
}

/// The states that are entered by default, and the actions that run then.
#[derive(Debug, Default)]
pub(crate) struct Entry {
    pub(crate) targets: Vec<StateId>,
    pub(crate) actions: Vec<Action>,
}

pub(crate) struct State {
    pub(crate) name: String,
    /// Path from the chart down; the outermost chart's path is its own name.
    pub(crate) path: String,
    pub(crate) kind: Kind,
    pub(crate) parent: Option<StateId>,
    /// The last state inside it, or itself if there is none.
    pub(crate) last: StateId,
    pub(crate) depth: u16,
    pub(crate) children: Vec<StateId>,
    pub(crate) histories: Vec<StateId>,
    /// Whether it is a region of a parallel state.
    pub(crate) region: bool,
    /// Whether it is the root of the chart inside a `statechart:` state, whose path it shares.
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
    /// Slots of its outputs.
    pub(crate) outputs: Vec<(String, u32)>,
    /// The event `done.state.NAME`.
    pub(crate) done: EventNumber,
    pub(crate) place: SourcePlace,
}

/// The events that a transition takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Pattern {
    /// No event: `always`, or `after`, which its own timer takes.
    None,
    Exact(Arc<str>),
    /// `error.*`: the tokens before the star.
    Prefix(Arc<str>),
    Any,
}

impl Pattern {
    /// Whether it matches an event that all states see.
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
}

#[derive(Debug)]
pub(crate) struct Transition {
    pub(crate) source: StateId,
    pub(crate) pattern: Pattern,
    pub(crate) delay: Option<Term>,
    pub(crate) guard: Option<Code>,
    /// Empty: the actions run and no state is left.
    pub(crate) targets: Vec<StateId>,
    /// Whether the source stays active when all targets are inside it (SCXML's `type="internal"`).
    pub(crate) internal: bool,
    /// The state inside which states are left and entered; `None` for a transition without target.
    pub(crate) domain: Option<StateId>,
    /// Whether a target is a history, so that the domain depends on the states that it remembers.
    pub(crate) historic: bool,
    pub(crate) actions: Vec<Action>,
    pub(crate) with: Vec<Binding>,
}

#[derive(Debug)]
pub(crate) struct Watch {
    pub(crate) state: StateId,
    pub(crate) name: EventNumber,
    pub(crate) condition: Code,
    pub(crate) until: Option<Code>,
    pub(crate) hold_s: f64,
}

/// An expression and where it was written.
#[derive(Clone, Debug)]
pub(crate) struct Code {
    pub(crate) expr: Expr,
    pub(crate) place: SourcePlace,
}

/// A value to compute: a literal, an expression, or a text, list or map that contains expressions.
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
    /// The parameter that the value is for.
    pub(crate) parameter: Parameter,
    pub(crate) term: Term,
    pub(crate) place: SourcePlace,
}

#[derive(Debug)]
pub(crate) enum Action {
    Assign { slot: u32, declaration: Arc<Parameter>, variable: String, term: Term, place: SourcePlace },
    Raise { event: EventNumber, data: Option<Term>, place: SourcePlace },
    Send(Box<SendAction>),
    Cancel { id: String },
    Log { term: Term },
    If { condition: Code, then: Vec<Action>, otherwise: Vec<Action> },
    Foreach { items: Term, slot: u32, body: Vec<Action>, place: SourcePlace },
}

/// The action `send`.
#[derive(Debug)]
pub(crate) struct SendAction {
    pub(crate) event: EventNumber,
    pub(crate) to: Option<Term>,
    pub(crate) data: Option<Term>,
    pub(crate) delay: Option<Term>,
    pub(crate) id: Option<String>,
    pub(crate) place: SourcePlace,
}

/// How many events a message names.
const MAX_EVENTS_NAMED: usize = 6;

/// Why a chart does not take an event.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum EventRefused {
    /// It neither declares nor takes an event of that name; `help` names a similar one, or those that it takes.
    #[error("the chart `{chart}` takes no event `{event}`: {help}")]
    Unknown { chart: String, event: String, help: String },
    /// The data are of another type than the chart declares.
    #[error("the data of `{event}`: {source}")]
    Data { event: String, source: ConvertError },
}

impl Program {
    /// The same program with its transitions' domains and its tables. To be called once all states exist.
    pub(crate) fn linked(mut self) -> Self {
        self.tables = Tables::new(&mut self.event_names, &self.states, &self.transitions);
        for at in 0..self.transitions.len() {
            let t = &self.transitions[at];
            let domain = (!t.targets.is_empty()).then(|| self.domain(t.source, t.internal, &t.targets));
            self.transitions[at].domain = domain;
        }
        self.tables.set_jumps(&self.transitions);
        self
    }

    /// The chart's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The file of the chart.
    pub(crate) fn file(&self) -> &Path {
        self.sources.first().map_or(Path::new(""), |source| &source.path)
    }

    /// The chart's inputs.
    pub fn inputs(&self) -> impl Iterator<Item = &Parameter> {
        self.instances[0].inputs.iter().map(|v| &v.declaration)
    }

    /// The chart's outputs.
    pub fn outputs(&self) -> impl Iterator<Item = &Parameter> {
        self.instances[0].outputs.iter().map(|v| &v.declaration)
    }

    /// What a state waits for, for people: the events that it and the states around it take.
    pub(crate) fn waits_for(&self, state: StateId) -> String {
        let mut events: Vec<&str> = Vec::new();
        for around in self.outward(state) {
            let of = self.state(around);
            let watches = of.watches.iter().map(|w| self.event_names.name(self.watches[*w as usize].name));
            let taken = of.transitions.iter().filter_map(|t| match &self.transitions[*t as usize].pattern {
                Pattern::Exact(name) => Some(&**name),
                _ => None,
            });
            for event in taken.chain(watches) {
                if !events.contains(&event) {
                    events.push(event);
                }
            }
        }
        let name = self.name_of(state);
        match events.split_at_checked(MAX_EVENTS_NAMED) {
            _ if events.is_empty() => format!("nothing leads out of `{name}`"),
            Some((first, rest)) if !rest.is_empty() => {
                format!("`{name}` waits for {} or {} others", first.join(", "), rest.len())
            }
            _ => format!("`{name}` waits for {}", events.join(", ")),
        }
    }

    /// Whether charts take an event from outside, with these data.
    ///
    /// # Errors
    /// [`EventRefused`] when no chart declares or takes it, or its data are of another type.
    pub fn accepts(&self, event: &str, data: &Value) -> Result<(), EventRefused> {
        let taken = || self.transitions.iter().any(|t| t.pattern.matches(event));
        if !self.declared_events.contains(event) && !taken() {
            let declared = self.declared_events.iter().map(String::as_str);
            let help = suggest(event, declared.clone())
                .unwrap_or_else(|| format!("its events are {}", declared.collect::<Vec<_>>().join(", ")));
            let help = if self.declared_events.is_empty() { "it declares no events".into() } else { help };
            return Err(EventRefused::Unknown { chart: self.name.clone(), event: event.to_owned(), help });
        }
        let Some(ty) = self.event_types.get(event) else { return Ok(()) };
        ty.convert(data.clone())
            .map(drop)
            .map_err(|source| EventRefused::Data { event: event.to_owned(), source })
    }

    /// The events from outside that charts declare, with the type of what comes with them.
    pub fn events(&self) -> impl Iterator<Item = (&str, Option<&Type>)> {
        self.declared_events.iter().map(|event| (event.as_str(), self.event_types.get(event)))
    }

    /// The outcomes that the chart can end with beyond `success` and `failure`, in their order.
    pub fn outcomes(&self) -> Vec<String> {
        let mut outcomes = BTreeSet::new();
        self.outcomes_of(1, &mut outcomes);
        outcomes.remove("success");
        outcomes.remove("failure");
        outcomes.into_iter().collect()
    }

    /// Collects the outcomes that the inside of a state can give it.
    fn outcomes_of(&self, state: StateId, outcomes: &mut BTreeSet<String>) {
        let of = self.state(state);
        match &of.kind {
            Kind::Skill { manifest } => outcomes.extend(manifest.outcomes.iter().cloned()),
            Kind::Chart { .. } | Kind::Parallel => {
                of.children.iter().for_each(|child| self.outcomes_of(*child, outcomes));
            }
            Kind::Composite { .. } => {
                for child in &of.children {
                    if let Kind::Final { outcome } = self.state(*child).kind {
                        outcomes.insert(self.event_names.name(outcome).to_owned());
                    }
                }
            }
            _ => {}
        }
    }

    /// The longest grace of the chart's skills: how long they may take to return after a cancel.
    pub fn grace(&self) -> Duration {
        let grace = |state: &State| match &state.kind {
            Kind::Skill { manifest } => Some(manifest.grace),
            _ => None,
        };
        self.states.iter().filter_map(grace).max().unwrap_or_default()
    }

    /// The channels that expressions read; a channel's number is its index here.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// What its charts observe of memory, and read.
    pub fn observed(&self) -> &[ObservedPattern] {
        &self.observed
    }

    /// Tests a condition of a guard or an action. It is false where it reads what memory knows nothing of.
    pub(crate) fn test(&self, code: &Code, context: &impl EvalContext) -> Result<bool, EvalError> {
        let observed = |channel: &u32| self.observed_channels.contains(channel);
        match code.expr.test(context) {
            Err(error) if error.absent && code.expr.reads().channels.iter().any(observed) => Ok(false),
            tested => tested,
        }
    }

    /// The names of the profiles.
    pub fn profiles(&self) -> impl Iterator<Item = &str> {
        self.profiles.keys().map(String::as_str)
    }

    /// The path of a state.
    pub fn path(&self, state: StateId) -> &str {
        &self.states[state as usize].path
    }

    /// A state's own name.
    pub fn name_of(&self, state: StateId) -> &str {
        &self.states[state as usize].name
    }

    /// The state around a state; none for state 0, which stands for the run.
    pub fn parent_of(&self, state: StateId) -> Option<StateId> {
        self.states.get(state as usize)?.parent
    }

    /// Whether a state is a root: the run, or the root of a chart, which shares the path of the state around it.
    pub fn is_root(&self, state: StateId) -> bool {
        state == 0 || self.states[state as usize].chart_root
    }

    /// The number of an event that the chart knows, for `Engine::raise`.
    pub fn event(&self, name: &str) -> Option<EventId> {
        self.event_names.find(name).map(EventId)
    }

    /// The number of states, with those of the charts inside.
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// False for every compiled program: it has at least one state.
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    pub(crate) fn state(&self, state: StateId) -> &State {
        &self.states[state as usize]
    }

    /// All states but the run itself.
    pub(crate) fn ids(&self) -> std::ops::Range<StateId> {
        1..StateId::try_from(self.states.len()).unwrap_or(StateId::MAX)
    }

    /// Whether `inner` is `outer` or inside it.
    pub(crate) fn within(&self, inner: StateId, outer: StateId) -> bool {
        (outer..=self.tables.last(outer)).contains(&inner)
    }

    pub(crate) fn place(&self, place: SourcePlace) -> String {
        self.sources.get(place.source as usize).map_or_else(String::new, |s| s.place(place.byte as usize))
    }

    /// `state` and the states around it, from the inside out.
    pub(crate) fn outward(&self, state: StateId) -> impl Iterator<Item = StateId> + '_ {
        std::iter::successors(Some(state), |s| self.tables.parent(*s))
    }

    /// Whether exactly one of its child states is active while it is active.
    pub(crate) fn compound(&self, state: StateId) -> bool {
        matches!(self.state(state).kind, Kind::Composite { .. } | Kind::Chart { .. })
    }

    /// SCXML's getTransitionDomain: a transition to `targets` leaves and enters only states inside it.
    pub(crate) fn domain(&self, source: StateId, internal: bool, targets: &[StateId]) -> StateId {
        let around = |s: StateId| targets.iter().all(|t| *t != s && self.within(*t, s));
        if internal && self.compound(source) && around(source) {
            return source;
        }
        self.outward(source).skip(1).find(|s| self.compound(*s) && around(*s)).unwrap_or(0)
    }
}
