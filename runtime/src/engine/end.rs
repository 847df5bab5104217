//! How states and runs end: outcomes of skills, final states, charts, regions, and failures with their chains.

use std::collections::BTreeMap;

use armarium_values::Value;

use super::act::Failed;
use super::event::{Event, Origin};
use super::state::Turn;
use super::{Effect, Engine, RunResult, TraceItem};
use crate::program::{EventNumber, FAILURE, Kind, Program, SUCCESS, StateId};
use crate::skill::{Failure, SkillManifest, SkillResult};

/// The reason and the chain of states from a failure's data.
pub(super) fn reason_and_chain(data: &Value) -> (Option<String>, Vec<String>) {
    let reason = data.get("reason").and_then(Value::as_str).map(str::to_owned);
    let chain = data.get("chain").and_then(Value::as_list).unwrap_or(&[]);
    (reason, chain.iter().filter_map(Value::as_str).map(str::to_owned).collect())
}

/// A failure's data with one more state in its chain.
fn with_link(data: Value, path: &str) -> Value {
    let mut fields = match data {
        Value::Map(fields) => fields,
        _ => BTreeMap::new(),
    };
    let chain = fields.entry("chain".to_owned()).or_insert_with(|| Value::List(Vec::new()));
    if let Value::List(links) = chain
        && !links.iter().any(|l| l.as_str() == Some(path))
    {
        links.push(path.into());
    }
    Value::Map(fields)
}

impl Engine {
    pub(super) fn outcome_of_skill(&mut self, state: StateId, result: SkillResult, turn: &Turn<'_>) -> Event {
        let program = turn.program;
        let origin = Origin::Outcome { state, entry: self.runs[state as usize].entry, region_end: false };
        let Kind::Skill { manifest: declared } = &program.state(state).kind else {
            return Event::new(FAILURE, Value::Null, origin);
        };
        match checked(declared, result) {
            Ok((name, outputs)) => {
                for (output, slot) in &program.state(state).outputs {
                    let all = || Value::Map(outputs.clone());
                    let value = if declared.open { Some(all()) } else { outputs.get(output).cloned() };
                    self.store.data[*slot as usize] = value;
                }
                // Declared outcomes have numbers.
                let number = program.event_names.find(&name).unwrap_or(SUCCESS);
                Event::new(number, Value::Map(outputs), origin)
            }
            Err(failure) => {
                let data = Value::record([("reason", failure.reason.into())]);
                Event::new(FAILURE, with_link(data, program.path(state)), origin)
            }
        }
    }

    /// Raises the failure of a state for a reason of the engine's own.
    pub(super) fn push_failure(&mut self, state: StateId, data: Value, program: &Program) {
        let data = with_link(data, program.path(state));
        let origin = Origin::Outcome { state, entry: self.runs[state as usize].entry, region_end: false };
        self.internal.push_back(Event::new(FAILURE, data, origin));
    }

    pub(super) fn reached_final(&mut self, state: StateId, outcome: EventNumber, turn: &mut Turn<'_>) {
        let Some(parent) = turn.program.tables.parent(state) else { return };
        let mut data = self.final_data(state, outcome, turn);
        if outcome == FAILURE && !turn.program.is_root(parent) {
            data = with_link(data, turn.program.path(parent));
        }
        self.report(parent, outcome, data, turn.program);
    }

    /// The data of a final state: its `with`, and for a failure the reason and the chain.
    fn final_data(&mut self, state: StateId, outcome: EventNumber, turn: &mut Turn<'_>) -> Value {
        let program = turn.program;
        let mut fields = match self.bindings(&program.state(state).with, turn) {
            Ok(fields) => fields,
            Err(Failed { message, place }) => {
                self.error_at(state, &message, place, turn);
                BTreeMap::new()
            }
        };
        if outcome == SUCCESS {
            return Value::Map(fields);
        }
        let event = self.store.event.as_ref().map(|e| e.data());
        let here = event.filter(|data| data.get("reason").is_some());
        let owner = program.outward(state).find(|s| matches!(program.state(*s).kind, Kind::Chart { .. }));
        let before = self.last_failure.as_ref().filter(|(_, from)| {
            outcome == FAILURE && owner.is_some_and(|owner| program.within(*from, owner))
        });
        if outcome == FAILURE
            && here.or(before.map(|(data, _)| data)).is_none()
            && !fields.contains_key("reason")
        {
            fields.insert("reason".to_owned(), self.way_to(state, program).into());
        }
        if let Some(Value::Map(why)) = here.or(before.map(|(data, _)| data)) {
            for key in ["reason", "chain"] {
                if let (false, Some(value)) = (fields.contains_key(key), why.get(key)) {
                    let own = key == "reason" && here.is_some();
                    let said = if own { self.by_outcome(outcome, value, program) } else { None };
                    fields.insert(key.to_owned(), said.unwrap_or_else(|| value.clone()));
                }
            }
        }
        Value::Map(fields)
    }

    /// The reason of a failure that an outcome with another name led to: it says which.
    fn by_outcome(&self, outcome: EventNumber, reason: &Value, program: &Program) -> Option<Value> {
        let event = self.store.event.as_ref()?;
        let Origin::Outcome { state, .. } = event.origin else { return None };
        if outcome != FAILURE || event.number == FAILURE {
            return None;
        }
        let (from, name, why) = (program.path(state), event.name(program), reason.as_str()?);
        Some(format!("`{from}` ended with `{name}`: {why}").into())
    }

