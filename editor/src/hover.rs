//! What is known of a name, for people.

use armarium_runtime::chart::{HeadSection, Library, OutlineKind, SkillPart, Symbol};
use armarium_runtime::skill::{Parameter, SkillManifest};
use armarium_source::{Span, code};
use armarium_values::expr;
use lsp_types::{Hover, HoverContents, MarkupContent, MarkupKind, Position, Uri};

use crate::cursor::{CursorPlace, TextCursor};
use crate::scope::shown;
use crate::symbols::describe;
use crate::uri;
use crate::workspace::Workspace;

impl Workspace {
    /// What is known of what stands at a place.
    pub fn hover(&mut self, uri: &Uri, position: Position) -> Option<Hover> {
        let path = uri::path(uri);
        let symbols = self.symbols_at(&path, position);
        let analysis = self.analysis(&path)?;
        let readable = self.readable(&path).map(|(analysis, _)| analysis);
        let document = self.document(&path)?;
        let offset = document.lines.offset(&document.source.text, position);
        let mut parts: Vec<String> = Vec::new();
        let mut span = None;
        if let Some((at, symbols)) = symbols {
            let library = readable
                .as_ref()
                .and_then(|analysis| analysis.library.clone().or_else(|| self.tested(analysis)));
            parts.extend(symbols.iter().filter_map(|symbol| self.describe(symbol, library.as_ref())));
            span = Some(at);
        }
        if parts.is_empty()
            && let Some((at, text)) = self.key(&document.source, document.kind?, offset)
        {
            parts.push(text);
            span = Some(at);
        }
        let here = |finding: &&armarium_source::Finding| {
            let Span { start, end } = finding.span;
            finding.source.path == path && start <= offset && offset <= end && !finding.is_about_the_file()
        };
        for finding in analysis.findings.iter().filter(here) {
            let meaning =
                code::TABLE.iter().find(|(code, _)| *code == finding.code).map_or("", |(_, meaning)| meaning);
            parts.push(format!("**{}** {}", finding.code, meaning.trim()));
            span.get_or_insert(finding.span);
        }
        parts.dedup();
        let contents = MarkupContent { kind: MarkupKind::Markdown, value: parts.join("\n\n---\n\n") };
        let range = span.map(|span| document.lines.range(&document.source.text, span));
        (!parts.is_empty()).then_some(Hover { contents: HoverContents::Markup(contents), range })
    }

    /// What the form says of the key at a place.
    fn key(
        &self,
        source: &armarium_source::Source,
        kind: crate::kind::FileKind,
        offset: usize,
    ) -> Option<(Span, String)> {
        let cursor = TextCursor::at(source, offset).filter(|cursor| cursor.place == CursorPlace::Key)?;
        let layout = source.layout();
        let entry =
            layout.entries.iter().rfind(|e| e.key.start <= offset && offset <= e.key.end && !e.item)?;
        let name = layout.key(&source.text, layout.at(entry.key.start)?);
        let forms = self.schemas.at(kind, &cursor.path);
        let form = forms.keys().into_iter().find(|form| form.name == name)?;
        Some((entry.key, format!("`{name}`\n\n{}", form.doc())))
    }

