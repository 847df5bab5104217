//! From the YAML tree to the model: the forms of the language, and nothing that needs other files.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::{Entries, Named, Node, Yaml};
use armarium_source::{Edit, Findings, FormKey, Remedy, Span, code};
use armarium_values::{Type, Unit};

use super::catalog::ChannelDescription;
use super::literals::{literal, negative_time};
use super::model::{Chart, DeclaredChannel, WrittenKind, WrittenPattern};
use super::symbols::HeadSection;
use super::{foreign, forms};
use crate::observed::{MAX_OBSERVED, MemoryPattern};
use crate::skill::{Limits, Parameter};

/// Deepest nesting of states.
pub(crate) const MAX_LEVELS: usize = 60;

/// The keys that other kinds of files begin with, and what those are.
const OTHER_KINDS: [(&str, &str); 4] = [
    ("world", "a world"),
    ("test", "a file of test cases"),
    ("scene", "a scene of prior knowledge"),
    ("object", "an object class of prior knowledge"),
];

/// Words of the language and of CEL, which are no names.
const RESERVED: &str = "inputs locals outputs event channels true false null in as break const continue else for function if import \
                        let loop package namespace return var void while";

/// What other languages call types.
const TYPES_ELSEWHERE: [(&str, &str); 15] = [
    ("integer", "int"),
    ("long", "int"),
    ("number", "float"),
    ("double", "float"),
    ("real", "float"),
    ("str", "string"),
    ("text", "string"),
    ("boolean", "bool"),
    ("time", "duration"),
    ("list", "list<any>"),
    ("array", "list<any>"),
    ("map", "map<any>"),
    ("dict", "map<any>"),
    ("object", "map<any>"),
    ("json", "any"),
];

/// Whether a text can be the name of a state, an input or an output.
#[must_use]
pub fn is_name(text: &str) -> bool {
    has_form(text) && !is_reserved(text)
}

fn is_reserved(text: &str) -> bool {
    RESERVED.split(' ').any(|word| word == text)
}

fn has_form(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Reads a chart; what is wrong is added to `findings`, and what can be read is returned.
pub(crate) fn chart(node: &Node, findings: &mut Findings) -> Option<Chart> {
    let mut reader = ChartReader { findings, types: BTreeMap::new(), type_uses: Vec::new() };
    reader.chart(node)
}

pub(super) struct ChartReader<'f> {
    pub(super) findings: &'f mut Findings,
    types: BTreeMap<String, Type>,
    /// Where those types are named.
    type_uses: Vec<Named>,
}

pub(super) fn get<'n>(entries: &'n Entries, key: &str) -> Option<&'n Node> {
    entries.iter().find(|(k, _)| k.text == key).map(|(_, v)| v)
}

/// Whether a form has every key. Where it has not, what seems to be missing may be what is misspelt.
pub(super) fn only_known(entries: &Entries, keys: &[FormKey]) -> bool {
    entries.iter().all(|(entry, _)| keys.iter().any(|key| key.name == entry.text))
}

