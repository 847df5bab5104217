//! Entering states: which ones a target stands for, what they are given, what starts with them; trying again.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_values::Value;

use super::end::reason_and_chain;
use super::program::{Binding, Kind, StateId};
use super::step::duration;
use super::{Effect, Engine, Event, Run, SkillRun, TimerUse, TraceItem, Turn};

/// Values by name, or what failed and where.
pub(super) type Given = Result<BTreeMap<String, Value>, (String, String)>;

/// The states that a microstep enters, and what transitions give to their targets.
#[derive(Default)]
pub(super) struct Entries {
    pub(super) states: BTreeSet<StateId>,
    pub(super) given: Vec<(StateId, Given)>,
}

impl Engine {
    /// Enters the run: state 0, the chart, and its initial states.
    pub(super) fn enter_run(&mut self, turn: &mut Turn<'_>) {
        let mut entries = Entries::default();
        entries.states.insert(0);
        self.add_inside(0, &mut entries);
        self.enter_all(entries, turn);
    }

    pub(super) fn add_target(&self, target: StateId, domain: StateId, entries: &mut Entries) {
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

    pub(super) fn enter_all(&mut self, entries: Entries, turn: &mut Turn<'_>) {
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

    pub(super) fn restart(&mut self, state: StateId, event: Option<&Event>, turn: &mut Turn<'_>) {
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
