//! The JSON Schema of chart files, for editors: made from the tables of keys that the reader uses, and from the skills of a
//! program.

use armarium_source::{FormKey, object};
use armarium_values::Type;
use serde_json::{Value as Json, json};

use super::catalog::Registry;
use super::forms;
use crate::skill::{Parameter, SkillManifest};

/// The schema of a chart file. Editors offer the skills of `registry` with what they do.
pub fn schema(registry: &Registry) -> Json {
    let mut state = object(forms::STATE);
    state["type"] = json!(["object", "null"]);
    let mut action = object(forms::ACTIONS);
    (action["minProperties"], action["maxProperties"]) = (json!(1), json!(1));
    let or_text = |keys: &[FormKey]| json!({"anyOf": [{"type": "string"}, object(keys)]});
    let one_or_list = |name: &str, other: Json| {
        let one = json!({"$ref": format!("#/$defs/{name}")});
        json!({"anyOf": [other, one, {"type": "array", "items": one}]})
    };
    let text = |what: &str| json!({"type": "string", "description": what});
    let skills = registry.manifests().map(|m| json!({"const": m.name, "description": m.description}));
    // What a state may give depends on the skill that it runs.
    let inputs = registry.manifests().filter(|manifest| !manifest.open).map(inputs_of);
    state["allOf"] = inputs.collect();
    let mut schema = object(forms::CHART);
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("Statechart");
    schema["$defs"] = json!({
        "state": state,
        "states": {"type": "object", "additionalProperties": {"$ref": "#/$defs/state"}},
        "skill": {"anyOf": skills.chain([json!({"type": "string"})]).collect::<Vec<_>>()},
        "values": {"type": "object", "description": "Values by name: literals, or `${expression}`."},
        "duration": {"type": ["string", "number"], "description": "A time: `2s`, `100ms`, or `${expression}`."},
        "chart": text("The name of a chart."),
        "outcome": text("The name of an outcome: `success`, `failure`, or one of your own."),
        "event": text("The name of an event."),
        "type": text("A type: `float`, `list<float>`, `Pose`, or one that the chart declares."),
        "pattern": text("Addresses in memory: `segment/provider/entity`, with `*` for any characters."),
        "unit": text("An SI unit: `N`, `m/s`."),
        "condition": {"type": ["string", "boolean"], "description": "An expression in CEL."},
        "targets": {
            "description": "The name or path of a state, or a list of states of several regions.",
            "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}],
        },
        "entry": {"anyOf": [{"$ref": "#/$defs/targets"}, object(forms::ENTRY)]},
        "declaration": or_text(forms::DECLARATION),
        "declarations": {"type": "object", "additionalProperties": {"$ref": "#/$defs/declaration"}},
        "transition": object(forms::TRANSITION),
        "transition_list": one_or_list("transition", json!({"type": "string"})),
        "event_transition": object(forms::EVENT_TRANSITION),
        "timed_transition": object(forms::TIMED_TRANSITION),
        "actions": one_or_list("action", json!({"type": "null"})),
        "action": action,
    });
    schema
}

/// What a state that runs a skill gives to it.
fn inputs_of(manifest: &SkillManifest) -> Json {
    let inputs = manifest.inputs.iter().map(|input| (input.name.clone(), input_of(input)));
    let inputs: serde_json::Map<String, Json> = inputs.collect();
    json!({
        "if": {"properties": {"skill": {"const": manifest.name}}, "required": ["skill"]},
        "then": {"properties": {"with": {"properties": inputs, "additionalProperties": false}}},
    })
}

fn input_of(input: &Parameter) -> Json {
    let mut schema = json!({"description": format!("{}: {}", input.ty, input.description)});
    if let Type::Enum(words) = &input.ty {
        schema["anyOf"] = json!([{"enum": words}, {"type": "string", "pattern": "\\$\\{"}]);
    }
    if let Some(default) = &input.default {
        schema["default"] = default.to_json();
    }
    schema
}
