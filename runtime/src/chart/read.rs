//! From the YAML tree to the model: the forms of the language, and nothing that needs other files.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::{Type, Unit, Value};

use super::finding::{Findings, Span, code, suggest};
use super::model::{Action, ActionKind, Chart, Declaration, Kind, Retry, State, Transition, Watch};
use super::yaml::{Named, Node, Yaml};
use crate::skill::Limits;

/// Deepest nesting of states.
pub(crate) const MAX_LEVELS: usize = 60;

const STATE_KEYS: &[&str] = &[
    "description",
    "skill",
    "statechart",
    "remote",
    "states",
    "initial",
    "parallel",
    "final",
    "history",
    "default",
    "with",
    "enter",
    "exit",
    "watch",
    "after",
    "always",
    "transitions",
    "retry",
    "limits",
    "unbreakable",
];
const CHART_KEYS: &[&str] = &[
    "statechart",
    "description",
    "inputs",
    "outputs",
    "locals",
    "types",
    "events",
    "profiles",
    "limits",
    "initial",
    "states",
    "parallel",
    "enter",
    "exit",
    "watch",
    "after",
    "always",
    "transitions",
];
const RESERVED: &[&str] = &[
    "inputs",
    "locals",
    "outputs",
    "event",
    "channels",
    "true",
    "false",
    "null",
    "in",
    "as",
    "break",
    "const",
    "continue",
    "else",
    "for",
    "function",
    "if",
    "import",
    "let",
    "loop",
    "package",
    "namespace",
    "return",
    "var",
    "void",
    "while",
];

/// Reads a chart; what is wrong is added to `findings`, and what can be read is returned.
pub(crate) fn chart(node: &Node, findings: &mut Findings) -> Option<Chart> {
    let mut reader = Reader { findings, types: BTreeMap::new() };
    reader.chart(node)
}

struct Reader<'f> {
    findings: &'f mut Findings,
    types: BTreeMap<String, Type>,
}

type Entries = [(Named, Node)];

fn get<'n>(entries: &'n Entries, key: &str) -> Option<&'n Node> {
    entries.iter().find(|(k, _)| k.text == key).map(|(_, v)| v)
}

