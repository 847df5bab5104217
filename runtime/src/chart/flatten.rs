//! Charts put into charts: every use of a chart becomes states and places for data of its own, in one tree. Names
//! are looked up here; nothing that is written at a state is compiled yet.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::Named;
use armarium_source::{Finding, Findings, Severity, Source, code};
use armarium_values::Type;

use super::catalog::Registry;
use super::library::Library;
use super::model::{self, Chart};
use super::read::MAX_LEVELS;
use super::symbols::Symbol;
use crate::program::{ChartVariable, Instance, StateId};
use crate::skill::{Limits, Parameter, SkillManifest};

/// Most states, those of the charts inside counted at each use.
const MAX_STATES: usize = 200_000;

/// A chart with the charts inside it, as one tree. States are numbered in the order of the file, parents before
/// children; state 0 stands for the run.
#[derive(Debug, Default)]
pub(super) struct Tree<'l> {
    pub(super) states: Vec<Flat<'l>>,
    /// Children by parent and name.
    children: BTreeMap<(StateId, &'l str), StateId>,
    pub(super) instances: Vec<Instance>,
    pub(super) sources: Vec<Arc<Source>>,
    /// How many places for data there are.
    pub(super) slots: u32,
}

/// A state of a use of a chart.
#[derive(Debug)]
pub(super) struct Flat<'l> {
    /// As it was written.
    pub(super) model: &'l model::WrittenState,
    pub(super) parent: Option<StateId>,
    /// The last state inside it, itself when there is none.
    pub(super) last: StateId,
    pub(super) depth: u16,
    pub(super) source: u32,
    /// The use of a chart that it belongs to.
    pub(super) instance: u32,
    /// From the chart down; empty for the run and the outermost chart.
    pub(super) path: String,
    pub(super) limits: Limits,
    /// Whether it is the inside of a `statechart:` state.
    pub(super) chart_root: bool,
    pub(super) inside: Inside<'l>,
    /// What it gives with its outcome: name, place and type.
    pub(super) outputs: Vec<(String, u32, Type)>,
}

/// What a state stands for, where that is found outside of its file; `Nothing` also where it could not be found.
#[derive(Debug)]
pub(super) enum Inside<'l> {
    Nothing,
    Skill(Arc<SkillManifest>),
    Chart { chart: &'l Chart, instance: u32 },
}

impl Flat<'_> {
    pub(super) fn name(&self) -> &str {
        &self.model.name.text
    }

    /// Whether it gives more than is known: then its first output has no name and is a map of all.
    pub(super) fn open(&self) -> bool {
        self.outputs.first().is_some_and(|(name, ..)| name.is_empty())
    }
}

pub(super) fn number(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

impl Tree<'_> {
    pub(super) fn state(&self, state: StateId) -> &Flat<'_> {
        &self.states[state as usize]
    }

    /// The states around `state`, itself first.
    pub(super) fn outward(&self, state: StateId) -> impl Iterator<Item = StateId> + '_ {
        std::iter::successors(Some(state), |s| self.state(*s).parent)
    }

    /// Whether `inner` is `outer` or inside it.
    pub(super) fn within(&self, inner: StateId, outer: StateId) -> bool {
        (outer..=self.state(outer).last).contains(&inner)
    }

    pub(super) fn instance(&self, state: StateId) -> &Instance {
        &self.instances[self.state(state).instance as usize]
    }

    /// The name of the chart that a state is written in.
    pub(super) fn chart_of(&self, state: StateId) -> &str {
        self.outward(state).find(|s| self.state(*s).chart_root).map_or("", |root| self.state(root).name())
    }

    /// What the name of a state stands for.
    pub(super) fn symbol(&self, state: StateId) -> Symbol {
        let chart = self.chart_of(state).to_owned();
        match self.state(state) {
            Flat { chart_root: true, .. } => Symbol::Chart { chart },
            Flat { path, .. } => Symbol::State { chart, path: path.clone() },
        }
    }

    pub(super) fn is_history(&self, state: StateId) -> bool {
        matches!(self.state(state).model.kind, model::WrittenKind::History { .. })
    }

    /// Whether a state is a region of a parallel state.
    pub(super) fn is_region(&self, state: StateId) -> bool {
        let of = self.state(state);
        let parallel =
            |p: StateId| matches!(self.state(p).model.kind, model::WrittenKind::Parallel(_)) && p != 0;
        !of.chart_root && of.parent.is_some_and(parallel)
    }

    /// A state by its path, looked up from `from` outward within its chart.
    pub(super) fn find(&self, from: StateId, path: &[&str]) -> Option<StateId> {
        self.find_prefix(from, path).filter(|(_, used)| *used == path.len()).map(|(state, _)| state)
    }

    /// The state that the first parts of a path name, and how many parts those are.
    pub(super) fn find_prefix(&self, from: StateId, path: &[&str]) -> Option<(StateId, usize)> {
        let first = *path.first()?;
        let start = self.visible(from).find_map(|around| self.children.get(&(around, first)))?;
        let (mut state, mut used) = (*start, 1);
        while let Some(name) = path.get(used) {
            match self.children.get(&(state, *name)) {
                Some(child) if self.state(*child).instance == self.state(from).instance => {
                    (state, used) = (*child, used + 1);
                }
                _ => break,
            }
        }
        Some((state, used))
    }

    /// The states whose children can be named at `from`: itself and those around it, up to its chart.
    pub(super) fn visible(&self, from: StateId) -> impl Iterator<Item = StateId> + '_ {
        std::iter::successors(Some(from), |s| {
            let of = self.state(*s);
            if of.chart_root { None } else { of.parent }
        })
    }

    /// The names of the first children of a state.
    pub(super) fn child_names(&self, of: StateId, most: usize) -> impl Iterator<Item = &str> {
        self.children.range((of, "")..(of + 1, "")).take(most).map(|((_, name), _)| *name)
    }
}

