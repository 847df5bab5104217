//! From the YAML tree to the model: the actions of `enter`, `exit` and transitions.

use armarium_source::yaml::{Entries, Node, Yaml};
use armarium_source::{Remedy, Span, code};

use super::forms;
use super::model::{ActionKind, WrittenAction};
use super::read::{ChartReader, get};

fn actions() -> Vec<&'static str> {
    forms::ACTIONS.iter().map(|key| key.name).collect()
}

impl ChartReader<'_> {
    pub(super) fn actions(&mut self, node: Option<&Node>) -> Vec<WrittenAction> {
        let Some(node) = node else { return Vec::new() };
        match &node.value {
            Yaml::Null => Vec::new(),
            Yaml::List(items) => items.iter().filter_map(|n| self.action(n)).collect(),
            _ => self.action(node).into_iter().collect(),
        }
    }

    fn action(&mut self, node: &Node) -> Option<WrittenAction> {
        let Yaml::Map(entries) = &node.value else {
            self.text_as_an_action(node);
            return None;
        };
        let [(key, value)] = entries.as_slice() else {
            let message = format!("an action has one key, of {}", actions().join(", "));
            match entries.first() {
                Some((key, Node { value: Yaml::String(event), .. }))
                    if ["raise", "send"].contains(&key.text.as_str()) =>
                {
                    let others = entries.iter().skip(1).map(|(key, _)| format!("{}: ...", key.text));
                    let others = others.collect::<Vec<_>>().join(", ");
                    let help = format!("write `{{{}: {{event: {event}, {others}}}}}`", key.text);
                    self.error_help(code::FORM, node.span, &message, &help);
                }
                _ => self.error(code::FORM, node.span, message),
            }
            return None;
        };
        let kind = match key.text.as_str() {
            "assign" => ActionKind::Assign(self.entries(value).to_vec()),
            "raise" => self.raise(value)?,
            "send" => self.send(value)?,
            "cancel" => ActionKind::Cancel(self.text(value)?),
            "log" => ActionKind::Log(value.clone()),
            "if" => {
                let form = self.entries(value);
                self.known(form, forms::IF, "`if`");
                let condition = self.required(form, "cond", value.span, "`if` needs `cond`")?.clone();
                let then = self.actions(get(form, "then"));
                ActionKind::If { condition, then, otherwise: self.actions(get(form, "else")) }
            }
            "foreach" => {
                let form = self.entries(value);
                self.known(form, forms::FOREACH, "`foreach`");
                let (items, variable) = (get(form, "in"), get(form, "as").and_then(|n| self.text(n)));
                let (Some(items), Some(variable)) = (items.cloned(), variable) else {
                    self.error(code::MISSING_KEY, value.span, "`foreach` needs `in` and `as`");
                    return None;
                };
                self.name(&variable);
                ActionKind::Foreach { items, variable, body: self.actions(get(form, "do")) }
            }
            other => {
                let help = format!("actions: {}", actions().join(", "));
                let message = format!("there is no action `{other}`");
                self.findings.unknown(code::KEY, (key.span, other), message, actions(), Some(help));
                return None;
            }
        };
        Some(WrittenAction { span: value.span, kind })
    }

    /// `log hello` where `{log: hello}` is meant.
    fn text_as_an_action(&mut self, node: &Node) {
        let text = if let Yaml::String(text) = &node.value { text.trim() } else { "" };
        let (word, rest) = text.split_once([' ', ':']).unwrap_or((text, ""));
        let simple = ["raise", "send", "cancel", "log"].contains(&word) && !rest.trim().is_empty();
        let rest = rest.trim().trim_matches(['"', '\'']);
        let right = match word {
            "log" => format!("{{log: \"{rest}\"}}"),
            word => format!("{{{word}: {rest}}}"),
        };
        let help = match simple {
            true => format!("write `{right}`"),
            false => {
                format!("an action is a map with one key, as `{{log: hello}}`, of {}", actions().join(", "))
            }
        };
        let message = format!("an action is needed here, not {}", node.value.describe());
        self.error_help(code::FORM, node.span, &message, &help);
        if simple && !rest.contains(['"', '\\']) {
            self.findings.remedy(Remedy::replace(node.span, right));
        }
    }

    /// What stands under a key that must be there.
    pub(super) fn required<'n>(
        &mut self,
        form: &'n Entries,
        key: &str,
        at: Span,
        message: &str,
    ) -> Option<&'n Node> {
        let found = get(form, key);
        if found.is_none() {
            self.error(code::MISSING_KEY, at, message);
        }
        found
    }

    fn raise(&mut self, value: &Node) -> Option<ActionKind> {
        if let Yaml::String(_) = &value.value {
            return Some(ActionKind::Raise { event: self.text(value)?, data: None });
        }
        let form = self.entries(value);
        self.known(form, forms::RAISE, "`raise`");
        let event = self.required(form, "event", value.span, "`raise` needs `event`")?;
        let event = self.text(event)?;
        Some(ActionKind::Raise { event, data: get(form, "data").cloned() })
    }

    fn send(&mut self, value: &Node) -> Option<ActionKind> {
        if let Yaml::String(_) = &value.value {
            let event = self.text(value)?;
            return Some(ActionKind::Send { event, to: None, data: None, delay: None, id: None });
        }
        let form = self.entries(value);
        self.known(form, forms::SEND, "`send`");
        let event = self.required(form, "event", value.span, "`send` needs `event`")?;
        let event = self.text(event)?;
        Some(ActionKind::Send {
            event,
            to: get(form, "to").cloned(),
            data: get(form, "data").cloned(),
            delay: get(form, "delay").cloned(),
            id: get(form, "id").and_then(|n| self.text(n)),
        })
    }
}
