//! Entering states: which states a target stands for, their inputs, the start of their skills, and retries.

use std::collections::BTreeMap;

use armarium_values::Value;

use super::act::Failed;
use super::end::reason_and_chain;
use super::state::{SkillRun, Timer, TimerUse, Turn};
use super::step::duration;
use super::{Effect, Engine, TraceItem};
use crate::program::{Action, Binding, Kind, Program, StateId};
use crate::skill::{Parameter, ParameterError};

/// Values by name.
pub(super) type Given = Result<BTreeMap<String, Value>, Failed>;

/// The states that a microstep enters, and the values that transitions give to their targets.
#[derive(Default)]
pub(super) struct Entries {
    /// Each target with the state inside which everything is entered (the domain).
    pub(super) targets: Vec<(StateId, StateId)>,
    pub(super) given: Vec<(StateId, Given)>,
}

/// Actions of `initial` and of a history's `default`; they run when the parent state has been entered.
type Defaults<'p> = Vec<(StateId, &'p [Action])>;

impl Engine {
    /// Enters state 0 (the run), the chart, and its initial states.
    pub(super) fn enter_run(&mut self, turn: &mut Turn<'_>) {
        self.enter_all(Entries { targets: vec![(0, StateId::MAX)], given: Vec::new() }, turn);
    }

    /// The states that a target stands for: itself, or a history's remembered states, or the history's default.
    pub(super) fn effective(&self, target: StateId, program: &Program) -> Vec<StateId> {
        match &program.state(target).kind {
            Kind::History { default, .. } => match self.remembered.get(&target) {
                Some(states) if !states.is_empty() => states.clone(),
                _ => default.targets.clone(),
            },
            _ => vec![target],
        }
    }

    /// SCXML's computeEntrySet: first all targets, then the states that are entered by default with them.
    pub(super) fn enter_all(&mut self, entries: Entries, turn: &mut Turn<'_>) {
        let mut plan = std::mem::take(&mut self.entries);
        let mut defaults = Defaults::new();
        plan.clear();
        let mark = self.next_selection();
        for (target, domain) in &entries.targets {
            self.plan_target(*target, *domain, mark, &mut plan, &mut defaults, turn.program);
        }
        self.plan_inside(0, mark, &mut plan, &mut defaults, turn.program);
        self.enter_plan(plan, &defaults, entries.given, turn);
    }

    /// Enters the inside of an active state.
    fn enter_inside(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let mut plan = std::mem::take(&mut self.entries);
        let mut defaults = Defaults::new();
        plan.clear();
        plan.push(state);
        let mark = self.next_selection();
        self.plan_inside(0, mark, &mut plan, &mut defaults, turn.program);
        plan.remove(0);
        self.enter_plan(plan, &defaults, Vec::new(), turn);
    }

    fn plan_state(&mut self, state: StateId, mark: u32, plan: &mut Vec<StateId>, program: &Program) {
        let run = &mut self.runs[state as usize];
        if run.active || std::mem::replace(&mut run.seen, mark) == mark {
            return;
        }
        plan.push(state);
        if let Some(parent) = program.tables.parent(state) {
            self.runs[parent as usize].filled = mark;
        }
    }

