//! The keys of the language, a table a form: the reader and the JSON Schema are made from them.

use armarium_source::{Key, object};
use serde_json::{Value as Json, json};

fn text() -> Json {
    json!({"type": "string"})
}

fn bool() -> Json {
    json!({"type": "boolean"})
}

fn any() -> Json {
    json!({})
}

fn map() -> Json {
    json!({"type": "object"})
}

fn quantity() -> Json {
    json!({"type": ["string", "number"]})
}

fn refer(name: &str) -> Json {
    json!({"$ref": format!("#/$defs/{name}")})
}

fn texts() -> Json {
    json!({"type": "array", "items": {"type": "string"}})
}

/// Something by names, or a list whose order counts.
fn by_name_or_list(one: &str) -> Json {
    let by_name = json!({"type": "object", "additionalProperties": refer("transition_list")});
    json!({"anyOf": [by_name, {"type": "array", "items": refer(one)}]})
}

fn watches() -> Json {
    json!({"type": "object", "additionalProperties": {"anyOf": [refer("condition"), object(WATCH)]}})
}

const DESCRIPTION: Key = Key::new("description", "For people.", text);
const STATES: Key = Key::new("states", "The states inside, one of them active.", || refer("states"));
const INITIAL: Key = Key::new("initial", "Where it is entered.", || refer("entry"));
const PARALLEL: Key = Key::new("parallel", "The regions, which run side by side.", || refer("states"));
const ENTER: Key = Key::new("enter", "What is done when the state is entered.", || refer("actions"));
const EXIT: Key = Key::new("exit", "What is done when the state is left.", || refer("actions"));
const WATCHES: Key =
    Key::new("watch", "Events that come when a condition over channels becomes true.", watches);
const AFTER: Key = Key::new("after", "Transitions that are taken when a time is over.", || {
    by_name_or_list("timed_transition")
});
const ALWAYS: Key = Key::new("always", "Transitions that need no event.", || refer("transition_list"));
const TRANSITIONS: Key = Key::new(
    "transitions",
    "Transitions by event: a target, `{target, if, do, with}`, or a list of these.",
    || by_name_or_list("event_transition"),
);
const LIMIT_SECTION: Key =
    Key::new("limits", "Bounds of force and speed for everything inside.", || object(LIMITS));

pub(super) const CHART: &[Key] = &[
    Key::new("statechart", "The name that other charts use.", text).required(),
    DESCRIPTION,
    Key::new("inputs", "What the chart takes.", || refer("declarations")),
    Key::new("outputs", "What the chart gives.", || refer("declarations")),
    Key::new("locals", "What the chart remembers while it runs.", || refer("declarations")),
    Key::new(
        "types",
        "Words that stand for a type: `{enum: [fist, open_hand]}`.",
        || json!({"type": "object", "additionalProperties": object(TYPE)}),
    ),
    Key::new(
        "events",
        "Events from outside that the chart understands, with what comes with them: `said: {data: {word: string}}`.",
        || json!({"type": "object", "additionalProperties": {"anyOf": [{"type": "null"}, object(EVENT)]}}),
    ),
    Key::new(
        "channels",
        "Channels that the chart's own skills publish, with what their values are: `battery: {type: {volts: {type: float, unit: V}}}`.",
        || json!({"type": "object", "additionalProperties": {"anyOf": [refer("type"), object(CHANNEL)]}}),
    ),
    Key::new("profiles", "Other defaults of inputs, chosen by `run --profile`.", map),
    LIMIT_SECTION,
    INITIAL,
    STATES,
    PARALLEL,
    ENTER,
    EXIT,
    WATCHES,
    AFTER,
    ALWAYS,
    TRANSITIONS,
];

pub(super) const STATE: &[Key] = &[
    DESCRIPTION,
    Key::new("skill", "The skill that this state runs.", || refer("skill")),
    Key::new("statechart", "The chart that is this state's inside.", || refer("chart")),
    Key::new("remote", "A chart or skill of another agent: `agent/Name`.", text),
    STATES,
    INITIAL,
    PARALLEL,
    Key::new("final", "Ends what it is in, with this outcome.", || refer("outcome")),
    Key::new("history", "Stands for what was left last.", || json!({"enum": ["shallow", "deep"]})),
    Key::new("default", "Where a history leads at first.", || refer("entry")),
    Key::new("with", "What the skill or chart is given.", || refer("values")),
    ENTER,
    EXIT,
    WATCHES,
    AFTER,
    ALWAYS,
    TRANSITIONS,
    Key::new("retry", "Starts a skill that fails again.", || object(RETRY)),
    LIMIT_SECTION,
    Key::new("unbreakable", "Holds back what would leave it until it has ended.", bool),
];