/// Puts everything that `root` uses into one tree, and finds what is wrong with the names of skills and charts.
pub(super) fn flatten<'l>(
    root: &'l Chart,
    library: &'l Library,
    registry: &Registry,
) -> (Tree<'l>, Vec<Finding>) {
    let mut flattening = Flattening {
        library,
        registry,
        tree: Tree::default(),
        findings: Vec::new(),
        stack: vec![root.name.clone()],
        too_many: false,
    };
    flattening.run(root);
    (flattening.tree, flattening.findings)
}

/// The tree as it grows.
struct Flattening<'l, 'r> {
    library: &'l Library,
    registry: &'r Registry,
    tree: Tree<'l>,
    findings: Vec<Finding>,
    /// The charts that are around, outermost first.
    stack: Vec<String>,
    too_many: bool,
}

impl<'l> Flattening<'l, '_> {
    fn run(&mut self, root: &'l Chart) {
        // State 0 stands for the run; the chart is its only child.
        self.tree.states.push(Flat {
            model: &root.root,
            parent: None,
            last: 0,
            depth: 0,
            source: 0,
            instance: 0,
            path: String::new(),
            limits: Limits::default(),
            chart_root: false,
            inside: Inside::Chart { chart: root, instance: 0 },
            outputs: Vec::new(),
        });
        self.chart(root, 0);
        self.finish(0);
    }

    fn finding(
        &mut self,
        severity: Severity,
        code: &'static str,
        at: &Named,
        message: String,
        help: Option<String>,
        source: u32,
    ) {
        let mut findings = Findings::new(Arc::clone(&self.tree.sources[source as usize]));
        findings.add(severity, code, at.span, message, help);
        self.findings.append(&mut findings.list);
    }

    fn error(&mut self, source: u32, code: &'static str, at: &Named, message: String, help: Option<String>) {
        self.finding(Severity::Error, code, at, message, help, source);
    }

    fn source(&mut self, source: &Arc<Source>) -> u32 {
        let sources = &mut self.tree.sources;
        number(sources.iter().position(|s| Arc::ptr_eq(s, source)).unwrap_or_else(|| {
            sources.push(Arc::clone(source));
            sources.len() - 1
        }))
    }

    fn slot(&mut self) -> u32 {
        self.tree.slots += 1;
        self.tree.slots - 1
    }

    fn variables(&mut self, declarations: &[Parameter]) -> Vec<ChartVariable> {
        let one =
            |declaration: &Parameter| ChartVariable { declaration: declaration.clone(), slot: self.slot() };
        declarations.iter().map(one).collect()
    }

    /// Adds a state inside `parent`.
    fn push(
        &mut self,
        model: &'l model::WrittenState,
        parent: StateId,
        chart: Option<(u32, u32)>,
    ) -> StateId {
        let around = &self.tree.states[parent as usize];
        let (source, instance) = chart.unwrap_or((around.source, around.instance));
        let path = match (chart, around.path.as_str()) {
            (Some(_), path) => path.to_owned(),
            (None, "") => model.name.text.clone(),
            (None, path) => format!("{path}.{}", model.name.text),
        };
        let id = number(self.tree.states.len());
        let state = Flat {
            model,
            parent: Some(parent),
            last: id,
            depth: around.depth + 1,
            source,
            instance,
            path,
            limits: around.limits.tightened(model.limits),
            chart_root: chart.is_some(),
            inside: Inside::Nothing,
            outputs: Vec::new(),
        };
        self.tree.states.push(state);
        id
    }

    /// All that was added since `state` is inside it.
    fn finish(&mut self, state: StateId) {
        self.tree.states[state as usize].last = number(self.tree.states.len() - 1);
    }

    /// Adds a chart as the inside of `owner`.
    fn chart(&mut self, chart: &'l Chart, owner: StateId) {
        let instance = number(self.tree.instances.len());
        let first_slot = self.tree.slots;
        let inputs = self.variables(&chart.inputs);
        let locals = self.variables(&chart.locals);
        let outputs = self.variables(&chart.outputs);
        self.tree.instances.push(Instance { owner, inputs, locals, outputs, first_slot, end_slot: 0 });
        let source = self.source(&chart.source);
        let root = self.push(&chart.root, owner, Some((source, instance)));
        self.children(root);
        self.finish(root);
        self.tree.instances[instance as usize].end_slot = self.tree.slots;
    }

    fn children(&mut self, parent: StateId) {
        let Flat { model, source, depth, .. } = self.tree.states[parent as usize];
        for child in model.kind.children() {
            if self.tree.states.len() >= MAX_STATES {
                if !std::mem::replace(&mut self.too_many, true) {
                    let message = format!("the chart has more than {MAX_STATES} states");
                    self.error(source, code::LIMIT, &child.name, message, None);
                }
                return;
            }
            if usize::from(depth) > MAX_LEVELS + 2 {
                let message = format!("states are nested deeper than {MAX_LEVELS} levels");
                self.error(source, code::LIMIT, &child.name, message, None);
                return;
            }
            let id = self.push(child, parent, None);
            let name = child.name.text.as_str();
            if self.tree.children.insert((parent, name), id).is_some() {
                let message = format!("there are two states `{name}` here");
                self.error(source, code::DUPLICATE, &child.name, message, None);
            }
            self.inside(id, child, source);
            self.children(id);
            self.finish(id);
        }
    }

    /// Finds what a state stands for.
    fn inside(&mut self, id: StateId, model: &'l model::WrittenState, source: u32) {
        match &model.kind {
            model::WrittenKind::Skill(name) => {
                let Some(manifest) = self.registry.manifest(&name.text).cloned() else {
                    let known = self.registry.manifests().map(|m| m.name.as_str());
                    let help = "`armarium skills` lists the skills".to_owned();
                    let message = format!("there is no skill `{}`", name.text);
                    let mut findings = Findings::new(Arc::clone(&self.tree.sources[source as usize]));
                    findings.unknown(code::SKILL, (name.span, &name.text), message, known, Some(help));
                    self.findings.append(&mut findings.list);
                    return self.gives_anything(id);
                };
                self.acts(id, manifest);
            }
            model::WrittenKind::Chart(name) if self.library.stand_ins.contains_key(&name.text) => {
                self.acts(id, Arc::clone(&self.library.stand_ins[&name.text]));
            }
            model::WrittenKind::Chart(name) => {
                // A chart that could not be read has its finding already.
                let Some(chart) = self.library.charts.get(&name.text) else { return self.gives_anything(id) };
                if self.stack.contains(&name.text) {
                    let message =
                        format!("charts contain each other: {} -> {}", self.stack.join(" -> "), name.text);
                    let help =
                        "a chart cannot be inside of itself: put what both need into a chart of its own";
                    self.error(source, code::CYCLE, name, message, Some(help.to_owned()));
                    return;
                }
                let outputs: Vec<_> =
                    chart.outputs.iter().map(|o| (o.name.clone(), self.slot(), o.ty.clone())).collect();
                let state = &mut self.tree.states[id as usize];
                state.outputs = outputs;
                state.inside = Inside::Chart { chart, instance: number(self.tree.instances.len()) };
                self.stack.push(name.text.clone());
                self.chart(chart, id);
                self.stack.pop();
            }
            model::WrittenKind::Remote(name) => {
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
                let help = Some("`armarium run --connect tcp/HOST:PORT` asks it".to_owned());
                self.finding(Severity::Warning, code::UNASKED, name, message, help, source);
            }
        }
        let mut manifest = SkillManifest::new(&name.text, "Something that another agent offers.");
        manifest.open = true;
        Arc::new(manifest)
    }

    /// What a state gives is not known, because what it names is not there: nothing is said of those who read it.
    fn gives_anything(&mut self, id: StateId) {
        let slot = self.slot();
        self.tree.states[id as usize].outputs = vec![(String::new(), slot, Type::Any)];
    }

    /// A state acts by a skill: places for what that gives. One that is not known yet gives a map of all.
    fn acts(&mut self, id: StateId, manifest: Arc<SkillManifest>) {
        let mut outputs = Vec::new();
        if manifest.open {
            outputs.push((String::new(), self.slot(), Type::Any));
        }
        outputs.extend(manifest.outputs.iter().map(|o| (o.name.clone(), self.slot(), o.ty.clone())));
        let state = &mut self.tree.states[id as usize];
        (state.outputs, state.inside) = (outputs, Inside::Skill(manifest));
    }
}

/// Whether a name has the form `agent/Name`.
fn is_remote_name(name: &str) -> bool {
    let plain = |part: &str| {
        (1..=100).contains(&part.len())
            && part.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-' || c == '.')
    };
    name.split_once('/').is_some_and(|(agent, rest)| plain(agent) && plain(rest))
}
