//! The self-describing value that charts compute with, skills take and return, and memory stores.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::geometry::{Frame, Pose, Vector, Wrench};

/// A typed value. Numbers are SI; durations are seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Value {
    /// No value.
    #[default]
    Null,
    /// A bool.
    Bool(bool),
    /// An integer.
    Int(i64),
    /// A number, SI.
    Float(#[serde(with = "number")] f64),
    /// Text.
    String(String),
    /// A duration, s.
    Duration(#[serde(with = "number")] f64),
    /// Opaque bytes.
    Bytes(#[serde(with = "bytes")] Vec<u8>),
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
    /// A reference to a named, versioned entity in working memory.
    Reference(Reference),
}

/// Serialises numbers; in formats without NaN and infinity, such as JSON, these become words.
mod number {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(number: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        if number.is_finite() || !serializer.is_human_readable() {
            serializer.serialize_f64(*number)
        } else {
            serializer.collect_str(number)
        }
    }

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum NumberForm {
        Number(f64),
        Word(String),
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        if !deserializer.is_human_readable() {
            return f64::deserialize(deserializer);
        }
        match NumberForm::deserialize(deserializer)? {
            NumberForm::Number(number) => Ok(number),
            NumberForm::Word(word) => word.parse().map_err(serde::de::Error::custom),
        }
    }
}

/// Serialises bytes: as bytes in binary formats, as a list of numbers in text formats. Reading accepts both.
mod bytes {
    use std::fmt;

    use serde::de::{SeqAccess, Visitor};
    use serde::{Deserializer, Serialize, Serializer};

    /// Capacity that is reserved before the bytes of a list have been read.
    const MAX_RESERVED: usize = 4096;

    pub(super) fn serialize<S: Serializer>(bytes: &Vec<u8>, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            bytes.serialize(serializer)
        } else {
            serializer.serialize_bytes(bytes)
        }
    }

    struct Bytes;

    impl<'de> Visitor<'de> for Bytes {
        type Value = Vec<u8>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("bytes")
        }

        fn visit_bytes<E>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
            Ok(bytes.to_vec())
        }

        fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
            Ok(bytes)
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<u8>, A::Error> {
            let mut bytes = Vec::with_capacity(items.size_hint().unwrap_or(0).min(MAX_RESERVED));
            while let Some(byte) = items.next_element()? {
                bytes.push(byte);
            }
            Ok(bytes)
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
        // A self-describing format tells which of the two it holds.
        deserializer.deserialize_any(Bytes)
    }
}

/// A reference to an entity in working memory; the entity may change while the reference is held.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Reference {
    /// The type of the entity, for instance `Motion` or `Object`.
    pub kind: String,
    /// The entity's address in memory: `segment/provider/entity`.
    pub id: String,
}

/// Bytes of text that count as one part.
const BYTES_PER_PART: usize = 64;

/// The size of a text in parts.
pub(crate) fn text_parts(text: &str) -> usize {
    1 + text.len() / BYTES_PER_PART
}

impl Value {
    /// The size of the value in parts: one for each value in it, and one for every 64 bytes of text.
    pub fn parts(&self) -> usize {
        match self {
            Self::String(text) => text_parts(text),
            Self::Bytes(bytes) => 1 + bytes.len() / BYTES_PER_PART,
            Self::List(items) => items.iter().map(Self::parts).sum::<usize>() + 1,
            Self::Map(fields) => {
                fields.iter().map(|(name, value)| text_parts(name) + value.parts()).sum::<usize>() + 1
            }
            _ => 1,
        }
    }

    /// Whether lists and maps are nested deeper than `levels`.
    pub fn deeper_than(&self, levels: usize) -> bool {
        let below = |value: &Self| levels == 0 || value.deeper_than(levels - 1);
        match self {
            Self::List(items) => items.iter().any(below),
            Self::Map(fields) => fields.values().any(below),
            _ => false,
        }
    }

