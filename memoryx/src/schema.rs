//! Typed core segments: the attributes of their entities, with types. Undeclared segments are not checked, nor are
//! attributes that a schema does not name.

use armarium_values::{Type, Value};

use crate::entity::{EntityId, Instance};
use crate::error::MemoryError;

/// Deepest nesting of an attribute's value; the codec can read this back.
const MAX_DEPTH: usize = 16;
/// Largest deviation of a unit quaternion's norm from 1: enough for numbers written with three digits.
const UNIT_NORM_TOLERANCE: f64 = 1e-3;

/// One attribute of a typed core segment.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute {
    /// Its name.
    pub name: String,
    /// Its type; an integer is accepted where a `Float` is declared.
    pub ty: Type,
    /// Whether every instance must have it.
    pub required: bool,
    /// One sentence for people, with frame and unit.
    pub description: String,
}

/// The schema of a core segment.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentSchema {
    /// The core segment's name.
    pub segment: String,
    /// What it holds, in one sentence.
    pub description: String,
    /// The attributes that are checked.
    pub attributes: Vec<Attribute>,
}

impl SegmentSchema {
    /// A core segment without checked attributes.
    pub fn new(segment: &str, description: &str) -> Self {
        Self { segment: segment.into(), description: description.into(), attributes: Vec::new() }
    }

    /// The same schema with one more mandatory attribute.
    #[must_use]
    pub fn required(self, name: &str, ty: Type, description: &str) -> Self {
        self.attribute(name, ty, true, description)
    }

    /// The same schema with one more optional attribute.
    #[must_use]
    pub fn optional(self, name: &str, ty: Type, description: &str) -> Self {
        self.attribute(name, ty, false, description)
    }

    fn attribute(mut self, name: &str, ty: Type, required: bool, description: &str) -> Self {
        self.attributes.push(Attribute { name: name.into(), ty, required, description: description.into() });
        self
    }

    /// Checks one instance.
    ///
    /// # Errors
    /// [`MemoryError::Schema`] with the first attribute that does not fit.
    pub fn check(&self, id: &EntityId, instance: &Instance) -> Result<(), MemoryError> {
        for attribute in &self.attributes {
            let missing = || Misfit::here(format!("is missing: {}", attribute.description));
            let wrong = match instance.attributes.get(&attribute.name) {
                None => attribute.required.then(missing),
                Some(value) => misfit(&attribute.ty, value),
            };
            if let Some(Misfit { path, what }) = wrong {
                let attribute = format!("{}{path}", attribute.name);
                return Err(MemoryError::Schema { id: id.to_string(), attribute, what });
            }
        }
        Ok(())
    }
}

/// A place inside an attribute, and the error there.
struct Misfit {
    path: String,
    what: String,
}

impl Misfit {
    fn here(what: String) -> Self {
        Self { path: String::new(), what }
    }

    fn inside(self, step: &str) -> Self {
        Self { path: format!("{step}{}", self.path), what: self.what }
    }
}

fn misfit(ty: &Type, value: &Value) -> Option<Misfit> {
    let finite = |numbers: &[f64]| {
        (!numbers.iter().all(|n| n.is_finite())).then(|| Misfit::here("is not finite".into()))
    };
    match (ty, value) {
        (Type::Any, _)
        | (Type::Bool, Value::Bool(_))
        | (Type::Int | Type::Float(_) | Type::Duration, Value::Int(_))
        | (Type::String, Value::String(_))
        | (Type::Bytes, Value::Bytes(_)) => None,
        (Type::Float(_), Value::Float(x)) | (Type::Duration, Value::Float(x) | Value::Duration(x)) => {
            finite(&[*x])
        }
        (Type::List(ty), Value::List(items)) => {
            items.iter().enumerate().find_map(|(i, item)| Some(misfit(ty, item)?.inside(&format!("[{i}]"))))
        }
        (Type::Map(ty), Value::Map(fields)) => {
            fields.iter().find_map(|(name, item)| Some(misfit(ty, item)?.inside(&format!(".{name}"))))
        }
        (Type::Record(types), Value::Map(fields)) => {
            types.iter().find_map(|(name, ty)| match fields.get(name) {
                None => Some(Misfit::here(format!("has no field `{name}`"))),
                Some(item) => Some(misfit(ty, item)?.inside(&format!(".{name}"))),
            })
        }
        (Type::Enum(words), Value::String(word)) => (!words.contains(word))
            .then(|| Misfit::here(format!("is `{word}`, not one of {}", words.join(", ")))),
        (Type::Vector, Value::Vector(v)) => finite(&v.components),
        (Type::Pose, Value::Pose(p)) => {
            finite(&p.position).or_else(|| finite(&p.orientation)).or_else(|| {
                (!is_unit(&p.orientation))
                    .then(|| Misfit::here("has an orientation that is not a unit quaternion".into()))
            })
        }
        (Type::Wrench, Value::Wrench(w)) => finite(&w.force).or_else(|| finite(&w.torque)),
        (Type::Reference(kind), Value::Reference(r)) => (r.kind != *kind)
            .then(|| Misfit::here(format!("refers to the {} `{}`, not to a {kind}", r.kind, r.id))),
        (ty, value) => Some(Misfit::here(format!("is {}, where {ty} is wanted", value.describe()))),
    }
}

