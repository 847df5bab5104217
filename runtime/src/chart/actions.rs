//! Transitions and actions, compiled.

use std::sync::Arc;

use armarium_values::Type;

use super::compile::{Compiler, number};
use super::finding::{code, suggest};
use super::model::{self, ActionKind};
use super::yaml::{Named, Node};
use crate::engine::program::{Action, Pattern, Place, Send, StateId, Term, Transition};

impl<'l> Compiler<'l> {
    pub(super) fn transition(&mut self, id: StateId, model: &'l model::Transition, source: u32) -> u32 {
        let targets: Vec<StateId> =
            model.targets.iter().filter_map(|target| self.target(id, target, source)).collect();
        self.together(&targets, &model.targets, source);
        let event = model.event.as_ref();
        self.event_data = event.and_then(|event| self.event_types.get(&event.text).cloned());
        let guard = model.guard.as_ref().and_then(|node| self.condition(id, node, source));
        let delay = model.delay.as_ref().and_then(|node| self.value(id, node, &Type::Duration, source));
        let with = match targets.as_slice() {
            [to] => self.bindings(id, *to, &model.with, source),
            _ => Vec::new(),
        };
        if targets.len() != 1 && targets.len() == model.targets.len() {
            for (name, _) in &model.with {
                let message = "only a transition with one target gives something to it".into();
                self.error(source, code::INPUT, name, message, None);
            }
        }
        if let [target] = targets.as_slice() {
            self.given.extend(with.iter().map(|b| (*target, b.name.clone())));
        }
        let pattern = model.event.as_ref().map_or(Pattern::None, |event| match event.text.as_str() {
            "*" => Pattern::Any,
            text => text
                .strip_suffix(".*")
                .map_or_else(|| Pattern::Exact(text.into()), |prefix| Pattern::Prefix(prefix.into())),
        });
        let actions = self.actions(id, &model.actions, source);
        self.event_data = None;
        self.transitions.push(Transition {
            source: id,
            pattern,
            delay,
            guard,
            historic: targets
                .iter()
                .any(|t| matches!(self.flats[*t as usize].model.kind, model::Kind::History { .. })),
            targets,
            internal: model.internal,
            domain: None,
            actions,
            with,
        });
        number(self.transitions.len() - 1)
    }

    pub(super) fn actions(
        &mut self,
        state: StateId,
        actions: &'l [model::Action],
        source: u32,
    ) -> Vec<Action> {
        let mut compiled = Vec::new();
        for action in actions {
            let place = Place { source, byte: number(action.span.start) };
            match &action.kind {
                ActionKind::Assign(entries) => {
                    for (name, node) in entries {
                        compiled.extend(self.assign(state, name, node, source));
                    }
                }
                ActionKind::Raise { event, data } => {
                    let data = self.data_of(state, event, data.as_ref(), source);
                    let event = self.symbols.intern(&event.text);
                    compiled.push(Action::Raise { event, data, place });
                }
                ActionKind::Send { event, to, data, delay, id } => {
                    let symbol = self.symbols.intern(&event.text);
                    // What another agent's event comes with is declared there.
                    let data = match to {
                        None => self.data_of(state, event, data.as_ref(), source),
                        Some(_) => data.as_ref().and_then(|n| self.value(state, n, &Type::Any, source)),
                    };
                    let mut optional = |node: &Option<Node>, ty: &Type| {
                        node.as_ref().and_then(|n| self.value(state, n, ty, source))
                    };
                    compiled.push(Action::Send(Box::new(Send {
                        event: symbol,
                        to: optional(to, &Type::String),
                        data,
                        delay: optional(delay, &Type::Duration),
                        id: id.as_ref().map(|id| id.text.clone()),
                        place,
                    })));
                }
                ActionKind::Cancel(id) => compiled.push(Action::Cancel { id: id.text.clone() }),
                ActionKind::Log(node) => {
                    let term = self.value(state, node, &Type::Any, source);
                    compiled.extend(term.map(|term| Action::Log { term }));
                }
                ActionKind::If { condition, then, otherwise } => {
                    let condition = self.condition(state, condition, source);
                    let then = self.actions(state, then, source);
                    let otherwise = self.actions(state, otherwise, source);
                    compiled.extend(condition.map(|condition| Action::If { condition, then, otherwise }));
                }
                ActionKind::Foreach { items, variable, body } => {
                    let items = self.value(state, items, &Type::list(Type::Any), source);
                    let slot = self.slots;
                    self.slots += 1;
                    self.bound.push((variable.text.clone(), slot));
                    let body = self.actions(state, body, source);
                    self.bound.pop();
                    compiled.extend(items.map(|items| Action::Foreach { items, slot, body, place }));
                }
            }
        }
        compiled
    }

    /// What goes with an event, held against what the event declares.
    fn data_of(&mut self, state: StateId, event: &Named, data: Option<&Node>, source: u32) -> Option<Term> {
        let declared = self.event_types.get(&event.text).cloned();
        if let (None, Some(Type::Record(fields))) = (data, &declared)
            && !fields.is_empty()
        {
            let names = fields.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            let message = format!("the event `{}` comes with data: {names}", event.text);
            self.error(source, code::TYPE, event, message, None);
        }
        data.and_then(|node| self.value(state, node, &declared.unwrap_or(Type::Any), source))
    }

    pub(super) fn assign(
        &mut self,
        state: StateId,
        name: &Named,
        node: &Node,
        source: u32,
    ) -> Option<Action> {
        let instance = &self.names.instances[self.names.outlines[state as usize].instance as usize];
        let (kind, variable) = name.text.split_once('.').unwrap_or(("", name.text.as_str()));
        let declared = match kind {
            "locals" => &instance.locals,
            "outputs" => &instance.outputs,
            _ => {
                let message = "only `locals.name` and `outputs.name` can be assigned".into();
                self.error(source, code::VARIABLE, name, message, None);
                return None;
            }
        };
        let Some(found) = declared.iter().find(|v| v.declaration.name == variable).cloned() else {
            let help = suggest(variable, declared.iter().map(|v| v.declaration.name.as_str()));
            let message = format!("the chart has no `{}`", name.text);
            self.error(source, code::VARIABLE, name, message, help);
            return None;
        };
        let term = self.value(state, node, &found.declaration.ty, source)?;
        if let Term::Literal(value) = &term
            && let Err(message) = found.declaration.accept(value.clone())
        {
            self.reporting(source, |_, findings| findings.error(code::TYPE, node.span, message));
        }
        Some(Action::Assign {
            slot: found.slot,
            declaration: Arc::new(found.declaration),
            variable: name.text.clone(),
            term,
            place: Place { source, byte: number(node.span.start) },
        })
    }
}
