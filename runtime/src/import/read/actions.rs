//! Reads executable content: the actions of states and transitions, as written.

use roxmltree::Node;

use super::{Code, Payload, ScxmlAction, ScxmlContent, ScxmlReader, ScxmlSend, words};

/// Deepest nesting of `<if>`: each `elseif` becomes a nesting level in the chart's text.
const MAX_IFS: usize = 20;
/// Deepest nesting of JSON.
const MAX_JSON: usize = 20;

impl<'x> ScxmlReader<'x, '_> {
    pub(super) fn actions(&mut self, node: Node<'x, 'x>, depth: usize) -> Vec<ScxmlAction> {
        let inside = node.tag_name().name();
        let mut actions = Vec::new();
        for child in node.children() {
            if let Some(name) = self.element(child) {
                actions.extend(self.action(child, name, inside, depth));
            }
        }
        actions
    }

    fn action(&mut self, node: Node<'x, 'x>, name: &str, inside: &str, depth: usize) -> Option<ScxmlAction> {
        match name {
            "raise" => self.raise(node),
            "send" => self.send(node),
            "cancel" => self.cancel(node),
            "log" => {
                let label = node.attribute("label").map(str::to_owned).filter(|l| !l.is_empty());
                Some(ScxmlAction::Log { label, expr: self.code(node, "expr") })
            }
            "if" if depth < MAX_IFS => Some(self.choice(node, depth)),
            "if" => {
                self.error(node, format!("`<if>` is nested deeper than {MAX_IFS} levels"));
                None
            }
            _ => {
                self.unknown(node, inside);
                None
            }
        }
    }

    fn raise(&mut self, node: Node<'x, 'x>) -> Option<ScxmlAction> {
        let Some(event) = node.attribute("event").filter(|e| !e.trim().is_empty()) else {
            self.error(node, "`<raise>` needs an `event`");
            return None;
        };
        Some(ScxmlAction::Raise(event.trim().to_owned()))
    }

    fn cancel(&mut self, node: Node<'x, 'x>) -> Option<ScxmlAction> {
        let id = self.text(node, "sendid", "sendidexpr");
        if id.is_none() {
            self.error(node, "`<cancel>` needs a `sendid`");
        }
        id.map(ScxmlAction::Cancel)
    }

    fn send(&mut self, node: Node<'x, 'x>) -> Option<ScxmlAction> {
        for attribute in ["idlocation", "namelist"] {
            if node.attribute(attribute).is_some_and(|a| !a.trim().is_empty()) {
                let message =
                    format!("`{attribute}` of `<send>` needs a data model and cannot be carried over");
                self.error(node, message);
            }
        }
        let Some(event) = self.text(node, "event", "eventexpr") else {
            self.error(node, "`<send>` needs an `event`");
            return None;
        };
        Some(ScxmlAction::Send(ScxmlSend {
            line: self.line(node),
            event,
            target: self.text(node, "target", "targetexpr"),
            kind: self.text(node, "type", "typeexpr"),
            delay: self.text(node, "delay", "delayexpr"),
            id: node.attribute("id").map(str::to_owned),
            data: self.data(node, "send"),
        }))
    }

    /// The data of a `<send>` or a `<donedata>`.
    pub(super) fn data(&mut self, node: Node<'x, 'x>, inside: &str) -> Payload {
        let mut data = Payload::default();
        for child in node.children() {
            match self.element(child) {
                None => {}
                Some("param") => match (child.attribute("name"), self.code(child, "expr")) {
                    (Some(name), Some(code)) => data.fields.push((name.to_owned(), code)),
                    _ => self.error(child, "`<param>` is carried over with `name` and `expr`"),
                },
                Some("content") => data.content = self.content(child),
                Some(_) => self.unknown(child, inside),
            }
        }
        if data.content.is_some() && !data.fields.is_empty() {
            self.error(node, format!("`<{inside}>` has `<param>` or `<content>`, not both"));
        }
        data
    }

    /// One value: an expression, JSON, or a text in which white space becomes single spaces.
    fn content(&mut self, node: Node<'x, 'x>) -> Option<ScxmlContent> {
        if node.children().any(|child| child.is_element()) {
            self.error(node, "`<content>` with elements cannot be carried over: XML is no value here");
            return None;
        }
        if let Some(code) = self.code(node, "expr") {
            return Some(ScxmlContent::Expr(code));
        }
        let text = node.text().unwrap_or("").trim();
        if text.is_empty() {
            return None;
        }
        let spaced = || serde_json::Value::String(words(text).join(" "));
        let value = serde_json::from_str(text).unwrap_or_else(|_| spaced());
        if deeper(&value, MAX_JSON) {
            self.error(node, format!("the JSON of `<content>` is nested deeper than {MAX_JSON} levels"));
            return None;
        }
        Some(ScxmlContent::Written(value))
    }

    fn choice(&mut self, node: Node<'x, 'x>, depth: usize) -> ScxmlAction {
        let mut branches = vec![(self.condition(node), Vec::new())];
        for child in node.children() {
            let Some(name) = self.element(child) else { continue };
            match name {
                "elseif" => branches.push((self.condition(child), Vec::new())),
                "else" => branches.push((None, Vec::new())),
                _ => {
                    let action = self.action(child, name, "if", depth + 1);
                    branches.last_mut().expect("there is a branch from the start").1.extend(action);
                }
            }
        }
        ScxmlAction::If(branches)
    }

    fn condition(&mut self, node: Node<'x, 'x>) -> Option<Code> {
        let code = self.code(node, "cond");
        if code.is_none() {
            self.error(node, format!("`<{}>` needs a `cond`", node.tag_name().name()));
        }
        code
    }
}

/// Whether lists and maps are nested in more than `levels` levels.
fn deeper(value: &serde_json::Value, levels: usize) -> bool {
    let below = |value: &serde_json::Value| levels == 0 || deeper(value, levels - 1);
    match value {
        serde_json::Value::Array(items) => items.iter().any(below),
        serde_json::Value::Object(fields) => fields.values().any(below),
        _ => false,
    }
}
