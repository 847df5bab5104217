//! A section of keys: one table says which there are, and both the reader and the JSON Schema come from it.

use std::sync::Arc;

use serde::Serialize;
use serde_json::{Map, Value as Json, json};

use crate::code;
use crate::field::Field;
use crate::finding::{Finding, Findings};
use crate::remedy::Remedy;
use crate::span::Span;
use crate::text::Source;
use crate::yaml::{self, Entries, Node, Yaml};

/// A key of a section.
#[derive(Clone, Copy, Debug)]
pub struct FormKey {
    /// The key.
    pub name: &'static str,
    /// What it says, for people.
    pub doc: &'static str,
    /// Whether it must be there.
    pub required: bool,
    /// The JSON Schema of what stands under it.
    pub schema: fn() -> Json,
}

impl FormKey {
    /// A key that may be left out.
    pub const fn new(name: &'static str, doc: &'static str, schema: fn() -> Json) -> Self {
        Self { name, doc, required: false, schema }
    }

    /// The same key, which must be there.
    #[must_use]
    pub const fn required(self) -> Self {
        Self { required: true, ..self }
    }
}

/// A section with a fixed set of keys, made by [`form!`](crate::form!).
pub trait Form: Field + Default + Serialize {
    /// What it is called in messages: `a table`.
    const CALLED: &'static str;

    /// Its keys, in their order.
    fn keys() -> Vec<FormKey>;

    /// Takes over what stands under one of its keys.
    fn take(&mut self, key: &str, node: &Node, findings: &mut Findings);

    /// Looks at values that must fit each other, when each is right by itself; fills in defaults that depend on others.
    fn check(&mut self, node: &Node, findings: &mut Findings);
}

impl Findings {
    /// Adds an error about the form of a value: `expected` is needed there.
    pub fn form(&mut self, node: &Node, expected: &str) {
        self.error(
            code::FORM,
            node.span,
            format!("{expected} is needed here, not {}", node.value.describe()),
        );
    }

    /// The entries of a map; none, with a finding, where the node is another thing.
    pub fn entries<'n>(&mut self, node: &'n Node) -> &'n Entries {
        match &node.value {
            Yaml::Map(entries) => entries,
            Yaml::Null => &[],
            _ => {
                self.form(node, "a map");
                &[]
            }
        }
    }

    /// Adds a finding for each key that a form does not have.
    pub fn known(&mut self, entries: &Entries, keys: &[FormKey], called: &str) {
        self.known_or(entries, keys, called, |_, _| None);
    }

    /// As [`Findings::known`]; `meant` knows words of other languages: what to do instead, and the key if it is the same with
    /// another name and the value has its form.
    pub fn known_or(
        &mut self,
        entries: &Entries,
        keys: &[FormKey],
        called: &str,
        meant: impl Fn(&str, &Node) -> Option<(&'static str, Option<&'static str>)>,
    ) {
        let names = || keys.iter().map(|key| key.name);
        for (key, node) in entries.iter().filter(|(key, _)| !names().any(|name| name == key.text)) {
            let help = format!("{called} has the keys {}", names().collect::<Vec<_>>().join(", "));
            let message = format!("{called} has no key `{}`", key.text);
            match meant(&key.text, node) {
                Some((help, same)) => {
                    self.error_help(code::KEY, key.span, message, Some(help.to_owned()));
                    let free = |same: &&str| {
                        names().any(|name| name == *same)
                            && !entries.iter().any(|(key, _)| key.text == **same)
                    };
                    if let Some(same) = same.filter(free) {
                        self.remedy(Remedy::replace(key.span, same));
                    }
                }
                None => self.unknown(code::KEY, (key.span, &key.text), message, names(), Some(help)),
            }
        }
    }
}