impl Reader<'_> {
    fn error(&mut self, code: &'static str, span: Span, message: impl Into<String>) {
        self.findings.error(code, span, message);
    }

    fn form(&mut self, node: &Node, expected: &str) {
        let message = format!("{expected} is needed here, not {}", node.value.describe());
        self.error(code::FORM, node.span, message);
    }

    fn entries<'n>(&mut self, node: &'n Node) -> &'n Entries {
        match &node.value {
            Yaml::Map(entries) => entries,
            Yaml::Null => &[],
            _ => {
                self.form(node, "a map");
                &[]
            }
        }
    }

    fn known(&mut self, entries: &Entries, keys: &[&str], of: &str) {
        for (key, _) in entries.iter().filter(|(key, _)| !keys.contains(&key.text.as_str())) {
            let help = suggest(&key.text, keys.iter().copied())
                .unwrap_or_else(|| format!("{of} has the keys {}", keys.join(", ")));
            let message = format!("{of} has no key `{}`", key.text);
            self.findings.error_help(code::KEY, key.span, message, Some(help));
        }
    }

    fn text(&mut self, node: &Node) -> Option<Named> {
        match &node.value {
            Yaml::String(s) => Some(Named { span: node.span, text: s.clone() }),
            _ => {
                self.form(node, "text");
                None
            }
        }
    }

    fn words(&mut self, entries: &Entries, key: &str) -> String {
        get(entries, key).and_then(|n| self.text(n)).map_or_else(String::new, |n| n.text)
    }

    fn name(&mut self, name: &Named) {
        let ok = name.text.chars().next().is_some_and(|c| c.is_alphabetic() || c == '_')
            && name.text.chars().all(|c| c.is_alphanumeric() || c == '_');
        if !ok {
            let message = format!("`{}` is not a name: letters, digits and `_`, no digit first", name.text);
            self.error(code::NAME, name.span, message);
        } else if RESERVED.contains(&name.text.as_str()) {
            self.error(code::NAME, name.span, format!("`{}` is a word of the language", name.text));
        }
    }

    fn chart(&mut self, node: &Node) -> Option<Chart> {
        let Yaml::Map(entries) = &node.value else {
            self.form(node, "a chart (a map with the key `statechart`)");
            return None;
        };
        self.known(entries, CHART_KEYS, "a chart");
        let Some(name) = get(entries, "statechart").and_then(|n| self.text(n)) else {
            if get(entries, "statechart").is_none() {
                self.error(code::MISSING_KEY, node.span, "a chart begins with `statechart: Name`");
            }
            return None;
        };
        self.name(&name);
        self.declare_types(entries);
        let inputs = self.declarations(entries, "inputs");
        let outputs = self.declarations(entries, "outputs");
        let locals = self.declarations(entries, "locals");
        let events = get(entries, "events")
            .map_or_else(Vec::new, |n| self.entries(n).iter().map(|(key, _)| key.clone()).collect());
        let profiles = self.profiles(entries, &inputs);
        let description = self.words(entries, "description");
        let root = self.state(name.clone(), node.span, entries, 0, true)?;
        if matches!(root.kind, Kind::Atomic) {
            self.error(code::MISSING_KEY, name.span, "a chart has `states` with `initial`, or `parallel`");
        }
        let source = Arc::clone(&self.findings.source);
        Some(Chart { source, name: name.text, description, inputs, outputs, locals, events, profiles, root })
    }

    fn declare_types(&mut self, entries: &Entries) {
        let Some(types) = get(entries, "types") else { return };
        for (key, node) in self.entries(types) {
            self.name(key);
            let form = self.entries(node);
            self.known(form, &["enum", "description"], "a type");
            let words = get(form, "enum").map(|n| &n.value);
            let Some(Yaml::List(items)) = words else {
                self.error(code::FORM, node.span, "a type is declared as `{enum: [word, ...]}`");
                continue;
            };
            let words = items.iter().filter_map(|n| self.text(n)).map(|n| n.text).collect();
            self.types.insert(key.text.clone(), Type::Enum(words));
        }
    }

    fn profiles(
        &mut self,
        entries: &Entries,
        inputs: &[Declaration],
    ) -> BTreeMap<String, Vec<(Named, Node)>> {
        let Some(profiles) = get(entries, "profiles") else { return BTreeMap::new() };
        let mut result = BTreeMap::new();
        for (name, node) in self.entries(profiles) {
            let values = self.entries(node);
            for (key, value) in values {
                match inputs.iter().find(|i| i.name == key.text) {
                    None => {
                        let help = suggest(&key.text, inputs.iter().map(|i| i.name.as_str()));
                        let message = format!("the chart has no input `{}`", key.text);
                        self.findings.error_help(code::INPUT, key.span, message, help);
                    }
                    Some(input) => {
                        if let Err(message) = input.accept(literal(value)) {
                            self.error(code::TYPE, value.span, message);
                        }
                    }
                }
            }
            result.insert(name.text.clone(), values.to_vec());
        }
        result
    }

    fn declarations(&mut self, entries: &Entries, key: &str) -> Vec<Declaration> {
        let Some(node) = get(entries, key) else { return Vec::new() };
        self.entries(node).iter().map(|(name, node)| self.declaration(name, node)).collect()
    }

    fn declaration(&mut self, name: &Named, node: &Node) -> Declaration {
        self.name(name);
        let short;
        let entries = if let Yaml::String(_) = &node.value {
            short = vec![(Named { span: node.span, text: "type".into() }, node.clone())];
            &short[..]
        } else {
            self.entries(node)
        };
        let keys = ["type", "unit", "default", "minimum", "maximum", "description", "enum"];
        self.known(entries, &keys, "a declaration");
        let mut result = Declaration {
            name: name.text.clone(),
            ty: self.declared_type(name, entries),
            default: None,
            minimum: None,
            maximum: None,
            description: self.words(entries, "description"),
            span: name.span,
        };
        result.minimum = self.bound(entries, "minimum", &result.ty);
        result.maximum = self.bound(entries, "maximum", &result.ty);
        if let Some(default) = get(entries, "default") {
            match result.accept(literal(default)) {
                Ok(value) => result.default = Some(value),
                Err(message) => self.error(code::TYPE, default.span, message),
            }
        }
        result
    }

    fn declared_type(&mut self, name: &Named, entries: &Entries) -> Type {
        if let Some(Yaml::List(items)) = get(entries, "enum").map(|n| &n.value) {
            return Type::Enum(items.iter().filter_map(|n| self.text(n)).map(|n| n.text).collect());
        }
        let Some(node) = get(entries, "type") else {
            self.error(code::MISSING_KEY, name.span, format!("`{}` needs a `type`", name.text));
            return Type::Any;
        };
        let Some(text) = self.text(node) else { return Type::Any };
        let Some(ty) = Type::parse(&text.text, &|t| self.types.get(t).cloned()) else {
            let known = [
                "bool",
                "int",
                "float",
                "string",
                "duration",
                "any",
                "list<float>",
                "map<float>",
                "Vector",
                "Pose",
                "Wrench",
                "Motion",
                "Object",
            ];
            let candidates = known.into_iter().chain(self.types.keys().map(String::as_str));
            let help =
                suggest(&text.text, candidates).unwrap_or_else(|| format!("types are {}", known.join(", ")));
            let message = format!("there is no type `{}`", text.text);
            self.findings.error_help(code::DECLARED_TYPE, text.span, message, Some(help));
            return Type::Any;
        };
        let Some(unit) = get(entries, "unit").and_then(|n| self.text(n)) else { return ty };
        match (Unit::parse(&unit.text), ty) {
            (Ok((si, 1.0)), Type::Float(_)) => Type::Float(Some(si)),
            (Ok((si, _)), ty @ Type::Float(_)) => {
                let help = Some(format!("write `unit: {si}`; values may be given in `{}`", unit.text));
                self.findings.error_help(code::UNIT, unit.span, "declared units are SI", help);
                ty
            }
            (Ok(_), ty) => {
                self.error(code::UNIT, unit.span, format!("{ty} has no unit, only float has"));
                ty
            }
            (Err(unknown), ty) => {
                self.error(code::UNIT, unit.span, unknown.to_string());
                ty
            }
        }
    }

    fn bound(&mut self, entries: &Entries, key: &str, ty: &Type) -> Option<f64> {
        let node = get(entries, key)?;
        match ty.convert(literal(node)) {
            Ok(value) => value.as_f64(),
            Err(error) => {
                self.error(code::TYPE, node.span, error.to_string());
                None
            }
        }
    }

    fn duration(&mut self, node: &Node) -> Option<f64> {
        match Type::Duration.convert(literal(node)) {
            Ok(value) => value.as_f64().filter(|s| s.is_finite() && *s >= 0.0).or_else(|| {
                self.error(code::TYPE, node.span, "a duration is not negative");
                None
            }),
            Err(error) => {
                self.error(code::TYPE, node.span, error.to_string());
                None
            }
        }
    }

    fn limits(&mut self, entries: &Entries) -> Limits {
        let Some(node) = get(entries, "limits") else { return Limits::default() };
        let entries = self.entries(node);
        self.known(entries, &["force", "speed"], "`limits`");
        let mut quantity = |key: &str, unit: Unit| {
            let node = get(entries, key)?;
            let value = Type::quantity(unit).convert(literal(node));
            match value.map(|v| v.as_f64()) {
                Ok(Some(v)) if v > 0.0 && v.is_finite() => Some(v),
                Ok(_) => {
                    self.findings.error(code::TYPE, node.span, "a limit is greater than 0");
                    None
                }
                Err(error) => {
                    self.findings.error(code::UNIT, node.span, error.to_string());
                    None
                }
            }
        };
        Limits { force_n: quantity("force", Unit::N), speed_m_s: quantity("speed", Unit::M_S) }
    }

    fn state(
        &mut self,
        name: Named,
        span: Span,
        entries: &Entries,
        level: usize,
        root: bool,
    ) -> Option<State> {
        if level > MAX_LEVELS {
            self.error(code::LIMIT, name.span, format!("states are nested deeper than {MAX_LEVELS} levels"));
            return None;
        }
        if !root {
            self.name(&name);
            self.known(entries, STATE_KEYS, "a state");
        }
        let kind = self.kind(&name, span, entries, level, root);
        let unbreakable = match get(entries, "unbreakable").map(|n| (&n.value, n.span)) {
            None | Some((Yaml::Bool(false), _)) => false,
            Some((Yaml::Bool(true), _)) => true,
            Some((_, at)) => {
                self.error(code::FORM, at, "`true` or `false` is needed here");
                false
            }
        };
        Some(State {
            kind,
            with: get(entries, "with").map_or_else(Vec::new, |n| self.entries(n).to_vec()),
            enter: self.actions(get(entries, "enter")),
            exit: self.actions(get(entries, "exit")),
            watch: self.watches(entries),
            after: self.after(entries),
            always: get(entries, "always").map_or_else(Vec::new, |n| self.transition_list(n, None)),
            transitions: self.transitions(entries),
            retry: self.retry(entries),
            limits: self.limits(entries),
            unbreakable,
            name,
        })
    }

    fn kind(&mut self, name: &Named, span: Span, entries: &Entries, level: usize, root: bool) -> Kind {
        const KINDS: [&str; 7] = ["skill", "statechart", "remote", "states", "parallel", "final", "history"];
        let given: Vec<&(Named, Node)> = entries
            .iter()
            .filter(|(k, _)| KINDS.contains(&k.text.as_str()) && !(root && k.text == "statechart"))
            .collect();
        if let [(first, _), (second, _), ..] = given.as_slice() {
            let message = format!("a state is one thing: it has both `{}` and `{}`", first.text, second.text);
            self.error(code::KIND, second.span, message);
        }
        let Some((key, node)) = given.first() else { return Kind::Atomic };
        match key.text.as_str() {
            "states" => {
                let states = self.states(node, level);
                let Some(initial) = get(entries, "initial") else {
                    let span = if root { name.span } else { key.span };
                    self.error(code::MISSING_KEY, span, "`states` needs `initial: Name`");
                    return Kind::Atomic;
                };
                match self.text(initial) {
                    Some(initial) => Kind::Composite { initial, states },
                    None => Kind::Atomic,
                }
            }
            "parallel" => Kind::Parallel(self.states(node, level)),
            "history" => {
                let default = get(entries, "default").and_then(|n| self.text(n));
                let form = self.text(node);
                match form.as_ref().map(|f| f.text.as_str()) {
                    Some("shallow" | "deep") | None => {}
                    Some(_) => self.error(code::FORM, node.span, "history is `shallow` or `deep`"),
                }
                if default.is_none() {
                    self.error(code::MISSING_KEY, span, "history needs `default: Target`");
                }
                Kind::History { deep: form.is_some_and(|f| f.text == "deep"), default }
            }
            key => match (key, self.text(node)) {
                ("skill", Some(name)) => Kind::Skill(name),
                ("statechart", Some(name)) => Kind::Chart(name),
                ("remote", Some(name)) => Kind::Remote(name),
                ("final", Some(outcome)) => Kind::Final(outcome),
                _ => Kind::Atomic,
            },
        }
    }

    fn states(&mut self, node: &Node, level: usize) -> Vec<State> {
        let mut states = Vec::new();
        for (name, node) in self.entries(node) {
            let entries = self.entries(node);
            states.extend(self.state(name.clone(), node.span, entries, level + 1, false));
        }
        states
    }

    fn retry(&mut self, entries: &Entries) -> Option<Retry> {
        let node = get(entries, "retry")?;
        let entries = self.entries(node);
        self.known(entries, &["times", "wait"], "`retry`");
        let times = match get(entries, "times").map(|n| (&n.value, n.span)) {
            Some((Yaml::Int(n), _)) if (0..=1_000_000).contains(n) => u32::try_from(*n).unwrap_or(0),
            Some((_, span)) => {
                self.error(code::FORM, span, "a number of times is needed here");
                0
            }
            None => 1,
        };
        let wait_s = get(entries, "wait").and_then(|n| self.duration(n)).unwrap_or(0.0);
        Some(Retry { times, wait_s })
    }

    fn watches(&mut self, entries: &Entries) -> Vec<Watch> {
        let Some(node) = get(entries, "watch") else { return Vec::new() };
        let mut watches = Vec::new();
        for (name, node) in self.entries(node) {
            self.name(name);
            let short;
            let form = if let Yaml::String(_) = &node.value {
                short = vec![(Named { span: node.span, text: "if".into() }, node.clone())];
                &short[..]
            } else {
                self.entries(node)
            };
            self.known(form, &["if", "for", "until"], "a watch");
            let Some(condition) = get(form, "if") else {
                self.error(code::MISSING_KEY, name.span, "a watch needs `if: condition`");
                continue;
            };
            let hold_s = get(form, "for").and_then(|n| self.duration(n)).unwrap_or(0.0);
            let until = get(form, "until").cloned();
            watches.push(Watch { name: name.clone(), condition: condition.clone(), hold_s, until });
        }
        watches
    }

    fn after(&mut self, entries: &Entries) -> Vec<Transition> {
        let Some(node) = get(entries, "after") else { return Vec::new() };
        let mut result = Vec::new();
        match &node.value {
            Yaml::List(items) => {
                for item in items {
                    let form = self.entries(item);
                    self.known(form, &["for", "if", "target", "do", "with"], "a timed transition");
                    let Some(delay) = get(form, "for") else {
                        self.error(code::MISSING_KEY, item.span, "a timed transition needs `for: duration`");
                        continue;
                    };
                    let mut transition = self.transition(item, None, true);
                    transition.delay = Some(delay.clone());
                    result.push(transition);
                }
            }
            _ => {
                for (key, node) in self.entries(node) {
                    let delay = Node { span: key.span, value: Yaml::String(key.text.clone()) };
                    for mut transition in self.transition_list(node, None) {
                        transition.delay = Some(delay.clone());
                        result.push(transition);
                    }
                }
            }
        }
        result
    }

    fn transitions(&mut self, entries: &Entries) -> Vec<Transition> {
        let Some(node) = get(entries, "transitions") else { return Vec::new() };
        let mut result = Vec::new();
        for (event, node) in self.entries(node) {
            let pattern = event.text.strip_suffix(".*").unwrap_or(&event.text);
            if event.text != "*"
                && (pattern.is_empty() || pattern.split('.').any(|t| t.is_empty() || t == "*"))
            {
                self.error(code::NAME, event.span, format!("`{}` is not the name of an event", event.text));
            }
            result.extend(self.transition_list(node, Some(event)));
        }
        result
    }

    fn transition_list(&mut self, node: &Node, event: Option<&Named>) -> Vec<Transition> {
        match &node.value {
            Yaml::List(items) => items.iter().map(|n| self.transition(n, event, false)).collect(),
            _ => vec![self.transition(node, event, false)],
        }
    }

    fn transition(&mut self, node: &Node, event: Option<&Named>, timed: bool) -> Transition {
        let mut result = Transition {
            span: event.map_or(node.span, |e| e.span),
            event: event.cloned(),
            delay: None,
            target: None,
            guard: None,
            actions: Vec::new(),
            with: Vec::new(),
        };
        if let Yaml::String(target) = &node.value {
            result.target = Some(Named { span: node.span, text: target.clone() });
            return result;
        }
        let Yaml::Map(entries) = &node.value else {
            self.form(node, "a target, or `{target, if, do, with}`, or a list of these");
            return result;
        };
        if !timed {
            self.known(entries, &["target", "if", "do", "with"], "a transition");
        }
        result.target = get(entries, "target").and_then(|n| self.text(n));
        result.guard = get(entries, "if").cloned();
        result.actions = self.actions(get(entries, "do"));
        result.with = get(entries, "with").map_or_else(Vec::new, |n| self.entries(n).to_vec());
        result
    }

    fn actions(&mut self, node: Option<&Node>) -> Vec<Action> {
        let Some(node) = node else { return Vec::new() };
        match &node.value {
            Yaml::Null => Vec::new(),
            Yaml::List(items) => items.iter().filter_map(|n| self.action(n)).collect(),
            _ => self.action(node).into_iter().collect(),
        }
    }

    fn action(&mut self, node: &Node) -> Option<Action> {
        const ACTIONS: [&str; 7] = ["assign", "raise", "send", "cancel", "log", "if", "foreach"];
        let Yaml::Map(entries) = &node.value else {
            self.form(node, "an action");
            return None;
        };
        let [(key, value)] = entries.as_slice() else {
            let message = format!("an action has one key, of {}", ACTIONS.join(", "));
            self.error(code::FORM, node.span, message);
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
                self.known(form, &["cond", "then", "else"], "`if`");
                let Some(condition) = get(form, "cond").cloned() else {
                    self.error(code::MISSING_KEY, value.span, "`if` needs `cond`");
                    return None;
                };
                let then = self.actions(get(form, "then"));
                ActionKind::If { condition, then, otherwise: self.actions(get(form, "else")) }
            }
            "foreach" => {
                let form = self.entries(value);
                self.known(form, &["in", "as", "do"], "`foreach`");
                let (items, variable) = (get(form, "in"), get(form, "as").and_then(|n| self.text(n)));
                let (Some(items), Some(variable)) = (items.cloned(), variable) else {
                    self.error(code::MISSING_KEY, value.span, "`foreach` needs `in` and `as`");
                    return None;
                };
                self.name(&variable);
                ActionKind::Foreach { items, variable, body: self.actions(get(form, "do")) }
            }
            other => {
                let help =
                    suggest(other, ACTIONS).unwrap_or_else(|| format!("actions: {}", ACTIONS.join(", ")));
                let message = format!("there is no action `{other}`");
                self.findings.error_help(code::KEY, key.span, message, Some(help));
                return None;
            }
        };
        Some(Action { span: value.span, kind })
    }

    fn raise(&mut self, value: &Node) -> Option<ActionKind> {
        if let Yaml::String(_) = &value.value {
            return Some(ActionKind::Raise { event: self.text(value)?, data: None });
        }
        let form = self.entries(value);
        self.known(form, &["event", "data"], "`raise`");
        let event = get(form, "event").and_then(|n| self.text(n));
        let Some(event) = event else {
            self.error(code::MISSING_KEY, value.span, "`raise` needs `event`");
            return None;
        };
        Some(ActionKind::Raise { event, data: get(form, "data").cloned() })
    }

    fn send(&mut self, value: &Node) -> Option<ActionKind> {
        if let Yaml::String(_) = &value.value {
            let event = self.text(value)?;
            return Some(ActionKind::Send { event, to: None, data: None, delay: None, id: None });
        }
        let form = self.entries(value);
        self.known(form, &["event", "to", "data", "delay", "id"], "`send`");
        let event = get(form, "event").and_then(|n| self.text(n));
        let Some(event) = event else {
            self.error(code::MISSING_KEY, value.span, "`send` needs `event`");
            return None;
        };
        Some(ActionKind::Send {
            event,
            to: get(form, "to").cloned(),
            data: get(form, "data").cloned(),
            delay: get(form, "delay").cloned(),
            id: get(form, "id").and_then(|n| self.text(n)),
        })
    }
}

/// A YAML value as a literal; `${` is not looked at.
pub(crate) fn literal(node: &Node) -> Value {
    match &node.value {
        Yaml::Null => Value::Null,
        Yaml::Bool(b) => Value::Bool(*b),
        Yaml::Int(i) => Value::Int(*i),
        Yaml::Float(f) => Value::Float(*f),
        Yaml::String(s) => Value::String(s.clone()),
        Yaml::List(items) => Value::List(items.iter().map(literal).collect()),
        Yaml::Map(entries) => Value::Map(entries.iter().map(|(k, v)| (k.text.clone(), literal(v))).collect()),
    }
}
