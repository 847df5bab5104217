//! From the YAML tree to the model: the forms of the language, and nothing that needs other files.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::{Entries, Named, Node, Yaml};
use armarium_source::{Findings, Key, Span, code, suggest};
use armarium_values::{Type, Unit};

use super::forms;
use super::model::{Chart, Kind};
use crate::skill::{Limits, Parameter};

/// Deepest nesting of states.
pub(crate) const MAX_LEVELS: usize = 60;

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

/// Whether a text can be the name of a state, an input or an output.
pub(crate) fn is_name(text: &str) -> bool {
    has_form(text) && !RESERVED.contains(&text)
}

fn has_form(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Reads a chart; what is wrong is added to `findings`, and what can be read is returned.
pub(crate) fn chart(node: &Node, findings: &mut Findings) -> Option<Chart> {
    let mut reader = Reader { findings, types: BTreeMap::new() };
    reader.chart(node)
}

pub(super) struct Reader<'f> {
    pub(super) findings: &'f mut Findings,
    types: BTreeMap<String, Type>,
}

pub(super) fn get<'n>(entries: &'n Entries, key: &str) -> Option<&'n Node> {
    entries.iter().find(|(k, _)| k.text == key).map(|(_, v)| v)
}

impl Reader<'_> {
    pub(super) fn error(&mut self, code: &'static str, span: Span, message: impl Into<String>) {
        self.findings.error(code, span, message);
    }

    pub(super) fn form(&mut self, node: &Node, expected: &str) {
        self.findings.form(node, expected);
    }

    pub(super) fn entries<'n>(&mut self, node: &'n Node) -> &'n Entries {
        self.findings.entries(node)
    }

    pub(super) fn known(&mut self, entries: &Entries, keys: &[Key], called: &str) {
        self.findings.known(entries, keys, called);
    }

    pub(super) fn text(&mut self, node: &Node) -> Option<Named> {
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

    pub(super) fn name(&mut self, name: &Named) {
        if !has_form(&name.text) {
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
        self.known(entries, forms::CHART, "a chart");
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
        let events = self.events(entries);
        let profiles = self.profiles(entries, &inputs);
        let description = self.words(entries, "description");
        let root = self.state(name.clone(), node.span, entries, 0, true)?;
        if matches!(root.kind, Kind::Atomic) {
            self.error(code::MISSING_KEY, name.span, "a chart has `states` with `initial`, or `parallel`");
        }
        let source = Arc::clone(&self.findings.source);
        Some(Chart { source, name: name.text, description, inputs, outputs, locals, events, profiles, root })
    }

    /// The events from outside, each with the type of its data where that is declared: named fields.
    fn events(&mut self, entries: &Entries) -> Vec<(Named, Option<Type>)> {
        let Some(node) = get(entries, "events") else { return Vec::new() };
        let mut events = Vec::new();
        for (event, node) in self.entries(node) {
            let mut data = None;
            if !matches!(node.value, Yaml::Null) {
                let form = self.entries(node);
                self.known(form, forms::EVENT, "an event");
                data = get(form, "data").map(|fields| {
                    let fields = self.entries(fields).iter();
                    let one = |(name, node): &(Named, Node)| {
                        let declared = self.declaration(name, node);
                        (declared.name, declared.ty)
                    };
                    Type::Record(fields.map(one).collect())
                });
            }
            events.push((event.clone(), data));
        }
        events
    }

    fn declare_types(&mut self, entries: &Entries) {
        let Some(types) = get(entries, "types") else { return };
        for (key, node) in self.entries(types) {
            self.name(key);
            let form = self.entries(node);
            self.known(form, forms::TYPE, "a type");
            let words = get(form, "enum").map(|n| &n.value);
            let Some(Yaml::List(items)) = words else {
                self.error(code::FORM, node.span, "a type is declared as `{enum: [word, ...]}`");
                continue;
            };
            let words = items.iter().filter_map(|n| self.text(n)).map(|n| n.text).collect();
            self.types.insert(key.text.clone(), Type::Enum(words));
        }
    }

    fn profiles(&mut self, entries: &Entries, inputs: &[Parameter]) -> BTreeMap<String, Vec<(Named, Node)>> {
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
                        if let Err(error) = input.accept(value.literal()) {
                            self.error(code::TYPE, value.span, error.to_string());
                        }
                    }
                }
            }
            result.insert(name.text.clone(), values.to_vec());
        }
        result
    }

    fn declarations(&mut self, entries: &Entries, key: &str) -> Vec<Parameter> {
        let Some(node) = get(entries, key) else { return Vec::new() };
        self.entries(node).iter().map(|(name, node)| self.declaration(name, node)).collect()
    }

    fn declaration(&mut self, name: &Named, node: &Node) -> Parameter {
        self.name(name);
        let short;
        let entries = if let Yaml::String(_) = &node.value {
            short = vec![(Named { span: node.span, text: "type".into() }, node.clone())];
            &short[..]
        } else {
            self.entries(node)
        };
        self.known(entries, forms::DECLARATION, "a declaration");
        let ty = self.declared_type(name, entries);
        let mut result = Parameter::new(&name.text, ty, &self.words(entries, "description"));
        result.minimum = self.bound(entries, "minimum", &result.ty);
        result.maximum = self.bound(entries, "maximum", &result.ty);
        if let Some(default) = get(entries, "default") {
            match result.accept(default.literal()) {
                Ok(value) => result.default = Some(value),
                Err(error) => self.error(code::TYPE, default.span, error.to_string()),
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
        match ty.convert(node.literal()) {
            Ok(value) => value.as_f64(),
            Err(error) => {
                self.error(code::TYPE, node.span, error.to_string());
                None
            }
        }
    }

    pub(super) fn duration(&mut self, node: &Node) -> Option<f64> {
        match Type::Duration.convert(node.literal()) {
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

    pub(super) fn limits(&mut self, entries: &Entries) -> Limits {
        let Some(node) = get(entries, "limits") else { return Limits::default() };
        let entries = self.entries(node);
        self.known(entries, forms::LIMITS, "`limits`");
        let mut quantity = |key: &str, unit: Unit| {
            let node = get(entries, key)?;
            let value = Type::quantity(unit).convert(node.literal());
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
}
