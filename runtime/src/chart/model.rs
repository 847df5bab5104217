//! A chart as it was written: every name with its place, nothing resolved yet.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_source::yaml::{Named, Node};
use armarium_source::{Source, Span};
use armarium_values::Type;

use super::catalog::ChannelDescription;
use super::symbols::HeadSection;
use crate::observed::MemoryPattern;
use crate::skill::{DeclaredAt, Limits, Parameter, SkillManifest};

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
    /// The names that the head gives, by section.
    pub(crate) declared: Vec<(HeadSection, Named)>,
    /// Where types of the head are named.
    pub(crate) type_uses: Vec<Named>,
    pub(crate) events: Vec<(Named, Option<Type>)>,
    pub(crate) channels: Vec<DeclaredChannel>,
    pub(crate) observed: Vec<WrittenPattern>,
    pub(crate) profiles: BTreeMap<String, Vec<(Named, Node)>>,
    pub(crate) probes: Vec<Named>,
    /// Where the defaults of inputs and locals stand, by the name.
    pub(crate) defaults: Vec<(String, Span)>,
    pub(crate) root: WrittenState,
}

impl Chart {
    /// The events from outside that it understands, with the type of what comes with them.
    pub fn events(&self) -> impl Iterator<Item = (&str, Option<&Type>)> {
        self.events.iter().map(|(name, data)| (name.text.as_str(), data.as_ref()))
    }

    /// The probes that are to judge a simulated run of it.
    pub fn probes(&self) -> impl Iterator<Item = &str> {
        self.probes.iter().map(|probe| probe.text.as_str())
    }

    /// The channels of its own skills that it declares.
    pub fn channels(&self) -> impl Iterator<Item = &ChannelDescription> {
        self.channels.iter().map(|channel| &channel.described)
    }

    /// What it observes of memory, by the names that it gives.
    pub fn observes(&self) -> impl Iterator<Item = (&str, &MemoryPattern)> {
        self.observed.iter().map(|observed| (observed.name.text.as_str(), &observed.pattern))
    }

    /// The chart seen from outside, like a skill: its inputs, its outputs, and the outcomes of its final states.
    #[must_use]
    pub fn manifest(&self) -> SkillManifest {
        let mut manifest = SkillManifest::new(&self.name, &self.description);
        manifest.declared_at = DeclaredAt::default();
        manifest.inputs.clone_from(&self.inputs);
        manifest.outputs.clone_from(&self.outputs);
        let mut outcomes = BTreeSet::new();
        finals(&self.root, &mut outcomes);
        let own = |outcome: &String| !["success", "failure"].contains(&outcome.as_str());
        manifest.outcomes = outcomes.into_iter().filter(own).collect();
        manifest
    }

    /// The text that an input has where nothing is given: the profile's, else its default.
    pub fn usual_text(&self, input: &str, profile: Option<&str>) -> Option<String> {
        let of_profile = profile.and_then(|profile| self.profiles.get(profile)).into_iter().flatten();
        let said = of_profile.filter(|(name, _)| name.text == input).map(|(_, node)| node.literal()).next();
        let declared = self.inputs.iter().find(|parameter| parameter.name == input);
        let usual = said.or_else(|| declared?.default.clone())?;
        usual.as_str().map(str::to_owned)
    }

    /// The names of the types that it declares.
    pub fn types(&self) -> impl Iterator<Item = &str> {
        let types = self.declared.iter().filter(|(section, _)| *section == HeadSection::Types);
        types.map(|(_, name)| name.text.as_str())
    }
}

/// The outcomes of the final states of a state, or of its regions.
fn finals(state: &WrittenState, outcomes: &mut BTreeSet<String>) {
    for child in state.kind.children() {
        match &child.kind {
            WrittenKind::Final(outcome) => {
                outcomes.insert(outcome.text.clone());
            }
            _ if matches!(state.kind, WrittenKind::Parallel(_)) => finals(child, outcomes),
            _ => {}
        }
    }
}

/// A channel in a chart's head.
#[derive(Debug)]
pub(crate) struct DeclaredChannel {
    pub(crate) name: Named,
    /// The names of its fields.
    pub(crate) fields: Vec<Named>,
    pub(crate) described: ChannelDescription,
}

/// A pattern of memory in a chart's head.
#[derive(Debug)]
pub(crate) struct WrittenPattern {
    pub(crate) name: Named,
    /// Where the pattern stands.
    pub(crate) span: Span,
    pub(crate) pattern: MemoryPattern,
}

#[derive(Debug)]
pub(crate) struct WrittenState {
    pub(crate) name: Named,
    /// For people.
    pub(crate) description: String,
    pub(crate) kind: WrittenKind,
    pub(crate) with: Vec<(Named, Node)>,
    pub(crate) enter: Vec<WrittenAction>,
    pub(crate) exit: Vec<WrittenAction>,
    pub(crate) watch: Vec<WrittenWatch>,
    pub(crate) after: Vec<WrittenTransition>,
    pub(crate) always: Vec<WrittenTransition>,
    pub(crate) transitions: Vec<WrittenTransition>,
    pub(crate) retry: Option<Retry>,
    pub(crate) limits: Limits,
    pub(crate) unbreakable: bool,
}

#[derive(Debug)]
pub(crate) enum WrittenKind {
    Atomic,
    Skill(Named),
    Chart(Named),
    Remote(Named),
    Composite { initial: WrittenEntry, states: Vec<WrittenState> },
    Parallel(Vec<WrittenState>),
    Final(Named),
    History { deep: bool, default: WrittenEntry },
}

/// `initial` and a history's `default`: what is entered, and what is done then.
#[derive(Debug, Default)]
pub(crate) struct WrittenEntry {
    pub(crate) targets: Vec<Named>,
    pub(crate) actions: Vec<WrittenAction>,
}

impl WrittenKind {
    pub(crate) fn children(&self) -> &[WrittenState] {
        match self {
            Self::Composite { states, .. } | Self::Parallel(states) => states,
            _ => &[],
        }
    }
}

#[derive(Debug)]
pub(crate) struct WrittenTransition {
    pub(crate) span: Span,
    /// The event that takes it; none for `always` and `after`.
    pub(crate) event: Option<Named>,
    pub(crate) delay: Option<Node>,
    pub(crate) targets: Vec<Named>,
    pub(crate) internal: bool,
    pub(crate) guard: Option<Node>,
    pub(crate) actions: Vec<WrittenAction>,
    pub(crate) with: Vec<(Named, Node)>,
}

#[derive(Debug)]
pub(crate) struct WrittenWatch {
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
pub(crate) struct WrittenAction {
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
    If { condition: Node, then: Vec<WrittenAction>, otherwise: Vec<WrittenAction> },
    Foreach { items: Node, variable: Named, body: Vec<WrittenAction> },
}
