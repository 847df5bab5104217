//! The tree of a text: every value and key with its place.

use armarium_values::Value;

use crate::span::Span;

/// A value with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Where it stands; of a map, its first key.
    pub span: Span,
    /// What it is.
    pub value: Yaml,
}

/// A name with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Where it stands.
    pub span: Span,
    /// The name.
    pub text: String,
}

/// The entries of a map, in the order of the file.
pub type Entries = [(Named, Node)];

/// What a node is.
#[derive(Clone, Debug, PartialEq)]
pub enum Yaml {
    /// `null`, `~` or nothing.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A whole number.
    Int(i64),
    /// Another number.
    Float(f64),
    /// Text.
    String(String),
    /// A list.
    List(Vec<Node>),
    /// A map; no key is there twice.
    Map(Vec<(Named, Node)>),
}

impl Node {
    /// The node under a key of a map.
    pub fn get(&self, key: &str) -> Option<&Self> {
        match &self.value {
            Yaml::Map(entries) => entries.iter().find(|(k, _)| k.text == key).map(|(_, node)| node),
            _ => None,
        }
    }

    /// The entries of a map.
    pub(crate) fn entries_mut(&mut self) -> Option<&mut Vec<(Named, Self)>> {
        match &mut self.value {
            Yaml::Map(entries) => Some(entries),
            _ => None,
        }
    }

    /// The place of what stands under a key; of the node itself where the key is not there.
    pub fn place(&self, key: &str) -> Span {
        self.get(key).unwrap_or(self).span
    }

    /// The items of a list.
    pub fn items(&self) -> &[Self] {
        match &self.value {
            Yaml::List(items) => items,
            _ => &[],
        }
    }

    /// The node as a literal; `${` is not looked at.
    pub fn literal(&self) -> Value {
        match &self.value {
            Yaml::Null => Value::Null,
            Yaml::Bool(b) => Value::Bool(*b),
            Yaml::Int(i) => Value::Int(*i),
            Yaml::Float(f) => Value::Float(*f),
            Yaml::String(s) => Value::String(s.clone()),
            Yaml::List(items) => Value::List(items.iter().map(Self::literal).collect()),
            Yaml::Map(entries) => {
                Value::Map(entries.iter().map(|(k, v)| (k.text.clone(), v.literal())).collect())
            }
        }
    }
}

impl Yaml {
    /// What it is, for messages.
    pub fn describe(&self) -> &'static str {
        match self {
            Self::Null => "nothing",
            Self::Bool(_) => "a bool",
            Self::Int(_) | Self::Float(_) => "a number",
            Self::String(_) => "text",
            Self::List(_) => "a list",
            Self::Map(_) => "a map",
        }
    }
}
