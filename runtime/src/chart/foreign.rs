//! Words of other languages for behaviour, and what Armarium calls them: XState, Sismic, SCXML, ArmarX, FlexBE,
//! BehaviorTree.CPP.

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Edit, FormKey, Remedy, Source, Span};

/// Words of other languages, with `|` between them, and what they are here.
const WORDS: &[(&str, &str)] = &[
    (
        "on|eventTransitions|Transitions|event_transitions|events|event|eventName|target",
        "in Armarium this is `transitions: {event: Target}`",
    ),
    ("type", "in Armarium the keys say what a state is: `states`, `parallel`, `final`, `history`, `skill`"),
    ("entry|onEntry|onentry|on_entry|on entry|onEnter", "in Armarium this is `enter: [action, ...]`"),
    ("onExit|onexit|on_exit|on exit|onBreak", "in Armarium this is `exit: [action, ...]`"),
    (
        "invoke|call|task|activity|activities|src|Action|actors|spawn",
        "in Armarium a state runs a skill: `skill: Name`",
    ),
    (
        "context|datamodel|data|preamble|variables|vars|localParameters|LocalParameters|userdata|\
         blackboard|SetBlackboard",
        "in Armarium a chart's variables are `locals: {name: {type: ..., default: ...}}`",
    ),
    (
        "inputParameters|InputParameters|input_ports|input_keys|input|params|parameters|args|arguments|\
         param|remapping|inputMapping|ParameterMappings|ParameterMapping",
        "in Armarium a state is given values by `with`, and a chart declares `inputs`",
    ),
    (
        "outputParameters|OutputParameters|output_ports|output_keys|output|outputMapping|donedata|content",
        "in Armarium a chart declares `outputs`, and `assign` sets them",
    ),
    (
        "guard|guards|cond|condition|when|unless|Condition|IfThenElse|WhileDoElse",
        "in Armarium this is `if: \"expression\"`",
    ),
    (
        "actions|action|script|Script|finalize|autoforward",
        "in Armarium these are `enter` and `exit` at a state, `do` at a transition",
    ),
    ("to|goto|next|destination|nextState", "in Armarium this is `target: State`"),
    (
        "initialState|initial state|start|startState|entry_point|StartState|root state",
        "in Armarium this is `initial: State`",
    ),
    (
        "parallel states|regions|orthogonal|Parallel|ReactiveParallel",
        "in Armarium this is `parallel: {Region: ...}`",
    ),
    ("timeout|delay|Timeout|Delay|delays", "in Armarium this is `after: {5s: Target}`"),
    (
        "Retry|RetryUntilSuccessful|num_attempts|max_attempts|retries|repeat|Repeat|\
         KeepRunningUntilFailure",
        "in Armarium this is `retry: {times: 3, wait: 1s}`",
    ),
    (
        "Sequence|SequenceNode|ReactiveSequence|sequence|children",
        "in Armarium a sequence is `states` whose `success` leads to the next: `transitions: {success: Next, failure: Failed}`",
    ),
    (
        "Fallback|Selector|ReactiveFallback|fallback",
        "in Armarium an alternative is a state to which `failure` leads: `transitions: {failure: Other}`",
    ),
    (
        "Inverter|ForceSuccess|ForceFailure|AlwaysFailure|AlwaysSuccess|Decorator",
        "in Armarium the transitions say where each outcome leads: `{success: Failed, failure: Done}`",
    ),
    (
        "SubTree|SubTreePlus|machine|substate|include|RemoteState",
        "in Armarium another chart is `statechart: Name`",
    ),
    ("EndState", "in Armarium this is `Name: {final: outcome}`"),
    ("meta|tags", "in Armarium what is for people is `description`"),
    ("priority", "in Armarium inner states come first, then the order in the file"),
    ("trigger|emit|raise", "in Armarium this is an action: `enter: [{raise: event}]`"),
    (
        "send|assign|log|cancel|foreach|do",
        "in Armarium actions stand under `enter` or `exit`, or `do` at a transition",
    ),
    (
        "if|switch|choice|choose|junction",
        "in Armarium a choice is `always: [{if: \"expression\", target: State}, Other]`",
    ),
    (
        "every|interval|loop",
        "in Armarium a state that is entered again and again leads to itself: `after: {5s: Name}`",
    ),
    (
        "autonomy",
        "in Armarium nobody has to confirm a transition; an event that a person sends is declared under `events`",
    ),
    (
        "reenter|external",
        "in Armarium a transition to a state leaves and enters it anew; `internal: true` keeps it",
    ),
    ("id|name", "in Armarium the key above is the name of a state"),
    ("eventless|automatic", "in Armarium this is `always: Target`"),
    (
        "onDone|onError|done|error|outcomes",
        "in Armarium outcomes are events: `transitions: {success: ..., failure: ...}`",
    ),
    (
        "contract|preconditions|postconditions|invariants",
        "in Armarium what must hold while a state is active is a `watch`",
    ),
    ("state|substates|LocalState|scxml", "in Armarium this is `states: {Name: ...}`"),
];