    fn describe(&self, symbol: &Symbol, library: Option<&Library>) -> Option<String> {
        let registry = &self.catalog.registry;
        let chart = symbol.chart().and_then(|name| library?.charts.get(name));
        Some(match symbol {
            Symbol::Chart { chart: name } => {
                let Some(chart) = chart else { return Some(format!("chart `{name}`")) };
                let mut text =
                    format!("chart **{name}** ({})\n\n{}", chart.source.path.display(), chart.description);
                text += &list("takes", &chart.inputs);
                text += &list("gives", &chart.outputs);
                let observed = chart.observes().map(|(name, pattern)| format!("- `{name}` {pattern}\n"));
                let observed: String = observed.collect();
                if !observed.is_empty() {
                    text += &format!("\n\nobserves:\n\n{observed}");
                }
                text
            }
            Symbol::State { path, .. } => {
                let outline = armarium_runtime::chart::Outline::of(chart?);
                let state = &outline.states[outline.find(0, path)?];
                let mut text = format!("state `{path}`: {}", describe(&state.kind));
                if !state.description.is_empty() {
                    text += &format!("\n\n{}", state.description);
                }
                if let OutlineKind::Skill(name) | OutlineKind::Remote(name) = &state.kind
                    && let Some(manifest) = registry.manifest(name)
                {
                    text += &format!("\n\n{}", skill(manifest));
                }
                text
            }
            Symbol::Declared { section, name, .. } => {
                let chart = chart?;
                let of = |parameters: &[Parameter], what: &str| {
                    let found = parameters.iter().find(|parameter| parameter.name == *name)?;
                    Some(parameter(what, found))
                };
                match section {
                    HeadSection::Inputs => of(&chart.inputs, "input")?,
                    HeadSection::Outputs => of(&chart.outputs, "output")?,
                    HeadSection::Locals => of(&chart.locals, "local")?,
                    HeadSection::Types => format!("type `{name}`"),
                    HeadSection::Observe => {
                        let schema = library?.channels_of(chart, &self.catalog.channels);
                        let of = schema.described().find(|channel| channel.name == *name)?;
                        let (_, pattern) = chart.observes().find(|(observed, _)| observed == name)?;
                        let text = format!("channel `{name}`: {pattern}\n\n{} ({})", of.description, of.rate);
                        text + &list("fields", &of.fields)
                    }
                }
            }
            Symbol::Event { name } => {
                let declared = library.into_iter().flat_map(|l| l.charts.values()).find_map(|chart| {
                    let (_, ty) = chart.events().find(|(event, _)| event == name)?;
                    let data = ty.map_or_else(String::new, |ty| format!(", with {ty}"));
                    Some(format!("event `{name}`, declared by {}{data}", chart.name))
                });
                declared.unwrap_or_else(|| format!("event `{name}`"))
            }
            Symbol::Watch { name, state, .. } => format!("watch `{name}` of `{state}`"),
            Symbol::Outcome { name, chart, state } if state.is_empty() => {
                format!("outcome `{name}` of the chart `{chart}`")
            }
            Symbol::Outcome { name, state, .. } => format!("outcome `{name}` of `{state}`"),
            Symbol::Skill { skill: name } => match registry.manifest(name) {
                Some(manifest) => skill(manifest),
                None => format!("`{name}`"),
            },
            Symbol::OfSkill { skill, part, name } => {
                let manifest = registry.manifest(skill);
                let of = |parameters: &[Parameter], what: &str| {
                    let found = parameters.iter().find(|parameter| parameter.name == *name)?;
                    Some(parameter(&format!("{what} of {skill}:"), found))
                };
                match part {
                    SkillPart::Input => of(&manifest?.inputs, "input")?,
                    SkillPart::Output => of(&manifest?.outputs, "output")?,
                    SkillPart::Outcome => format!("outcome `{name}` of the skill {skill}"),
                    SkillPart::Event => format!("event `{name}` of the skill {skill}"),
                }
            }
            Symbol::Channel { channel, fields } => {
                let shipped = &self.catalog.channels;
                let declared = library.map(|library| library.channels(shipped));
                let schema = declared.as_ref().unwrap_or(shipped);
                let ty = schema.get(channel)?.clone();
                let ty = fields.iter().try_fold(ty, |ty, field| {
                    ty.fields().into_iter().find(|(name, _)| name == field).map(|(_, ty)| ty)
                });
                let path: String = fields.iter().map(|field| format!(".{field}")).collect();
                let ty = ty.map_or_else(|| "any".to_owned(), |ty| ty.to_string());
                let mut text = format!("channel `{channel}{path}`: {ty}");
                if let Some(of) = schema.described().find(|of| of.name == *channel) {
                    let field = fields.first().and_then(|name| of.fields.iter().find(|f| f.name == *name));
                    let said = field.map_or(&of.description, |field| &field.description);
                    let rate = if of.rate.is_empty() { String::new() } else { format!(" ({})", of.rate) };
                    text += &format!("\n\n{said}{rate}");
                    text += &if fields.is_empty() { list("fields", &of.fields) } else { String::new() };
                    let using = |uses: fn(&SkillManifest) -> &Vec<String>| {
                        registry
                            .manifests()
                            .filter(move |m| uses(m).contains(channel))
                            .map(|m| m.name.clone())
                    };
                    let published = of.publishers.iter().cloned().chain(using(|m| &m.publishes));
                    let read = of.readers.iter().cloned().chain(using(|m| &m.reads));
                    for (title, names) in
                        [("published by", published.collect::<Vec<_>>()), ("read by", read.collect())]
                    {
                        if !names.is_empty() {
                            text += &format!("\n\n{title}: {}", names.join(", "));
                        }
                    }
                }
                text
            }
            Symbol::Attribute { segment, name } => {
                let of = self.catalog.channels.segment(segment)?;
                match (of.attributes.iter().find(|attribute| attribute.name == *name), name.as_str()) {
                    (Some(attribute), _) => parameter(&format!("attribute of {segment}:"), attribute),
                    (None, "confidence") => "`confidence: float`\n\nhow sure it is, 0 to 1".to_owned(),
                    (None, "id") => "`id: string`\n\nits address in memory".to_owned(),
                    (None, _) => return None,
                }
            }
            Symbol::Function { name } => {
                let function = expr::functions().find(|function| function.name == name)?;
                format!("`{}`\n\n{}", function.form, function.doc)
            }
            _ => return None,
        })
    }
}

fn parameter(what: &str, parameter: &Parameter) -> String {
    format!("{what} `{}`\n\n{}", shown(parameter), parameter.description)
}

fn list(title: &str, parameters: &[Parameter]) -> String {
    let line = |p: &Parameter| format!("- `{}` {}\n", shown(p), p.description);
    let lines: String = parameters.iter().map(line).collect();
    if lines.is_empty() { lines } else { format!("\n\n{title}:\n\n{lines}") }
}

/// What a skill declares.
pub(crate) fn skill(manifest: &SkillManifest) -> String {
    let mut text = format!("skill **{}**\n\n{}", manifest.name, manifest.description);
    text += &list("takes", &manifest.inputs);
    text += &list("gives", &manifest.outputs);
    let commands = manifest.commands();
    for (title, names) in [
        ("outcomes", &manifest.outcomes),
        ("events", &manifest.events),
        ("reads", &manifest.reads),
        ("publishes", &manifest.publishes),
        ("commands", &commands),
    ] {
        if !names.is_empty() {
            text += &format!("\n\n{title}: {}", names.join(", "));
        }
    }
    if let Some((file, line)) = manifest.declared_at.line() {
        text += &format!("\n\ndeclared at {}:{line}", file.display());
    }
    text
}
