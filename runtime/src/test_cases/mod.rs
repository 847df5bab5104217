//! Cases in YAML beside a chart, played under virtual time: how skills end, what happens, and what is expected.
//!
//! [`TestFile::read`] reads a file, [`TestFile::check`] holds it against its chart, [`TestFile::play`] plays one of its cases. No skill runs and nothing is printed here.

mod checks;
mod play;
mod stand_in;

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Field, Finding, Findings, Rule, Source, code, form};
use serde::Serialize;
use serde_json::{Value as Json, json};

pub use checks::{Programs, StepCheck, WrongStep};
pub use play::CaseError;
pub use stand_in::{StandInError, channel_value};

form! {
    /// A file of test cases.
    pub struct TestFile: "a file of test cases" {
        /// The chart, relative to this file.
        pub test: String;
        /// How skills end, by the skill's name or by the state, unless a case says otherwise.
        pub skills: BTreeMap<String, Script> = BTreeMap::new();
        /// Charts inside the chart that are stood in for, by their names, and how they end.
        pub charts: BTreeMap<String, Script> = BTreeMap::new();
        /// The cases.
        pub cases: Vec<Case>;
    }
}

form! {
    /// One case.
    pub struct Case: "a case" {
        /// What it shows.
        pub case: String;
        /// Inputs of the chart.
        pub given: BTreeMap<String, Json> = BTreeMap::new();
        /// The profile of the chart's inputs.
        pub profile: Option<String> = None;
        /// How skills end in this case.
        pub skills: BTreeMap<String, Script> = BTreeMap::new();
        /// Charts inside the chart that are stood in for in this case.
        pub charts: BTreeMap<String, Script> = BTreeMap::new();
        /// What happens, in this order.
        pub steps: Vec<Step> = Vec::new();
    }
}

/// How a skill ends: one way after the other, the last of which stays.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Script(Vec<Ending>);

form! {
    /// How a skill ends once.
    pub struct Ending: "an ending" {
        /// Its outcome; `never` is one that does not come.
        pub outcome: String = "success".into();
        /// How long it takes, s.
        pub after: f64 = 0.0, Rule::number("s", 0.0, 1e9);
        /// What it gives.
        pub outputs: BTreeMap<String, Json> = BTreeMap::new();
        /// Why it fails.
        pub reason: Option<String> = None;
    }
}

form! {
    /// One step: time goes by, then one thing happens, then something is expected.
    pub struct Step: "a step", check Self::does_one_thing {
        /// How much time goes by, s.
        pub after: f64 = 0.0, Rule::number("s", 0.0, 1e9);
        /// An event; with `from`, an outcome or a watch of that state.
        pub event: Option<String> = None;
        /// The state that it comes from.
        pub from: Option<String> = None;
        /// What comes with the event.
        pub data: Json = Json::Null;
        /// A channel that has a new value.
        pub channel: Option<String> = None;
        /// The channel's value; of what the chart observes of memory, `null` is nothing.
        pub value: Json = Json::Null;
        /// How old the value is then, s.
        pub age: f64 = 0.0, Rule::number("s", 0.0, 1e9);
        /// What is expected then.
        pub expect: Option<Expect> = None;
    }
}

form! {
    /// What is expected; what is left out is not looked at.
    pub struct Expect: "`expect`" {
        /// All innermost active states.
        pub active: Option<Vec<String>> = None;
        /// Locals of the chart.
        pub locals: BTreeMap<String, Json> = BTreeMap::new();
        /// Outputs of the chart.
        pub outputs: BTreeMap<String, Json> = BTreeMap::new();
        /// How the run has ended.
        pub outcome: Option<String> = None;
        /// A part of the reason.
        pub reason: Option<String> = None;
        /// A part of what was logged since the last step that looked at it.
        pub log: Option<String> = None;
        /// An event that was sent to another agent since the last step that looked at it.
        pub sent: Option<String> = None;
    }
}

impl TestFile {
    /// Reads a file of test cases.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(source: Arc<Source>) -> Result<Self, Vec<Finding>> {
        armarium_source::read(source)
    }
}

impl Script {
    /// How the skill ends when it is started for the `n`th time, from 0.
    fn ending(&self, n: usize) -> Ending {
        self.0.get(n).or(self.0.last()).cloned().unwrap_or_default()
    }
}

/// An outcome, a map with more about it, or a list of these.
impl Field for Script {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        let one = std::slice::from_ref(node);
        let endings = if let Yaml::List(items) = &node.value { items } else { one };
        self.0 = vec![Ending::default(); endings.len()];
        for (ending, node) in self.0.iter_mut().zip(endings) {
            match &node.value {
                Yaml::String(outcome) => ending.outcome.clone_from(outcome),
                Yaml::Map(_) => ending.read(node, rule, findings),
                _ => findings.form(node, "an outcome, or a map with more about it,"),
            }
        }
    }
    fn schema(rule: &Rule) -> Json {
        let one = json!({"anyOf": [{"type": "string"}, Ending::schema(rule)]});
        json!({"anyOf": [one, {"type": "array", "items": one}]})
    }
}

