//! The keys of the language, a table a form: the reader and the JSON Schema are made from them.

use armarium_source::{FormKey, object};
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

const DESCRIPTION: FormKey = FormKey::new("description", "For people.", text);
const STATES: FormKey = FormKey::new("states", "The states inside, one of them active.", || refer("states"));
const INITIAL: FormKey = FormKey::new("initial", "Where it is entered.", || refer("entry"));
const PARALLEL: FormKey =
    FormKey::new("parallel", "The regions, which run side by side.", || refer("states"));
const ENTER: FormKey = FormKey::new("enter", "What is done when the state is entered.", || refer("actions"));
const EXIT: FormKey = FormKey::new("exit", "What is done when the state is left.", || refer("actions"));
const WATCHES: FormKey =
    FormKey::new("watch", "Events that come when a condition over channels becomes true.", watches);
const AFTER: FormKey = FormKey::new("after", "Transitions that are taken when a time is over.", || {
    by_name_or_list("timed_transition")
});
const ALWAYS: FormKey =
    FormKey::new("always", "Transitions that need no event.", || refer("transition_list"));
const TRANSITIONS: FormKey = FormKey::new(
    "transitions",
    "Transitions by event: a target, `{target, if, do, with}`, or a list of these.",
    || by_name_or_list("event_transition"),
);
const LIMIT_SECTION: FormKey =
    FormKey::new("limits", "Bounds of force and speed for everything inside.", || object(LIMITS));

