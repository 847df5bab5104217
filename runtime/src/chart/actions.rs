//! Transitions and actions, compiled.

use std::sync::Arc;

use armarium_source::yaml::{Named, Node};
use armarium_source::{Remedy, code};
use armarium_values::Type;
use armarium_values::expr::nearest;

use super::compile::Compiler;
use super::model::{self, ActionKind};
use super::scope::ExprSite;
use super::symbols::Symbol;
use crate::program::{Action, Pattern, SendAction, StateId, Term, Transition};

impl<'t> Compiler<'t> {
    pub(super) fn transition(
        &mut self,
        at: &ExprSite<'t>,
        model: &'t model::WrittenTransition,
    ) -> Transition {
        let targets: Vec<StateId> =
            model.targets.iter().filter_map(|target| self.target(at, target)).collect();
        self.together(at, &targets, &model.targets);
        let event = model.event.as_ref();
        let event_data = event.and_then(|event| self.event_types.get(&event.text));
        let site = &ExprSite { event_data, ..at.clone() };
        let guard = model.guard.as_ref().and_then(|node| self.condition(site, node));
        let delay = model.delay.as_ref().and_then(|node| self.delay(site, node));
        let with = match targets.as_slice() {
            [to] => self.bindings(site, *to, &model.with),
            _ => Vec::new(),
        };
        if targets.len() != 1 && targets.len() == model.targets.len() {
            for (name, _) in &model.with {
                let message = "only a transition with one target gives something to it".into();
                self.error(site, code::INPUT, name, message, None);
            }
        }
        let pattern = event.map_or(Pattern::None, |event| match event.text.as_str() {
            "*" => Pattern::Any,
            text => text
                .strip_suffix(".*")
                .map_or_else(|| Pattern::Exact(text.into()), |prefix| Pattern::Prefix(prefix.into())),
        });
        Transition {
            source: site.state,
            pattern,
            delay,
            guard,
            historic: targets.iter().any(|t| self.tree.is_history(*t)),
            targets,
            internal: model.internal,
            domain: None,
            actions: self.actions(site, &model.actions),
            with,
        }
    }

    /// A time that is waited for: as long as `node` says.
    fn delay(&mut self, site: &ExprSite<'_>, node: &Node) -> Option<Term> {
        let term = self.value(site, node, &Type::Duration)?;
        self.not_negative(site, node, &term);
        Some(term)
    }

    pub(super) fn actions(&mut self, site: &ExprSite<'_>, actions: &[model::WrittenAction]) -> Vec<Action> {
        let mut compiled = Vec::new();
        for action in actions {
            let place = site.place(action.span);
            match &action.kind {
                ActionKind::Assign(entries) => {
                    for (name, node) in entries {
                        compiled.extend(self.assign(site, name, node));
                    }
                }
                ActionKind::Raise { event, data } => {
                    self.names
                        .refer(site.source, event.span, || Some(Symbol::Event { name: event.text.clone() }));
                    let data = self.data_of(site, event, data.as_ref());
                    let event = self.event_names.intern(&event.text);
                    compiled.push(Action::Raise { event, data, place });
                }
                ActionKind::Send { event, to, data, delay, id } => {
                    let symbol = self.event_names.intern(&event.text);
                    let address = to.as_ref().and_then(|node| self.value(site, node, &Type::String));
                    // What another agent's event comes with is declared there.
                    let data = match to {
                        None => {
                            let symbol = || Some(Symbol::Event { name: event.text.clone() });
                            self.names.refer(site.source, event.span, symbol);
                            self.data_of(site, event, data.as_ref())
                        }
                        Some(_) => data.as_ref().and_then(|node| self.value(site, node, &Type::Any)),
                    };
                    let delay = delay.as_ref().and_then(|node| self.delay(site, node));
                    let id = id.as_ref().map(|id| id.text.clone());
                    let send = SendAction { event: symbol, to: address, data, delay, id, place };
                    compiled.push(Action::Send(Box::new(send)));
                }
                ActionKind::Cancel(id) => compiled.push(Action::Cancel { id: id.text.clone() }),
                ActionKind::Log(node) => {
                    let term = self.value(site, node, &Type::Any);
                    compiled.extend(term.map(|term| Action::Log { term }));
                }
                ActionKind::If { condition, then, otherwise } => {
                    let condition = self.condition(site, condition);
                    let then = self.actions(site, then);
                    let otherwise = self.actions(site, otherwise);
                    compiled.extend(condition.map(|condition| Action::If { condition, then, otherwise }));
                }
                ActionKind::Foreach { items, variable, body } => {
                    let items = self.value(site, items, &Type::list(Type::Any));
                    let slot = self.slots;
                    self.slots += 1;
                    let mut inside = site.clone();
                    inside.bound.push((variable.text.clone(), slot));
                    let body = self.actions(&inside, body);
                    compiled.extend(items.map(|items| Action::Foreach { items, slot, body, place }));
                }
            }
        }
        compiled
    }

    /// What goes with an event, held against what the event declares.
    fn data_of(&mut self, site: &ExprSite<'_>, event: &Named, data: Option<&Node>) -> Option<Term> {
        let declared = self.event_types.get(&event.text);
        if let (None, Some(Type::Record(fields))) = (data, declared)
            && !fields.is_empty()
        {
            let names = fields.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            let message = format!("the event `{}` comes with data: {names}", event.text);
            self.error(site, code::TYPE, event, message, None);
        }
        data.and_then(|node| self.value(site, node, declared.unwrap_or(&Type::Any)))
    }

    fn assign(&mut self, site: &ExprSite<'_>, name: &Named, node: &Node) -> Option<Action> {
        let instance = self.tree.instance(site.state);
        let (kind, variable) = name.text.split_once('.').unwrap_or(("", name.text.as_str()));
        let declared = match kind {
            "locals" => &instance.locals,
            "outputs" => &instance.outputs,
            _ => {
                let message = "only `locals.name` and `outputs.name` can be assigned".into();
                self.error(site, code::VARIABLE, name, message, None);
                return None;
            }
        };
        let Some(found) = declared.iter().find(|v| v.declaration.name == variable).cloned() else {
            let near = nearest(variable, declared.iter().map(|v| v.declaration.name.as_str()));
            let near = near.map(|near| format!("{kind}.{near}"));
            let message = format!("the chart has no `{}`", name.text);
            self.error(
                site,
                code::VARIABLE,
                name,
                message,
                near.as_ref().map(|n| format!("did you mean `{n}`?")),
            );
            if let Some((near, finding)) = near.zip(self.findings.last_mut()) {
                finding.remedy = Some(Remedy::replace(name.span, near));
            }
            return None;
        };
        self.names.refer_declared(site, name.span, &name.text, &found.declaration.name);
        let term = self.given(site, node, &found.declaration)?;
        Some(Action::Assign {
            slot: found.slot,
            declaration: Arc::new(found.declaration),
            variable: name.text.clone(),
            term,
            place: site.place(node.span),
        })
    }
}
