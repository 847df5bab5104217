//! Values of a declared type: read from a script, or made up where a script does not say.

use std::collections::BTreeMap;

use armarium_values::{ConvertError, Frame, Pose, Reference, Type, Value, Vector, Wrench};
use serde_json::Value as Json;

use crate::program::{ChannelSource, Program};

/// Why a script's value is none of the declared type.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StandInError {
    /// A part of it is missing or is another thing.
    #[error(transparent)]
    Part(#[from] serde_json::Error),
    /// It is of another type.
    #[error(transparent)]
    Type(#[from] ConvertError),
}

/// A script's value as the declared type; poses, vectors and wrenches are maps of their parts.
pub(super) fn read(ty: &Type, json: &Json) -> Result<Value, StandInError> {
    let value = match (ty, json) {
        (Type::Pose, Json::Object(_)) => Value::Pose(serde_json::from_value::<Pose>(json.clone())?),
        (Type::Vector, Json::Object(_)) => Value::Vector(serde_json::from_value::<Vector>(json.clone())?),
        (Type::Wrench, Json::Object(_)) => Value::Wrench(serde_json::from_value::<Wrench>(json.clone())?),
        _ => Value::from_json(json),
    };
    Ok(ty.convert(value)?)
}

/// A script's value as that of a channel of the program, whose fields may be left out. Memory may hold nothing.
///
/// # Errors
/// [`StandInError`] when a field is none of its type.
pub fn channel_value(program: &Program, channel: &str, json: &Json) -> Result<Value, StandInError> {
    let Some(channel) = program.named_channels.get(channel) else { return Ok(Value::from_json(json)) };
    match (&channel.ty, json) {
        (_, Json::Null) if matches!(channel.source, ChannelSource::Memory { .. }) => Ok(Value::Null),
        (Type::List(of), Json::Array(items)) => {
            Ok(Value::List(items.iter().map(|item| fields(of, item)).collect::<Result<_, _>>()?))
        }
        (ty, json) => fields(ty, json),
    }
}

fn fields(ty: &Type, json: &Json) -> Result<Value, StandInError> {
    let (Type::Record(types), Json::Object(fields)) = (ty, json) else { return read(ty, json) };
    let field = |(name, json): (&String, &Json)| {
        let value = types.get(name).map_or_else(|| Ok(Value::from_json(json)), |ty| read(ty, json));
        value.map(|value| (name.clone(), value))
    };
    Ok(Value::Map(fields.iter().map(field).collect::<Result<_, _>>()?))
}

/// Some value of a type: nothing, none, at the origin; a reference to something that is called `name`.
pub(super) fn of(ty: &Type, name: &str) -> Value {
    let root = || Frame::from("root");
    match ty {
        Type::Any => Value::Null,
        Type::Bool => Value::Bool(false),
        Type::Int => Value::Int(0),
        Type::Float(_) => Value::Float(0.0),
        Type::String => Value::String(String::new()),
        Type::Duration => Value::Duration(0.0),
        Type::Bytes => Value::Bytes(Vec::new()),
        Type::List(_) => Value::List(Vec::new()),
        Type::Map(_) => Value::Map(BTreeMap::new()),
        Type::Record(types) => {
            Value::Map(types.iter().map(|(field, ty)| (field.clone(), of(ty, field))).collect())
        }
        Type::Enum(words) => Value::String(words.first().cloned().unwrap_or_default()),
        Type::Vector => Value::Vector(Vector { frame: root(), components: [0.0; 3] }),
        Type::Pose => {
            Value::Pose(Pose { frame: root(), position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] })
        }
        Type::Wrench => Value::Wrench(Wrench { frame: root(), force: [0.0; 3], torque: [0.0; 3] }),
        Type::Reference(kind) => Value::Reference(Reference { kind: kind.clone(), id: name.to_owned() }),
    }
}