    /// The frame of a vector, a pose or a wrench, or of the first part of a list or map that has one.
    pub fn frame(&self) -> Option<&Frame> {
        match self {
            Self::Vector(vector) => Some(&vector.frame),
            Self::Pose(pose) => Some(&pose.frame),
            Self::Wrench(wrench) => Some(&wrench.frame),
            Self::List(items) => items.iter().find_map(Self::frame),
            Self::Map(fields) => fields.values().find_map(Self::frame),
            _ => None,
        }
    }

    /// The number in an `Int`, `Float` or `Duration`.
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Int(i) => Some(*i as f64),
            Self::Float(f) | Self::Duration(f) => Some(*f),
            _ => None,
        }
    }

    /// The text in a `String`.
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Self::String(s) => Some(s),
            _ => None,
        }
    }

    /// The items of a `List`.
    pub fn as_list(&self) -> Option<&[Self]> {
        match self {
            Self::List(items) => Some(items),
            _ => None,
        }
    }

    /// The integer in an `Int`.
    pub fn as_int(&self) -> Option<i64> {
        match self {
            Self::Int(i) => Some(*i),
            _ => None,
        }
    }

    /// The reference in a `Reference`.
    pub fn as_reference(&self) -> Option<&Reference> {
        match self {
            Self::Reference(r) => Some(r),
            _ => None,
        }
    }

    /// The field `name` of a `Map`.
    pub fn get(&self, name: &str) -> Option<&Self> {
        match self {
            Self::Map(fields) => fields.get(name),
            _ => None,
        }
    }

    /// A named component of a geometric value or a reference, as expressions read it: `x` of a vector, `position` of a pose.
    pub fn part(&self, name: &str) -> Option<Self> {
        let axis = |v: [f64; 3]| match name {
            "x" => Some(Self::Float(v[0])),
            "y" => Some(Self::Float(v[1])),
            "z" => Some(Self::Float(v[2])),
            _ => None,
        };
        match (self, name) {
            (Self::Vector(v), "frame") => Some(v.frame.0.as_str().into()),
            (Self::Vector(v), _) => axis(v.components),
            (Self::Pose(p), "frame") => Some(p.frame.0.as_str().into()),
            (Self::Pose(p), "position") => Some(p.position.into()),
            (Self::Pose(p), "orientation") => Some(p.orientation.to_vec().into()),
            (Self::Pose(p), _) => axis(p.position),
            (Self::Wrench(w), "frame") => Some(w.frame.0.as_str().into()),
            (Self::Wrench(w), "force") => Some(w.force.into()),
            (Self::Wrench(w), "torque") => Some(w.torque.into()),
            (Self::Reference(r), "kind") => Some(r.kind.as_str().into()),
            (Self::Reference(r), "id") => Some(r.id.as_str().into()),
            _ => None,
        }
    }

    /// What is at a path of fields and of [parts](Self::part) of those; the value itself where the path is empty. Only that is
    /// copied.
    pub fn at(&self, path: &[String]) -> Option<Self> {
        let Some((name, rest)) = path.split_first() else { return Some(self.clone()) };
        match self {
            Self::Map(fields) => fields.get(name)?.at(rest),
            value => value.part(name)?.at(rest),
        }
    }

    /// Three numbers, from a `Vector` or a `List` of three.
    pub fn as_vector3(&self) -> Option<[f64; 3]> {
        match self {
            Self::Vector(v) => Some(v.components),
            Self::List(items) => match items.as_slice() {
                [x, y, z] => Some([x.as_f64()?, y.as_f64()?, z.as_f64()?]),
                _ => None,
            },
            _ => None,
        }
    }

    /// A map from named fields.
    pub fn record<const N: usize>(fields: [(&str, Self); N]) -> Self {
        Self::Map(fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
    }

    /// A short description for messages: the type, and the value if it is short.
    pub fn describe(&self) -> String {
        match self {
            Self::Null => "nothing".into(),
            Self::Bool(b) => format!("the bool {b}"),
            Self::Int(i) => format!("the int {i}"),
            Self::Float(f) => format!("the float {f}"),
            Self::String(s) if s.len() <= 60 => format!("the string \"{s}\""),
            Self::String(_) => "a long string".into(),
            Self::Duration(d) => format!("the duration {d} s"),
            Self::Bytes(b) => format!("{} bytes", b.len()),
            Self::List(items) => format!("a list of {}", items.len()),
            Self::Map(_) => "a map".into(),
            Self::Vector(_) => "a Vector".into(),
            Self::Pose(_) => "a Pose".into(),
            Self::Wrench(_) => "a Wrench".into(),
            Self::Reference(r) => format!("a reference to the {} `{}`", r.kind, r.id),
        }
    }

    /// The value as plain JSON for people and reports; non-finite numbers become `null`, and types are lost.
    pub fn to_json(&self) -> serde_json::Value {
        use serde_json::{Value as Json, json};
        match self {
            Self::Null => Json::Null,
            Self::Bool(b) => json!(b),
            Self::Int(i) => json!(i),
            Self::Float(f) | Self::Duration(f) => json!(f),
            Self::String(s) => json!(s),
            Self::Bytes(b) => json!(b),
            Self::List(items) => Json::Array(items.iter().map(Self::to_json).collect()),
            Self::Map(fields) => Json::Object(fields.iter().map(|(k, v)| (k.clone(), v.to_json())).collect()),
            Self::Vector(v) => json!({"frame": v.frame.0, "components": v.components}),
            Self::Pose(p) => {
                json!({"frame": p.frame.0, "position": p.position, "orientation": p.orientation})
            }
            Self::Wrench(w) => json!({"frame": w.frame.0, "force": w.force, "torque": w.torque}),
            Self::Reference(r) => json!({"kind": r.kind, "id": r.id}),
        }
    }

    /// A value from JSON: integers become `Int`, other numbers `Float`.
    pub fn from_json(json: &serde_json::Value) -> Self {
        use serde_json::Value as Json;
        match json {
            Json::Null => Self::Null,
            Json::Bool(b) => Self::Bool(*b),
            Json::Number(n) => {
                n.as_i64().map_or_else(|| Self::Float(n.as_f64().unwrap_or(f64::NAN)), Self::Int)
            }
            Json::String(s) => Self::String(s.clone()),
            Json::Array(items) => Self::List(items.iter().map(Self::from_json).collect()),
            Json::Object(fields) => {
                Self::Map(fields.iter().map(|(k, v)| (k.clone(), Self::from_json(v))).collect())
            }
        }
    }
}

