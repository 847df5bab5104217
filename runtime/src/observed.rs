//! What charts observe of memory: patterns of addresses, the channels that hold what they match, and who publishes it.
//!
//! Each pattern has two channels, whose names are made of the pattern, so that charts that observe the same read the same and a
//! name that one chart gives means nothing in another. This file publishes nothing and knows no memory.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use armarium_values::{Value, Vector};

/// Most patterns that one chart observes.
pub const MAX_OBSERVED: usize = 64;
/// Most matches of a pattern that its channels hold.
pub const MAX_MATCHES: usize = 100;
/// What a name under `observe:` ends in where all matches are meant, not only the one with the highest confidence.
pub const ALL: &str = "_all";
/// Longest part of an address, bytes.
const MAX_NAME_BYTES: usize = 200;

/// Addresses of memory: core segment, provider and entity, in each of which `*` stands for any characters.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemoryPattern {
    /// The core segment.
    pub segment: String,
    /// The provider segment.
    pub provider: String,
    /// The entity's own name.
    pub entity: String,
}

/// Why a text is no pattern of addresses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum PatternError {
    /// It has not three parts.
    #[error("a pattern has three parts, core segment, provider and entity; this has {found}")]
    Parts { found: usize },
    /// A part can be in no address.
    #[error(
        "`{part}` can be no part of an address in memory: letters, digits and other signs, without `#`, `?`, `$`, and at most {MAX_NAME_BYTES} bytes"
    )]
    Name { part: String },
}

impl FromStr for MemoryPattern {
    type Err = PatternError;

    fn from_str(text: &str) -> Result<Self, PatternError> {
        let parts: Vec<&str> = text.split('/').collect();
        let &[segment, provider, entity] = parts.as_slice() else {
            return Err(PatternError::Parts { found: parts.len() });
        };
        let forbidden = |c: char| matches!(c, '#' | '?' | '$') || c.is_control();
        let bad = |part: &&str| {
            part.is_empty()
                || part.len() > MAX_NAME_BYTES
                || part.starts_with('@')
                || part.contains(forbidden)
        };
        if let Some(part) = [segment, provider, entity].into_iter().find(bad) {
            return Err(PatternError::Name { part: part.chars().take(40).collect() });
        }
        Ok(Self { segment: segment.into(), provider: provider.into(), entity: entity.into() })
    }
}

impl fmt::Display for MemoryPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.segment, self.provider, self.entity)
    }
}

impl MemoryPattern {
    /// Every address.
    #[must_use]
    pub fn any() -> Self {
        let [segment, provider, entity] = [(); 3].map(|()| "*".to_owned());
        Self { segment, provider, entity }
    }

    /// The channel of the match with the highest confidence, or of all matches.
    #[must_use]
    pub fn channel(&self, all: bool) -> String {
        if all { format!("all {self}") } else { self.to_string() }
    }
}

/// What a program observes: a pattern, and which of its channels expressions read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObservedPattern {
    /// The pattern.
    pub pattern: MemoryPattern,
    /// Whether the match with the highest confidence is read.
    pub best: bool,
    /// Whether the list of all matches is read.
    pub all: bool,
}

/// The value of a match: its attributes by name, with `confidence` and `id` in place of attributes of these names. A thing with a
/// pose and without a position has the pose's position.
#[must_use]
pub fn match_of(mut attributes: BTreeMap<String, Value>, confidence: f64, id: &str) -> Value {
    attributes.insert("confidence".into(), confidence.into());
    attributes.insert("id".into(), id.into());
    placed(attributes)
}

fn placed(mut fields: BTreeMap<String, Value>) -> Value {
    if let (Some(Value::Pose(pose)), false) = (fields.get("pose"), fields.contains_key("position")) {
        let position = Vector { frame: pose.frame.clone(), components: pose.position };
        fields.insert("position".into(), Value::Vector(position));
    }
    Value::Map(fields)
}

/// What the channels of a pattern hold when a person says what one of them does: a test case, a line of `step`. For the best match
/// that is a map of its fields, or nothing; for all matches a list of such maps. Without a `confidence` it is 1, without an `id` it
/// is the pattern. Returns the best, and all of them.
#[must_use]
pub(crate) fn told(pattern: &MemoryPattern, value: Value, all: bool) -> (Option<Value>, Vec<Value>) {
    let complete = |value: Value| match value {
        Value::Map(mut fields) => {
            fields.entry("confidence".into()).or_insert(Value::Float(1.0));
            fields.entry("id".into()).or_insert_with(|| pattern.to_string().into());
            placed(fields)
        }
        other => other,
    };
    let mut matches: Vec<Value> = match value {
        Value::List(items) if all => items.into_iter().map(complete).collect(),
        Value::Null => Vec::new(),
        one => vec![complete(one)],
    };
    let confidence = |of: &Value| of.get("confidence").and_then(Value::as_f64).unwrap_or(0.0);
    matches.sort_by(|a, b| confidence(b).total_cmp(&confidence(a)));
    (matches.first().cloned(), matches)
}

#[cfg(test)]
mod tests {
    use armarium_values::{Frame, Pose};

    use super::*;

    #[test]
    fn a_pattern_has_three_parts() {
        let read = |text: &str| text.parse::<MemoryPattern>();
        let cups = read("ObjectInstances/*/cup*").expect("it is in order");
        assert_eq!(
            (cups.channel(false), cups.channel(true)),
            ("ObjectInstances/*/cup*".into(), "all ObjectInstances/*/cup*".into())
        );
        assert_eq!(read("ObjectInstances/cup"), Err(PatternError::Parts { found: 2 }));
        for bad in ["a//c", "a/b?/c", "@a/b/c", "a/b/c\n", &format!("a/b/{}", "c".repeat(201))] {
            assert!(matches!(read(bad), Err(PatternError::Name { .. })), "{bad:?}");
        }
    }

    #[test]
    fn what_is_told_is_ordered_and_has_a_position() {
        let pose =
            Pose { frame: Frame::root(), position: [1.0, 2.0, 3.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        let cup = |confidence: f64| {
            Value::record([("confidence", confidence.into()), ("pose", Value::Pose(pose.clone()))])
        };
        let (best, all) = told(&MemoryPattern::any(), Value::List(vec![cup(0.3), cup(0.8)]), true);
        let best = best.expect("there are two");
        assert_eq!(best.at(&["confidence".into()]), Some(0.8.into()));
        assert_eq!(best.at(&["position".into(), "y".into()]), Some(2.0.into()));
        assert_eq!(all.len(), 2);
        assert_eq!(told(&MemoryPattern::any(), Value::Null, false), (None, Vec::new()));
        assert_eq!(told(&MemoryPattern::any(), Value::List(Vec::new()), true), (None, Vec::new()));
    }
}