    /// How a failure without a reason of its own was reached.
    fn way_to(&self, state: StateId, program: &Program) -> String {
        let name = program.path(state);
        let Some(event) = &self.store.event else {
            return format!("a transition without an event leads to `{name}`");
        };
        let said = event.name(program);
        match event.origin {
            Origin::Outcome { state: from, .. } => {
                format!("`{}` ended with `{said}`, which leads to `{name}`", program.path(from))
            }
            Origin::Watch { state: from, .. } => {
                format!("the watch `{said}` of `{}` leads to `{name}`", program.path(from))
            }
            Origin::After { state: from, .. } => {
                format!("the time of `{}` was over, which leads to `{name}`", program.path(from))
            }
            _ => format!("the event `{said}` leads to `{name}`"),
        }
    }

    /// A state has ended by itself: raises `done.state` for all states, and the outcome for the state and those
    /// around it.
    fn report(&mut self, state: StateId, outcome: EventNumber, data: Value, program: &Program) {
        let of = program.state(state);
        if let (true, Some(owner)) = (of.chart_root, of.parent) {
            return self.chart_ended(owner, outcome, data, program);
        }
        let entry = self.runs[state as usize].entry;
        let region_end = of.region && !matches!(of.kind, Kind::Chart { .. });
        let origin = Origin::Outcome { state, entry, region_end };
        self.internal.push_back(Event::new(outcome, data.clone(), origin));
        self.internal.push_back(Event::new(of.done, data, Origin::Broadcast));
    }

    /// The chart inside a state has ended: its outputs and its outcome become the state's.
    fn chart_ended(&mut self, owner: StateId, outcome: EventNumber, mut data: Value, program: &Program) {
        if owner == 0 {
            self.ending.get_or_insert((outcome, data));
            return;
        }
        let of = program.state(owner);
        if let Kind::Chart { instance } = of.kind {
            let inner = &program.instances[instance as usize].outputs;
            for ((_, slot), variable) in of.outputs.iter().zip(inner) {
                let value = self.store.data[variable.slot as usize].clone();
                if let (Value::Map(fields), Some(value)) = (&mut data, &value) {
                    fields.entry(variable.declaration.name.clone()).or_insert_with(|| value.clone());
                }
                self.store.data[*slot as usize] = value;
            }
        }
        if outcome == FAILURE {
            data = with_link(data, &of.path);
        }
        self.report(owner, outcome, data, program);
    }

    /// No transition takes a state's outcome: the state stays active, marked as done. A parallel state ends when
    /// all its regions are done.
    pub(super) fn mark_done(&mut self, state: StateId, event: &Event, turn: &mut Turn<'_>) {
        let program = turn.program;
        self.extra(state).done = Some(event.number);
        turn.trace(|p| TraceItem::Done {
            state: p.path(state).to_owned(),
            outcome: event.name(p).to_owned(),
        });
        let of = program.state(state);
        let Some(parallel) = of.parent.filter(|_| of.region) else { return };
        let first_other = &mut self.extra(parallel).first_other;
        if event.number != SUCCESS && first_other.is_none() {
            *first_other = Some((event.number, event.data().clone()));
        }
        let children = &program.state(parallel).children;
        if children.iter().all(|c| self.extra_of(*c).is_some_and(|e| e.done.is_some())) {
            let other = self.extra(parallel).first_other.take();
            let (outcome, mut data) = other.unwrap_or_else(|| (SUCCESS, Value::record([])));
            if outcome == FAILURE {
                data = with_link(data, program.path(parallel));
            }
            self.report(parallel, outcome, data, program);
        }
    }

    pub(super) fn finish(
        &mut self,
        outcome: String,
        reason: Option<String>,
        chain: Vec<String>,
        turn: &mut Turn<'_>,
    ) {
        let outputs = self.outputs();
        self.finished = true;
        self.show_configuration(turn);
        for timer in std::mem::take(&mut self.timers).into_keys() {
            turn.out.push(Effect::CancelTimer { timer });
        }
        turn.trace(|_| TraceItem::Finished {
            outcome: outcome.clone(),
            reason: reason.clone(),
            chain: chain.clone(),
            outputs: outputs.clone(),
        });
        turn.out.push(Effect::Finished(RunResult { outcome, reason, chain, outputs }));
    }
}

/// Checks a skill's outcome and outputs against its manifest. Returns the failure if they do not match.
fn checked(
    declared: &SkillManifest,
    result: SkillResult,
) -> Result<(String, BTreeMap<String, Value>), Failure> {
    let skill = &declared.name;
    let outcome = result?;
    let name = outcome.name;
    if name == "failure" {
        return Err(Failure::new(format!("the skill `{skill}` failed without saying why")));
    }
    if declared.open {
        return Ok((name, outcome.outputs));
    }
    if name != "success" && !declared.outcomes.contains(&name) {
        let reason = format!("the skill `{skill}` gave the outcome `{name}`, which it does not declare");
        return Err(Failure::new(reason));
    }
    let mut outputs = BTreeMap::new();
    for (name, value) in outcome.outputs {
        let Some(output) = declared.outputs.iter().find(|o| o.name == name) else {
            return Err(Failure::new(format!(
                "the skill `{skill}` gave `{name}`, which it does not declare"
            )));
        };
        let wrong = |e| Failure::new(format!("the output `{name}` of `{skill}`: {e}"));
        let value = output.ty.convert(value).map_err(wrong)?;
        outputs.insert(name, value);
    }
    Ok((name, outputs))
}
