//! Writes executable content as actions of the language. What cannot be sent becomes the error event that SCXML
//! names.

use super::{ChartWriter, value_of};
use crate::import::read::{Code, Index, ScxmlAction, ScxmlContent, ScxmlSend};
use crate::import::yaml::{comment, json, quoted, scalar};

impl ChartWriter<'_> {
    /// Writes one block. Actions after one that always fails are left out, as SCXML does not run them.
    pub(super) fn actions(&mut self, at: Index, actions: &[ScxmlAction], indent: usize) {
        for action in actions {
            match action {
                ScxmlAction::Raise(event) => {
                    let event = scalar(&self.event(event));
                    self.line(indent, &format!("- raise: {event}"));
                }
                ScxmlAction::Send(send) => {
                    if !self.send(at, send, indent) {
                        return;
                    }
                }
                ScxmlAction::Cancel(id) => {
                    if let Some(id) = self.text(at, id) {
                        self.line(indent, &format!("- cancel: {}", scalar(&id)));
                    }
                }
                ScxmlAction::Log { label, expr } => self.log(at, label.as_deref(), expr.as_ref(), indent),
                ScxmlAction::If(branches) => self.choice(at, branches, indent),
            }
        }
    }

    fn log(&mut self, at: Index, label: Option<&str>, expr: Option<&Code>, indent: usize) {
        let mut text = label.map_or_else(String::new, |l| l.replace("${", "$${"));
        if let Some(value) = expr.and_then(|code| self.expression(at, code)) {
            if !text.is_empty() {
                text.push_str(": ");
            }
            match value.words() {
                Some(words) => text.push_str(&words.replace("${", "$${")),
                None => text.push_str(&format!("${{{}}}", value.cel())),
            }
        }
        self.line(indent, &format!("- log: {}", quoted(&text)));
    }

    fn choice(&mut self, at: Index, branches: &[(Option<Code>, Vec<ScxmlAction>)], indent: usize) {
        let Some(((condition, actions), rest)) = branches.split_first() else { return };
        let Some(condition) = condition else {
            // `else`: its actions are written in place.
            return self.actions(at, actions, indent);
        };
        let Some(condition) = self.expression(at, condition) else { return };
        let condition = condition.truth().map_or_else(|| condition.cel(), |truth| truth.to_string());
        self.line(indent, "- if:");
        self.line(indent + 2, &format!("cond: {}", quoted(&condition)));
        self.list("then", indent + 2, |writer| writer.actions(at, actions, indent + 3));
        if !rest.is_empty() {
            self.list("else", indent + 2, |writer| writer.choice(at, rest, indent + 3));
        }
    }

    /// Writes a key with a list that `items` writes, or an empty list.
    fn list(&mut self, key: &str, indent: usize, items: impl FnOnce(&mut Self)) {
        let before = self.out.len();
        self.line(indent, &format!("{key}:"));
        let after = self.out.len();
        items(self);
        if self.out.len() == after {
            self.out.truncate(before);
            self.line(indent, &format!("{key}: []"));
        }
    }

    /// Returns whether the actions after it are run.
    fn send(&mut self, at: Index, send: &ScxmlSend, indent: usize) -> bool {
        let Some(event) = self.text(at, &send.event) else { return true };
        let event = self.event(event.trim());
        let target = send.target.as_ref().and_then(|t| self.text(at, t));
        let kind = send.kind.as_ref().and_then(|t| self.text(at, t));
        let data = match &send.data.content {
            Some(ScxmlContent::Written(value)) => Some(json(value)),
            Some(ScxmlContent::Expr(code)) => self.expression(at, code).map(|value| value_of(&value)),
            None if send.data.fields.is_empty() => None,
            None => Some(self.fields(at, &send.data.fields)),
        };
        let delay = send.delay.as_ref().and_then(|t| self.text(at, t));
        let delay = delay.and_then(|text| {
            let milliseconds = milliseconds(&text);
            if milliseconds.is_none() {
                self.error(send.line, format!("`{text}` is not a delay: write `2s` or `100ms`"));
            }
            milliseconds.filter(|ms| *ms > 0.0)
        });
        let own = format!("#_scxml_{}", self.names.chart);
        match undeliverable(kind.as_deref(), target.as_deref().filter(|t| *t != own)) {
            Delivery::Error(error, why) => {
                let note = comment(&format!("`{event}` cannot be sent: {why}"));
                self.line(indent, &format!("- raise: {error}  # {note}"));
                return error != "error.execution";
            }
            Delivery::Internal => {
                if delay.is_some() {
                    self.error(send.line, "`<send>` to `#_internal` cannot be delayed");
                }
                let text = match data {
                    Some(data) => format!("- raise: {{event: {}, data: {data}}}", scalar(&event)),
                    None => format!("- raise: {}", scalar(&event)),
                };
                self.line(indent, &text);
            }
            Delivery::External => {
                let mut parts = vec![format!("event: {}", scalar(&event))];
                parts.extend(data.map(|d| format!("data: {d}")));
                if let Some(ms) = delay {
                    parts.push(format!("delay: {}", quoted(&duration(ms))));
                    parts.extend(send.id.as_ref().map(|id| format!("id: {}", scalar(id))));
                }
                match parts.as_slice() {
                    [_] => self.line(indent, &format!("- send: {}", scalar(&event))),
                    _ => self.line(indent, &format!("- send: {{{}}}", parts.join(", "))),
                }
            }
        }
        true
    }
}

/// The destination of a `<send>`.
enum Delivery {
    External,
    Internal,
    /// It cannot be sent: the error event that SCXML raises instead.
    Error(&'static str, String),
}

fn undeliverable(kind: Option<&str>, target: Option<&str>) -> Delivery {
    const PROCESSOR: [&str; 4] =
        ["", "scxml", "http://www.w3.org/TR/scxml/#SCXMLEventProcessor", "http://www.w3.org/TR/scxml/"];
    if let Some(kind) = kind.filter(|k| !PROCESSOR.contains(k)) {
        return Delivery::Error("error.execution", format!("there is no processor `{kind}`"));
    }
    match target.map(str::trim) {
        None | Some("") => Delivery::External,
        Some("#_internal") => Delivery::Internal,
        Some(session) if session.starts_with("#_") => {
            Delivery::Error("error.communication", format!("there is no session `{session}`"))
        }
        Some(other) => Delivery::Error("error.execution", format!("`{other}` is no target")),
    }
}

/// A delay as SCXML writes it (CSS 2 times), ms.
fn milliseconds(text: &str) -> Option<f64> {
    let text = text.trim();
    let (number, factor) = match text.strip_suffix("ms") {
        Some(number) => (number, 1.0),
        None => (text.strip_suffix('s')?, 1000.0),
    };
    let number: f64 = number.trim().trim_start_matches('+').parse().ok()?;
    (number.is_finite() && number >= 0.0).then_some(number * factor)
}

fn duration(ms: f64) -> String {
    if ms % 1000.0 == 0.0 { format!("{}s", ms / 1000.0) } else { format!("{ms}ms") }
}
