//! The protocol: messages in, answers and diagnostics out. Only here is a connection; what is known is in [`Workspace`].
//!
//! Messages are handled in their order. Diagnostics wait until no message does, so that newer edits supersede them; a request that
//! was cancelled before its turn is not worked on.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use armarium_source::{Edit, Finding};
use lsp_server::{
    Connection, ErrorCode, ExtractError, Message, Notification, Request, RequestId, Response, ResponseError,
};
use lsp_types::notification::{
    Cancel, DidChangeConfiguration, DidChangeTextDocument, DidChangeWatchedFiles, DidCloseTextDocument,
    DidOpenTextDocument, Notification as _, PublishDiagnostics,
};
use lsp_types::request::{
    CodeActionRequest, CodeLensRequest, Completion, DocumentSymbolRequest, FoldingRangeRequest, Formatting,
    GotoDefinition, HoverRequest, InlayHintRequest, PrepareRenameRequest, References, Rename, Request as _,
};
use lsp_types::{
    CodeActionKind, CodeActionOptions, CodeActionOrCommand, CodeActionProviderCapability, CodeLensOptions,
    CompletionOptions, CompletionResponse, DidChangeTextDocumentParams, DidOpenTextDocumentParams,
    DocumentSymbolResponse, FoldingRangeProviderCapability, GotoDefinitionResponse, HoverProviderCapability,
    InitializeParams, NumberOrString, OneOf, PrepareRenameResponse, PublishDiagnosticsParams, RenameOptions,
    ServerCapabilities, TextDocumentPositionParams, TextDocumentSyncCapability, TextDocumentSyncKind,
    TextEdit, Uri,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value as Json, json};

use crate::fixes::diagnostic;
use crate::kind::Catalog;
use crate::text::{Lines, Shift};
use crate::uri;
use crate::workspace::Workspace;

/// Why a server has ended before its client asked it to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServerError {
    /// The client does not speak the protocol, or is gone.
    #[error("the client does not speak the language server protocol: {0}")]
    Protocol(#[from] lsp_server::ProtocolError),
    /// Standard input or output failed.
    #[error("the connection to the client is broken")]
    Connection(#[source] std::io::Error),
}

/// What a client may set: `initializationOptions`, and the section `armarium` of its configuration.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct ClientSettings {
    /// Folders where charts find others.
    charts: Vec<PathBuf>,
}

/// Serves a client on standard input and output until it says `exit`.
///
/// # Errors
/// [`ServerError`] when the client breaks the protocol.
pub fn serve_stdio(catalog: Catalog, folders: &[PathBuf]) -> Result<(), ServerError> {
    let (connection, threads) = Connection::stdio();
    serve(&connection, catalog, folders)?;
    drop(connection);
    threads.join().map_err(ServerError::Connection)
}

/// Serves the client at the other end of a connection until it says `exit`, or is gone.
///
/// # Errors
/// [`ServerError::Protocol`] when the client breaks the protocol.
pub fn serve(connection: &Connection, catalog: Catalog, folders: &[PathBuf]) -> Result<(), ServerError> {
    let (id, params) = connection.initialize_start()?;
    let params: InitializeParams = serde_json::from_value(params).unwrap_or_default();
    let info = json!({"name": "armarium", "version": env!("CARGO_PKG_VERSION")});
    connection.initialize_finish(id, json!({"capabilities": capabilities(), "serverInfo": info}))?;
    let mut server = LanguageServer {
        connection,
        workspace: Workspace::new(catalog, folders),
        folders,
        snippets: snippets(&params),
        published: BTreeMap::new(),
        cancelled: BTreeSet::new(),
    };
    server.workspace.set_roots(roots(&params));
    server.configure(params.initialization_options.as_ref());
    server.run()
}

