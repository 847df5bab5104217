//! Reads XML into a tree of states: SCXML's structure, with expressions and targets as written.

mod actions;

use roxmltree::{Document as Xml, Node, ParsingOptions};

use super::{ImportError, MAX_BYTES};

const NAMESPACE: &str = "http://www.w3.org/2005/07/scxml";
const XINCLUDE: &str = "http://www.w3.org/2001/XInclude";
/// Deepest nesting of elements; enough for 60 levels of states.
const MAX_DEPTH: usize = 150;
/// Largest number of elements and texts.
const MAX_NODES: u32 = 4_000_000;

/// Number of a state in [`Document::states`].
pub(super) type Index = usize;

/// A document; state 0 is the root.
#[derive(Debug, Default)]
pub(super) struct Document {
    pub(super) name: Option<String>,
    pub(super) states: Vec<ScxmlState>,
    /// Elements with foreign names that tools have added to the document, with their lines.
    pub(super) foreign: Vec<(u32, String)>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum ScxmlKind {
    #[default]
    State,
    Parallel,
    Final,
    History {
        deep: bool,
    },
}

#[derive(Debug, Default)]
pub(super) struct ScxmlState {
    pub(super) line: u32,
    pub(super) id: Option<String>,
    pub(super) kind: ScxmlKind,
    pub(super) parent: Option<Index>,
    pub(super) children: Vec<Index>,
    /// The target that is entered by default, or a history's default.
    pub(super) initial: Option<ScxmlEntry>,
    pub(super) transitions: Vec<ScxmlTransition>,
    /// Each `<onentry>` is its own block: an error ends only its block.
    pub(super) enter: Vec<Vec<ScxmlAction>>,
    pub(super) exit: Vec<Vec<ScxmlAction>>,
    /// The data of a final state, with expressions.
    pub(super) data: Vec<(String, Code)>,
}

/// A piece of text with its line.
#[derive(Clone, Debug)]
pub(super) struct Code {
    pub(super) line: u32,
    pub(super) text: String,
}

#[derive(Debug)]
pub(super) struct ScxmlEntry {
    pub(super) line: u32,
    pub(super) targets: Vec<String>,
    pub(super) actions: Vec<ScxmlAction>,
}

#[derive(Debug)]
pub(super) struct ScxmlTransition {
    pub(super) line: u32,
    /// Event descriptors without their `.*`; empty for an eventless transition.
    pub(super) events: Vec<String>,
    pub(super) condition: Option<Code>,
    pub(super) targets: Vec<String>,
    pub(super) internal: bool,
    pub(super) actions: Vec<ScxmlAction>,
}

#[derive(Debug)]
pub(super) enum ScxmlAction {
    Raise(String),
    Send(ScxmlSend),
    Cancel(Text),
    Log { label: Option<String>, expr: Option<Code> },
    If(Vec<(Option<Code>, Vec<ScxmlAction>)>),
}

/// A literal text, or an expression that gives one.
#[derive(Debug)]
pub(super) enum Text {
    Plain(String),
    Expr(Code),
}

#[derive(Debug)]
pub(super) struct ScxmlSend {
    pub(super) line: u32,
    pub(super) event: Text,
    pub(super) target: Option<Text>,
    pub(super) kind: Option<Text>,
    pub(super) delay: Option<Text>,
    pub(super) id: Option<String>,
    pub(super) data: Payload,
}

/// The data of an event: named values, or one value.
#[derive(Debug, Default)]
pub(super) struct Payload {
    pub(super) fields: Vec<(String, Code)>,
    pub(super) content: Option<ScxmlContent>,
}

#[derive(Debug)]
pub(super) enum ScxmlContent {
    Expr(Code),
    /// JSON or a text.
    Written(serde_json::Value),
}

/// Reads a document and appends what cannot be converted to `errors`.
pub(super) fn document(text: &str, errors: &mut Vec<ImportError>) -> Option<Document> {
    if text.len() > MAX_BYTES {
        let message = format!("the document has more than {} MB", MAX_BYTES / 1_000_000);
        errors.push(ImportError { line: 1, message });
        return None;
    }
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    // White space before the XML declaration is an error that many tools accept.
    let lead = text.len() - text.trim_start().len();
    let xml = match Xml::parse_with_options(&text[lead..], options) {
        Ok(xml) => xml,
        Err(error) => {
            let line = error.pos().row;
            errors.push(ImportError { line, message: format!("this cannot be read as XML: {error}") });
            return None;
        }
    };
    let lines_before = u32::try_from(text[..lead].matches('\n').count()).unwrap_or(0);
    let mut reader = ScxmlReader { xml: &xml, lines_before, document: Document::default(), errors };
    reader.root(xml.root_element());
    Some(reader.document).filter(|document| !document.states.is_empty())
}

struct ScxmlReader<'x, 'e> {
    xml: &'x Xml<'x>,
    lines_before: u32,
    document: Document,
    errors: &'e mut Vec<ImportError>,
}

impl<'x> ScxmlReader<'x, '_> {
    fn line(&self, node: Node<'_, '_>) -> u32 {
        self.lines_before + self.xml.text_pos_at(node.range().start).row
    }

