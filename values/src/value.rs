//! The self-describing value: what charts compute with, skills take and return, and memory keeps.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::geometry::{Pose, Vector, Wrench};

/// A typed value. Numbers are SI; durations are seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Value {
    /// No value.
    #[default]
    Null,
    /// A truth value.
    Bool(bool),
    /// A whole number.
    Int(i64),
    /// A number, SI.
    Float(f64),
    /// Text.
    String(String),
    /// A span of time, s.
    Duration(f64),
    /// Opaque bytes.
    Bytes(Vec<u8>),
    /// An ordered sequence.
    List(Vec<Value>),
    /// Named values, ordered by name.
    Map(BTreeMap<String, Value>),
    /// A vector or point with its frame.
    Vector(Vector),
    /// A pose with its frame.
    Pose(Pose),
    /// A wrench with its frame.
    Wrench(Wrench),
    /// A named, versioned entity in working memory.
    Reference(Reference),
}

/// A reference to an entity in working memory; who holds it sees the entity change.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Reference {
    /// The type of the entity, for instance `Motion` or `Object`.
    pub kind: String,
    /// The entity's address in memory: `segment/provider/entity`.
    pub id: String,
}

impl Value {
    /// The number in an `Int`, `Float` or `Duration`.
    #[must_use]
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Int(i) => Some(*i as f64),
            Self::Float(f) | Self::Duration(f) => Some(*f),
            _ => None,
        }
    }

    /// The text in a `String`.
    #[must_use]
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Self::String(s) => Some(s),
            _ => None,
        }
    }

    /// The truth value in a `Bool`.
    #[must_use]
    pub fn as_bool(&self) -> Option<bool> {
        match self {
            Self::Bool(b) => Some(*b),
            _ => None,
        }
    }
}

impl From<bool> for Value {
    fn from(v: bool) -> Self {
        Self::Bool(v)
    }
}
impl From<i64> for Value {
    fn from(v: i64) -> Self {
        Self::Int(v)
    }
}
impl From<f64> for Value {
    fn from(v: f64) -> Self {
        Self::Float(v)
    }
}
impl From<&str> for Value {
    fn from(v: &str) -> Self {
        Self::String(v.into())
    }
}
impl From<String> for Value {
    fn from(v: String) -> Self {
        Self::String(v)
    }
}