fn capabilities() -> ServerCapabilities {
    let triggers = [".", ":", " ", "$", "{", "'", "\""];
    ServerCapabilities {
        text_document_sync: Some(TextDocumentSyncCapability::Kind(TextDocumentSyncKind::INCREMENTAL)),
        completion_provider: Some(CompletionOptions {
            trigger_characters: Some(triggers.map(str::to_owned).into()),
            ..CompletionOptions::default()
        }),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        definition_provider: Some(OneOf::Left(true)),
        references_provider: Some(OneOf::Left(true)),
        rename_provider: Some(OneOf::Right(RenameOptions {
            prepare_provider: Some(true),
            work_done_progress_options: lsp_types::WorkDoneProgressOptions::default(),
        })),
        document_symbol_provider: Some(OneOf::Left(true)),
        folding_range_provider: Some(FoldingRangeProviderCapability::Simple(true)),
        document_formatting_provider: Some(OneOf::Left(true)),
        code_action_provider: Some(CodeActionProviderCapability::Options(CodeActionOptions {
            code_action_kinds: Some(vec![CodeActionKind::QUICKFIX]),
            ..CodeActionOptions::default()
        })),
        code_lens_provider: Some(CodeLensOptions { resolve_provider: Some(false) }),
        inlay_hint_provider: Some(OneOf::Left(true)),
        ..ServerCapabilities::default()
    }
}

fn snippets(params: &InitializeParams) -> bool {
    let completion = params.capabilities.text_document.as_ref().and_then(|text| text.completion.as_ref());
    let item = completion.and_then(|completion| completion.completion_item.as_ref());
    item.and_then(|item| item.snippet_support).unwrap_or(false)
}

fn roots(params: &InitializeParams) -> Vec<PathBuf> {
    #[expect(deprecated, reason = "clients of before 2020 name their folder so")]
    let old = params.root_uri.iter().map(uri::path);
    let folders = params.workspace_folders.iter().flatten().map(|folder| uri::path(&folder.uri));
    let folders: Vec<PathBuf> = folders.collect();
    if folders.is_empty() { old.collect() } else { folders }
}

struct LanguageServer<'c> {
    connection: &'c Connection,
    workspace: Workspace,
    /// Folders where charts find others, besides those that the client sets.
    folders: &'c [PathBuf],
    /// Whether the client can fill in places of what it inserts.
    snippets: bool,
    /// What was found with each open document, by the file that it is in.
    published: BTreeMap<Uri, BTreeMap<PathBuf, Vec<Finding>>>,
    /// Requests whose answers are not wanted any more.
    cancelled: BTreeSet<String>,
}