/// Reads a section into `form`, key by key.
pub fn set<F: Form>(form: &mut F, node: &Node, findings: &mut Findings) {
    let before = findings.list.len();
    let entries = findings.entries(node);
    let keys = F::keys();
    findings.known(entries, &keys, F::CALLED);
    for key in keys.iter().filter(|key| key.required && node.get(key.name).is_none()) {
        findings.error(code::MISSING_KEY, node.span, format!("{} needs `{}`", F::CALLED, key.name));
    }
    for (key, node) in entries {
        form.take(&key.text, node, findings);
    }
    if findings.list.len() == before {
        form.check(node, findings);
    }
}

/// Reads a whole file.
///
/// # Errors
/// Everything that is wrong with it, in the order of the text.
pub fn read<F: Form>(source: Arc<Source>) -> Result<F, Vec<Finding>> {
    read_node(source).map(|(form, _)| form)
}

/// Reads a whole file, and gives its tree too, in which the place of everything is. A file without keys, be it with nothing but
/// comments, is refused.
///
/// # Errors
/// Everything that is wrong with it, in the order of the text.
pub fn read_node<F: Form>(source: Arc<Source>) -> Result<(F, Arc<Node>), Vec<Finding>> {
    let blank = source.text.lines().all(|line| line.trim().is_empty() || line.trim_start().starts_with('#'));
    let mut findings = Findings::new(source);
    let node = if blank { None } else { yaml::parse(&mut findings) };
    if blank || node.as_ref().is_some_and(|node| node.value == Yaml::Null) {
        let message = format!("the file is empty: {} has the keys {}", F::CALLED, names_of::<F>());
        findings.error(code::FILE, Span { start: 0, end: 1 }, message);
        return Err(findings.list);
    }
    if let Some(node) = &node
        && node.get("statechart").is_some()
        && !F::keys().iter().any(|key| key.name == "statechart")
    {
        let message = format!("this is a chart, where {} is needed", F::CALLED);
        findings.error(code::FORM, node.place("statechart"), message);
        return Err(findings.list);
    }
    let read = node.map(|node| {
        let mut form = F::default();
        set(&mut form, &node, &mut findings);
        (form, node)
    });
    match read {
        Some(read) if findings.list.is_empty() => Ok(read),
        _ => {
            findings.list.sort_by_key(|finding| finding.span.start);
            Err(findings.list)
        }
    }
}

/// The keys of a form, for messages.
fn names_of<F: Form>() -> String {
    F::keys().iter().map(|key| key.name).collect::<Vec<_>>().join(", ")
}

/// The JSON Schema of a map with these keys and no others.
pub fn object(keys: &[FormKey]) -> Json {
    let mut properties = Map::new();
    for key in keys {
        let mut schema = (key.schema)();
        if !key.doc.is_empty() {
            schema["description"] = json!(key.doc.trim());
        }
        properties.insert(key.name.into(), schema);
    }
    let required: Vec<&str> = keys.iter().filter(|key| key.required).map(|key| key.name).collect();
    let mut schema = json!({"type": "object", "additionalProperties": false, "properties": properties});
    if !required.is_empty() {
        schema["required"] = json!(required);
    }
    schema
}

/// The JSON Schema of a form, with its defaults.
pub fn schema<F: Form>() -> Json {
    let keys = F::keys();
    let mut schema = object(&keys);
    let defaults = serde_json::to_value(F::default()).unwrap_or_default();
    for key in keys.iter().filter(|key| !key.required) {
        match &defaults[key.name] {
            // A section says its defaults key by key.
            Json::Null | Json::Object(_) => {}
            default => schema["properties"][key.name]["default"] = default.clone(),
        }
    }
    schema
}