    /// Adds a target and the states around it, up to `domain`, to the plan.
    fn plan_target<'p>(
        &mut self,
        target: StateId,
        domain: StateId,
        mark: u32,
        plan: &mut Vec<StateId>,
        defaults: &mut Defaults<'p>,
        program: &'p Program,
    ) {
        if let Kind::History { default, .. } = &program.state(target).kind {
            let fresh = self.remembered.get(&target).is_none_or(Vec::is_empty);
            if let (true, Some(parent)) =
                (fresh && !default.actions.is_empty(), program.tables.parent(target))
            {
                defaults.push((parent, &default.actions));
            }
            for meant in self.effective(target, program) {
                if meant != target {
                    self.plan_path(meant, domain, mark, plan, program);
                }
            }
        } else {
            self.plan_path(target, domain, mark, plan, program);
        }
    }

    fn plan_path(
        &mut self,
        target: StateId,
        domain: StateId,
        mark: u32,
        plan: &mut Vec<StateId>,
        program: &Program,
    ) {
        for state in program.outward(target).take_while(|s| *s != domain) {
            self.plan_state(state, mark, plan, program);
        }
    }

    /// Adds the states that are entered by default inside the planned states, from number `from` on.
    fn plan_inside<'p>(
        &mut self,
        mut from: usize,
        mark: u32,
        plan: &mut Vec<StateId>,
        defaults: &mut Defaults<'p>,
        program: &'p Program,
    ) {
        while let Some(state) = plan.get(from).copied() {
            from += 1;
            if program.tables.node(state).leaf {
                continue;
            }
            match &program.state(state).kind {
                Kind::Composite { initial } if self.runs[state as usize].filled != mark => {
                    if !initial.actions.is_empty() {
                        defaults.push((state, &initial.actions));
                    }
                    for target in &initial.targets {
                        self.plan_target(*target, state, mark, plan, defaults, program);
                    }
                }
                Kind::Parallel | Kind::Chart { .. } => {
                    for child in &program.state(state).children {
                        self.plan_state(*child, mark, plan, program);
                    }
                }
                _ => {}
            }
        }
    }

    fn enter_plan(
        &mut self,
        mut plan: Vec<StateId>,
        defaults: &Defaults<'_>,
        mut given: Vec<(StateId, Given)>,
        turn: &mut Turn<'_>,
    ) {
        plan.sort_unstable();
        self.configuration.extend_from_slice(&plan);
        self.configuration.sort();
        self.moved |= !plan.is_empty();
        for state in &plan {
            let at = given.iter().rposition(|(target, _)| target == state);
            let given = at.map(|at| given.swap_remove(at).1);
            self.enter(*state, given, defaults, turn);
        }
        self.entries = plan;
    }

    /// Enters one plain state that contains no states.
    pub(super) fn enter_leaf(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let at = self.configuration.partition_point(|s| *s < state);
        self.configuration.insert(at, state);
        self.moved = true;
        self.enter(state, None, &Defaults::new(), turn);
    }

    fn enter(&mut self, state: StateId, given: Option<Given>, defaults: &Defaults<'_>, turn: &mut Turn<'_>) {
        let entry = self.number();
        let run = &mut self.runs[state as usize];
        (run.active, run.entry, run.extra) = (true, entry, None);
        if !turn.program.is_root(state) {
            turn.trace(|p| TraceItem::Entered { state: p.path(state).to_owned() });
        }
        if !turn.program.tables.node(state).plain {
            self.enter_fully(state, given, defaults, turn);
        }
    }

    fn enter_fully(
        &mut self,
        state: StateId,
        given: Option<Given>,
        defaults: &Defaults<'_>,
        turn: &mut Turn<'_>,
    ) {
        let of = turn.program.state(state);
        let entry = self.runs[state as usize].entry;
        self.eager += u32::from(!of.always.is_empty());
        self.unbreakable += u32::from(of.unbreakable);
        if state == 0 {
            self.reset_locals(0, turn.program);
        }
        self.act(&of.enter, state, turn);
        for (_, actions) in defaults.iter().filter(|(around, _)| *around == state) {
            self.act(actions, state, turn);
        }
        self.give_inputs(state, given, turn);
        for t in &of.after {
            self.start_after(state, *t, turn);
        }
        turn.out.extend(of.watches.iter().map(|watch| Effect::ArmWatch { watch: *watch, entry }));
        if let Kind::Final { outcome } = of.kind {
            self.reached_final(state, outcome, turn);
        }
    }

    /// Evaluates `with`. Then prepares the skill, or sets the inputs of the chart inside.
    fn give_inputs(&mut self, state: StateId, given: Option<Given>, turn: &mut Turn<'_>) {
        let program = turn.program;
        let of = program.state(state);
        if state == 0 || !matches!(of.kind, Kind::Skill { .. } | Kind::Chart { .. }) {
            return;
        }
        if let Kind::Chart { instance } = of.kind {
            self.reset_instance(instance, program);
        }
        let mut values = match self.bindings(&of.with, turn) {
            Ok(values) => values,
            Err(Failed { message, place }) => return self.with_failed(state, &message, &place, turn),
        };
        match given {
            Some(Ok(over)) => self.extra(state).given = over,
            Some(Err(Failed { message, place })) => return self.with_failed(state, &message, &place, turn),
            None => {}
        }
        values.extend(self.extra(state).given.clone());
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
                    let place = program.place(of.place);
                    return self.with_failed(state, &message, &place, turn);
                }
                self.extra(state).skill = SkillRun::Ready(values);
                self.ready.insert(state);
            }
            Kind::Chart { instance } => {
                for variable in &program.instances[*instance as usize].inputs {
                    let Parameter { name, default, .. } = &variable.declaration;
                    self.store.data[variable.slot as usize] = values.remove(name).or_else(|| default.clone());
                }
            }
            _ => {}
        }
    }

    fn with_failed(&mut self, state: StateId, message: &str, place: &str, turn: &mut Turn<'_>) {
        turn.trace(|_| TraceItem::Error { message: message.to_owned(), place: place.to_owned() });
        let reason = format!("{message} ({place})");
        let data = Value::record([("reason", reason.into()), ("place", place.into())]);
        self.push_failure(state, data, turn.program);
    }

    /// Clears all data of one use of a chart.
    fn reset_instance(&mut self, instance: u32, program: &Program) {
        let of = &program.instances[instance as usize];
        for slot in of.first_slot..of.end_slot {
            self.store.data[slot as usize] = None;
        }
        let owner = of.owner;
        self.remembered.retain(|history, _| !program.within(*history, owner));
        self.reset_locals(instance, program);
    }

    fn reset_locals(&mut self, instance: u32, program: &Program) {
        let of = &program.instances[instance as usize];
        for variable in of.locals.iter().chain(&of.outputs) {
            self.store.data[variable.slot as usize].clone_from(&variable.declaration.default);
        }
    }

    fn start_after(&mut self, state: StateId, transition: u32, turn: &mut Turn<'_>) {
        let program = turn.program;
        let Some(delay) = &program.transitions[transition as usize].delay else { return };
        let seconds = match self.evaluate(delay, turn) {
            Ok(value) => value.as_f64().unwrap_or(f64::NAN),
            Err(Failed { message, place }) => return self.error_at(state, &message, place, turn),
        };
        if !seconds.is_finite() || seconds < 0.0 {
            let place = program.place(program.state(state).place);
            return self.error_at(state, &format!("{seconds} s is not a time to wait"), place, turn);
        }
        let entry = self.runs[state as usize].entry;
        let depth = u64::from(u16::MAX - program.state(state).depth);
        let order = (depth << 40) | u64::from(transition);
        let timer = self.start_timer(TimerUse::After { state, entry, transition }, seconds, order, turn);
        self.extra(state).timers.push(timer);
    }

    pub(super) fn start_timer(&mut self, of: TimerUse, seconds: f64, order: u64, turn: &mut Turn<'_>) -> u64 {
        let timer = self.number();
        let after = duration(seconds);
        let chain = if after.is_zero() { self.chain + 1 } else { 0 };
        self.timers.insert(timer, Timer { of, chain });
        turn.out.push(Effect::StartTimer { timer, after, order });
        timer
    }

    /// Starts the skills of the states that were entered and are still active.
    pub(super) fn start_ready(&mut self, turn: &mut Turn<'_>) {
        for state in std::mem::take(&mut self.ready) {
            let SkillRun::Ready(inputs) = std::mem::take(&mut self.extra(state).skill) else { continue };
            let of = turn.program.state(state);
            let Kind::Skill { manifest } = &of.kind else { continue };
            let skill = manifest.name.clone();
            let activation = self.number();
            let extra = self.extra(state);
            (extra.skill, extra.chosen) = (SkillRun::Running(activation), None);
            self.skills.insert(activation, state);
            turn.trace(|_| TraceItem::SkillStarted {
                activation,
                state: of.path.clone(),
                skill: skill.clone(),
                inputs: inputs.clone(),
            });
            turn.out.push(Effect::StartSkill { activation, state, skill, inputs, limits: of.limits });
        }
    }

    // Retries.

    pub(super) fn restart(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let (_, wait_s) = turn.program.state(state).retry.unwrap_or((0, 0.0));
        let entry = self.runs[state as usize].entry;
        let extra = self.extra(state);
        extra.retries += 1;
        (extra.ended, extra.done, extra.waiting) = (false, None, wait_s > 0.0);
        let attempt = extra.retries;
        let event = self.store.event.as_ref();
        let reason = event.and_then(|e| reason_and_chain(e.data()).0).unwrap_or_default();
        turn.trace(|p| TraceItem::Retry { state: p.path(state).to_owned(), attempt, reason });
        if wait_s > 0.0 {
            let timer = self.start_timer(TimerUse::Retry { state, entry }, wait_s, u64::MAX - 1, turn);
            self.extra(state).timers.push(timer);
        } else {
            self.begin_again(state, turn);
        }
    }

    /// Restarts the inside of an active state.
    pub(super) fn begin_again(&mut self, state: StateId, turn: &mut Turn<'_>) {
        self.extra(state).waiting = false;
        self.give_inputs(state, None, turn);
        self.enter_inside(state, turn);
    }

    /// Evaluates a `with`.
    pub(super) fn bindings(&mut self, bindings: &[Binding], turn: &mut Turn<'_>) -> Given {
        let mut values = BTreeMap::new();
        for binding in bindings {
            let value = self.evaluate(&binding.term, turn)?;
            let Binding { parameter, place, .. } = binding;
            let failed = |error: ParameterError| {
                Failed::new(format!("input `{}`: {error}", parameter.name), self.program.place(*place))
            };
            values.insert(parameter.name.clone(), parameter.accept(value).map_err(failed)?);
        }
        Ok(values)
    }
}