macro_rules! from {
    ($($variant:ident($ty:ty);)*) => { $(
        impl From<$ty> for Value {
            fn from(value: $ty) -> Self {
                Self::$variant(value)
            }
        }
    )* };
}

from! {
    Bool(bool);
    Int(i64);
    Float(f64);
    String(String);
    List(Vec<Value>);
    Vector(Vector);
    Pose(Pose);
    Wrench(Wrench);
    Reference(Reference);
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::String(text.into())
    }
}
impl From<Vec<f64>> for Value {
    fn from(numbers: Vec<f64>) -> Self {
        Self::List(numbers.into_iter().map(Self::Float).collect())
    }
}
impl From<[f64; 3]> for Value {
    fn from(numbers: [f64; 3]) -> Self {
        numbers.to_vec().into()
    }
}

/// For people: numbers with at least four significant digits, bytes only counted, a reference by what it names.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Null => f.write_str("nothing"),
            Self::Bool(b) => write!(f, "{b}"),
            Self::Int(i) => write!(f, "{i}"),
            Self::Float(x) => f.write_str(&short(*x)),
            Self::Duration(x) => write!(f, "{} s", short(*x)),
            Self::String(s) => write!(f, "\"{s}\""),
            Self::Bytes(b) => write!(f, "{} bytes", b.len()),
            Self::List(items) => {
                f.write_str("[")?;
                separated(f, items, |f, item| write!(f, "{item}"))?;
                f.write_str("]")
            }
            Self::Map(fields) => {
                f.write_str("{")?;
                separated(f, fields, |f, (name, field)| write!(f, "{name}: {field}"))?;
                f.write_str("}")
            }
            Self::Vector(v) => write!(f, "{} in {}", point(&v.components), v.frame.0),
            Self::Pose(p) => {
                write!(f, "{} turned {} in {}", point(&p.position), point(&p.orientation), p.frame.0)
            }
            Self::Wrench(w) => {
                write!(f, "force {} torque {} in {}", point(&w.force), point(&w.torque), w.frame.0)
            }
            Self::Reference(r) => f.write_str(&r.id),
        }
    }
}

