//! The names of states that transitions, `initial` and histories lead to, resolved.

use super::compile::Compiler;
use super::expressions;
use super::finding::{code, suggest};
use super::model;
use super::yaml::Named;
use crate::engine::program::StateId;

impl Compiler<'_> {
    pub(super) fn initial(&mut self, id: StateId, initial: &model::Entry, source: u32) -> Vec<StateId> {
        let last = self.last[id as usize];
        let mut targets = Vec::new();
        for name in &initial.targets {
            let parts: Vec<&str> = name.text.split('.').collect();
            match self.names.find(id, &parts).filter(|found| *found > id && *found <= last) {
                Some(found) => targets.push(found),
                None => {
                    let known =
                        self.flats[id as usize].model.kind.children().iter().take(expressions::MAX_NAMES);
                    let help = suggest(&name.text, known.map(|c| c.name.text.as_str()));
                    let message = format!("there is no state `{}` inside", name.text);
                    self.error(source, code::STATE, name, message, help);
                }
            }
        }
        self.together(&targets, &initial.targets, source);
        targets
    }

    pub(super) fn history_default(
        &mut self,
        id: StateId,
        default: &model::Entry,
        source: u32,
    ) -> Vec<StateId> {
        let parent = self.names.outlines[id as usize].parent.unwrap_or(0);
        let mut targets = Vec::new();
        for name in &default.targets {
            let Some(to) = self.target(id, name, source) else { continue };
            let inside = to > parent && to <= self.last[parent as usize];
            let history = matches!(self.flats[to as usize].model.kind, model::Kind::History { .. });
            if inside && !history {
                targets.push(to);
            } else {
                let message = "the default of a history is a state beside it, not a history".into();
                self.error(source, code::STATE, name, message, None);
            }
        }
        self.together(&targets, &default.targets, source);
        targets
    }

    /// Several targets can only be entered together when they are in different regions of parallel states.
    pub(super) fn together(&mut self, targets: &[StateId], names: &[Named], source: u32) {
        for (i, a) in targets.iter().enumerate() {
            for b in &targets[i + 1..] {
                let around =
                    |s: StateId| std::iter::successors(Some(s), |s| self.names.outlines[*s as usize].parent);
                let meet = around(*a).find(|s| (*s..=self.last[*s as usize]).contains(b));
                let apart = meet.is_some_and(|s| {
                    s != *a
                        && s != *b
                        && matches!(self.flats[s as usize].model.kind, model::Kind::Parallel(_))
                });
                let Some(name) = names.first().filter(|_| !apart) else { continue };
                let (a, b) = (&self.flats[*a as usize].path, &self.flats[*b as usize].path);
                let message =
                    format!("`{a}` and `{b}` cannot be entered together: they are not in two regions");
                return self.error(source, code::TOGETHER, name, message, None);
            }
        }
    }

    pub(super) fn target(&mut self, from: StateId, target: &Named, source: u32) -> Option<StateId> {
        let parts: Vec<&str> = target.text.split('.').collect();
        let found = self.names.find(from, &parts);
        if found.is_none() {
            let last = parts.last().copied().unwrap_or("");
            let instance = self.names.outlines[from as usize].instance;
            let few = self.names.asked.get() < expressions::MAX_HELP;
            let outlines = if few { self.names.outlines.as_slice() } else { &[] };
            let elsewhere = outlines
                .iter()
                .enumerate()
                .find(|(id, o)| o.name == last && o.instance == instance && !o.chart_root && *id != 0);
            let help = suggest(&target.text, self.names.visible(from)).or_else(|| {
                elsewhere.map(|(id, _)| {
                    format!("`{last}` is inside another state: write `{}`", self.flats[id].path)
                })
            });
            let message = format!("there is no state `{}`", target.text);
            self.error(source, code::STATE, target, message, help);
        }
        found
    }
}