/// Words for which another key of the same form stands here.
const SAME: &[(&str, &[&str])] = &[
    ("transitions", &["on", "eventTransitions", "event_transitions", "Transitions"]),
    ("enter", &["entry", "onEntry", "onentry", "on_entry", "on entry", "onEnter"]),
    ("exit", &["onExit", "onexit", "on_exit", "on exit", "onBreak"]),
    ("skill", &["call", "task", "src"]),
    ("statechart", &["SubTree", "SubTreePlus", "machine", "include", "RemoteState"]),
    ("with", &["params", "parameters", "args", "arguments", "param", "inputParameters", "input_ports"]),
    ("if", &["guard", "cond", "condition", "when", "Condition"]),
    ("do", &["actions", "action"]),
    ("target", &["to", "goto", "next", "destination", "nextState"]),
    ("initial", &["initialState", "initial state", "start", "startState", "entry_point", "StartState"]),
    ("parallel", &["regions", "orthogonal", "Parallel", "ReactiveParallel"]),
    ("retry", &["Retry"]),
    ("after", &["delay", "delays"]),
    ("always", &["eventless", "automatic"]),
    ("states", &["substates"]),
    ("locals", &["variables", "vars"]),
];

/// Words for keys that only one form needs: a transition in a list, a chart.
const IN_FORMS: &[(&str, &[&str], &str)] = &[
    ("event", &["trigger", "on", "name", "signal", "id"], "in Armarium this is `event: name`"),
    ("for", &["delay", "after", "time", "timeout", "in"], "in Armarium this is `for: 5s`"),
    (
        "statechart",
        &["name", "id", "title", "machine", "scxml", "key"],
        "in Armarium this is `statechart: Name`",
    ),
];

/// Whether a value can stand under a key of a chart.
fn has_form_of(key: &str, node: &Node) -> bool {
    match key {
        "enter" | "exit" | "do" => match &node.value {
            Yaml::List(items) => items.iter().all(|item| matches!(item.value, Yaml::Map(_))),
            value => matches!(value, Yaml::Map(_)),
        },
        "with" | "after" | "states" | "parallel" | "locals" | "retry" => matches!(node.value, Yaml::Map(_)),
        "transitions" => matches!(node.value, Yaml::Map(_) | Yaml::List(_)),
        "skill" | "statechart" | "initial" | "target" | "event" | "if" => {
            matches!(node.value, Yaml::String(_))
        }
        _ => true,
    }
}

/// What a key that a form with `keys` does not have is here, and the key that stands for it if nothing else changes.
pub(super) fn meant(
    key: &str,
    node: &Node,
    keys: &[FormKey],
) -> Option<(&'static str, Option<&'static str>)> {
    let required = |name: &str| keys.iter().any(|key| key.name == name && key.required);
    if let Some((same, _, help)) =
        IN_FORMS.iter().find(|(same, words, _)| required(same) && words.contains(&key))
    {
        return Some((help, Some(*same).filter(|same| has_form_of(same, node))));
    }
    let (_, help) = WORDS.iter().find(|(words, _)| words.split('|').any(|word| word == key))?;
    let same = SAME.iter().find(|(_, words)| words.contains(&key)).map(|(same, _)| *same);
    Some((help, same.filter(|same| has_form_of(same, node))))
}

/// What a file is that is no chart, told by its outermost keys, and what to do.
pub(super) fn whole(has: impl Fn(&str) -> bool) -> Option<&'static str> {
    let any = |keys: &[&str]| keys.iter().any(|key| has(key));
    if any(&["BehaviorTree", "main_tree_to_execute", "root", "tree", "TreeNodesModel"]) {
        Some(
            "a behaviour tree has no states: make each node a state; a `Sequence` goes on by `success`, a `Fallback` by `failure`",
        )
    } else if any(&["states", "initial", "machine", "regions"]) {
        Some(
            "a statechart of another kind needs `statechart: Name` as its first key, and its words as in `docs/statecharts.md`",
        )
    } else {
        None
    }
}

/// Keys by which states in a list are named.
const NAMES: [&str; 3] = ["name", "id", "state"];

/// States of a list under their names; none where it is not known how, as in a list in brackets.
pub(super) fn by_name(source: &Source, items: &[Node]) -> Option<Remedy> {
    let text = source.text.as_str();
    let line_of = |at: usize| text[..at].rfind('\n').map_or(0, |newline| newline + 1);
    let mut edits = Vec::new();
    for item in items {
        let line = line_of(item.span.start);
        let indent = text[line..].len() - text[line..].trim_start_matches(' ').len();
        let dash = line + indent;
        let after = text.get(dash..)?.strip_prefix("- ")?.trim_start();
        let (to, written) = match &item.value {
            Yaml::String(name) => (item.span.end, format!("{name}: {{}}")),
            Yaml::Map(entries) => {
                let (key, value) = entries.first()?;
                let Yaml::String(name) = &value.value else { return None };
                let next = entries.get(1).map(|(next, _)| next.span.start);
                if !NAMES.contains(&key.text.as_str()) {
                    return None;
                }
                match (after.starts_with('{'), next) {
                    (true, next) => (next.unwrap_or(value.span.end), format!("{name}: {{")),
                    (false, Some(_)) => (value.span.end, format!("{name}:")),
                    (false, None) => (value.span.end, format!("{name}: {{}}")),
                }
            }
            _ => return None,
        };
        edits.push(Edit { span: Span { start: dash, end: to }, text: written });
    }
    // A list may stand as far left as its key; a map may not.
    let (first, last) = (line_of(items.first()?.span.start), items.last()?.span.end);
    let above = text[..first].lines().rfind(|line| line.trim_start().starts_with("states"))?;
    let indent = |line: &str| line.len() - line.trim_start().len();
    if indent(above) == indent(&text[first..]) {
        let lines = text[first..last].match_indices('\n').map(|(at, _)| first + at + 1);
        let starts = [first].into_iter().chain(lines);
        edits.extend(starts.map(|at| Edit { span: Span { start: at, end: at }, text: "  ".to_owned() }));
        edits.sort_by_key(|edit| (edit.span.start, edit.span.end));
    }
    Some(Remedy::Replace(edits))
}
