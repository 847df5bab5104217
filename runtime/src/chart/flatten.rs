//! Charts put into charts: every use of a chart becomes states and places for data of its own.

use std::sync::Arc;

use armarium_values::Type;

use super::compile::{Compiler, Flat, number};
use super::expressions::Outline;
use super::finding::{Severity, code, suggest};
use super::model::{self, Chart, Declaration};
use super::read::MAX_LEVELS;
use super::yaml::Named;
use crate::engine::program::{Instance, StateId, Variable};
use crate::skill::{Limits, SkillManifest};

/// Most states, those of the charts inside counted at each use.
const MAX_STATES: usize = 200_000;

impl<'l> Compiler<'l> {
    pub(super) fn flatten_root(&mut self, root: &'l Arc<Chart>) {
        let source = self.source(&root.source);
        // State 0 stands for the run; the chart is its only child.
        self.push(&root.root, source, None, 0, String::new(), Limits::default(), false);
        self.names.outlines[0].outputs = Vec::new();
        self.flats[0].chart = Some((root, 0));
        let mut stack = vec![root.name.clone()];
        self.flatten_chart(root, 0, Limits::default(), &mut stack);
        self.last[0] = number(self.flats.len() - 1);
    }

    #[expect(clippy::too_many_arguments, reason = "one row of a table")]
    fn push(
        &mut self,
        model: &'l model::State,
        source: u32,
        parent: Option<StateId>,
        instance: u32,
        path: String,
        limits: Limits,
        chart_root: bool,
    ) -> StateId {
        let id = number(self.flats.len());
        let depth = parent.map_or(0, |p| self.flats[p as usize].depth + 1);
        self.flats.push(Flat { model, source, depth, path, limits, chart: None, skill: None });
        self.last.push(id);
        let name = model.name.text.clone();
        self.names.outlines.push(Outline {
            name,
            parent,
            instance,
            chart_root,
            outputs: Vec::new(),
            open: false,
        });
        id
    }

    fn variables(&mut self, declarations: &[Declaration]) -> Vec<Variable> {
        let one = |declaration: &Declaration| {
            self.slots += 1;
            Variable { declaration: declaration.clone(), slot: self.slots - 1 }
        };
        declarations.iter().map(one).collect()
    }

    fn flatten_chart(&mut self, chart: &'l Chart, owner: StateId, limits: Limits, stack: &mut Vec<String>) {
        let instance = number(self.names.instances.len());
        let first_slot = self.slots;
        let inputs = self.variables(&chart.inputs);
        let locals = self.variables(&chart.locals);
        let outputs = self.variables(&chart.outputs);
        self.names.instances.push(Instance { owner, inputs, locals, outputs, first_slot, end_slot: 0 });
        let source = self.source(&chart.source);
        let path = self.flats[owner as usize].path.clone();
        let path = if owner == 0 { String::new() } else { path };
        let limits = limits.tightened(chart.root.limits);
        let root = self.push(&chart.root, source, Some(owner), instance, path, limits, true);
        self.flatten_children(root, &chart.root, instance, source, limits, stack);
        self.finish(root);
        self.names.instances[instance as usize].end_slot = self.slots;
    }

    fn finish(&mut self, state: StateId) {
        self.last[state as usize] = number(self.flats.len() - 1);
    }

    fn flatten_children(
        &mut self,
        parent: StateId,
        model: &'l model::State,
        instance: u32,
        source: u32,
        limits: Limits,
        stack: &mut Vec<String>,
    ) {
        for child in model.kind.children() {
            if self.flats.len() >= MAX_STATES {
                if !self.too_many {
                    self.too_many = true;
                    let message = format!("the chart has more than {MAX_STATES} states");
                    self.error(source, code::LIMIT, &child.name, message, None);
                }
                return;
            }
            if usize::from(self.flats[parent as usize].depth) > MAX_LEVELS + 2 {
                let message = format!("states are nested deeper than {MAX_LEVELS} levels");
                self.error(source, code::LIMIT, &child.name, message, None);
                return;
            }
            let prefix = &self.flats[parent as usize].path;
            let name = &child.name.text;
            let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
            let limits = limits.tightened(child.limits);
            let id = self.push(child, source, Some(parent), instance, path, limits, false);
            if self.names.children.insert((parent, name.clone()), id).is_some() {
                let message = format!("there are two states `{name}` here");
                self.error(source, code::DUPLICATE, &child.name, message, None);
            }
            self.flatten_inside(id, child, source, limits, stack);
            self.flatten_children(id, child, instance, source, limits, stack);
            self.finish(id);
        }
    }

