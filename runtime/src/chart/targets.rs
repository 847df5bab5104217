//! The names of states that transitions, `initial` and histories lead to, resolved.

use armarium_source::yaml::Named;
use armarium_source::{Remedy, code};

use super::compile::Compiler;
use super::model;
use super::scope::{self, ExprSite};
use crate::program::StateId;

impl Compiler<'_> {
    pub(super) fn initial(&mut self, site: &ExprSite<'_>, initial: &model::WrittenEntry) -> Vec<StateId> {
        let (tree, id) = (self.tree, site.state);
        let mut targets = Vec::new();
        for name in &initial.targets {
            let parts: Vec<&str> = name.text.split('.').collect();
            match tree.find(id, &parts).filter(|found| *found != id && tree.within(*found, id)) {
                Some(found) => {
                    self.names.refer_path(site.source, name.span, &name.text, found);
                    targets.push(found);
                }
                // Where no state could be read at all, that was said already.
                None if tree.state(id).model.kind.children().is_empty() => {}
                None => {
                    let known = tree.state(id).model.kind.children().iter().take(scope::MAX_NAMES);
                    let message = format!("there is no state `{}` inside", name.text);
                    self.unknown(site, code::STATE, name, message, known.map(|c| c.name.text.as_str()));
                }
            }
        }
        self.together(site, &targets, &initial.targets);
        targets
    }

    pub(super) fn history_default(
        &mut self,
        site: &ExprSite<'_>,
        default: &model::WrittenEntry,
    ) -> Vec<StateId> {
        let parent = self.tree.state(site.state).parent.unwrap_or(0);
        let mut targets = Vec::new();
        for name in &default.targets {
            let Some(to) = self.target(site, name) else { continue };
            if to != parent && self.tree.within(to, parent) && !self.tree.is_history(to) {
                targets.push(to);
            } else {
                let message = "the default of a history is a state beside it, not a history".into();
                self.error(site, code::STATE, name, message, None);
            }
        }
        self.together(site, &targets, &default.targets);
        targets
    }

    /// Several targets can only be entered together when they are in different regions of parallel states.
    pub(super) fn together(&mut self, site: &ExprSite<'_>, targets: &[StateId], names: &[Named]) {
        let tree = self.tree;
        let parallel = |s: StateId| matches!(tree.state(s).model.kind, model::WrittenKind::Parallel(_));
        for (i, a) in targets.iter().enumerate() {
            for b in &targets[i + 1..] {
                let meet = tree.outward(*a).find(|s| tree.within(*b, *s));
                let apart = meet.is_some_and(|s| s != *a && s != *b && parallel(s));
                let Some(name) = names.first().filter(|_| !apart) else { continue };
                let (a, b) = (&tree.state(*a).path, &tree.state(*b).path);
                let message =
                    format!("`{a}` and `{b}` cannot be entered together: they are not in two regions");
                return self.error(site, code::TOGETHER, name, message, None);
            }
        }
    }

    pub(super) fn target(&mut self, site: &ExprSite<'_>, target: &Named) -> Option<StateId> {
        let (tree, from) = (self.tree, site.state);
        let parts: Vec<&str> = target.text.split('.').collect();
        let found = tree.find(from, &parts);
        if found.is_none() {
            let last = parts.last().copied().unwrap_or("");
            let instance = tree.state(from).instance;
            let states = if self.names.helps() { tree.states.as_slice() } else { &[] };
            let mut others = states.iter().skip(1).filter(|s| s.instance == instance && !s.chart_root);
            let elsewhere = others.find(|s| s.name() == last);
            let elsewhere = elsewhere.map(|s| s.path.clone());
            let message = format!("there is no state `{}`", target.text);
            let visible = self.names.visible(from).into_iter().map(str::to_owned).collect::<Vec<_>>();
            self.unknown(site, code::STATE, target, message, visible.iter().map(String::as_str));
            if let Some((path, finding)) =
                elsewhere.zip(self.findings.last_mut().filter(|f| f.help.is_none()))
            {
                finding.help = Some(format!("`{last}` is inside another state: write `{path}`"));
                finding.remedy = Some(Remedy::replace(target.span, path));
            }
        }
        if let Some(found) = found {
            self.names.refer_path(site.source, target.span, &target.text, found);
        }
        found
    }
}