fn separated<T>(
    f: &mut fmt::Formatter<'_>,
    items: impl IntoIterator<Item = T>,
    each: impl Fn(&mut fmt::Formatter<'_>, T) -> fmt::Result,
) -> fmt::Result {
    for (i, item) in items.into_iter().enumerate() {
        f.write_str(if i > 0 { ", " } else { "" })?;
        each(f, item)?;
    }
    Ok(())
}

fn point(numbers: &[f64]) -> String {
    format!("({})", numbers.iter().map(|x| short(*x)).collect::<Vec<_>>().join(", "))
}

/// A number with four digits behind the point, or four significant ones where it is below 1.
fn short(x: f64) -> String {
    let size = x.abs();
    if size == 0.0 || !size.is_finite() {
        return if size == 0.0 { "0".into() } else { x.to_string() };
    }
    if !(1e-4..1e12).contains(&size) {
        let text = format!("{x:.3e}");
        let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{exponent}", digits.trim_end_matches('0').trim_end_matches('.'));
    }
    let decimals = if size >= 1.0 { 4 } else { (3.0 - libm::floor(libm::log10(size))) as usize };
    let text = format!("{x:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_json_does_not_have_come_back() {
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.5] {
            let text = serde_json::to_string(&Value::Float(number)).unwrap();
            let Value::Float(back) = serde_json::from_str(&text).unwrap() else { panic!("{text}") };
            assert_eq!(back.to_bits(), number.to_bits(), "{text}");
        }
    }
    #[test]
    fn bytes_are_numbers_for_people() {
        let bytes = Value::Bytes(vec![0, 1, 255]);
        let text = serde_json::to_string(&bytes).unwrap();
        assert_eq!(text, r#"{"bytes":[0,1,255]}"#);
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), bytes);
    }

    #[test]
    fn people_read_values_without_their_types() {
        let place = Vector { frame: "root".into(), components: [0.1, -0.0, 1234.56789] };
        let motion = crate::Reference { kind: "Motion".into(), id: "Motions/local/wiping".into() };
        for (value, text) in [
            (Value::Float(-0.785_412_345), "-0.7854"),
            (Value::Float(123_456.789), "123456.789"),
            (Value::Float(60.0), "60"),
            (Value::Float(0.001_234_56), "0.001235"),
            (Value::Float(1e-7 / 3.0), "3.333e-8"),
            (Value::Float(2e300), "2e300"),
            (Value::Float(f64::NAN), "NaN"),
            (Value::Float(-f64::INFINITY), "-inf"),
            (Value::Duration(1.5), "1.5 s"),
            (Value::from("cup"), "\"cup\""),
            (Value::from(vec![1.0, 2.5]), "[1, 2.5]"),
            (
                Value::record([("data", Value::Bytes(vec![0; 6])), ("width", Value::Int(2))]),
                "{data: 6 bytes, width: 2}",
            ),
            (Value::Vector(place), "(0.1, 0, 1234.5679) in root"),
            (Value::Reference(motion), "Motions/local/wiping"),
        ] {
            assert_eq!(value.to_string(), text);
        }
    }
}
