//! How states and runs end: outcomes of skills, final states, charts, regions, and failures with their chains.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::Value;

use super::program::{Kind, StateId};
use super::{Effect, Engine, Event, Origin, RunResult, TraceItem, Turn};
use crate::skill::SkillResult;

/// The reason and the chain in a failure's data.
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
    pub(super) fn outcome_of_skill(&mut self, state: StateId, result: SkillResult) -> Event {
        let entry = self.runs[state as usize].entry;
        let origin = Origin::Outcome { state, entry, region_end: false };
        let declared = match &self.program.state(state).kind {
            Kind::Skill { manifest } => Arc::clone(manifest),
            _ => return Event { name: "failure".into(), data: Value::Null, origin },
        };
        let checked = result.map_err(|f| f.reason).and_then(|outcome| {
            let name = outcome.name.as_str();
            if name == "failure" {
                return Err(format!("the skill `{}` failed without saying why", declared.name));
            }
            if name != "success" && !declared.outcomes.iter().any(|o| o == name) {
                return Err(format!(
                    "the skill `{}` gave the outcome `{name}`, which it does not declare",
                    declared.name
                ));
            }
            let mut outputs = BTreeMap::new();
            for (name, value) in outcome.outputs {
                let Some(output) = declared.outputs.iter().find(|o| o.name == name) else {
                    return Err(format!(
                        "the skill `{}` gave `{name}`, which it does not declare",
                        declared.name
                    ));
                };
                let value = output.ty.convert(value);
                let value = value.map_err(|e| format!("the output `{name}` of `{}`: {e}", declared.name))?;
                outputs.insert(name, value);
            }
            Ok((outcome.name, outputs))
        });
        match checked {
            Ok((name, outputs)) => {
                for (output, slot) in &self.program.state(state).outputs {
                    self.store.data[*slot as usize] = outputs.get(output).cloned();
                }
                Event { name: name.into(), data: Value::Map(outputs), origin }
            }
            Err(reason) => {
                let data = Value::record([("reason", reason.into())]);
                let data = with_link(data, &self.program.state(state).path);
                Event { name: "failure".into(), data, origin }
            }
        }
    }

    /// A state fails for a reason of the engine's.
    pub(super) fn push_failure(&mut self, state: StateId, data: Value) {
        let data = with_link(data, &self.program.state(state).path);
        let entry = self.runs[state as usize].entry;
        let origin = Origin::Outcome { state, entry, region_end: false };
        self.internal.push_back(Event { name: "failure".into(), data, origin });
    }

    pub(super) fn reached_final(&mut self, state: StateId, outcome: &str, turn: &mut Turn<'_>) {
        let Some(parent) = self.program.state(state).parent else { return };
        let mut data = self.final_data(state, outcome, turn);
        if outcome == "failure" && !self.program.state(parent).chart_root {
            data = with_link(data, &self.program.state(parent).path);
        }
        self.report(parent, outcome.into(), data);
    }

    /// What a final state tells: its `with`, and for a failure why it came to that.
    fn final_data(&mut self, state: StateId, outcome: &str, turn: &mut Turn<'_>) -> Value {
        let program = Arc::clone(&self.program);
        let mut fields = self.bindings(&program.state(state).with, turn).unwrap_or_default();
        if outcome == "success" {
            return Value::Map(fields);
        }
        let event = self.store.event.as_ref().map(|e| &e.data);
        let here = event.filter(|data| data.get("reason").is_some());
        let instance_owner =
            program.outward(state).find(|s| matches!(program.state(*s).kind, Kind::Chart { .. }));
        let before = self.last_failure.as_ref().filter(|(_, from)| {
            outcome == "failure" && instance_owner.is_some_and(|owner| program.within(*from, owner))
        });
        if let Some(Value::Map(why)) = here.or(before.map(|(data, _)| data)) {
            for key in ["reason", "chain"] {
                if let (false, Some(value)) = (fields.contains_key(key), why.get(key)) {
                    fields.insert(key.to_owned(), value.clone());
                }
            }
        }
        Value::Map(fields)
    }

    /// A state has come to its end by itself: `done.state` for all, its outcome for itself and its surroundings.
    fn report(&mut self, state: StateId, outcome: Arc<str>, data: Value) {
        let program = Arc::clone(&self.program);
        let of = program.state(state);
        if of.chart_root
            && let Some(owner) = of.parent
        {
            return self.chart_ended(owner, outcome, data);
        }
        let entry = self.runs[state as usize].entry;
        let region_end = of.region && !matches!(of.kind, Kind::Chart { .. });
        let origin = Origin::Outcome { state, entry, region_end };
        let done = format!("done.state.{}", of.name);
        self.internal.push_back(Event { name: outcome, data: data.clone(), origin });
        self.internal.push_back(Event { name: done.into(), data, origin: Origin::Broadcast });
    }

    /// The chart inside a state has ended: its outputs become the state's, its outcome the state's.
    fn chart_ended(&mut self, owner: StateId, outcome: Arc<str>, mut data: Value) {
        let program = Arc::clone(&self.program);
        let of = program.state(owner);
        if let Kind::Chart { instance } = of.kind
            && owner != 0
        {
            let inner = &program.instances[instance as usize].outputs;
            for ((_, slot), variable) in of.outputs.iter().zip(inner) {
                let value = self.store.data[variable.slot as usize].clone();
                if let (Value::Map(fields), Some(value)) = (&mut data, &value) {
                    fields.entry(variable.declaration.name.clone()).or_insert_with(|| value.clone());
                }
                self.store.data[*slot as usize] = value;
            }
        }
        if owner != 0 {
            if &*outcome == "failure" {
                data = with_link(data, &of.path);
            }
            return self.report(owner, outcome, data);
        }
        let entry = self.runs[0].entry;
        let origin = Origin::Outcome { state: 0, entry, region_end: false };
        self.internal.push_back(Event { name: outcome, data, origin });
    }

    /// Nobody handled a state's outcome: it stays, marked done. Regions that are done end their parallel state,
    /// and the end of the outermost chart ends the run.
    pub(super) fn mark_done(&mut self, state: StateId, event: &Event, turn: &mut Turn<'_>) {
        if state == 0 {
            let (reason, chain) = reason_and_chain(&event.data);
            return self.finish_with(event.name.to_string(), reason, chain, turn);
        }
        self.runs[state as usize].done = Some(Arc::clone(&event.name));
        let path = self.program.state(state).path.clone();
        turn.trace(TraceItem::Done { state: path, outcome: event.name.to_string() });
        let Some(parallel) = self.program.state(state).parent.filter(|_| self.program.state(state).region)
        else {
            return;
        };
        if &*event.name != "success" && self.runs[parallel as usize].first_other.is_none() {
            self.runs[parallel as usize].first_other = Some((Arc::clone(&event.name), event.data.clone()));
        }
        let children = &self.program.state(parallel).children;
        if children.iter().all(|c| self.runs[*c as usize].done.is_some()) {
            let other = self.runs[parallel as usize].first_other.take();
            let (outcome, mut data) = other.unwrap_or_else(|| ("success".into(), Value::record([])));
            if &*outcome == "failure" {
                data = with_link(data, &self.program.state(parallel).path);
            }
            self.report(parallel, outcome, data);
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
        turn.trace(TraceItem::Finished {
            outcome: outcome.clone(),
            reason: reason.clone(),
            chain: chain.clone(),
            outputs: outputs.clone(),
        });
        turn.out.push(Effect::Finished(RunResult { outcome, reason, chain, outputs }));
    }
}
