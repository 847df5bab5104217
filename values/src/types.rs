//! Declared types of inputs, outputs, locals, channel fields and event data, and the conversion of literals to them.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::unit::{Unit, parse_quantity};
use crate::value::{Reference, Value};

/// A declared type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Type {
    /// Any value; checked only when it is used.
    Any,
    /// A bool.
    Bool,
    /// An integer.
    Int,
    /// A number in SI, with its unit if declared.
    Float(Option<Unit>),
    /// Text.
    String,
    /// A duration, s.
    Duration,
    /// Opaque bytes.
    Bytes,
    /// An ordered sequence.
    List(Box<Type>),
    /// Values of one type by name.
    Map(Box<Type>),
    /// Named fields, each of its own type.
    Record(BTreeMap<String, Type>),
    /// One of these words.
    Enum(Vec<String>),
    /// A vector or point with its frame.
    Vector,
    /// A pose with its frame.
    Pose,
    /// A wrench with its frame.
    Wrench,
    /// A reference to an entity of this kind (`Motion`, `Object`) in working memory.
    Reference(String),
}

/// How well a value of one type fits a declared type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Always, possibly after conversion.
    Yes,
    /// Known only at run time.
    Perhaps,
    /// Never, because the units are of different kinds.
    OtherUnit,
    /// Never.
    No,
}

/// Why a value does not fit its declared type.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum ConvertError {
    /// The value is of another type.
    #[error("expected {expected}, found {found}")]
    Type { expected: String, found: String },
    /// The value has a unit of another kind.
    #[error("expected a number in {expected}, found one in {found}")]
    Unit { expected: String, found: String },
    /// The text after the number is not a unit.
    #[error(transparent)]
    UnknownUnit(#[from] crate::unit::UnknownUnit),
    /// The word is not a value of the enum.
    #[error("`{found}` is not one of {}", expected.join(", "))]
    NotInEnum { expected: Vec<String>, found: String },
}

impl Type {
    /// A number without a declared unit.
    pub const FLOAT: Self = Self::Float(None);

    /// A number in `unit`, for instance `Type::quantity(Unit::N)`.
    pub fn quantity(unit: Unit) -> Self {
        Self::Float(Some(unit))
    }

    /// A list of `element`.
    pub fn list(element: Self) -> Self {
        Self::List(Box::new(element))
    }

    /// A map whose values are all `element`.
    pub fn map(element: Self) -> Self {
        Self::Map(Box::new(element))
    }

    /// Named fields.
    pub fn record<const N: usize>(fields: [(&str, Self); N]) -> Self {
        Self::Record(fields.into_iter().map(|(name, ty)| (name.to_owned(), ty)).collect())
    }

    /// One of these words.
    pub fn one_of<const N: usize>(words: [&str; N]) -> Self {
        Self::Enum(words.iter().map(|w| (*w).to_owned()).collect())
    }

    /// A reference to a motion.
    pub fn motion() -> Self {
        Self::Reference("Motion".into())
    }

    /// A reference to an object.
    pub fn object() -> Self {
        Self::Reference("Object".into())
    }

    /// Parses a type as charts write it: `float`, `list<float>`, `map<string>`, `Pose`, `Motion` ... `declared`
    /// resolves the names that the chart itself declares. `None` for an unknown name.
    pub fn parse(text: &str, declared: &dyn Fn(&str) -> Option<Self>) -> Option<Self> {
        Self::parse_nested(text.trim(), declared, 8)
    }

    fn parse_nested(text: &str, declared: &dyn Fn(&str) -> Option<Self>, depth: u8) -> Option<Self> {
        let element = |prefix: &str| text.strip_prefix(prefix)?.strip_suffix('>');
        let inner = |t: &str| Self::parse_nested(t.trim(), declared, depth.checked_sub(1)?);
        if let Some(t) = element("list<") {
            return Some(Self::list(inner(t)?));
        }
        if let Some(t) = element("map<") {
            return Some(Self::map(inner(t)?));
        }
        Some(match text {
            "any" => Self::Any,
            "bool" => Self::Bool,
            "int" => Self::Int,
            "float" => Self::FLOAT,
            "string" => Self::String,
            "duration" => Self::Duration,
            "bytes" => Self::Bytes,
            "list" => Self::list(Self::Any),
            "map" => Self::map(Self::Any),
            "Vector" => Self::Vector,
            "Pose" => Self::Pose,
            "Wrench" => Self::Wrench,
            "Motion" | "Object" => Self::Reference(text.into()),
            _ => return declared(text),
        })
    }