    fn error(&mut self, node: Node<'_, '_>, message: impl Into<String>) {
        let line = self.line(node);
        self.errors.push(ImportError { line, message: message.into() });
    }

    /// The name of an SCXML element. For any other element, adds an error and returns `None`.
    fn element(&mut self, node: Node<'x, 'x>) -> Option<&'x str> {
        if !node.is_element() {
            let text = node.text().unwrap_or("").trim();
            if node.is_text() && !text.is_empty() {
                self.error(node, format!("text stands where an element is needed: `{}`", start(text)));
            }
            return None;
        }
        let tag = node.tag_name();
        if tag.namespace().is_some_and(|n| n != NAMESPACE) {
            let space = tag.namespace().unwrap_or("");
            let message = format!("`<{}>` of {space} is not SCXML and cannot be carried over", tag.name());
            self.error(node, message);
            return None;
        }
        Some(tag.name())
    }

    /// As [`Self::element`], but elements with foreign names are only noted; they concern the tools that wrote
    /// them.
    fn element_or_foreign(&mut self, node: Node<'x, 'x>) -> Option<&'x str> {
        let space = node.tag_name().namespace();
        if node.is_element() && space.is_some_and(|space| space != NAMESPACE && space != XINCLUDE) {
            self.document.foreign.push((self.line(node), node.tag_name().name().to_owned()));
            return None;
        }
        self.element(node)
    }

    fn unknown(&mut self, node: Node<'x, 'x>, inside: &str) {
        let name = node.tag_name().name();
        let message = match name {
            "datamodel" | "data" | "assign" | "foreach" => {
                format!(
                    "`<{name}>` needs a data model: only the null data model and literals are carried over"
                )
            }
            "script" => "`<script>` cannot be carried over: charts hold no programs".to_owned(),
            "invoke" | "finalize" => {
                format!("`<{name}>` cannot be carried over: write a `statechart:` or `remote:` state")
            }
            _ => format!("`<{name}>` cannot be carried over inside `<{inside}>`"),
        };
        self.error(node, message);
    }

    fn code(&self, node: Node<'x, 'x>, attribute: &str) -> Option<Code> {
        let text = node.attribute(attribute)?.to_owned();
        Some(Code { line: self.line(node), text })
    }

    /// An attribute, or its `expr` form.
    fn text(&mut self, node: Node<'x, 'x>, plain: &str, expr: &str) -> Option<Text> {
        match (node.attribute(plain), self.code(node, expr)) {
            (Some(_), Some(_)) => {
                self.error(node, format!("`{plain}` and `{expr}` are given both"));
                None
            }
            (Some(text), None) => Some(Text::Plain(text.to_owned())),
            (None, code) => code.map(Text::Expr),
        }
    }

    fn root(&mut self, node: Node<'x, 'x>) {
        match self.element(node) {
            Some("scxml") => {}
            Some(other) => return self.error(node, format!("the root is `<{other}>`, not `<scxml>`")),
            None => return,
        }
        self.document.name = node.attribute("name").map(str::to_owned);
        let initial = self.initial_attribute(node);
        self.document.states.push(ScxmlState { line: self.line(node), initial, ..ScxmlState::default() });
        for child in node.children() {
            match self.element_or_foreign(child) {
                None => {}
                Some("state" | "parallel" | "final" | "history") => self.state(child, 0, 1),
                Some("datamodel") if child.children().all(|c| !c.is_element()) => {}
                Some(_) => self.unknown(child, "scxml"),
            }
        }
        if self.document.states.len() == 1 {
            self.error(node, "the document has no states");
        }
    }

    fn initial_attribute(&mut self, node: Node<'x, 'x>) -> Option<ScxmlEntry> {
        let targets: Vec<String> = words(node.attribute("initial")?);
        if targets.is_empty() {
            self.error(node, "`initial` names no state");
        }
        Some(ScxmlEntry { line: self.line(node), targets, actions: Vec::new() })
    }

    fn state(&mut self, node: Node<'x, 'x>, parent: Index, depth: usize) {
        if depth > MAX_DEPTH {
            return self.error(node, format!("states are nested deeper than {MAX_DEPTH} levels"));
        }
        let at = self.document.states.len();
        let kind = match node.tag_name().name() {
            "parallel" => ScxmlKind::Parallel,
            "final" => ScxmlKind::Final,
            "history" => ScxmlKind::History { deep: self.deep(node) },
            _ => ScxmlKind::State,
        };
        let initial = self.initial_attribute(node);
        let id = node.attribute("id").map(str::to_owned);
        let state = ScxmlState {
            line: self.line(node),
            id,
            kind,
            parent: Some(parent),
            initial,
            ..ScxmlState::default()
        };
        self.document.states.push(state);
        self.document.states[parent].children.push(at);
        for child in node.children() {
            let Some(name) = self.element_or_foreign(child) else { continue };
            match (name, kind) {
                ("transition", ScxmlKind::History { .. }) => self.entry(child, at),
                ("transition", ScxmlKind::State | ScxmlKind::Parallel) => {
                    let transition = self.transition(child);
                    self.document.states[at].transitions.push(transition);
                }
                ("initial", ScxmlKind::State) => self.initial_element(child, at),
                ("onentry", ScxmlKind::State | ScxmlKind::Parallel | ScxmlKind::Final) => {
                    let actions = self.actions(child, 0);
                    self.document.states[at].enter.push(actions);
                }
                ("onexit", ScxmlKind::State | ScxmlKind::Parallel | ScxmlKind::Final) => {
                    let actions = self.actions(child, 0);
                    self.document.states[at].exit.push(actions);
                }
                ("state" | "parallel" | "final" | "history", ScxmlKind::State)
                | ("state" | "parallel" | "history", ScxmlKind::Parallel) => self.state(child, at, depth + 1),
                ("donedata", ScxmlKind::Final) => {
                    let data = self.data(child, "donedata");
                    if data.content.is_some() {
                        let message = "`<content>` of `<donedata>` cannot be carried over: what a final state tells \
                                       has names, as `<param>`";
                        self.error(child, message);
                    }
                    self.document.states[at].data = data.fields;
                }
                ("datamodel", _) if child.children().all(|c| !c.is_element()) => {}
                _ => self.unknown(child, node.tag_name().name()),
            }
        }
    }

    fn deep(&mut self, node: Node<'x, 'x>) -> bool {
        match node.attribute("type") {
            None | Some("shallow") => false,
            Some("deep") => true,
            Some(other) => {
                self.error(node, format!("a history is `shallow` or `deep`, not `{other}`"));
                false
            }
        }
    }

    fn initial_element(&mut self, node: Node<'x, 'x>, at: Index) {
        for child in node.children() {
            match self.element(child) {
                None => {}
                Some("transition") => self.entry(child, at),
                Some(_) => self.unknown(child, "initial"),
            }
        }
    }

    /// The transition of an `<initial>` or a `<history>`.
    fn entry(&mut self, node: Node<'x, 'x>, at: Index) {
        if let Some(attribute) = ["event", "cond"].into_iter().find(|a| node.has_attribute(*a)) {
            self.error(node, format!("the transition of an initial or history state has no `{attribute}`"));
        }
        if self.document.states[at].initial.is_some() {
            self.error(node, "the state is told twice where it is entered");
        }
        let targets = words(node.attribute("target").unwrap_or(""));
        if targets.is_empty() {
            self.error(node, "the transition of an initial or history state needs a `target`");
        }
        let actions = self.actions(node, 0);
        self.document.states[at].initial = Some(ScxmlEntry { line: self.line(node), targets, actions });
    }

    fn transition(&mut self, node: Node<'x, 'x>) -> ScxmlTransition {
        let internal = match node.attribute("type") {
            None | Some("external") => false,
            Some("internal") => true,
            Some(other) => {
                self.error(node, format!("a transition is `external` or `internal`, not `{other}`"));
                false
            }
        };
        let events: Vec<String> =
            node.attribute("event").map_or_else(Vec::new, words).iter().map(|e| descriptor(e)).collect();
        if node.has_attribute("event") && events.is_empty() {
            self.error(node, "`event` names no event");
        }
        for event in events.iter().filter(|e| *e != "*") {
            if event.split('.').any(|token| token.is_empty() || token == "*") {
                self.error(node, format!("`{event}` is not the name of an event"));
            }
        }
        ScxmlTransition {
            line: self.line(node),
            events,
            condition: self.code(node, "cond"),
            targets: node.attribute("target").map_or_else(Vec::new, words),
            internal,
            actions: self.actions(node, 0),
        }
    }
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// An event descriptor without a final `.*` or `.`, which have no meaning in SCXML.
fn descriptor(text: &str) -> String {
    let text = text.strip_suffix(".*").unwrap_or(text);
    text.strip_suffix('.').unwrap_or(text).to_owned()
}

fn start(text: &str) -> String {
    text.chars().take(30).collect()
}
