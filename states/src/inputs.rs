//! Converts a skill's checked inputs to Rust types, and results back to values.

use armarium_memoryx::{EntityId, Pattern};
use armarium_runtime::observed::MemoryPattern;
use armarium_runtime::skill::{Failure, SkillContext};
use armarium_values::{Frame, Observation, Pose, Reference, Value};
use nalgebra::{Isometry3, Point2, Point3, Vector3};

use crate::motions::failed;

/// Typed inputs of the robot and the memory, in addition to those of [`SkillContext`].
pub(crate) trait Inputs {
    /// A pose in the root frame.
    fn pose(&self, name: &str) -> Result<Isometry3<f64>, Failure>;
    /// True or false.
    fn flag(&self, name: &str) -> Result<bool, Failure>;
    /// The memory address in a reference.
    fn entity(&self, name: &str) -> Result<EntityId, Failure>;
    /// Three numbers.
    fn vector(&self, name: &str) -> Result<Vector3<f64>, Failure>;
    /// Three numbers; `None` where the list is empty.
    fn vector_if_given(&self, name: &str) -> Result<Option<Vector3<f64>>, Failure>;
}

impl Inputs for SkillContext {
    fn pose(&self, name: &str) -> Result<Isometry3<f64>, Failure> {
        let value = self.value(name)?;
        as_pose(value).ok_or_else(|| Failure::input(name, "a pose in the root frame", value))
    }

    fn flag(&self, name: &str) -> Result<bool, Failure> {
        Ok(matches!(self.value(name)?, Value::Bool(true)))
    }

    fn entity(&self, name: &str) -> Result<EntityId, Failure> {
        let value = self.value(name)?;
        let reference = value.as_reference().ok_or_else(|| Failure::input(name, "a reference", value))?;
        entity_of(reference)
    }

    fn vector(&self, name: &str) -> Result<Vector3<f64>, Failure> {
        let none = || Failure::new(format!("`{name}` needs three numbers"));
        as_vector(self.value(name)?).ok_or_else(none)
    }

    fn vector_if_given(&self, name: &str) -> Result<Option<Vector3<f64>>, Failure> {
        let is_empty = self.value(name)?.as_list().is_some_and(<[Value]>::is_empty);
        if is_empty { Ok(None) } else { self.vector(name).map(Some) }
    }
}

/// A pose value in the root frame as an isometry.
pub(crate) fn as_pose(value: &Value) -> Option<Isometry3<f64>> {
    match value {
        Value::Pose(pose) if pose.frame.0 == "root" => Some(pose.isometry()),
        _ => None,
    }
}

/// A pose in the root frame as a value.
pub(crate) fn pose_value(root_from: &Isometry3<f64>) -> Value {
    Value::Pose(Pose::new("root".into(), root_from))
}

/// Where something was observed, root frame, m.
pub(crate) fn seen_at(seen: &Observation) -> Option<Point3<f64>> {
    let place = seen.place.as_ref().filter(|place| place.position.frame == Frame::root())?;
    Some(Point3::from(place.position.vector()))
}

/// The pose in which something was observed, root frame.
pub(crate) fn seen_pose(seen: &Observation) -> Option<Isometry3<f64>> {
    seen.attributes.get("pose").and_then(as_pose)
}

/// A pattern of addresses, as memory is asked.
pub(crate) fn pattern_of(of: &MemoryPattern) -> Pattern {
    let part = |part: &str| (part != "*").then(|| part.to_owned());
    Pattern { segment: part(&of.segment), provider: part(&of.provider), entity: part(&of.entity) }
}

/// Three numbers as a vector.
pub(crate) fn as_vector(value: &Value) -> Option<Vector3<f64>> {
    value.as_vector3().map(Vector3::from)
}

/// Two numbers as a point, such as of a table.
pub(crate) fn as_flat_point(value: &Value) -> Option<Point2<f64>> {
    let [x, y] = value.as_list()? else { return None };
    Some(Point2::new(x.as_f64()?, y.as_f64()?))
}

/// A point as two numbers.
pub(crate) fn flat_point_value(point: &Point2<f64>) -> Value {
    Value::List(vec![Value::Float(point.x), Value::Float(point.y)])
}

/// Three numbers as a point.
pub(crate) fn as_point(value: &Value) -> Option<Point3<f64>> {
    value.as_vector3().map(Point3::from)
}

/// The memory address in a reference.
pub(crate) fn entity_of(reference: &Reference) -> Result<EntityId, Failure> {
    let id = &reference.id;
    match id.split('/').collect::<Vec<_>>().as_slice() {
        [segment, provider, entity] => EntityId::new(segment, provider, entity).map_err(failed),
        _ => Err(Failure::new(format!("`{id}` is not a memory address: it needs segment/provider/entity"))),
    }
}

/// A reference of a kind to a memory address.
pub(crate) fn reference(kind: &str, id: &EntityId) -> Value {
    Value::Reference(Reference { kind: kind.into(), id: id.to_string() })
}