    /// The names of the types that charts write, besides those that they declare.
    pub const NAMES: &[&str] = &[
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

    /// The fields that values of this type have, with their types; none where they are not known or there are none.
    #[must_use]
    pub fn fields(&self) -> Vec<(&str, Self)> {
        let metres = || Self::quantity(Unit::M);
        match self {
            Self::Record(fields) => fields.iter().map(|(name, ty)| (name.as_str(), ty.clone())).collect(),
            Self::Vector => {
                vec![("x", Self::FLOAT), ("y", Self::FLOAT), ("z", Self::FLOAT), ("frame", Self::String)]
            }
            Self::Pose => vec![
                ("position", Self::list(metres())),
                ("orientation", Self::list(Self::FLOAT)),
                ("frame", Self::String),
                ("x", metres()),
                ("y", metres()),
                ("z", metres()),
            ],
            Self::Wrench => vec![
                ("force", Self::list(Self::quantity(Unit::N))),
                ("torque", Self::list(Self::quantity(Unit::NM))),
                ("frame", Self::String),
            ],
            Self::Reference(_) => vec![("kind", Self::String), ("id", Self::String)],
            _ => Vec::new(),
        }
    }

    /// Whether a value of type `from` is accepted where `self` is declared.
    pub fn fit(&self, from: &Self) -> Fit {
        match (self, from) {
            (Self::Any, _) => Fit::Yes,
            (_, Self::Any) => Fit::Perhaps,
            (Self::Float(Some(a)), Self::Float(Some(b))) if a != b => Fit::OtherUnit,
            (Self::Float(Some(a)), Self::Duration) | (Self::Duration, Self::Float(Some(a))) => {
                if *a == Unit::S { Fit::Yes } else { Fit::OtherUnit }
            }
            (Self::Float(_) | Self::Duration, Self::Float(_) | Self::Duration | Self::Int) => Fit::Yes,
            (Self::List(a), Self::List(b)) | (Self::Map(a), Self::Map(b)) => a.fit(b),
            (Self::Map(a), Self::Record(fields)) => worst(fields.values().map(|f| a.fit(f))),
            (Self::Record(want), Self::Record(have)) => {
                worst(want.iter().map(|(name, ty)| have.get(name).map_or(Fit::No, |f| ty.fit(f))))
            }
            (Self::Record(_), Self::Map(_)) => Fit::Perhaps,
            (Self::Enum(a), Self::Enum(b)) => {
                if b.iter().all(|w| a.contains(w)) {
                    Fit::Yes
                } else if b.iter().any(|w| a.contains(w)) {
                    Fit::Perhaps
                } else {
                    Fit::No
                }
            }
            (Self::Enum(_), Self::String) => Fit::Perhaps,
            (Self::String, Self::Enum(_)) => Fit::Yes,
            (Self::List(element), Self::Vector) => element.fit(&Self::FLOAT),
            (a, b) if a == b => Fit::Yes,
            _ => Fit::No,
        }
    }

    /// Converts the value to this type: promotes numbers, converts quantities in text to SI, and turns names into
    /// references.
    ///
    /// # Errors
    /// [`ConvertError`] with the expected and the actual type.
    pub fn convert(&self, value: Value) -> Result<Value, ConvertError> {
        match (self, value) {
            (Self::Any, v) => Ok(v),
            (Self::Bool, v @ Value::Bool(_))
            | (Self::Int, v @ Value::Int(_))
            | (Self::Float(_), v @ Value::Float(_))
            | (Self::String, v @ Value::String(_))
            | (Self::Duration, v @ Value::Duration(_))
            | (Self::Bytes, v @ Value::Bytes(_))
            | (Self::Vector, v @ Value::Vector(_))
            | (Self::Pose, v @ Value::Pose(_))
            | (Self::Wrench, v @ Value::Wrench(_)) => Ok(v),
            (Self::Float(_), Value::Int(i)) => Ok(Value::Float(i as f64)),
            (Self::Int, Value::Float(f)) if f.fract() == 0.0 && f.abs() <= 9.0e15 => Ok(Value::Int(f as i64)),
            (Self::Float(None | Some(Unit::S)), Value::Duration(d)) => Ok(Value::Float(d)),
            (Self::Duration, Value::Float(f)) => Ok(Value::Duration(f)),
            (Self::Duration, Value::Int(i)) => Ok(Value::Duration(i as f64)),
            (Self::Float(unit), Value::String(s)) => {
                Ok(Value::Float(self.quantity_from(&s, unit.unwrap_or(Unit::ONE))?))
            }
            (Self::Duration, Value::String(s)) => Ok(Value::Duration(self.quantity_from(&s, Unit::S)?)),
            (Self::Enum(words), Value::String(s)) => {
                if words.contains(&s) {
                    Ok(Value::String(s))
                } else {
                    Err(ConvertError::NotInEnum { expected: words.clone(), found: s })
                }
            }
            (Self::Reference(kind), Value::String(id)) => {
                Ok(Value::Reference(Reference { kind: kind.clone(), id }))
            }
            (Self::Reference(kind), Value::Reference(r)) if r.kind == *kind => Ok(Value::Reference(r)),
            (Self::List(element), Value::List(items)) => {
                Ok(Value::List(items.into_iter().map(|v| element.convert(v)).collect::<Result<_, _>>()?))
            }
            (Self::List(element), Value::Vector(v)) => {
                let items = v.components.iter().map(|c| element.convert(Value::Float(*c)));
                Ok(Value::List(items.collect::<Result<_, _>>()?))
            }
            (Self::Map(element), Value::Map(fields)) => {
                let convert = |(k, v)| element.convert(v).map(|v| (k, v));
                Ok(Value::Map(fields.into_iter().map(convert).collect::<Result<_, _>>()?))
            }
            (Self::Record(types), Value::Map(fields)) => self.convert_record(types, fields),
            (_, v) => Err(self.mismatch(&v)),
        }
    }

    /// Parses a value from a command line: `true`, `8 N`, `[1, 2]`, a word.
    ///
    /// # Errors
    /// [`ConvertError`] with the expected and the actual type.
    pub fn read(&self, text: &str) -> Result<Value, ConvertError> {
        let json = || serde_json::from_str(text).ok().map(|json| Value::from_json(&json));
        let value = match self {
            Self::String | Self::Enum(_) | Self::Reference(_) | Self::Float(_) | Self::Duration => None,
            _ => json(),
        };
        self.convert(value.unwrap_or_else(|| Value::String(text.to_owned())))
    }

    fn convert_record(
        &self,
        types: &BTreeMap<String, Self>,
        mut fields: BTreeMap<String, Value>,
    ) -> Result<Value, ConvertError> {
        for (name, ty) in types {
            let Some(field) = fields.remove(name) else {
                return Err(ConvertError::Type {
                    expected: self.to_string(),
                    found: format!("a map without `{name}`"),
                });
            };
            fields.insert(name.clone(), ty.convert(field)?);
        }
        Ok(Value::Map(fields))
    }

    fn quantity_from(&self, text: &str, unit: Unit) -> Result<f64, ConvertError> {
        match parse_quantity(text) {
            None => Err(self.mismatch(&Value::String(text.into()))),
            Some(Err(unknown)) => Err(unknown.into()),
            Some(Ok((value, None))) => Ok(value),
            Some(Ok((value, Some(found)))) if found == unit => Ok(value),
            Some(Ok((_, Some(found)))) => {
                Err(ConvertError::Unit { expected: unit.to_string(), found: found.to_string() })
            }
        }
    }

    fn mismatch(&self, value: &Value) -> ConvertError {
        ConvertError::Type { expected: self.to_string(), found: value.describe() }
    }
}

fn worst(fits: impl Iterator<Item = Fit>) -> Fit {
    fits.fold(Fit::Yes, |a, b| match (a, b) {
        (Fit::No, _) | (_, Fit::No) => Fit::No,
        (Fit::OtherUnit, _) | (_, Fit::OtherUnit) => Fit::OtherUnit,
        (Fit::Perhaps, _) | (_, Fit::Perhaps) => Fit::Perhaps,
        (Fit::Yes, Fit::Yes) => Fit::Yes,
    })
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Any => f.write_str("any"),
            Self::Bool => f.write_str("bool"),
            Self::Int => f.write_str("int"),
            Self::Float(None) => f.write_str("float"),
            Self::Float(Some(unit)) => write!(f, "float in {unit}"),
            Self::String => f.write_str("string"),
            Self::Duration => f.write_str("duration"),
            Self::Bytes => f.write_str("bytes"),
            Self::List(t) => write!(f, "list<{t}>"),
            Self::Map(t) => write!(f, "map<{t}>"),
            Self::Record(fields) => {
                f.write_str("{")?;
                for (i, (name, ty)) in fields.iter().enumerate() {
                    write!(f, "{}{name}: {ty}", if i == 0 { "" } else { ", " })?;
                }
                f.write_str("}")
            }
            Self::Enum(words) => write!(f, "one of {}", words.join(", ")),
            Self::Vector => f.write_str("Vector"),
            Self::Pose => f.write_str("Pose"),
            Self::Wrench => f.write_str("Wrench"),
            Self::Reference(kind) => f.write_str(kind),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_become_what_was_declared() {
        let n = Type::quantity(Unit::N);
        assert_eq!(n.convert("40 N".into()), Ok(Value::Float(40.0)));
        assert_eq!(n.convert(Value::Int(40)), Ok(Value::Float(40.0)));
        assert!(matches!(n.convert("40 mm".into()), Err(ConvertError::Unit { .. })));
        assert!(matches!(n.convert("40 blobs".into()), Err(ConvertError::UnknownUnit(_))));
        assert_eq!(Type::Duration.convert("100ms".into()), Ok(Value::Duration(0.1)));
        assert_eq!(
            Type::motion().convert("wipe".into()),
            Ok(Value::Reference(Reference { kind: "Motion".into(), id: "wipe".into() }))
        );
        assert!(Type::one_of(["fist"]).convert("fits".into()).is_err());
    }

    #[test]
    fn texts_are_read_as_what_is_declared() {
        assert_eq!(Type::Bool.read("true"), Ok(Value::Bool(true)));
        assert_eq!(Type::String.read("true"), Ok("true".into()));
        assert_eq!(Type::quantity(Unit::M).read("15 mm"), Ok(Value::Float(0.015)));
        assert_eq!(Type::list(Type::FLOAT).read("[1, 2.5]"), Ok(vec![1.0, 2.5].into()));
        assert!(Type::Int.read("many").is_err());
    }

    #[test]
    fn types_read_back_as_written() {
        for text in ["bool", "list<map<float>>", "Pose", "Motion", "duration"] {
            assert_eq!(Type::parse(text, &|_| None).unwrap().to_string(), text);
        }
        assert_eq!(Type::parse("Nonsense", &|_| None), None);
        let deep = format!("{}int{}", "list<".repeat(40), ">".repeat(40));
        assert_eq!(Type::parse(&deep, &|_| None), None);
    }

    #[test]
    fn units_of_another_kind_do_not_fit() {
        let (n, m) = (Type::quantity(Unit::N), Type::quantity(Unit::M));
        assert_eq!(n.fit(&m), Fit::OtherUnit);
        assert_eq!(n.fit(&Type::FLOAT), Fit::Yes);
        assert_eq!(Type::Duration.fit(&Type::quantity(Unit::S)), Fit::Yes);
        assert_eq!(Type::Int.fit(&Type::FLOAT), Fit::No);
    }
}
