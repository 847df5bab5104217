//! Types and units beside what is given to inputs.

use armarium_runtime::chart::{HeadSection, Library, SkillPart, Symbol};
use armarium_runtime::skill::Parameter;
use lsp_types::{InlayHint, InlayHintKind, InlayHintLabel, Range, Uri};

use crate::uri;
use crate::workspace::Workspace;

/// Longest label, bytes; a longer type would push the line away.
const MAX_LABEL: usize = 40;

impl Workspace {
    /// The types of the inputs that are given in a part of a document.
    pub fn hints(&mut self, uri: &Uri, range: Range) -> Vec<InlayHint> {
        let path = uri::path(uri);
        let Some((analysis, shift)) = self.readable(&path) else { return Vec::new() };
        let (Some(document), Some(library)) = (self.document(&path), &analysis.library) else {
            return Vec::new();
        };
        let text = &document.source.text;
        let (wanted, layout) = (document.lines.span(text, range), document.source.layout());
        let mut hints = Vec::new();
        for reference in self.references(&analysis).iter().filter(|r| r.source.path == path && !r.definition)
        {
            let Some(key) = shift.back().map(reference.span.start) else { continue };
            if !(wanted.start..=wanted.end).contains(&key) {
                continue;
            }
            // Where the name is a key, it is given something.
            let entry = layout.at(key).or_else(|| layout.at(key.saturating_sub(1)));
            let Some(entry) = entry.map(|at| &layout.entries[at]) else { continue };
            let Some(parameter) = self.input(&reference.symbol, library) else { continue };
            let (Some(value), false) = (entry.value, entry.item) else { continue };
            let label = parameter.ty.to_string();
            if label.len() > MAX_LABEL
                || document.lines.position(text, value).line != document.lines.position(text, entry.end).line
            {
                continue;
            }
            hints.push(InlayHint {
                position: document.lines.position(text, entry.end),
                label: InlayHintLabel::String(label),
                kind: Some(InlayHintKind::TYPE),
                text_edits: None,
                tooltip: None,
                padding_left: Some(true),
                padding_right: Some(false),
                data: None,
            });
        }
        hints
    }

    fn input<'w>(&'w self, symbol: &Symbol, library: &'w Library) -> Option<&'w Parameter> {
        let (inputs, name) = match symbol {
            Symbol::OfSkill { skill, part: SkillPart::Input, name } => {
                (&self.catalog.registry.manifest(skill)?.inputs, name)
            }
            Symbol::Declared { chart, section: HeadSection::Inputs, name } => {
                (&library.charts.get(chart)?.inputs, name)
            }
            _ => return None,
        };
        inputs.iter().find(|input| input.name == *name)
    }
}
