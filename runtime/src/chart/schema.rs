//! The JSON Schema of chart files, for editors: made from the same tables of keys that the reader uses, and from the
//! skills of a program.

use serde_json::{Map, Value as Json, json};

use super::catalog::Registry;
use super::read::CHART_KEYS;
use super::read_state::{ACTIONS, STATE_KEYS};

/// The schema of a chart file. Editors offer the skills of `registry` with what they do.
#[must_use]
pub fn schema(registry: &Registry) -> Json {
    let chart: Map<String, Json> = CHART_KEYS.iter().map(|key| ((*key).to_owned(), chart_key(key))).collect();
    let state: Map<String, Json> = STATE_KEYS.iter().map(|key| ((*key).to_owned(), state_key(key))).collect();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Statechart",
        "type": "object",
        "required": ["statechart"],
        "additionalProperties": false,
        "properties": chart,
        "$defs": {
            "state": {"type": ["object", "null"], "additionalProperties": false, "properties": state},
            "states": {"type": "object", "additionalProperties": {"$ref": "#/$defs/state"}},
            "skill": {"anyOf": skills(registry)},
            "values": {"type": "object", "description": "Values by name: literals, or `${expression}`."},
            "duration": {"type": ["string", "number"], "description": "A time: `2s`, `100ms`, or `${expression}`."},
            "condition": {"type": ["string", "boolean"], "description": "An expression in CEL."},
            "targets": {
                "description": "The name or path of a state, or a list of states of several regions.",
                "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}],
            },
            "entry": {"anyOf": [
                {"$ref": "#/$defs/targets"},
                object(&["target"], json!({"target": {"$ref": "#/$defs/targets"}, "do": {"$ref": "#/$defs/actions"}})),
            ]},
            "declaration": declaration(),
            "declarations": {"type": "object", "additionalProperties": {"$ref": "#/$defs/declaration"}},
            "transition": transition(&[]),
            "transition_list": {"anyOf": [
                {"type": "string"},
                {"$ref": "#/$defs/transition"},
                {"type": "array", "items": {"$ref": "#/$defs/transition"}},
            ]},
            "event_transition": transition(&["event"]),
            "timed_transition": transition(&["for"]),
            "actions": {"anyOf": [
                {"$ref": "#/$defs/action"},
                {"type": "array", "items": {"$ref": "#/$defs/action"}},
                {"type": "null"},
            ]},
            "action": action(),
        },
    })
}

fn object(required: &[&str], properties: Json) -> Json {
    json!({"type": "object", "additionalProperties": false, "required": required, "properties": properties})
}

fn text(description: &str) -> Json {
    json!({"type": "string", "description": description})
}

fn reference(name: &str, description: &str) -> Json {
    json!({"$ref": format!("#/$defs/{name}"), "description": description})
}

fn skills(registry: &Registry) -> Vec<Json> {
    let known = registry.manifests().map(|m| json!({"const": m.name, "description": m.description}));
    known.chain([json!({"type": "string"})]).collect()
}

fn chart_key(key: &str) -> Json {
    match key {
        "statechart" => text("The name that other charts use."),
        "inputs" => reference("declarations", "What the chart takes."),
        "outputs" => reference("declarations", "What the chart gives."),
        "locals" => reference("declarations", "What the chart remembers while it runs."),
        "types" => {
            json!({"type": "object", "description": "Words that stand for a type: `{enum: [fist, open_hand]}`."})
        }
        "events" => {
            json!({"type": "object", "description": "Events from outside that the chart understands, with what comes with them: `said: {data: {word: string}}`."})
        }
        "profiles" => {
            json!({"type": "object", "description": "Other defaults of inputs, chosen by `run --profile`."})
        }
        other => state_key(other),
    }
}