/// Checks what holds for every instance in any segment: confidence, depth, covariances.
pub(crate) fn check_form(id: &EntityId, instance: &Instance) -> Result<(), MemoryError> {
    let refused = |attribute: &str, what: &str| {
        Err(MemoryError::Schema { id: id.to_string(), attribute: attribute.into(), what: what.into() })
    };
    if !(0.0..=1.0).contains(&instance.confidence) {
        return Err(MemoryError::Confidence { id: id.to_string() });
    }
    if let Some((name, _)) = instance.attributes.iter().find(|(_, value)| too_deep(value)) {
        return refused(name, "is nested too deep");
    }
    if let Some((name, _)) = instance.attributes.iter().find(|(_, value)| has_bad_orientation(value)) {
        return refused(name, "has a pose whose orientation is no unit quaternion");
    }
    for (name, covariance) in &instance.covariance {
        let size = match instance.attributes.get(name) {
            Some(Value::Int(_) | Value::Float(_) | Value::Duration(_)) => 1,
            Some(Value::Vector(_)) => 3,
            Some(Value::Pose(_)) => 6,
            Some(_) => return refused(name, "has a covariance, and is of a type that has none"),
            None => return refused(name, "has a covariance, and is missing"),
        };
        if !is_covariance(covariance, size) {
            let what = format!("needs a symmetric covariance of {size}x{size} numbers, not negative");
            return refused(name, &what);
        }
    }
    Ok(())
}

/// Whether `rows` is a symmetric matrix whose 1x1 and 2x2 principal minors are not negative.
fn is_covariance(rows: &[f64], size: usize) -> bool {
    if rows.len() != size * size || rows.iter().any(|x| !x.is_finite()) {
        return false;
    }
    let at = |i: usize, j: usize| rows[i * size + j];
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (a.abs() + b.abs()) + f64::MIN_POSITIVE;
    (0..size).all(|i| {
        at(i, i) >= 0.0
            && (0..i).all(|j| {
                let bound = (at(i, i) * at(j, j)).sqrt() * (1.0 + 1e-9) + f64::MIN_POSITIVE;
                close(at(i, j), at(j, i)) && at(i, j).abs() <= bound
            })
    })
}

fn is_unit(quaternion: &[f64; 4]) -> bool {
    let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
    (norm - 1.0).abs() <= UNIT_NORM_TOLERANCE
}

/// Whether a value contains a pose whose orientation is not a unit quaternion. The value must not be nested too deep.
fn has_bad_orientation(value: &Value) -> bool {
    match value {
        Value::Pose(pose) => !is_unit(&pose.orientation),
        Value::List(items) => items.iter().any(has_bad_orientation),
        Value::Map(fields) => fields.values().any(has_bad_orientation),
        _ => false,
    }
}

/// Whether a value is nested too deep to be stored or sent.
pub(crate) fn too_deep(value: &Value) -> bool {
    value.deeper_than(MAX_DEPTH - 1)
}

#[cfg(test)]
mod tests {
    use armarium_values::{Frame, Vector};

    use super::*;

    #[test]
    fn covariances_fit_their_attributes() {
        let id: EntityId = "S/p/e".parse().unwrap();
        let point = Value::Vector(Vector { frame: Frame::root(), components: [0.0; 3] });
        let instance = Instance::new([("x", Value::Float(1.0)), ("at", point), ("word", "a".into())]);
        let fits = |name: &str, rows: &[f64]| {
            check_form(&id, &instance.clone().with_covariance(name, rows.to_vec())).is_ok()
        };
        assert!(fits("x", &[0.0]) && fits("at", &[1.0, 0.5, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 2.0]));
        for (name, rows) in [
            ("x", &[-1.0][..]),
            ("x", &[f64::NAN]),
            ("x", &[1.0, 1.0]),
            ("at", &[1.0]),
            ("at", &[1.0, 0.5, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0, 2.0]),
            ("at", &[1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 2.0]),
            ("word", &[1.0]),
            ("missing", &[1.0]),
        ] {
            assert!(!fits(name, rows), "{name} {rows:?}");
        }
    }

    #[test]
    fn depth_is_bounded() {
        let nested = |n| (0..n).fold(Value::Null, |v, _| Value::List(vec![v]));
        assert!(!too_deep(&nested(MAX_DEPTH - 1)));
        assert!(too_deep(&nested(MAX_DEPTH)));
    }
}