impl LanguageServer<'_> {
    fn run(&mut self) -> Result<(), ServerError> {
        loop {
            // All that has arrived is looked at for cancellations before the first of it is worked on.
            let Ok(first) = self.connection.receiver.recv() else { return Ok(()) };
            let mut messages = vec![first];
            loop {
                messages.extend(self.connection.receiver.try_iter());
                for message in &messages {
                    self.note_cancellation(message);
                }
                for message in messages.drain(..) {
                    match message {
                        Message::Request(request) => {
                            if self.connection.handle_shutdown(&request)? {
                                return Ok(());
                            }
                            self.request(request);
                        }
                        Message::Notification(notification) => self.notification(notification),
                        // The server asks nothing.
                        Message::Response(_) => {}
                    }
                }
                messages.extend(self.connection.receiver.try_iter());
                if messages.is_empty() && !self.diagnose_one() {
                    break;
                }
            }
            self.cancelled.clear();
        }
    }

    fn note_cancellation(&mut self, message: &Message) {
        if let Message::Notification(notification) = message
            && notification.method == Cancel::METHOD
            && let Some(params) = parsed::<lsp_types::CancelParams>(notification.params.clone())
        {
            self.cancelled.insert(match params.id {
                NumberOrString::Number(number) => RequestId::from(number).to_string(),
                NumberOrString::String(text) => RequestId::from(text).to_string(),
            });
        }
    }

    fn send(&self, message: impl Into<Message>) {
        // A client that is gone needs no answer; `recv` says so next.
        let _ = self.connection.sender.send(message.into());
    }

    fn notification(&mut self, notification: Notification) {
        let Notification { method, params } = notification;
        match method.as_str() {
            DidOpenTextDocument::METHOD => {
                if let Some(DidOpenTextDocumentParams { text_document: document }) = parsed(params) {
                    self.workspace.open(document.uri, document.version, document.text);
                }
            }
            DidChangeTextDocument::METHOD => {
                if let Some(params) = parsed::<DidChangeTextDocumentParams>(params) {
                    let document = params.text_document;
                    self.workspace.change(&document.uri, document.version, params.content_changes);
                }
            }
            DidCloseTextDocument::METHOD => {
                if let Some(params) = parsed::<lsp_types::DidCloseTextDocumentParams>(params) {
                    self.workspace.close(&params.text_document.uri);
                    self.publish(params.text_document.uri, Vec::new());
                }
            }
            DidChangeWatchedFiles::METHOD => {
                let params = parsed::<lsp_types::DidChangeWatchedFilesParams>(params);
                for change in params.into_iter().flat_map(|params| params.changes) {
                    self.workspace.touched(&uri::path(&change.uri));
                }
            }
            DidChangeConfiguration::METHOD => {
                self.configure(params.get("settings").and_then(|s| s.get("armarium")))
            }
            _ => {}
        }
    }

    fn configure(&mut self, settings: Option<&Json>) {
        if let Some(settings) = settings.and_then(|settings| ClientSettings::deserialize(settings).ok()) {
            self.workspace.set_folders(self.folders.iter().cloned().chain(settings.charts));
        }
    }

    /// Analyses a document that was changed and publishes what is wrong. Returns whether there was one.
    fn diagnose_one(&mut self) -> bool {
        let Some(uri) = self.workspace.stale().next().cloned() else { return false };
        let findings = self.workspace.findings(&uri);
        self.publish(uri, findings);
        true
    }

    /// Publishes what was found with a document: in itself and in the files that it names, each with what others found there.
    fn publish(&mut self, root: Uri, findings: Vec<Finding>) {
        let mut by_file: BTreeMap<PathBuf, Vec<Finding>> = BTreeMap::new();
        if self.workspace.document(&uri::path(&root)).is_some() {
            by_file.insert(uri::path(&root), Vec::new());
        }
        for finding in findings {
            by_file.entry(finding.source.path.clone()).or_default().push(finding);
        }
        let before = match by_file.is_empty() {
            true => self.published.remove(&root),
            false => self.published.insert(root, by_file.clone()),
        };
        let files: BTreeSet<PathBuf> =
            before.into_iter().flatten().map(|(file, _)| file).chain(by_file.into_keys()).collect();
        files.into_iter().for_each(|file| self.publish_file(file));
    }

    fn publish_file(&self, file: PathBuf) {
        let mut findings: Vec<&Finding> =
            self.published.values().filter_map(|by_file| by_file.get(&file)).flatten().collect();
        findings.sort_by_key(|finding| (finding.span.start, finding.code));
        findings.dedup_by(|a, b| a.code == b.code && a.span == b.span && a.message == b.message);
        let (uri, version, diagnostics) = match self.workspace.document(&file) {
            Some(document) => {
                let all = findings
                    .iter()
                    .map(|finding| diagnostic(finding, &document.source.text, &document.lines));
                (document.uri.clone(), Some(document.version), all.collect())
            }
            None => {
                let Some(uri) = uri::of(&file) else { return };
                let all = findings.iter().map(|finding| {
                    let text = &finding.source.text;
                    diagnostic(finding, text, &Lines::of(text))
                });
                (uri, None, all.collect())
            }
        };
        let params = PublishDiagnosticsParams { uri, diagnostics, version };
        self.send(Notification::new(PublishDiagnostics::METHOD.to_owned(), params));
    }

    fn request(&mut self, request: Request) {
        if self.cancelled.remove(&request.id.to_string()) {
            let code = ErrorCode::RequestCanceled as i32;
            return self.send(Response::new_err(request.id, code, "the request was cancelled".into()));
        }
        let id = request.id.clone();
        let answer =
            self.answer(request).unwrap_or_else(|error| Response { id, response_result: Err(error) });
        self.send(answer);
    }

    fn answer(&mut self, request: Request) -> Result<Response, ResponseError> {
        let workspace = &mut self.workspace;
        let snippets = self.snippets;
        let at = |position: TextDocumentPositionParams| (position.text_document.uri, position.position);
        match request.method.as_str() {
            Completion::METHOD => reply::<Completion>(request, |params| {
                let (uri, position) = at(params.text_document_position);
                Ok(Some(CompletionResponse::Array(workspace.completion(&uri, position, snippets))))
            }),
            HoverRequest::METHOD => reply::<HoverRequest>(request, |params| {
                let (uri, position) = at(params.text_document_position_params);
                Ok(workspace.hover(&uri, position))
            }),
            GotoDefinition::METHOD => reply::<GotoDefinition>(request, |params| {
                let (uri, position) = at(params.text_document_position_params);
                Ok(Some(GotoDefinitionResponse::Array(workspace.definition(&uri, position))))
            }),
            References::METHOD => reply::<References>(request, |params| {
                let (uri, position) = at(params.text_document_position);
                Ok(Some(workspace.find_references(&uri, position, params.context.include_declaration)))
            }),
            PrepareRenameRequest::METHOD => reply::<PrepareRenameRequest>(request, |params| {
                let (uri, position) = at(params);
                workspace
                    .prepare_rename(&uri, position)
                    .map(|range| Some(PrepareRenameResponse::Range(range)))
                    .map_err(refused)
            }),
            Rename::METHOD => reply::<Rename>(request, |params| {
                let (uri, position) = at(params.text_document_position);
                workspace.rename(&uri, position, &params.new_name).map(Some).map_err(refused)
            }),
            DocumentSymbolRequest::METHOD => reply::<DocumentSymbolRequest>(request, |params| {
                Ok(Some(DocumentSymbolResponse::Nested(workspace.symbols(&params.text_document.uri))))
            }),
            FoldingRangeRequest::METHOD => reply::<FoldingRangeRequest>(request, |params| {
                Ok(Some(workspace.folding(&params.text_document.uri)))
            }),
            Formatting::METHOD => {
                reply::<Formatting>(request, |params| Ok(formatted(workspace, &params.text_document.uri)))
            }
            CodeActionRequest::METHOD => reply::<CodeActionRequest>(request, |params| {
                let fixes = workspace.fixes(&params.text_document.uri, params.range);
                Ok(Some(fixes.into_iter().map(CodeActionOrCommand::CodeAction).collect()))
            }),
            CodeLensRequest::METHOD => reply::<CodeLensRequest>(request, |params| {
                Ok(Some(workspace.lenses(&params.text_document.uri)))
            }),
            InlayHintRequest::METHOD => reply::<InlayHintRequest>(request, |params| {
                Ok(Some(workspace.hints(&params.text_document.uri, params.range)))
            }),
            StateAt::METHOD => reply::<StateAt>(request, |params| {
                let (uri, position) = at(params);
                Ok(workspace.state_at(&uri, position))
            }),
            method => {
                let message = format!("the method {method} is not known");
                Err(ResponseError { code: ErrorCode::MethodNotFound as i32, message, data: None })
            }
        }
    }
}