fn state_key(key: &str) -> Json {
    match key {
        "description" => text("For people."),
        "skill" => reference("skill", "The skill that this state runs."),
        "statechart" => text("The chart that is this state's inside."),
        "remote" => text("A chart or skill of another agent: `agent/Name`."),
        "states" => reference("states", "The states inside, one of them active."),
        "initial" => reference("entry", "Where it is entered."),
        "parallel" => reference("states", "The regions, which run side by side."),
        "final" => text("Ends what it is in, with this outcome."),
        "history" => json!({"enum": ["shallow", "deep"], "description": "Stands for what was left last."}),
        "default" => reference("entry", "Where a history leads at first."),
        "with" => reference("values", "What the skill or chart is given."),
        "enter" => reference("actions", "What is done when the state is entered."),
        "exit" => reference("actions", "What is done when the state is left."),
        "always" => reference("transition_list", "Transitions that need no event."),
        "after" => json!({
            "description": "Transitions that are taken when a time is over.",
            "anyOf": [
                {"type": "object", "additionalProperties": {"$ref": "#/$defs/transition_list"}},
                {"type": "array", "items": {"$ref": "#/$defs/timed_transition"}},
            ],
        }),
        "transitions" => json!({
            "description": "Transitions by event: a target, `{target, if, do, with}`, or a list of these.",
            "anyOf": [
                {"type": "object", "additionalProperties": {"$ref": "#/$defs/transition_list"}},
                {"type": "array", "items": {"$ref": "#/$defs/event_transition"}},
            ],
        }),
        "watch" => json!({
            "type": "object",
            "description": "Events that come when a condition over channels becomes true.",
            "additionalProperties": {"anyOf": [
                {"$ref": "#/$defs/condition"},
                object(&["if"], json!({
                    "if": {"$ref": "#/$defs/condition"},
                    "for": {"$ref": "#/$defs/duration"},
                    "until": {"$ref": "#/$defs/condition"},
                })),
            ]},
        }),
        "retry" => object(&[], json!({"times": {"type": "integer"}, "wait": {"$ref": "#/$defs/duration"}})),
        "limits" => object(
            &[],
            json!({"force": {"type": ["string", "number"]}, "speed": {"type": ["string", "number"]}}),
        ),
        "unbreakable" => {
            json!({"type": "boolean", "description": "Holds back what would leave it until it has ended."})
        }
        _ => json!({}),
    }
}

fn declaration() -> Json {
    let properties = json!({
        "type": text("bool, int, float, string, duration, list<T>, map<T>, Pose, Motion ..."),
        "unit": text("An SI unit, for float."),
        "default": {},
        "minimum": {"type": ["number", "string"]},
        "maximum": {"type": ["number", "string"]},
        "description": text("For people."),
        "enum": {"type": "array", "items": {"type": "string"}},
    });
    json!({"anyOf": [{"type": "string"}, object(&[], properties)]})
}

/// A transition as a map; `first` are the keys that it must have.
fn transition(first: &[&str]) -> Json {
    let mut properties = json!({
        "target": {"$ref": "#/$defs/targets"},
        "internal": {"type": "boolean", "description": "Leaves only what is inside."},
        "if": {"$ref": "#/$defs/condition"},
        "do": {"$ref": "#/$defs/actions"},
        "with": {"$ref": "#/$defs/values"},
    });
    for key in first {
        properties[*key] =
            if *key == "for" { json!({"$ref": "#/$defs/duration"}) } else { json!({"type": "string"}) };
    }
    object(first, properties)
}

fn action() -> Json {
    let form = |name: &str| match name {
        "assign" => json!({"$ref": "#/$defs/values"}),
        "raise" => {
            json!({"anyOf": [{"type": "string"}, object(&["event"], json!({"event": {"type": "string"}, "data": {}}))]})
        }
        "send" => json!({"anyOf": [{"type": "string"}, object(&["event"], json!({
            "event": {"type": "string"}, "to": {"type": "string"}, "data": {},
            "delay": {"$ref": "#/$defs/duration"}, "id": {"type": "string"},
        }))]}),
        "cancel" => text("The id of an event that was sent with a delay."),
        "if" => object(
            &["cond"],
            json!({
                "cond": {"$ref": "#/$defs/condition"},
                "then": {"$ref": "#/$defs/actions"}, "else": {"$ref": "#/$defs/actions"},
            }),
        ),
        "foreach" => object(
            &["in", "as"],
            json!({
                "in": {"type": ["string", "array"]}, "as": {"type": "string"}, "do": {"$ref": "#/$defs/actions"},
            }),
        ),
        _ => json!({}),
    };
    let properties: Map<String, Json> = ACTIONS.iter().map(|name| ((*name).to_owned(), form(name))).collect();
    json!({
        "type": "object", "additionalProperties": false,
        "minProperties": 1, "maxProperties": 1, "properties": properties,
    })
}
