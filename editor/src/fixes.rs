//! Quick fixes: the remedies of findings as actions of the client.

use armarium_source::Finding;
use lsp_types::{
    CodeAction, CodeActionKind, Diagnostic, DiagnosticSeverity, DocumentChanges, NumberOrString, OneOf,
    OptionalVersionedTextDocumentIdentifier, Range, TextDocumentEdit, Uri, WorkspaceEdit,
};

use crate::text::Lines;
use crate::uri;
use crate::workspace::Workspace;

impl Workspace {
    /// What can be done about the findings in a part of a document.
    pub fn fixes(&mut self, uri: &Uri, range: Range) -> Vec<CodeAction> {
        let path = uri::path(uri);
        let (Some(analysis), Some(document)) = (self.analysis(&path), self.document(&path)) else {
            return Vec::new();
        };
        let text = &document.source.text;
        let wanted = document.lines.span(text, range);
        let here = |finding: &&Finding| {
            finding.source.path == path
                && finding.span.start <= wanted.end
                && wanted.start <= finding.span.end
        };
        let action = |finding: &Finding| {
            let edits: Vec<_> =
                finding.edits().into_iter().map(|edit| OneOf::Left(document.edit(edit))).collect();
            let title = finding.remedy.as_ref().filter(|_| !edits.is_empty())?.title(&finding.source);
            let text_document =
                OptionalVersionedTextDocumentIdentifier { uri: uri.clone(), version: Some(document.version) };
            let changes = vec![TextDocumentEdit { text_document, edits }];
            let edit = WorkspaceEdit {
                document_changes: Some(DocumentChanges::Edits(changes)),
                ..WorkspaceEdit::default()
            };
            Some(CodeAction {
                title,
                kind: Some(CodeActionKind::QUICKFIX),
                diagnostics: Some(vec![diagnostic(finding, text, &document.lines)]),
                edit: Some(edit),
                is_preferred: Some(true),
                ..CodeAction::default()
            })
        };
        analysis.findings.iter().filter(here).filter_map(action).collect()
    }
}

/// A finding as a client shows it.
pub(crate) fn diagnostic(finding: &Finding, text: &str, lines: &Lines) -> Diagnostic {
    let help = finding.help.as_ref().map_or_else(String::new, |help| format!("\n{help}"));
    let severity = if finding.is_error() { DiagnosticSeverity::ERROR } else { DiagnosticSeverity::WARNING };
    Diagnostic {
        range: lines.range(text, finding.span),
        severity: Some(severity),
        code: Some(NumberOrString::String(finding.code.to_owned())),
        source: Some("armarium".to_owned()),
        message: format!("{}{help}", finding.message),
        ..Diagnostic::default()
    }
}
