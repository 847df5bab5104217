//! What names in charts stand for, as the compiler finds it: data for editors. Nothing is looked up here.

use std::cell::RefCell;
use std::sync::Arc;

use armarium_source::{Source, Span};

/// A thing that has a name.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Symbol {
    /// A chart.
    Chart { chart: String },
    /// A state, by its path in the chart that it is written in.
    State { chart: String, path: String },
    /// Something that the head of a chart declares.
    Declared { chart: String, section: HeadSection, name: String },
    /// An event that charts declare, raise or answer.
    Event { name: String },
    /// A watch, with the path of its state.
    Watch { chart: String, state: String, name: String },
    /// How a state with states inside, or a chart, ends; `state` is a path, empty for the chart itself.
    Outcome { chart: String, state: String, name: String },
    /// A skill of the program, or of another agent: `agent/Name`.
    Skill { skill: String },
    /// An input, output, outcome or event of a skill.
    OfSkill { skill: String, part: SkillPart, name: String },
    /// A channel, or the field of it that the names in `fields` lead down to.
    Channel { channel: String, fields: Vec<String> },
    /// An attribute of the entities of a core segment of memory.
    Attribute { segment: String, name: String },
    /// A function of expressions.
    Function { name: String },
}

/// A section of a chart's head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum HeadSection {
    /// `inputs`.
    Inputs,
    /// `outputs`.
    Outputs,
    /// `locals`.
    Locals,
    /// `types`.
    Types,
    /// `observe`.
    Observe,
}

impl HeadSection {
    /// The section's key.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Inputs => "inputs",
            Self::Outputs => "outputs",
            Self::Locals => "locals",
            Self::Types => "types",
            Self::Observe => "observe",
        }
    }

    /// The section whose variables expressions call `key.name`.
    #[must_use]
    pub fn of(key: &str) -> Option<Self> {
        [Self::Inputs, Self::Outputs, Self::Locals].into_iter().find(|section| section.key() == key)
    }
}

/// What of a skill's manifest is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SkillPart {
    /// An input.
    Input,
    /// An output.
    Output,
    /// An outcome.
    Outcome,
    /// An event that it raises.
    Event,
}

impl Symbol {
    /// Its own name, without what it belongs to.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Chart { chart: name }
            | Self::Skill { skill: name }
            | Self::Declared { name, .. }
            | Self::Event { name }
            | Self::Watch { name, .. }
            | Self::Outcome { name, .. }
            | Self::OfSkill { name, .. }
            | Self::Attribute { name, .. }
            | Self::Function { name } => name,
            Self::State { path, .. } => path.rsplit('.').next().unwrap_or(path),
            Self::Channel { channel, fields } => fields.last().unwrap_or(channel),
        }
    }

    /// The chart whose file defines it.
    #[must_use]
    pub fn chart(&self) -> Option<&str> {
        match self {
            Self::Chart { chart }
            | Self::State { chart, .. }
            | Self::Declared { chart, .. }
            | Self::Watch { chart, .. }
            | Self::Outcome { chart, .. } => Some(chart),
            _ => None,
        }
    }
}

/// A place where a name stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NameReference {
    /// The file.
    pub source: Arc<Source>,
    /// The name's letters, where they stand in the file as they read; otherwise the text that they are in.
    pub span: Span,
    /// Whether the span holds the name's letters and nothing else.
    pub exact: bool,
    /// Whether the name is given here.
    pub definition: bool,
    /// What it stands for.
    pub symbol: Symbol,
}

/// References as they are found.
#[derive(Debug, Default)]
pub(super) struct Collector(RefCell<Vec<NameReference>>);

impl Collector {
    /// Adds a name at a place.
    pub(super) fn add(&self, source: &Arc<Source>, span: Span, definition: bool, symbol: Symbol) {
        let exact = source.text.get(span.start..span.end) == Some(symbol.name());
        let inner = || within(&source.text, span, symbol.name());
        let (span, exact) = match (exact, inner()) {
            (false, Some(inner)) => (inner, true),
            _ => (span, exact),
        };
        self.0.borrow_mut().push(NameReference {
            source: Arc::clone(source),
            span,
            exact,
            definition,
            symbol,
        });
    }

    /// What was found, ordered by file and place, each once.
    pub(super) fn into_references(self) -> Vec<NameReference> {
        let mut found = self.0.into_inner();
        found.sort_by(|a, b| {
            let key = |r: &NameReference| (r.span.start, r.span.end);
            let definitions_first = || b.definition.cmp(&a.definition);
            let by_place = || key(a).cmp(&key(b)).then_with(|| a.symbol.cmp(&b.symbol));
            a.source.by_path(&b.source).then_with(by_place).then_with(definitions_first)
        });
        found
            .dedup_by(|a, b| a.span == b.span && a.symbol == b.symbol && a.source.by_path(&b.source).is_eq());
        found
    }
}

/// The letters of a name inside its quotes.
fn within(text: &str, span: Span, name: &str) -> Option<Span> {
    let raw = text.get(span.start..span.end)?;
    let inner = raw.strip_prefix(['"', '\'']).and_then(|raw| raw.strip_suffix(['"', '\'']))?;
    (inner == name).then_some(Span { start: span.start + 1, end: span.end - 1 })
}

/// The places of the parts of a dotted name that stands at `span`, as far as it stands there as it reads.
pub(super) fn parts(text: &str, span: Span, name: &str) -> Vec<Span> {
    let raw = text.get(span.start..span.end).unwrap_or("");
    let Some(start) = raw.find(name).map(|at| span.start + at) else {
        return name.split('.').map(|_| span).collect();
    };
    let mut at = start;
    name.split('.')
        .map(|part| {
            let place = Span { start: at, end: at + part.len() };
            at = place.end + 1;
            place
        })
        .collect()
}