pub(super) const DECLARATION: &[Key] = &[
    Key::new("type", "bool, int, float, string, duration, list<T>, map<T>, Pose, Motion ...", || {
        refer("type")
    }),
    Key::new("unit", "An SI unit, for float.", || refer("unit")),
    Key::new("default", "What it is where nothing is given.", any),
    Key::new("minimum", "The least value.", quantity),
    Key::new("maximum", "The largest value.", quantity),
    DESCRIPTION,
    Key::new("enum", "The words that it can be.", texts),
];

pub(super) const EVENT: &[Key] =
    &[Key::new("data", "What comes with it.", || refer("declarations")), DESCRIPTION];

pub(super) const CHANNEL: &[Key] = &[
    Key::new(
        "type",
        "The fields of its values: `{volts: {type: float, unit: V}}`; or one type.",
        || json!({"anyOf": [refer("type"), refer("declarations")]}),
    )
    .required(),
    Key::new("unit", "An SI unit, where the type is float.", || refer("unit")),
    DESCRIPTION,
];

pub(super) const TYPE: &[Key] =
    &[Key::new("enum", "The words that it can be.", texts).required(), DESCRIPTION];

pub(super) const WATCH: &[Key] = &[
    Key::new("if", "The condition.", || refer("condition")).required(),
    Key::new("for", "How long it must hold.", || refer("duration")),
    Key::new("until", "What ends it; then it can come again.", || refer("condition")),
];

pub(super) const RETRY: &[Key] = &[
    Key::new("times", "How often.", || json!({"type": "integer"})),
    Key::new("wait", "How long after a failure.", || refer("duration")),
];

pub(super) const LIMITS: &[Key] = &[
    Key::new("force", "Largest force, N.", quantity),
    Key::new("speed", "Largest speed of the hand, m/s.", quantity),
];

const TARGET: Key = Key::new("target", "Where it leads.", || refer("targets"));
const GUARD: Key = Key::new("if", "When it may be taken.", || refer("condition"));
const DO: Key = Key::new("do", "What is done on the way.", || refer("actions"));
const WITH: Key = Key::new("with", "What the target is given.", || refer("values"));
const INTERNAL: Key = Key::new("internal", "Leaves only what is inside.", bool);

pub(super) const ENTRY: &[Key] = &[TARGET.required(), DO];
pub(super) const TRANSITION: &[Key] = &[TARGET, GUARD, DO, WITH, INTERNAL];
pub(super) const EVENT_TRANSITION: &[Key] = &[
    Key::new("event", "The event that it answers.", || refer("event")).required(),
    TARGET,
    GUARD,
    DO,
    WITH,
    INTERNAL,
];
pub(super) const TIMED_TRANSITION: &[Key] = &[
    Key::new("for", "The time after which it is taken.", || refer("duration")).required(),
    TARGET,
    GUARD,
    DO,
    WITH,
    INTERNAL,
];

pub(super) const ACTIONS: &[Key] = &[
    Key::new("assign", "Gives values to locals and outputs.", || refer("values")),
    Key::new(
        "raise",
        "Raises an event inside of this chart.",
        || json!({"anyOf": [refer("event"), object(RAISE)]}),
    ),
    Key::new(
        "send",
        "Sends an event to another agent, or later.",
        || json!({"anyOf": [refer("event"), object(SEND)]}),
    ),
    Key::new("cancel", "The id of an event that was sent with a delay.", text),
    Key::new("log", "Says something to people.", any),
    Key::new("if", "Does one thing or another.", || object(IF)),
    Key::new("foreach", "Does something for each item of a list.", || object(FOREACH)),
];

const NAME: Key = Key::new("event", "Its name.", || refer("event")).required();
const DATA: Key = Key::new("data", "What comes with it.", any);

pub(super) const RAISE: &[Key] = &[NAME, DATA];
pub(super) const SEND: &[Key] = &[
    NAME,
    Key::new("to", "The agent.", text),
    DATA,
    Key::new("delay", "How much later.", || refer("duration")),
    Key::new("id", "By which it can be cancelled.", text),
];
pub(super) const IF: &[Key] = &[
    Key::new("cond", "The condition.", || refer("condition")).required(),
    Key::new("then", "What is done when it holds.", || refer("actions")),
    Key::new("else", "What is done when it does not.", || refer("actions")),
];
pub(super) const FOREACH: &[Key] = &[
    Key::new("in", "The list.", || json!({"type": ["string", "array"]})).required(),
    Key::new("as", "The name of an item.", text).required(),
    Key::new("do", "What is done.", || refer("actions")),
];
