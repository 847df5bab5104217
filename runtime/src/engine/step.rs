//! One microstep: cancel what is left, wait until it has returned, then leave, act and enter.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;

use super::program::{Binding, Kind, StateId};
use super::{
    Effect, Engine, Event, Origin, Pending, Run, RunResult, SkillRun, Step, TimerUse, TraceItem, Turn,
};
use crate::skill::SkillResult;

/// Longest time that a timer waits.
const LONGEST_S: f64 = 1.0e9;

/// A finite, non-negative number of seconds as a duration.
pub(super) fn duration(seconds: f64) -> Duration {
    if seconds.is_finite() { Duration::from_secs_f64(seconds.clamp(0.0, LONGEST_S)) } else { Duration::ZERO }
}

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
    /// Begins a microstep: cancels the skills of all states that it leaves.
    pub(super) fn begin(&mut self, step: Step, event: Option<Event>, turn: &mut Turn<'_>) {
        if let Step::Take(transitions) = &step {
            for t in transitions {
                let t = &self.program.transitions[*t as usize];
                turn.trace(TraceItem::Transition {
                    source: self.program.state(t.source).path.clone(),
                    event: event.as_ref().map(|e| e.name.to_string()),
                    target: t.target.map(|s| self.program.state(s).path.clone()),
                });
            }
        }
        let exits = self.exits(&step);
        let waiting = self.cancel(&exits, turn);
        if !waiting.is_empty() {
            let states = exits.iter().filter(|s| **s != 0 && !self.program.state(**s).chart_root);
            let states = states.map(|s| self.program.state(*s).path.clone()).collect();
            turn.trace(TraceItem::Leaving { states });
        }
        self.pending = Some(Pending { step, event, exits, waiting });
        self.complete_if_returned(turn);
    }

    /// Ends the run, whatever is being done: everything is left, once all skills have returned.
    pub(super) fn finish_with(
        &mut self,
        outcome: String,
        reason: Option<String>,
        chain: Vec<String>,
        turn: &mut Turn<'_>,
    ) {
        self.show_configuration(turn);
        // What was pending is given up; its cancelled skills are still waited for, as their states are active.
        self.pending = None;
        self.begin(Step::Finish { outcome, reason, chain }, None, turn);
    }

    fn exits(&self, step: &Step) -> Vec<StateId> {
        let inside = |domain: StateId| {
            let program = &self.program;
            self.configuration.iter().copied().filter(move |s| *s != domain && program.within(*s, domain))
        };
        match step {
            Step::Finish { .. } => self.configuration.clone(),
            Step::Restart(state) => inside(*state).collect(),
            Step::Take(transitions) => {
                let domains = transitions.iter().filter_map(|t| self.program.transitions[*t as usize].domain);
                let exits: BTreeSet<StateId> = domains.flat_map(inside).collect();
                exits.into_iter().collect()
            }
        }
    }

    /// Cancels the skills of these states; gives those that have to return.
    fn cancel(&mut self, states: &[StateId], turn: &mut Turn<'_>) -> BTreeSet<u64> {
        let mut waiting = BTreeSet::new();
        for state in states {
            let run = &mut self.runs[*state as usize];
            match run.skill {
                SkillRun::Running(activation) => {
                    run.skill = SkillRun::Cancelling(activation);
                    let path = self.program.state(*state).path.clone();
                    turn.trace(TraceItem::SkillCancelled { activation, state: path });
                    let grace = match &self.program.state(*state).kind {
                        Kind::Skill { manifest } => manifest.grace,
                        _ => Duration::from_secs(1),
                    };
                    turn.out.push(Effect::Cancel { activation, grace });
                    waiting.insert(activation);
                }
                SkillRun::Cancelling(activation) => {
                    waiting.insert(activation);
                }
                SkillRun::Ready(_) => {
                    run.skill = SkillRun::None;
                    self.ready.remove(state);
                }
                SkillRun::None => {}
            }
        }
        waiting
    }

    /// Goes on with the microstep that is pending, once all skills that it leaves have returned.
    pub(super) fn complete_if_returned(&mut self, turn: &mut Turn<'_>) {
        if self.pending.as_ref().is_none_or(|p| !p.waiting.is_empty()) {
            return;
        }
        let Some(pending) = self.pending.take() else { return };
        if pending.event.is_some() {
            self.store.event.clone_from(&pending.event);
        }
        self.remember(&pending.exits);
        for state in pending.exits.iter().rev() {
            self.exit(*state, turn);
        }
        match pending.step {
            Step::Take(transitions) => self.take(&transitions, turn),
            Step::Restart(state) => self.restart(state, pending.event.as_ref(), turn),
            Step::Finish { outcome, reason, chain } => self.finish(outcome, reason, chain, turn),
        }
    }

    fn take(&mut self, transitions: &[u32], turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let mut entries = Entries::default();
        for t in transitions {
            let t = &program.transitions[*t as usize];
            // What a transition gives is evaluated before its actions change anything that it reads.
            let given = self.bindings(&t.with, turn);
            self.act(&t.actions, t.source, turn);
            if let (Some(target), Some(domain)) = (t.target, t.domain) {
                self.add_target(target, domain, &mut entries);
                entries.given.push((target, given));
            }
        }
        self.enter_all(entries, turn);
    }

    // Leaving.

    /// Histories of states that are left remember what is active now.
    fn remember(&mut self, exits: &[StateId]) {
        let program = Arc::clone(&self.program);
        for state in exits {
            for history in &program.state(*state).histories {
                let Kind::History { deep, .. } = &program.state(*history).kind else { continue };
                let inside = self.configuration.iter().copied();
                let inside = inside.filter(|s| s != state && program.within(*s, *state));
                let states: Vec<StateId> = if *deep {
                    // Leaves of this chart; the inside of another chart is not remembered.
                    let foreign = |s: StateId| {
                        program.outward(s).take_while(|a| a != state).any(|a| program.state(a).chart_root)
                    };
                    let own: Vec<StateId> = inside.filter(|s| !foreign(*s)).collect();
                    let inner = |s: &StateId| !own.iter().any(|o| o != s && program.within(*o, *s));
                    own.iter().copied().filter(inner).collect()
                } else {
                    inside.filter(|s| program.state(*s).parent == Some(*state)).collect()
                };
                self.remembered.insert(*history, states);
            }
        }
    }

    fn exit(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let of = program.state(state);
        self.act(&of.exit, state, turn);
        for timer in std::mem::take(&mut self.runs[state as usize].timers) {
            if self.timers.remove(&timer).is_some() {
                turn.out.push(Effect::CancelTimer { timer });
            }
        }
        for watch in &of.watches {
            turn.out.push(Effect::DisarmWatch { watch: *watch });
        }
        if matches!(of.kind, Kind::Final { .. })
            && let Some(parent) = of.parent
        {
            self.runs[parent as usize].done = None;
        }
        self.runs[state as usize] = Run::default();
        self.configuration.retain(|s| *s != state);
        if state != 0 && !of.chart_root {
            turn.trace(TraceItem::Exited { state: of.path.clone() });
        }
        if of.unbreakable {
            self.release_held();
        }
    }

    // Entering.

    /// Enters the run: state 0, the chart, and its initial states.
    pub(super) fn enter_run(&mut self, turn: &mut Turn<'_>) {
        let mut entries = Entries::default();
        entries.states.insert(0);
        self.add_inside(0, &mut entries);
        self.enter_all(entries, turn);
    }

    fn add_target(&self, target: StateId, domain: StateId, entries: &mut Entries) {
        let program = &self.program;
        // All that is meant first, so that no region of it is taken for one to be entered by default.
        let effective = self.effective(target);
        effective.iter().for_each(|state| self.add_state(*state, entries));
        for state in effective {
            let around = program.outward(state).skip(1).take_while(|s| *s != domain);
            for state in around {
                entries.states.insert(state);
                if matches!(program.state(state).kind, Kind::Parallel) {
                    self.add_missing_regions(state, entries);
                }
            }
        }
        // A transition into one region of a parallel state enters the others by default, up to the domain.
        if matches!(program.state(domain).kind, Kind::Parallel) {
            self.add_missing_regions(domain, entries);
        }
    }

    /// What a target stands for: itself, or what a history remembers.
    fn effective(&self, target: StateId) -> Vec<StateId> {
        match &self.program.state(target).kind {
            Kind::History { default, .. } => match self.remembered.get(&target) {
                Some(states) if !states.is_empty() => states.clone(),
                _ => default
                    .iter()
                    .flat_map(|d| if *d == target { vec![] } else { self.effective_default(*d) })
                    .collect(),
            },
            _ => vec![target],
        }
    }

    /// A history's default; a default that is a history itself is followed once.
    fn effective_default(&self, target: StateId) -> Vec<StateId> {
        match &self.program.state(target).kind {
            Kind::History { default, .. } => {
                self.remembered.get(&target).cloned().unwrap_or_else(|| default.iter().copied().collect())
            }
            _ => vec![target],
        }
    }

    fn add_state(&self, state: StateId, entries: &mut Entries) {
        if matches!(self.program.state(state).kind, Kind::History { .. }) {
            return;
        }
        entries.states.insert(state);
        self.add_inside(state, entries);
    }

    /// The states that are entered with a state by default.
    fn add_inside(&self, state: StateId, entries: &mut Entries) {
        match &self.program.state(state).kind {
            Kind::Composite { initial } => self.add_target(*initial, state, entries),
            Kind::Parallel => self.add_missing_regions(state, entries),
            Kind::Chart { .. } => {
                self.program.state(state).children.iter().for_each(|c| self.add_state(*c, entries));
            }
            _ => {}
        }
    }

    fn add_missing_regions(&self, parallel: StateId, entries: &mut Entries) {
        for region in &self.program.state(parallel).children {
            let last = self.program.state(*region).last;
            if entries.states.range(*region..=last).next().is_none() && !self.runs[*region as usize].active {
                self.add_state(*region, entries);
            }
        }
    }

    fn enter_all(&mut self, entries: Entries, turn: &mut Turn<'_>) {
        // A composite that is entered on the way to an inner target has that target, not its initial state.
        for state in &entries.states {
            if self.runs[*state as usize].active {
                continue;
            }
            let given =
                entries.given.iter().rev().find(|(target, _)| target == state).map(|(_, g)| g.clone());
            self.enter(*state, given, turn);
        }
    }

    fn enter(&mut self, state: StateId, given: Option<Given>, turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let of = program.state(state);
        let entry = self.number();
        self.runs[state as usize] = Run { active: true, entry, ..Run::default() };
        let at = self.configuration.partition_point(|s| *s < state);
        self.configuration.insert(at, state);
        if state != 0 && !of.chart_root {
            turn.trace(TraceItem::Entered { state: of.path.clone() });
        }
        self.act(&of.enter, state, turn);
        self.give_inputs(state, given, turn);
        for t in &of.after {
            self.start_after(state, *t, turn);
        }
        for watch in &of.watches {
            turn.out.push(Effect::ArmWatch { watch: *watch, entry });
        }
        if let Kind::Final { outcome } = &of.kind {
            self.reached_final(state, outcome, turn);
        }
    }

    /// Evaluates `with` and makes the skill ready, or fills the inputs of the chart inside.
    fn give_inputs(&mut self, state: StateId, given: Option<Given>, turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let of = program.state(state);
        if let Kind::Chart { instance } = of.kind
            && state != 0
        {
            self.reset_instance(instance);
        }
        if state == 0 {
            self.reset_locals(0);
            return;
        }
        let mut values = match self.bindings(&of.with, turn) {
            Ok(values) => values,
            Err((message, place)) => return self.with_failed(state, &message, &place),
        };
        match given {
            Some(Ok(over)) => self.runs[state as usize].given = over,
            Some(Err((message, place))) => return self.with_failed(state, &message, &place),
            None => {}
        }
        values.extend(self.runs[state as usize].given.clone());
        match &of.kind {
            Kind::Skill { manifest } => {
                for parameter in &manifest.inputs {
                    if let (false, Some(default)) = (values.contains_key(&parameter.name), &parameter.default)
                    {
                        values.insert(parameter.name.clone(), default.clone());
                    }
                }
                if let Some(missing) = manifest.inputs.iter().find(|p| !values.contains_key(&p.name)) {
                    let message = format!("the input `{}` is not given", missing.name);
                    let place = self.program.place(of.place);
                    return self.with_failed(state, &message, &place);
                }
                self.runs[state as usize].skill = SkillRun::Ready(values);
                self.ready.insert(state);
            }
            Kind::Chart { instance } => {
                for variable in &program.instances[*instance as usize].inputs {
                    let declaration = &variable.declaration;
                    let value = values.remove(&declaration.name);
                    let value = match value.map(|v| declaration.accept(v)) {
                        Some(Ok(value)) => Some(value),
                        Some(Err(message)) => {
                            let message = format!("input `{}`: {message}", declaration.name);
                            let place = self.program.place(of.place);
                            self.with_failed(state, &message, &place);
                            None
                        }
                        None => declaration.default.clone(),
                    };
                    self.store.data[variable.slot as usize] = value;
                }
            }
            _ => {}
        }
    }

    fn with_failed(&mut self, state: StateId, message: &str, place: &str) {
        let data = Value::record([("reason", format!("{message} ({place})").into())]);
        self.push_failure(state, data);
    }

    /// Forgets everything that a use of a chart knew.
    fn reset_instance(&mut self, instance: u32) {
        let of = &self.program.instances[instance as usize];
        for slot in of.first_slot..of.end_slot {
            self.store.data[slot as usize] = None;
        }
        let owner = of.owner;
        let program = Arc::clone(&self.program);
        self.remembered.retain(|history, _| !program.within(*history, owner));
        self.reset_locals(instance);
    }

    fn reset_locals(&mut self, instance: u32) {
        let program = Arc::clone(&self.program);
        let of = &program.instances[instance as usize];
        for variable in of.locals.iter().chain(&of.outputs) {
            self.store.data[variable.slot as usize].clone_from(&variable.declaration.default);
        }
    }

    fn start_after(&mut self, state: StateId, transition: u32, turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let Some(delay) = &program.transitions[transition as usize].delay else { return };
        let seconds = match self.evaluate(delay, turn) {
            Ok(value) => value.as_f64().unwrap_or(f64::NAN),
            Err((message, place)) => return self.error_at(state, &message, place, turn),
        };
        if !seconds.is_finite() || seconds < 0.0 {
            let place = program.place(program.state(state).place);
            return self.error_at(state, &format!("{seconds} s is not a time to wait"), place, turn);
        }
        let entry = self.runs[state as usize].entry;
        let depth = u64::from(u16::MAX - program.state(state).depth);
        let order = (depth << 40) | u64::from(transition);
        let timer = self.start_timer(TimerUse::After { state, entry, transition }, seconds, order, turn);
        self.runs[state as usize].timers.push(timer);
    }

    pub(super) fn start_timer(&mut self, of: TimerUse, seconds: f64, order: u64, turn: &mut Turn<'_>) -> u64 {
        let timer = self.number();
        self.timers.insert(timer, of);
        turn.out.push(Effect::StartTimer { timer, after: duration(seconds), order });
        timer
    }

    /// Starts the skills of states that were entered and are still there. Gives whether there were any.
    pub(super) fn start_ready(&mut self, turn: &mut Turn<'_>) -> bool {
        let ready = std::mem::take(&mut self.ready);
        let any = !ready.is_empty();
        for state in ready {
            let SkillRun::Ready(inputs) = std::mem::take(&mut self.runs[state as usize].skill) else {
                continue;
            };
            let of = self.program.state(state);
            let Kind::Skill { manifest } = &of.kind else { continue };
            let (skill, limits, path) = (manifest.name.clone(), of.limits, of.path.clone());
            let activation = self.number();
            self.runs[state as usize].skill = SkillRun::Running(activation);
            self.skills.insert(activation, state);
            let shown = inputs.clone();
            turn.trace(TraceItem::SkillStarted {
                activation,
                state: path,
                skill: skill.clone(),
                inputs: shown,
            });
            turn.out.push(Effect::StartSkill { activation, state, skill, inputs, limits });
        }
        any
    }

    // Trying again.

    fn restart(&mut self, state: StateId, event: Option<&Event>, turn: &mut Turn<'_>) {
        let (_, wait_s) = self.program.state(state).retry.unwrap_or((0, 0.0));
        let run = &mut self.runs[state as usize];
        run.retries += 1;
        (run.ended, run.done, run.waiting) = (false, None, wait_s > 0.0);
        let (attempt, entry) = (run.retries, run.entry);
        let reason = event.and_then(|e| reason_and_chain(&e.data).0).unwrap_or_default();
        let path = self.program.state(state).path.clone();
        turn.trace(TraceItem::Retry { state: path, attempt, reason });
        if wait_s > 0.0 {
            let timer = self.start_timer(TimerUse::Retry { state, entry }, wait_s, u64::MAX - 1, turn);
            self.runs[state as usize].timers.push(timer);
        } else {
            self.begin_again(state, turn);
        }
    }

    /// Starts the inside of a state that is active.
    pub(super) fn begin_again(&mut self, state: StateId, turn: &mut Turn<'_>) {
        self.runs[state as usize].waiting = false;
        self.give_inputs(state, None, turn);
        let mut entries = Entries::default();
        self.add_inside(state, &mut entries);
        self.enter_all(entries, turn);
    }

    // Ending.

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

    fn reached_final(&mut self, state: StateId, outcome: &str, turn: &mut Turn<'_>) {
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

    fn finish(&mut self, outcome: String, reason: Option<String>, chain: Vec<String>, turn: &mut Turn<'_>) {
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

/// Values by name, or what failed and where.
pub(super) type Given = Result<BTreeMap<String, Value>, (String, String)>;

/// The states that a microstep enters, and what transitions give to their targets.
#[derive(Default)]
struct Entries {
    states: BTreeSet<StateId>,
    given: Vec<(StateId, Given)>,
}

impl Engine {
    /// Evaluates a `with`.
    pub(super) fn bindings(&mut self, bindings: &[Binding], turn: &mut Turn<'_>) -> Given {
        let mut values = BTreeMap::new();
        for binding in bindings {
            let value = self.evaluate(&binding.term, turn)?;
            let converted = binding.ty.convert(value);
            let failed = |e: armarium_values::ConvertError| {
                (format!("input `{}`: {e}", binding.name), self.program.place(binding.place))
            };
            values.insert(binding.name.clone(), converted.map_err(failed)?);
        }
        Ok(values)
    }
}