/// Declares a section of keys: the type with its default, and the table from which it is read and its JSON Schema made.
///
/// A key without a default must be there. After a default stands the [`Rule`](crate::Rule) for the value, if there is one; a key
/// that is no name of Rust's is written with `as`. `check` names a method that looks at values together, when
/// each is right by itself.
///
/// ```
/// use armarium_source::{Rule, Source, form, read};
///
/// form! {
///     /// A shelf.
///     pub struct Shelf: "a shelf" {
///         /// How high it is, m.
///         pub height: f64 = 0.5, Rule::number("m", 0.0, 3.0);
///         /// Who put it there.
///         pub owner as "for": String;
///     }
/// }
///
/// let shelf: Shelf = read(Source::new("shelf.yaml", "for: alice\nheight: 1500 mm\n").into()).unwrap();
/// assert_eq!((shelf.height, shelf.owner.as_str()), (1.5, "alice"));
/// let wrong = read::<Shelf>(Source::new("shelf.yaml", "hight: 1 kg\n").into()).unwrap_err();
/// assert_eq!(wrong[0].to_string(), "shelf.yaml:1:1: error[E003]: a shelf has no key `hight` (did you mean `height`?)");
/// ```
#[macro_export]
macro_rules! form {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Form:ident: $called:literal $(, check $check:path)? {
            $(
                $(#[doc = $doc:literal])*
                $(#[serde($($serde:tt)*)])?
                $fvis:vis $field:ident $(as $key:literal)?: $ty:ty $(= $default:expr)? $(, $rule:expr)?;
            )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, $crate::serde::Serialize)]
        #[serde(crate = "armarium_source::serde")]
        $vis struct $Form {
            $(
                $(#[doc = $doc])*
                $(#[serde($($serde)*)])?
                $(#[serde(rename = $key)])?
                $fvis $field: $ty,
            )*
        }

        impl Default for $Form {
            fn default() -> Self {
                Self { $($field: $crate::form!(@default $($default)?)),* }
            }
        }

        impl $crate::Field for $Form {
            fn read(&mut self, node: &$crate::yaml::Node, _: &$crate::Rule, findings: &mut $crate::Findings) {
                $crate::set(self, node, findings);
            }
            fn schema(_: &$crate::Rule) -> $crate::serde_json::Value {
                $crate::schema::<Self>()
            }
        }

        impl $crate::Form for $Form {
            const CALLED: &'static str = $called;
            fn keys() -> Vec<$crate::FormKey> {
                let mut keys = Vec::new();
                $(
                    keys.push($crate::FormKey {
                        name: $crate::form!(@key $field $($key)?),
                        doc: concat!($($doc),*),
                        required: $crate::form!(@required $($default)?),
                        schema: || <$ty as $crate::Field>::schema(&$crate::form!(@rule $($rule)?)),
                    });
                    if let Some(name) = $crate::form!(@rule $($rule)?).radians {
                        let schema = || <$ty as $crate::Field>::schema(&$crate::form!(@rule $($rule)?).in_radians());
                        keys.push($crate::FormKey::new(name, "The same in rad, or with a unit: `20 deg`.", schema));
                    }
                )*
                keys
            }
            fn take(&mut self, key: &str, node: &$crate::yaml::Node, findings: &mut $crate::Findings) {
                $(
                    let rule: $crate::Rule = $crate::form!(@rule $($rule)?);
                    if key == $crate::form!(@key $field $($key)?) {
                        return $crate::Field::read(&mut self.$field, node, &rule, findings);
                    }
                    if rule.radians == Some(key) {
                        return $crate::Field::read(&mut self.$field, node, &rule.in_radians(), findings);
                    }
                )*
            }
            fn check(&mut self, node: &$crate::yaml::Node, findings: &mut $crate::Findings) {
                let _ = (node, &findings);
                $($check(self, node, findings);)?
            }
        }
    };
    (@key $field:ident) => { stringify!($field) };
    (@key $field:ident $key:literal) => { $key };
    (@default) => { Default::default() };
    (@default $default:expr) => { $default };
    (@required) => { true };
    (@required $default:expr) => { false };
    (@rule) => { $crate::Rule::ANY };
    (@rule $rule:expr) => { $rule };
}