impl ChartReader<'_> {
    pub(super) fn error(&mut self, code: &'static str, span: Span, message: impl Into<String>) {
        self.findings.error(code, span, message);
    }

    pub(super) fn error_help(&mut self, code: &'static str, span: Span, message: &str, help: &str) {
        self.findings.error_help(code, span, message, Some(help.to_owned()));
    }

    pub(super) fn form(&mut self, node: &Node, expected: &str) {
        self.findings.form(node, expected);
    }

    pub(super) fn entries<'n>(&mut self, node: &'n Node) -> &'n Entries {
        self.findings.entries(node)
    }

    pub(super) fn known(&mut self, entries: &Entries, keys: &[FormKey], called: &str) {
        self.findings.known_or(entries, keys, called, |key, node| foreign::meant(key, node, keys));
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

    pub(super) fn words(&mut self, entries: &Entries, key: &str) -> String {
        get(entries, key).and_then(|n| self.text(n)).map_or_else(String::new, |n| n.text)
    }

    pub(super) fn name(&mut self, name: &Named) {
        if !has_form(&name.text) {
            let message = format!("`{}` is not a name: letters, digits and `_`, no digit first", name.text);
            let word = |c: char| if c.is_alphanumeric() { c } else { '_' };
            let meant: String = name.text.trim().chars().map(word).collect();
            let meant =
                if meant.starts_with(|c: char| c.is_ascii_digit()) { format!("_{meant}") } else { meant };
            let help = is_name(&meant).then(|| format!("write `{meant}`, here and where it is used"));
            self.findings.error_help(code::NAME, name.span, message, help);
        } else if is_reserved(&name.text) {
            self.error(code::NAME, name.span, format!("`{}` is a word of the language", name.text));
        }
    }

    fn chart(&mut self, node: &Node) -> Option<Chart> {
        let Yaml::Map(entries) = &node.value else {
            if self.findings.source.text.trim_start().starts_with('<') {
                let help = "`armarium import FILE` makes a chart of SCXML";
                self.error_help(code::FORM, node.span, "this is XML, where a chart in YAML is needed", help);
            } else {
                self.form(node, "a chart (a map with the key `statechart`)");
            }
            return None;
        };
        match get(entries, "statechart") {
            None => {
                let other = OTHER_KINDS.iter().find_map(|(key, what)| Some((node.get(key)?, key, what)));
                match other {
                    Some((_, key, what)) => {
                        let message = format!("this is {what}, where a chart is needed");
                        self.error(code::FORM, node.place(key), message);
                    }
                    None => {
                        let help = foreign::whole(|key| get(entries, key).is_some()).map(str::to_owned);
                        let message = "a chart begins with `statechart: Name`";
                        self.findings.error_help(code::MISSING_KEY, node.span, message, help);
                    }
                }
                return None;
            }
            Some(node) if matches!(node.value, Yaml::Map(_)) => {
                let help = "in Armarium this is `statechart: Name`, and its keys stand beside it";
                self.error_help(code::FORM, node.span, "the name of the chart is needed here", help);
                return None;
            }
            Some(_) => {}
        }
        self.known(entries, forms::CHART, "a chart");
        let name = get(entries, "statechart").and_then(|n| self.text(n))?;
        self.name(&name);
        self.declare_types(entries);
        let inputs = self.declarations(entries, "inputs");
        let outputs = self.declarations(entries, "outputs");
        let locals = self.declarations(entries, "locals");
        let events = self.events(entries);
        let channels = self.channels(entries);
        let observed = self.observed(entries);
        let profiles = self.profiles(entries, &inputs);
        let probes = get(entries, "probes").map_or(&[][..], Node::items);
        let probes = probes.iter().filter_map(|node| self.text(node)).collect();
        let root = self.state(name.clone(), node.span, entries, 0, true)?;
        if matches!(root.kind, WrittenKind::Atomic) && only_known(entries, forms::CHART) {
            self.error(code::MISSING_KEY, name.span, "a chart has `states` with `initial`, or `parallel`");
        }
        let source = Arc::clone(&self.findings.source);
        let description = root.description.clone();
        let (declared, type_uses) = (declared(entries), std::mem::take(&mut self.type_uses));
        let name = name.text;
        Some(Chart {
            source,
            name,
            description,
            inputs,
            outputs,
            locals,
            declared,
            type_uses,
            events,
            channels,
            observed,
            profiles,
            probes,
            defaults: defaults(entries),
            root,
        })
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
            // Their meaning is given, and a pattern names no event.
            let given = matches!(event.text.as_str(), "success" | "failure")
                || event.text.contains('*')
                || ["done.state.", "error."].iter().any(|start| event.text.starts_with(start));
            if given {
                let message = format!("`{}` cannot be an event from outside", event.text);
                let help = "outcomes, `done.state.NAME` and `error...` come from the chart itself, and `*` stands for \
                    several events: declare each by its name";
                self.error_help(code::NAME, event.span, &message, help);
                self.findings.remedy(Remedy::Remove(event.span));
                continue;
            }
            events.push((event.clone(), data));
        }
        events
    }

    /// The channels of the chart's own skills: each with named fields, or of one type.
    fn channels(&mut self, entries: &Entries) -> Vec<DeclaredChannel> {
        let Some(node) = get(entries, "channels") else { return Vec::new() };
        let mut channels = Vec::new();
        for (name, node) in self.entries(node) {
            self.name(name);
            let fields = match node.get("type") {
                Some(fields) if matches!(fields.value, Yaml::Map(_)) => self.entries(fields),
                _ => &[],
            };
            let described = if fields.is_empty() {
                let one = self.declaration_of(name, node, forms::CHANNEL, "a channel");
                ChannelDescription { ty: one.ty, ..ChannelDescription::new(&name.text, &one.description) }
            } else {
                let form = self.entries(node);
                self.known(form, forms::CHANNEL, "a channel");
                let described = ChannelDescription::new(&name.text, &self.words(form, "description"));
                let fields = fields.iter().map(|(name, node)| self.declaration(name, node));
                described.with_fields(fields.collect())
            };
            let fields = fields.iter().map(|(name, _)| name.clone()).collect();
            channels.push(DeclaredChannel { name: name.clone(), fields, described });
        }
        channels
    }

    /// What the chart observes of memory: a name and a pattern of addresses.
    fn observed(&mut self, entries: &Entries) -> Vec<WrittenPattern> {
        let Some(node) = get(entries, "observe") else { return Vec::new() };
        let mut observed = Vec::new();
        for (name, node) in self.entries(node) {
            self.name(name);
            let Some(text) = self.text(node) else { continue };
            if observed.len() >= MAX_OBSERVED {
                let message = format!("a chart observes at most {MAX_OBSERVED} patterns");
                self.error(code::LIMIT, name.span, message);
                break;
            }
            // What is wrong with a pattern is no mistake of those who read its name.
            let pattern = self.pattern(&text).unwrap_or_else(MemoryPattern::any);
            observed.push(WrittenPattern { name: name.clone(), span: node.span, pattern });
        }
        observed
    }

    fn pattern(&mut self, written: &Named) -> Option<MemoryPattern> {
        let error = match written.text.parse::<MemoryPattern>() {
            Ok(pattern) => return Some(pattern),
            Err(error) => error,
        };
        let parts: Vec<&str> = written.text.split('/').filter(|part| !part.is_empty()).collect();
        let meant = match parts.as_slice() {
            [segment] => Some(format!("{segment}/*/*")),
            [segment, entity] => Some(format!("{segment}/*/{entity}")),
            _ => None,
        };
        let meant = meant.filter(|meant| meant.parse::<MemoryPattern>().is_ok());
        let help = meant.as_ref().map_or_else(
            || "`*` stands for any characters: `ObjectInstances/*/cup*`".to_owned(),
            |meant| format!("write `{meant}`: `*` stands for any characters"),
        );
        self.findings.error_help(code::FORM, written.span, error.to_string(), Some(help));
        if let Some(meant) = meant {
            self.findings.remedy(Remedy::replace(written.span, format!("\"{meant}\"")));
        }
        None
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
                        let known = inputs.iter().map(|i| i.name.as_str());
                        let message = format!("the chart has no input `{}`", key.text);
                        self.findings.unknown(code::INPUT, (key.span, &key.text), message, known, None);
                    }
                    Some(input) => {
                        let Some(literal) = literal(value, &input.ty, self.findings) else { continue };
                        if let Err(error) = input.accept(literal) {
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
        self.declaration_of(name, node, forms::DECLARATION, "a declaration")
    }

    fn declaration_of(&mut self, name: &Named, node: &Node, keys: &[FormKey], called: &str) -> Parameter {
        let short;
        let entries = if let Yaml::String(_) = &node.value {
            short = vec![(Named { span: node.span, text: "type".into() }, node.clone())];
            &short[..]
        } else {
            self.entries(node)
        };
        self.known(entries, keys, called);
        let ty = self.declared_type(name, entries);
        let mut result = Parameter::new(&name.text, ty, &self.words(entries, "description"));
        result.minimum = self.bound(entries, "minimum", &result.ty);
        result.maximum = self.bound(entries, "maximum", &result.ty);
        if let Some((default, value)) = get(entries, "default")
            .and_then(|default| Some((default, literal(default, &result.ty, self.findings)?)))
        {
            match result.accept(value) {
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
            let named = TYPES_ELSEWHERE.iter().find(|(word, _)| text.text.eq_ignore_ascii_case(word));
            if let Some((_, same)) = named {
                let message = format!("there is no type `{}`", text.text);
                let help = format!("in Armarium this is `{same}`");
                self.error_help(code::DECLARED_TYPE, text.span, &message, &help);
                self.findings.remedy(Remedy::replace(text.span, *same));
                return Type::Any;
            }
            let candidates = Type::NAMES.iter().copied().chain(self.types.keys().map(String::as_str));
            let unit =
                text.text.split_once([' ', '<', '(']).map(|(_, unit)| unit.trim_end_matches(['>', ')']));
            let with_unit = unit.filter(|unit| Unit::parse(unit).is_ok());
            let with_unit = with_unit.map(|unit| format!("{{type: float, unit: {unit}}}"));
            let help = match &with_unit {
                Some(written) => format!("a number with a unit is `{written}`"),
                None => format!("types are {}", Type::NAMES.join(", ")),
            };
            let message = format!("there is no type `{}`", text.text);
            let at = (text.span, text.text.as_str());
            self.findings.unknown(code::DECLARED_TYPE, at, message, candidates, Some(help));
            // Where the type stands alone, the whole declaration can.
            if let (Some(written), [(key, _)]) = (with_unit, entries)
                && key.span == text.span
            {
                self.findings.remedy(Remedy::replace(text.span, written));
            }
            return Type::Any;
        };
        self.type_uses.extend(named_types(&text, &self.types, &self.findings.source.text));
        let Some(unit) = get(entries, "unit").and_then(|n| self.text(n)) else { return ty };
        match (Unit::parse(&unit.text), ty) {
            (Ok((si, 1.0)), Type::Float(_)) => Type::Float(Some(si)),
            (Ok((si, _)), ty @ Type::Float(_)) => {
                let help = Some(format!("write `unit: {si}`; values may be given in `{}`", unit.text));
                self.findings.error_help(code::UNIT, unit.span, "declared units are SI", help);
                self.findings.remedy(in_si(entries, &unit, &si.to_string()));
                ty
            }
            (Ok(_), ty) => {
                self.error(code::UNIT, unit.span, format!("{ty} has no unit, only float has"));
                ty
            }
            (Err(unknown), ty) => {
                let at = (unit.span, unit.text.as_str());
                let message = unknown.to_string();
                self.findings.unknown(code::UNIT, at, message, Unit::symbols(), None);
                ty
            }
        }
    }

    fn bound(&mut self, entries: &Entries, key: &str, ty: &Type) -> Option<f64> {
        literal(get(entries, key)?, ty, self.findings)?.as_f64()
    }

    pub(super) fn duration(&mut self, node: &Node) -> Option<f64> {
        let seconds = literal(node, &Type::Duration, self.findings)?.as_f64();
        if seconds.is_some_and(|seconds| seconds < 0.0) {
            negative_time(node, self.findings);
            return None;
        }
        seconds
    }

    pub(super) fn limits(&mut self, entries: &Entries) -> Limits {
        let Some(node) = get(entries, "limits") else { return Limits::default() };
        let entries = self.entries(node);
        self.known(entries, forms::LIMITS, "`limits`");
        let mut quantity = |key: &str, unit: Unit| {
            let node = get(entries, key)?;
            let limit = literal(node, &Type::quantity(unit), self.findings)?.as_f64();
            if limit.is_none_or(|limit| limit <= 0.0) {
                self.findings.error(code::VALUE, node.span, "a limit is greater than 0");
                return None;
            }
            limit
        };
        Limits { force_n: quantity("force", Unit::N), speed_m_s: quantity("speed", Unit::M_S) }
    }
}

/// The names that a chart's head gives.
fn declared(entries: &Entries) -> Vec<(HeadSection, Named)> {
    let of = |section: HeadSection| match get(entries, section.key()).map(|node| &node.value) {
        Some(Yaml::Map(names)) => names.iter().map(|(name, _)| (section, name.clone())).collect(),
        _ => Vec::new(),
    };
    [HeadSection::Inputs, HeadSection::Outputs, HeadSection::Locals, HeadSection::Types, HeadSection::Observe]
        .into_iter()
        .flat_map(of)
        .collect()
}

/// Where the defaults of inputs and locals stand.
fn defaults(entries: &Entries) -> Vec<(String, Span)> {
    let default = |(name, node): &(Named, Node)| Some((name.text.clone(), node.get("default")?.span));
    let of = |section: &str| match get(entries, section).map(|node| &node.value) {
        Some(Yaml::Map(declared)) => declared.iter().filter_map(default).collect(),
        _ => Vec::new(),
    };
    ["inputs", "locals"].into_iter().flat_map(of).collect()
}

/// The types of the chart that a type's text names, as in `list<Mood>`.
fn named_types(text: &Named, types: &BTreeMap<String, Type>, file: &str) -> Vec<Named> {
    let inner = text.text.trim_end_matches(['>', ' ']).rsplit(['<', ' ']).next().unwrap_or("");
    let raw = file.get(text.span.start..text.span.end).unwrap_or("");
    let found = types.contains_key(inner).then(|| raw.rfind(inner)).flatten();
    let named = found.map(|at| {
        let start = text.span.start + at;
        Named { span: Span { start, end: start + inner.len() }, text: inner.to_owned() }
    });
    named.into_iter().collect()
}

/// The SI unit as the declared one; numbers that were meant in the other get it.
fn in_si(entries: &Entries, unit: &Named, si: &str) -> Remedy {
    let mut edits = vec![Edit { span: unit.span, text: si.to_owned() }];
    for (_, node) in entries.iter().filter(|(key, _)| matches!(&*key.text, "default" | "minimum" | "maximum"))
    {
        if matches!(node.value, Yaml::Int(_) | Yaml::Float(_)) {
            let at = Span { start: node.span.end, end: node.span.end };
            edits.push(Edit { span: at, text: format!(" {}", unit.text) });
        }
    }
    edits.sort_by_key(|edit| edit.span.start);
    Remedy::Replace(edits)
}
