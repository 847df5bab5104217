//! Typed, documented values that skills and charts take and give: what they declare, and whether given values are as declared. It
//! knows no skill.

use std::collections::BTreeMap;
use std::fmt;

use armarium_source::suggest;
use armarium_values::{ConvertError, Type, Unit, Value};
use serde::Serialize;

/// A typed, documented input or output of a skill or chart, or a local of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its type, with the unit for numbers.
    pub ty: Type,
    /// Value when none is given; an input without one is required.
    pub default: Option<Value>,
    /// Smallest number that is allowed, SI.
    pub minimum: Option<f64>,
    /// Largest number that is allowed, SI.
    pub maximum: Option<f64>,
    /// What names its values are, where they are names that are known before a run.
    pub names: Option<NameKind>,
    /// One sentence for people.
    pub description: String,
}

/// A kind of names that are known before a run. What the names are, the host of the skills knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NameKind {
    /// A posture of the robot.
    Posture,
    /// An arm of the robot.
    Arm,
    /// A class of objects in prior knowledge.
    ObjectClass,
    /// What judges a simulated run.
    Probe,
}

impl fmt::Display for NameKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Posture => "posture",
            Self::Arm => "arm",
            Self::ObjectClass => "object class",
            Self::Probe => "probe",
        })
    }
}

/// Why a parameter refuses a value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum ParameterError {
    /// It has another type, or another unit.
    #[error(transparent)]
    Type(#[from] ConvertError),
    /// The number is not within the bounds; all are in SI.
    #[error("{value} is outside of the allowed range, {} to {}", bound(*.minimum), bound(*.maximum))]
    Range { value: f64, minimum: Option<f64>, maximum: Option<f64> },
}

fn bound(bound: Option<f64>) -> String {
    bound.map_or_else(|| "any".into(), |bound| bound.to_string())
}

/// Why a skill or chart cannot be started with the given inputs.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum InputError {
    /// No input of that name; `help` says what might be meant.
    #[error("there is no input `{name}`{}", help.as_ref().map_or(String::new(), |h| format!("; {h}")))]
    Unknown { name: String, help: Option<String> },
    /// The value does not fit.
    #[error("input `{name}`: {error}")]
    Value { name: String, error: ParameterError },
    /// An input without default was not given.
    #[error("the input `{name}` is needed, and was not given")]
    Missing { name: String },
    /// The chart has no profile of that name.
    #[error("the chart has no profile `{name}`; it has: {known}")]
    Profile { name: String, known: String },
}

/// Checks the given values against the parameters, converts them and adds defaults; an unknown or missing one is an error.
pub(crate) fn inputs<'p>(
    parameters: impl Iterator<Item = &'p Parameter> + Clone,
    mut given: BTreeMap<String, Value>,
) -> Result<BTreeMap<String, Value>, InputError> {
    let names = || parameters.clone().map(|p| p.name.as_str());
    if let Some(name) = given.keys().find(|name| !names().any(|known| known == *name)) {
        let all = || format!("the inputs are {}", names().collect::<Vec<_>>().join(", "));
        let none = names().next().is_none();
        let help = if none {
            Some("it has no inputs".to_owned())
        } else {
            suggest(name, names()).or_else(|| Some(all()))
        };
        return Err(InputError::Unknown { name: name.clone(), help });
    }
    let one = |parameter: &Parameter| {
        let name = parameter.name.clone();
        let value = match given.remove(&name) {
            Some(value) => {
                parameter.accept(value).map_err(|error| InputError::Value { name: name.clone(), error })?
            }
            None => parameter.default.clone().ok_or_else(|| InputError::Missing { name: name.clone() })?,
        };
        Ok((name, value))
    };
    parameters.clone().map(one).collect()
}

impl Parameter {
    /// A parameter without default and bounds.
    pub fn new(name: &str, ty: Type, description: &str) -> Self {
        let (name, description) = (name.into(), description.into());
        Self { name, ty, default: None, minimum: None, maximum: None, names: None, description }
    }

    /// A value that it takes, as it is written in a file: the default, or something of its type. None where only an
    /// expression gives one.
    #[must_use]
    pub fn example(&self) -> Option<String> {
        let number =
            self.minimum.or(self.maximum).map_or(0.0, |bound| if self.allows(0.0) { 0.0 } else { bound });
        let value = match &self.ty {
            _ if self.default.is_some() => self.default.clone()?,
            Type::Bool => Value::Bool(false),
            Type::Int => Value::Int(number as i64),
            Type::Float(Some(unit)) if *unit != Unit::ONE => return Some(format!("{number} {unit}")),
            Type::Float(_) => Value::Float(number),
            Type::Duration => return Some(format!("{number} s")),
            Type::String | Type::Any => Value::String(String::new()),
            Type::Reference(kind) => Value::String(kind.to_lowercase()),
            Type::Enum(words) => Value::String(words.first()?.clone()),
            Type::List(_) => Value::List(Vec::new()),
            Type::Map(_) => Value::Map(BTreeMap::new()),
            _ => return None,
        };
        self.accept(value.clone()).ok()?;
        match value {
            Value::Reference(reference) => Some(reference.id),
            Value::String(word)
                if !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || c == '_') =>
            {
                Some(word)
            }
            Value::Duration(seconds) => Some(format!("{seconds} s")),
            value => Some(value.to_json().to_string()),
        }
    }

    fn allows(&self, x: f64) -> bool {
        !x.is_nan() && self.minimum.is_none_or(|m| x >= m) && self.maximum.is_none_or(|m| x <= m)
    }

    /// Whether a value already has exactly the declared form. If false, [`accept`](Self::accept) decides.
    pub(crate) fn holds(&self, value: &Value) -> bool {
        match (&self.ty, value) {
            (Type::Bool, Value::Bool(_)) | (Type::String, Value::String(_)) => true,
            (Type::Int, Value::Int(i)) => self.allows(*i as f64),
            (Type::Float(_), Value::Float(x)) | (Type::Duration, Value::Duration(x)) => self.allows(*x),
            _ => false,
        }
    }

    /// The value, converted to the declared type and checked against the bounds.
    ///
    /// # Errors
    /// [`ParameterError`] when it is of another type, or out of bounds.
    pub fn accept(&self, value: Value) -> Result<Value, ParameterError> {
        let value = self.ty.convert(value)?;
        match value.as_f64().filter(|x| !self.allows(*x)) {
            None => Ok(value),
            Some(value) => Err(ParameterError::Range { value, minimum: self.minimum, maximum: self.maximum }),
        }
    }
}
