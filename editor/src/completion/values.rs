//! What may be written as a value.

use std::collections::BTreeSet;

use armarium_runtime::skill::{Parameter, SkillManifest};
use armarium_source::Span;
use armarium_values::{Fit, Type, Unit};

use super::expressions::{expression_before, words};
use super::{Completing, Icon, Proposal, placeholder, snippet_text};
use crate::cursor::{PathStep, TextCursor};
use crate::kind::FileKind;
use crate::scope::StateScope;
use crate::symbols::describe;

impl Completing<'_> {
    pub(super) fn values(&self, cursor: &TextCursor) -> (Vec<Proposal>, Span) {
        let text = &self.source.text;
        let before = &text[cursor.before.start..cursor.before.end];
        let condition = self.forms.is("condition");
        if let Some(written) = expression_before(before, condition) {
            return self.expression(cursor, written);
        }
        let quoted = before.trim_start().starts_with(['"', '\'']);
        let dotted = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.' | '/' | '-' | '<');
        let start =
            self.offset - before.chars().rev().take_while(|c| dotted(*c)).map(char::len_utf8).sum::<usize>();
        let span = Span { start, end: cursor.word.end };
        let mut proposals = self.domain(cursor, quoted);
        proposals.extend(
            self.forms.words().into_iter().map(|(word, doc)| Proposal::new(word, Icon::ENUM_MEMBER).doc(doc)),
        );
        proposals.extend(self.given(cursor, quoted));
        let mut seen = BTreeSet::new();
        proposals.retain(|proposal| seen.insert(proposal.label.clone()));
        (proposals, span)
    }

    /// Names that a value may be, by what the form says that it is.
    fn domain(&self, cursor: &TextCursor, quoted: bool) -> Vec<Proposal> {
        let forms = &self.forms;
        let mut proposals = Vec::new();
        if forms.is("skill") {
            let skills = self.workspace.catalog.registry.manifests();
            proposals.extend(skills.map(|manifest| self.skill_state(cursor, manifest)));
        }
        if forms.is("chart") || self.kind == FileKind::Test && cursor.key() == Some("test") {
            let charts = self.workspace.charts(self.path);
            proposals.extend(charts.into_iter().map(|(name, files)| {
                let file = files
                    .first()
                    .and_then(|f| f.file_name())
                    .map_or_else(String::new, |f| f.to_string_lossy().into());
                let insert = if self.kind == FileKind::Test { file.clone() } else { name.clone() };
                Proposal::new(name, Icon::CLASS).detail(file).insert(insert)
            }));
        }
        if forms.is("pattern") {
            let segments = self.workspace.catalog.channels.segments();
            proposals.extend(segments.map(|segment| {
                let pattern = format!("{}/*/*", segment.name);
                let insert = if quoted { pattern.clone() } else { format!("\"{pattern}\"") };
                Proposal::new(pattern, Icon::VALUE).doc(&segment.description).insert(insert)
            }));
        }
        if forms.is("unit") {
            proposals.extend(Unit::symbols().map(|symbol| Proposal::new(symbol, Icon::UNIT)));
        }
        if forms.is("type") {
            let known = Type::NAMES.iter().map(|name| Proposal::new(*name, Icon::CLASS));
            proposals.extend(known);
            let declared =
                self.scoped(cursor, |scope| scope.chart.types().map(str::to_owned).collect::<Vec<_>>());
            proposals
                .extend(declared.into_iter().flatten().map(|name| Proposal::new(name, Icon::ENUM).rank(1)));
        }
        let scoped = self.scoped(cursor, |scope| {
            let mut proposals = Vec::new();
            if forms.is("targets") || forms.is("transition_list") || forms.is("entry") {
                proposals.extend(self.targets(cursor, scope));
            }
            if forms.is("event") || self.kind == FileKind::Test && cursor.key() == Some("event") {
                proposals.extend(
                    self.events(scope)
                        .into_iter()
                        .map(|(name, from)| Proposal::new(name, Icon::EVENT).detail(from)),
                );
            }
            if forms.is("outcome") {
                proposals.extend(["success", "failure"].map(|name| Proposal::new(name, Icon::EVENT)));
            }
            if self.kind == FileKind::Test {
                proposals.extend(self.in_test(cursor, scope));
            }
            proposals
        });
        proposals.extend(scoped.unwrap_or_default());
        proposals
    }

    pub(super) fn skill(&self, name: &str) -> Proposal {
        let manifest = self.workspace.catalog.registry.manifest(name);
        let doc = manifest.map_or_else(String::new, |manifest| crate::hover::skill(manifest));
        Proposal::new(name, Icon::FUNCTION).doc(doc)
    }

    /// A skill, with places for the inputs that it must have.
    fn skill_state(&self, cursor: &TextCursor, manifest: &SkillManifest) -> Proposal {
        let proposal = self.skill(&manifest.name);
        let required: Vec<&Parameter> =
            manifest.inputs.iter().filter(|input| input.default.is_none()).collect();
        let layout = self.source.layout();
        let state = cursor.entry.and_then(|skill| layout.entries[skill].parent);
        let has_with = layout.child(&self.source.text, state, "with").is_some();
        let (Some(skill), false) = (cursor.entry, required.is_empty() || has_with || !self.snippets) else {
            return proposal;
        };
        let places = required.iter().enumerate().map(|(at, input)| {
            format!("{}: ${{{}:{}}}", input.name, at + 1, snippet_text(&placeholder(input)))
        });
        let with = format!("with: {{{}}}", places.collect::<Vec<_>>().join(", "));
        let entry = &layout.entries[skill];
        let join = if entry.flow { ", ".to_owned() } else { format!("\n{}", " ".repeat(entry.column)) };
        proposal.snippet(format!("{}{join}{with}", manifest.name))
    }

    pub(super) fn targets(&self, cursor: &TextCursor, scope: &StateScope<'_>) -> Vec<Proposal> {
        // `initial` leads inside, a transition to what can be seen from its state.
        let inside = cursor.path.iter().any(|step| matches!(step, PathStep::Key(key) if key == "initial"));
        let states = &scope.outline.states;
        let visible = match inside {
            true => states[scope.state].children.iter().map(|c| (*c, states[*c].name.clone())).collect(),
            false => scope.visible(),
        };
        let shown = |(state, name): (usize, String)| {
            Proposal::new(name, Icon::VALUE)
                .detail(describe(&states[state].kind))
                .doc(&states[state].description)
        };
        visible.into_iter().map(shown).collect()
    }

    fn in_test(&self, cursor: &TextCursor, scope: &StateScope<'_>) -> Vec<Proposal> {
        let states = || {
            let all = scope
                .library
                .charts
                .values()
                .flat_map(|chart| armarium_runtime::chart::Outline::of(chart).states);
            let names: std::collections::BTreeSet<String> = all.map(|state| state.name).collect();
            names.into_iter().map(|name| Proposal::new(name, Icon::VALUE)).collect()
        };
        match cursor.key() {
            Some("active" | "from") => states(),
            Some("channel") => {
                let channels = scope.library.channels_of(scope.chart, &self.workspace.catalog.channels);
                let shown = |name: &str| channels.get(name).map_or_else(String::new, ToString::to_string);
                channels.names().map(|name| Proposal::new(name, Icon::FIELD).detail(shown(name))).collect()
            }
            Some("outcome") => {
                ["success", "failure", "never"].map(|name| Proposal::new(name, Icon::EVENT)).into()
            }
            _ => Vec::new(),
        }
    }

    /// What may be given to an input: its words, and variables that fit.
    fn given(&self, cursor: &TextCursor, quoted: bool) -> Vec<Proposal> {
        let under =
            |key: &str| cursor.path.iter().any(|step| matches!(step, PathStep::Key(name) if name == key));
        if self.kind == FileKind::Chart && under("assign") {
            let assigned = self.scoped(cursor, |scope| {
                let (section, name) = cursor.key()?.split_once('.')?;
                let of = match section {
                    "locals" => &scope.chart.locals,
                    _ => &scope.chart.outputs,
                };
                of.iter().find(|variable| variable.name == name).map(|variable| words(Some(&variable.ty)))
            });
            return assigned.flatten().unwrap_or_default();
        }
        if self.kind != FileKind::Chart || !under("with") {
            return Vec::new();
        }
        let with = TextCursor {
            entry: cursor.entry.and_then(|e| self.source.layout().entries[e].parent),
            ..cursor.clone()
        };
        let found = self.scoped(cursor, |scope| {
            let states = self.entered(&with, scope);
            let input = states
                .iter()
                .flat_map(|s| scope.inputs(*s))
                .find(|i| Some(i.name.as_str()) == cursor.key())?;
            let registry = &self.workspace.catalog.registry;
            let names = input.names.and_then(|kind| registry.names(kind, self.path));
            let mut proposals = match names {
                Some(names) => words(Some(&Type::Enum(names.into_iter().collect()))),
                None => words(Some(&input.ty)),
            };
            let channels = scope.library.channels(&self.workspace.catalog.channels);
            for (root, ty, _) in scope.roots(&channels, Type::Any) {
                let Type::Record(fields) = ty else { continue };
                let fitting = fields.iter().filter(|(_, ty)| {
                    matches!(input.ty.fit(ty), Fit::Yes) && root != "channels" && root != "event"
                });
                proposals.extend(fitting.map(|(name, ty)| {
                    let text = format!("${{{root}.{name}}}");
                    let insert = if quoted { text.clone() } else { format!("\"{text}\"") };
                    Proposal::new(text, Icon::VARIABLE).detail(ty.to_string()).insert(insert).rank(1)
                }));
            }
            Some(proposals)
        });
        found.flatten().unwrap_or_default()
    }
}
