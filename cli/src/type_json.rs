//! Types as data for programs, as `skills --json` and `channels --json` print them.

use armarium_values::Type;
use serde_json::{Value as Json, json};

/// A type as data: `type`, and with it a number's `unit`, the words of an `enum`, what a list or map has as its `items`, the
/// `fields` of a record.
pub(crate) fn type_json(ty: &Type) -> Json {
    match ty {
        Type::Float(unit) => json!({"type": "float", "unit": unit.map(|unit| unit.to_string())}),
        Type::Duration => json!({"type": "duration", "unit": "s"}),
        Type::Enum(words) => json!({"type": "enum", "enum": words}),
        Type::List(items) => json!({"type": "list", "items": type_json(items)}),
        Type::Map(items) => json!({"type": "map", "items": type_json(items)}),
        Type::Record(fields) => {
            let field = |(name, ty): (&String, &Type)| {
                let mut json = type_json(ty);
                json["name"] = json!(name);
                json
            };
            json!({"type": "record", "fields": fields.iter().map(field).collect::<Vec<_>>()})
        }
        ty => json!({"type": ty.to_string()}),
    }
}