/// The state that a place is in, for pictures that follow the cursor.
enum StateAt {}

impl lsp_types::request::Request for StateAt {
    type Params = TextDocumentPositionParams;
    type Result = Option<String>;
    const METHOD: &'static str = "armarium/stateAt";
}

fn parsed<P: DeserializeOwned>(params: Json) -> Option<P> {
    serde_json::from_value(params).ok()
}

fn refused(error: crate::rename::RenameError) -> ResponseError {
    ResponseError { code: ErrorCode::RequestFailed as i32, message: error.to_string(), data: None }
}

/// Answers a request whose parameters have the form of its kind.
fn reply<R: lsp_types::request::Request>(
    request: Request,
    work: impl FnOnce(R::Params) -> Result<R::Result, ResponseError>,
) -> Result<Response, ResponseError> {
    let invalid =
        |message: String| ResponseError { code: ErrorCode::InvalidParams as i32, message, data: None };
    let (id, params) = request.extract::<R::Params>(R::METHOD).map_err(|error| match error {
        ExtractError::JsonError { error, .. } => invalid(error.to_string()),
        ExtractError::MethodMismatch(request) => invalid(format!("this is not {}", request.method)),
    })?;
    Ok(Response::new_ok(id, work(params)?))
}

/// The edit that gives a document its form; none where it is no YAML.
fn formatted(workspace: &Workspace, uri: &Uri) -> Option<Vec<TextEdit>> {
    let document = workspace.document(&uri::path(uri))?;
    let text = &document.source.text;
    let formatted = crate::format::format(&document.source.path, text).ok()?;
    if formatted == *text {
        return Some(Vec::new());
    }
    let (span, new) = Shift::between(text, &formatted).differing(text, &formatted);
    Some(vec![document.edit(Edit { span, text: formatted[new.start..new.end].to_owned() })])
}