impl Step {
    fn does_one_thing(&self, node: &Node, findings: &mut Findings) {
        let alone = self.channel.is_none() || (self.event.is_none() && self.from.is_none());
        if !alone || (self.from.is_some() && self.event.is_none()) {
            let message = "a step does one thing: `event`, perhaps with `from`, or `channel`";
            findings.error(code::FORM, node.span, message);
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::chart::{ChannelSchema, Registry, check, load_text};
    use crate::program::Program;

    const CHART: &str = "statechart: C
locals: {list: {type: list<int>, default: [1]}}
events: {go: {data: {n: int}}}
initial: A
states:
  A:
    transitions: {go: {target: B, do: [{assign: {locals.list: \"${[locals.list[event.data.n]]}\"}}]}}
  B: {after: {1s: Failed}}
  Failed: {final: failure}
";

    fn program() -> Arc<Program> {
        let library = load_text("c.yaml", CHART, &[]);
        check(&library, &Registry::default(), &ChannelSchema::default()).program.expect("it is in order")
    }

    fn played(steps: &str) -> Result<(), String> {
        let text = format!("test: c.yaml\ncases:\n- case: a\n  steps: {steps}\n");
        let file = TestFile::read(Arc::new(Source::new("c.test.yaml", text))).expect("it is in order");
        file.play(&file.cases[0], &program()).1.map_err(|error| error.to_string())
    }

    #[test]
    fn a_run_that_fails_unexpectedly_fails_its_case() {
        let error =
            played("[{event: go, data: {n: 7}, expect: {active: [B]}}]").expect_err("there is no item 7");
        assert!(error.starts_with("the run has failed in ") && error.contains("c.yaml:7:"), "{error}");
        assert_eq!(played("[{event: go, data: {n: 7}, expect: {outcome: failure}}]"), Ok(()));
        assert_eq!(played("[{event: go, data: {n: 0}}, {after: 1s, expect: {active: [Failed]}}]"), Ok(()));
        assert!(played("[{event: go, data: {n: 0}}, {after: 1s}]").is_err());
    }

    #[test]
    fn a_chart_is_stood_in_for_in_one_case() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let inner = "statechart: Inner\nevents: {go: {}}\ninitial: A\nstates:\n  A: {transitions: {go: Done}}\n  Done: {final: success}\n";
        let outer = "statechart: Outer\ninitial: I\nstates:\n  I: {statechart: Inner, transitions: {success: Done, failure: Failed}}\n  Done: {final: success}\n  Failed: {final: failure}\n";
        for (name, text) in [("inner.yaml", inner), ("outer.yaml", outer)] {
            std::fs::write(folder.path().join(name), text).expect("it can be written");
        }
        let found = |case: &str| {
            let text = format!(
                "test: outer.yaml\ncases:\n- case: a\n  steps: [{{event: go, expect: {{outcome: success}}}}]\n- case: b\n  {case}\n"
            );
            let source = Arc::new(Source::new(folder.path().join("outer.test.yaml"), text));
            let file = TestFile::read(Arc::clone(&source)).expect("it is in order");
            let (registry, channels) = (Registry::default(), ChannelSchema::default());
            let programs = file.programs(&source, &[], &armarium_source::Disk, &registry, &channels)?;
            let findings = TestFile::check(source, &programs, &registry);
            if !findings.is_empty() {
                return Err(findings);
            }
            let played =
                file.cases.iter().zip(&programs.cases).map(|(case, program)| file.play(case, program).1);
            Ok(played.map(|result| result.err().map(|error| error.to_string())).collect::<Vec<_>>())
        };
        let passed = Ok(vec![None, None]);
        assert_eq!(found("charts: {Inner: failure}\n  steps: [{expect: {outcome: failure}}]"), passed);
        let said = |case: &str| found(case).expect_err("it is wrong")[0].to_string();
        let unused = said("charts: {Other: failure}\n  steps: []");
        assert!(unused.contains("outer.test.yaml:6:12") && unused.contains("`Other`"), "{unused}");
        let inside = said("charts: {Inner: never}\n  steps: [{expect: {active: [A]}}]");
        assert!(inside.contains("there is no state `A`"), "{inside}");
    }

    #[test]
    fn a_step_by_hand_is_held_against_the_chart() {
        let (program, registry) = (program(), Registry::default());
        let check = StepCheck::new(&program, &registry);
        for (step, said) in [
            (json!({"event": "go", "data": {"n": 1}}), ""),
            (json!({"event": "goo"}), "the chart takes no event `goo` (did you mean `go`?)"),
            (json!({"event": "success", "from": "C"}), "there is no state `C` (did you mean `A`?)"),
            (
                json!({"event": "success", "from": "B"}),
                "there is no outcome or watch of `B` called `success` (none is known)",
            ),
            (json!({"channel": "hand", "value": 1}), "there is no channel `hand` (none is known)"),
        ] {
            let found = check.check(&step).err().map_or_else(String::new, |error| error.to_string());
            assert_eq!(found, said, "{step}");
        }
        assert!(check.check(&json!({"event": "go", "data": {"n": "one"}})).is_err());
    }
}
