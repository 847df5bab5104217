//! CEL expressions over snapshots, for queries and observers.
//!
//! Names: `id`, `segment`, `provider`, `entity`, `version`, `confidence`, `referenced_s`, `sent_s`, `arrived_s`; any
//! other name is an attribute of the hypothesis with the highest confidence (`attributes.NAME` where it has one of
//! these names). An expression without a value, because an attribute is missing or has another type, does not match.
//! One that exceeds a limit of evaluation is an error.

use std::cell::RefCell;

use armarium_values::expr::{Environment, EvalContext, Expr, Slot, Unknown, Unresolved, Variable};
use armarium_values::{Type, Value};

use crate::entity::Snapshot;
use crate::error::MemoryError;

/// A checked expression over snapshots.
#[derive(Clone, Debug)]
pub struct Filter {
    expression: Expr,
    names: Vec<Name>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Name {
    /// One of [`OWN`].
    Own(usize),
    Attribute(String),
}

/// A name, its type, and its value of a snapshot.
type OwnName = (&'static str, Type, fn(&Snapshot) -> Option<Value>);

/// The names that are not attributes.
static OWN: [OwnName; 9] = [
    ("id", Type::String, |s| Some(s.id.as_str().into())),
    ("segment", Type::String, |s| Some(s.id.segment().into())),
    ("provider", Type::String, |s| Some(s.id.provider().into())),
    ("entity", Type::String, |s| Some(s.id.entity().into())),
    ("version", Type::Int, |s| Some(Value::Int(i64::try_from(s.version).unwrap_or(i64::MAX)))),
    ("confidence", Type::FLOAT, |s| Some(Value::Float(s.instance()?.confidence))),
    ("referenced_s", Type::FLOAT, |s| Some(seconds(s.referenced_ns))),
    ("sent_s", Type::FLOAT, |s| Some(seconds(s.sent_ns))),
    ("arrived_s", Type::FLOAT, |s| Some(seconds(s.arrived_ns))),
];

fn seconds(ns: u64) -> Value {
    Value::Float(ns as f64 * 1e-9)
}

impl Name {
    /// The name at the start of a dotted path, its type, and how many of the path's parts belong to it.
    fn of(path: &[&str]) -> Option<(Self, Type, usize)> {
        let attribute = |name: &str| Self::Attribute(name.to_owned());
        match path {
            ["attributes", name, ..] => Some((attribute(name), Type::Any, 2)),
            [name, ..] => match OWN.iter().position(|(own, ..)| own == name) {
                Some(own) => Some((Self::Own(own), OWN[own].1.clone(), 1)),
                None => Some((attribute(name), Type::Any, 1)),
            },
            [] => None,
        }
    }
}

struct Names(RefCell<Vec<Name>>);

impl Environment for Names {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let missing = || Unresolved::new(Unknown::Name, "a name is missing".into(), None, None);
        let (name, ty, used) = Name::of(path).ok_or_else(missing)?;
        let mut names = self.0.borrow_mut();
        let at = names.iter().position(|n| *n == name).unwrap_or_else(|| {
            names.push(name);
            names.len() - 1
        });
        let slot = Slot::Data(u32::try_from(at).map_err(|_| missing())?);
        Ok(Variable { slot, ty, used })
    }

    fn channel(&self, name: &str) -> Result<u32, Unresolved> {
        let message = format!("`{name}` is a channel, and memory has none");
        Err(Unresolved::new(Unknown::Channel, message, None, None))
    }

    fn state(&self, path: &str) -> Result<u32, Unresolved> {
        let message = format!("`{path}` is a state, and memory has none");
        Err(Unresolved::new(Unknown::State, message, None, None))
    }
}

struct SnapshotContext<'a> {
    filter: &'a Filter,
    snapshot: &'a Snapshot,
    own: Vec<Option<Value>>,
}

impl EvalContext for SnapshotContext<'_> {
    fn data(&self, slot: u32) -> Option<&Value> {
        let at = usize::try_from(slot).ok()?;
        match self.filter.names.get(at)? {
            Name::Attribute(name) => self.snapshot.attribute(name),
            _ => self.own.get(at)?.as_ref(),
        }
    }
}

impl Filter {
    /// Checks an expression.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when it is not valid CEL, or cannot be a boolean.
    pub fn compile(source: &str) -> Result<Self, MemoryError> {
        let wrong = |what: String| {
            let short: String = source.chars().take(80).collect();
            MemoryError::Query { what: format!("the filter `{short}`: {what}") }
        };
        let names = Names(RefCell::default());
        let expression = Expr::compile(source, &names).map_err(|error| {
            let help = error.help.map_or_else(String::new, |help| format!(" ({help})"));
            wrong(error.message + &help)
        })?;
        if !matches!(expression.ty(), Type::Bool | Type::Any) {
            return Err(wrong(format!("is a {}, where true or false is wanted", expression.ty())));
        }
        Ok(Self { expression, names: names.0.into_inner() })
    }

    /// The `class` that whatever matches has to have, if it has to have one.
    pub(crate) fn wanted_class(&self) -> Option<&str> {
        let class = Name::Attribute("class".to_owned());
        let slot = self.names.iter().position(|name| *name == class)?;
        self.expression.wanted_text(u32::try_from(slot).ok()?)
    }

    /// Whether a snapshot matches.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when that is not known, because the evaluation exceeds a limit.
    pub fn fits(&self, snapshot: &Snapshot) -> Result<bool, MemoryError> {
        let own = |name: &Name| match name {
            Name::Own(own) => OWN[*own].2(snapshot),
            Name::Attribute(_) => None,
        };
        let own = self.names.iter().map(own).collect();
        match self.expression.test(&SnapshotContext { filter: self, snapshot, own }) {
            Err(error) if error.limit => {
                let what = format!("the filter says nothing about `{}`: {}", snapshot.id, error.message);
                Err(MemoryError::Query { what })
            }
            tested => Ok(tested.unwrap_or(false)),
        }
    }
}

#[cfg(test)]
mod tests {
    use armarium_values::{Frame, Vector};

    use super::*;
    use crate::attributes::Attributes;
    use crate::entity::Instance;

    #[test]
    fn expressions_see_attributes_and_what_surrounds_them() {
        let position = Value::Vector(Vector { frame: Frame::root(), components: [0.1, 0.2, 0.9] });
        let attributes =
            Attributes::from([("class", "sponge".into()), ("position", position), ("id", Value::Int(7))]);
        let snapshot = Snapshot {
            id: "ObjectInstances/vision/sponge".parse().unwrap(),
            version: 3,
            referenced_ns: 2_000_000_000,
            sent_ns: 0,
            arrived_ns: 0,
            instances: vec![Instance::new(attributes).with_confidence(0.75)],
        };
        for (source, expected) in [
            ("class == 'sponge' && confidence > 0.5", true),
            ("position.z > 0.8 && position.x < 0.2", true),
            ("position.z > 1", false),
            ("referenced_s == 2.0 && version == 3 && provider == 'vision'", true),
            ("id.startsWith('ObjectInstances') && attributes.id == 7", true),
            ("mass > 1.0", false),
            ("class > 1.0", false),
            ("!(mass > 1.0)", false),
        ] {
            match Filter::compile(source) {
                Ok(filter) => assert_eq!(filter.fits(&snapshot), Ok(expected), "{source}"),
                Err(error) => panic!("{source}: {error}"),
            }
        }
        for bad in ["", "class ==", "version + 1", "age(x) > 1", "'text'"] {
            assert!(matches!(Filter::compile(bad), Err(MemoryError::Query { .. })), "{bad}");
        }
    }
}