pub(super) const CHART: &[FormKey] = &[
    FormKey::new("statechart", "The name that other charts use.", text).required(),
    DESCRIPTION,
    FormKey::new("inputs", "What the chart takes.", || refer("declarations")),
    FormKey::new("outputs", "What the chart gives.", || refer("declarations")),
    FormKey::new("locals", "What the chart remembers while it runs.", || refer("declarations")),
    FormKey::new(
        "types",
        "Words that stand for a type: `{enum: [fist, open_hand]}`.",
        || json!({"type": "object", "additionalProperties": object(TYPE)}),
    ),
    FormKey::new(
        "events",
        "Events from outside that the chart understands, with what comes with them: `said: {data: {word: string}}`.",
        || json!({"type": "object", "additionalProperties": {"anyOf": [{"type": "null"}, object(EVENT)]}}),
    ),
    FormKey::new(
        "channels",
        "Channels that the chart's own skills publish, with what their values are: `battery: {type: {volts: {type: float, unit: V}}}`.",
        || json!({"type": "object", "additionalProperties": {"anyOf": [refer("type"), object(CHANNEL)]}}),
    ),
    FormKey::new(
        "observe",
        "What the chart observes of memory, as channels: `cup: \"ObjectInstances/*/cup*\"`.",
        || json!({"type": "object", "additionalProperties": refer("pattern")}),
    ),
    FormKey::new("profiles", "Other defaults of inputs, chosen by `run --profile`.", map),
    FormKey::new("probes", "What judges a simulated run, unless its world says it: `[grasp, force]`.", texts),
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

pub(super) const STATE: &[FormKey] = &[
    DESCRIPTION,
    FormKey::new("skill", "The skill that this state runs.", || refer("skill")),
    FormKey::new("statechart", "The chart that is this state's inside.", || refer("chart")),
    FormKey::new("remote", "A chart or skill of another agent: `agent/Name`.", text),
    STATES,
    INITIAL,
    PARALLEL,
    FormKey::new("final", "Ends what it is in, with this outcome.", || refer("outcome")),
    FormKey::new("history", "Stands for what was left last.", || json!({"enum": ["shallow", "deep"]})),
    FormKey::new("default", "Where a history leads at first.", || refer("entry")),
    FormKey::new("with", "What the skill or chart is given.", || refer("values")),
    ENTER,
    EXIT,
    WATCHES,
    AFTER,
    ALWAYS,
    TRANSITIONS,
    FormKey::new("retry", "Starts a skill that fails again.", || object(RETRY)),
    LIMIT_SECTION,
    FormKey::new("unbreakable", "Holds back what would leave it until it has ended.", bool),
];

pub(super) const DECLARATION: &[FormKey] = &[
    FormKey::new("type", "bool, int, float, string, duration, list<T>, map<T>, Pose, Motion ...", || {
        refer("type")
    }),
    FormKey::new("unit", "An SI unit, for float.", || refer("unit")),
    FormKey::new("default", "What it is where nothing is given.", any),
    FormKey::new("minimum", "The least value.", quantity),
    FormKey::new("maximum", "The largest value.", quantity),
    DESCRIPTION,
    FormKey::new("enum", "The words that it can be.", texts),
];

pub(super) const EVENT: &[FormKey] =
    &[FormKey::new("data", "What comes with it.", || refer("declarations")), DESCRIPTION];

pub(super) const CHANNEL: &[FormKey] = &[
    FormKey::new(
        "type",
        "The fields of its values: `{volts: {type: float, unit: V}}`; or one type.",
        || json!({"anyOf": [refer("type"), refer("declarations")]}),
    )
    .required(),
    FormKey::new("unit", "An SI unit, where the type is float.", || refer("unit")),
    DESCRIPTION,
];

pub(super) const TYPE: &[FormKey] =
    &[FormKey::new("enum", "The words that it can be.", texts).required(), DESCRIPTION];

pub(super) const WATCH: &[FormKey] = &[
    FormKey::new("if", "The condition.", || refer("condition")).required(),
    FormKey::new("for", "How long it must hold.", || refer("duration")),
    FormKey::new("until", "What ends it; then it can come again.", || refer("condition")),
];

pub(super) const RETRY: &[FormKey] = &[
    FormKey::new("times", "How often.", || json!({"type": "integer"})),
    FormKey::new("wait", "How long after a failure.", || refer("duration")),
];

pub(super) const LIMITS: &[FormKey] = &[
    FormKey::new("force", "Largest force, N.", quantity),
    FormKey::new("speed", "Largest speed of the hand, m/s.", quantity),
];

const TARGET: FormKey = FormKey::new("target", "Where it leads.", || refer("targets"));
const GUARD: FormKey = FormKey::new("if", "When it may be taken.", || refer("condition"));
const DO: FormKey = FormKey::new("do", "What is done on the way.", || refer("actions"));
const WITH: FormKey = FormKey::new("with", "What the target is given.", || refer("values"));
const INTERNAL: FormKey = FormKey::new("internal", "Leaves only what is inside.", bool);

pub(super) const ENTRY: &[FormKey] = &[TARGET.required(), DO];
pub(super) const TRANSITION: &[FormKey] = &[TARGET, GUARD, DO, WITH, INTERNAL];
pub(super) const EVENT_TRANSITION: &[FormKey] = &[
    FormKey::new("event", "The event that it answers.", || refer("event")).required(),
    TARGET,
    GUARD,
    DO,
    WITH,
    INTERNAL,
];
pub(super) const TIMED_TRANSITION: &[FormKey] = &[
    FormKey::new("for", "The time after which it is taken.", || refer("duration")).required(),
    TARGET,
    GUARD,
    DO,
    WITH,
    INTERNAL,
];

pub(super) const ACTIONS: &[FormKey] = &[
    FormKey::new("assign", "Gives values to locals and outputs.", || refer("values")),
    FormKey::new(
        "raise",
        "Raises an event inside of this chart.",
        || json!({"anyOf": [refer("event"), object(RAISE)]}),
    ),
    FormKey::new(
        "send",
        "Sends an event to another agent, or later.",
        || json!({"anyOf": [refer("event"), object(SEND)]}),
    ),
    FormKey::new("cancel", "The id of an event that was sent with a delay.", text),
    FormKey::new("log", "Says something to people.", any),
    FormKey::new("if", "Does one thing or another.", || object(IF)),
    FormKey::new("foreach", "Does something for each item of a list.", || object(FOREACH)),
];

const NAME: FormKey = FormKey::new("event", "Its name.", || refer("event")).required();
const DATA: FormKey = FormKey::new("data", "What comes with it.", any);

pub(super) const RAISE: &[FormKey] = &[NAME, DATA];
pub(super) const SEND: &[FormKey] = &[
    NAME,
    FormKey::new("to", "The agent.", text),
    DATA,
    FormKey::new("delay", "How much later.", || refer("duration")),
    FormKey::new("id", "By which it can be cancelled.", text),
];
pub(super) const IF: &[FormKey] = &[
    FormKey::new("cond", "The condition.", || refer("condition")).required(),
    FormKey::new("then", "What is done when it holds.", || refer("actions")),
    FormKey::new("else", "What is done when it does not.", || refer("actions")),
];
pub(super) const FOREACH: &[FormKey] = &[
    FormKey::new("in", "The list.", || json!({"type": ["string", "array"]})).required(),
    FormKey::new("as", "The name of an item.", text).required(),
    FormKey::new("do", "What is done.", || refer("actions")),
];