    fn flatten_inside(
        &mut self,
        id: StateId,
        model: &'l model::State,
        source: u32,
        limits: Limits,
        stack: &mut Vec<String>,
    ) {
        match &model.kind {
            model::Kind::Skill(name) => {
                let Some(manifest) = self.registry.manifest(&name.text).cloned() else {
                    let known = self.registry.manifests().map(|m| m.name.as_str());
                    let help = suggest(&name.text, known)
                        .unwrap_or_else(|| "`armarium skills` lists the skills".into());
                    let message = format!("there is no skill `{}`", name.text);
                    self.error(source, code::SKILL, name, message, Some(help));
                    return;
                };
                self.acts(id, manifest);
            }
            model::Kind::Chart(name) => {
                // A chart that could not be read has its finding already.
                let Some(chart) = self.library.charts.get(&name.text) else { return };
                if stack.contains(&name.text) {
                    let message =
                        format!("charts contain each other: {} -> {}", stack.join(" -> "), name.text);
                    self.error(source, code::CYCLE, name, message, None);
                    return;
                }
                for output in &chart.outputs {
                    let place = (output.name.clone(), self.slots, output.ty.clone());
                    self.names.outlines[id as usize].outputs.push(place);
                    self.slots += 1;
                }
                self.flats[id as usize].chart = Some((chart, number(self.names.instances.len())));
                stack.push(name.text.clone());
                self.flatten_chart(chart, id, limits, stack);
                stack.pop();
            }
            model::Kind::Remote(name) => {
                let manifest = self.offered(source, name);
                self.acts(id, manifest);
            }
            _ => {}
        }
    }

    /// What another agent offers under a name `agent/Name`; of what is not known or cannot be used, nothing more is said.
    fn offered(&mut self, source: u32, name: &Named) -> Arc<SkillManifest> {
        match self.registry.remote(&name.text) {
            Some(Ok(manifest)) => return Arc::clone(manifest),
            _ if !is_remote_name(&name.text) => {
                let message = format!("`{}` names nothing of another agent", name.text);
                let help = "write it as `agent/Name`".to_owned();
                self.error(source, code::REMOTE, name, message, Some(help));
            }
            Some(Err(refused)) => {
                let (message, help) = (refused.reason.clone(), refused.help.clone());
                self.error(source, code::REMOTE, name, message, help);
            }
            None => {
                let message = format!("`{}` is not checked: its agent was not asked", name.text);
                let help = Some("`--connect tcp/HOST:PORT` asks it".to_owned());
                self.reporting(source, |_, findings| {
                    findings.add(Severity::Warning, code::UNASKED, name.span, message, help);
                });
            }
        }
        let mut manifest = SkillManifest::new(&name.text, "Something that another agent offers.");
        manifest.open = true;
        Arc::new(manifest)
    }

    /// A state acts by a skill: places for what that gives. One that is not known yet gives a map of all.
    fn acts(&mut self, id: StateId, manifest: Arc<SkillManifest>) {
        let outline = &mut self.names.outlines[id as usize];
        outline.open = manifest.open;
        if manifest.open {
            outline.outputs.push((String::new(), self.slots, Type::Any));
            self.slots += 1;
        }
        for output in &manifest.outputs {
            outline.outputs.push((output.name.clone(), self.slots, output.ty.clone()));
            self.slots += 1;
        }
        self.flats[id as usize].skill = Some(manifest);
    }
}

/// Whether a name has the form `agent/Name`.
pub(super) fn is_remote_name(name: &str) -> bool {
    let plain = |part: &str| {
        (1..=100).contains(&part.len())
            && part.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-' || c == '.')
    };
    name.split_once('/').is_some_and(|(agent, rest)| plain(agent) && plain(rest))
}
