//! What is wrong with a file of test cases, held against its chart: names that stand for nothing, data of another type, outcomes
//! that cannot come. Found before a case is played, each with its place.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::yaml::{Entries, Named, Node, Yaml};
use armarium_source::{Files, Finding, Findings, Source, Span, code, yaml};
use armarium_values::Type;
use serde_json::Value as Json;

use super::{TestFile, stand_in};
use crate::chart::{self, ChannelSchema, Registry, unit_of_time};
use crate::program::{ChannelSource, EventRefused, Kind, NamedChannel, Program, StateId};
use crate::skill::{Parameter, SkillManifest};
use crate::stepping::labels;

/// The programs of a file's chart: with what stands in for charts inside it in all cases, and in each case.
#[derive(Clone, Debug)]
pub struct Programs {
    /// With what stands in in all cases.
    pub all: Arc<Program>,
    /// Of each case.
    pub cases: Vec<Arc<Program>>,
}

impl TestFile {
    /// The programs of the chart that a file tests, with what stands in for charts inside it.
    ///
    /// # Errors
    /// What is wrong with the chart, and stand-ins for charts that it does not use.
    pub fn programs(
        &self,
        source: &Arc<Source>,
        folders: &[PathBuf],
        files: &dyn Files,
        registry: &Registry,
        channels: &ChannelSchema,
    ) -> Result<Programs, Vec<Finding>> {
        let chart = source.path.parent().unwrap_or(Path::new("")).join(&self.test);
        let library = chart::load_from(&chart, folders, files);
        let mut findings = Findings::new(Arc::clone(source));
        let unreadable = |finding: &&Finding| finding.code == code::FILE && finding.source.path == chart;
        if let Some(finding) = library.findings.iter().find(unreadable) {
            let node = yaml::parse(&mut findings);
            let at = node.map_or(Span::default(), |node| node.place("test"));
            let help = "`test` names the chart's file, beside this one: `test: my_chart.yaml`".to_owned();
            findings.error_help(code::FILE, at, format!("{}: {}", self.test, finding.message), Some(help));
            return Err(findings.list);
        }
        let mut by_stand_ins: BTreeMap<BTreeSet<&String>, Arc<Program>> = BTreeMap::new();
        let mut program = |case: Option<usize>| {
            let own = case.and_then(|case| self.cases.get(case)).map(|case| &case.charts);
            let names: BTreeSet<&String> =
                self.charts.keys().chain(own.into_iter().flat_map(BTreeMap::keys)).collect();
            if let Some(program) = by_stand_ins.get(&names) {
                return Ok(Arc::clone(program));
            }
            let mut library = library.clone();
            let unused = library.stand_in(names.iter().copied());
            if !unused.is_empty() {
                return Err(self.unused(source, case, &unused));
            }
            let checked = chart::check(&library, registry, channels);
            let program = checked.program.ok_or(checked.findings)?;
            by_stand_ins.insert(names, Arc::clone(&program));
            Ok(program)
        };
        let all = program(None)?;
        let cases = (0..self.cases.len()).map(|case| program(Some(case))).collect::<Result<_, _>>()?;
        Ok(Programs { all, cases })
    }

    /// Findings about stand-ins for charts that are not used.
    fn unused(&self, source: &Arc<Source>, case: Option<usize>, names: &[&String]) -> Vec<Finding> {
        let mut findings = Findings::new(Arc::clone(source));
        let node = yaml::parse(&mut findings);
        let of = |node: &Node, name: &str| {
            entries(node.get("charts")).iter().find(|(key, _)| key.text == name).map(|(key, _)| key.span)
        };
        for name in names {
            let place = node.as_deref().and_then(|node| {
                let case = case.and_then(|case| node.get("cases")?.items().get(case));
                case.and_then(|case| of(case, name)).or_else(|| of(node, name))
            });
            let message = format!("`charts` stands in for `{name}`, which the chart does not use");
            findings.error(code::CHART, place.unwrap_or_default(), message);
        }
        findings.list
    }

    /// Everything in a file that does not fit its chart, in the order of the text.
    pub fn check(source: Arc<Source>, programs: &Programs, registry: &Registry) -> Vec<Finding> {
        let mut findings = Findings::new(source);
        let Some(node) = yaml::parse(&mut findings) else { return findings.list };
        let (_, states) = labels(&programs.all);
        let mut check = Check { findings, program: &programs.all, registry, states: &states };
        check.scripts(node.get("skills"));
        check.scripts(node.get("charts"));
        let mut findings = check.findings;
        let cases = node.get("cases").map_or(&[][..], Node::items);
        for (case, program) in cases.iter().zip(&programs.cases) {
            let own_states = (!Arc::ptr_eq(program, &programs.all)).then(|| labels(program).1);
            let states = own_states.as_ref().unwrap_or(&states);
            let mut check = Check { findings, program, registry, states };
            check.case(case);
            findings = check.findings;
        }
        findings.list.sort_by_key(|finding| finding.span.start);
        findings.list
    }
}

/// Holds single steps against a chart, for those who drive it by hand.
#[derive(Debug)]
pub struct StepCheck<'p> {
    program: &'p Program,
    registry: &'p Registry,
    states: BTreeMap<String, StateId>,
}

impl<'p> StepCheck<'p> {
    /// For the steps of a chart.
    pub fn new(program: &'p Program, registry: &'p Registry) -> Self {
        Self { program, registry, states: labels(program).1 }
    }

    /// What is wrong with a step that has the keys of a step of a test case: one sentence, with what to do about it.
    ///
    /// # Errors
    /// That sentence.
    pub fn check(&self, step: &Json) -> Result<(), WrongStep> {
        let mut findings = Findings::new(Arc::new(Source::new("", step.to_string())));
        let node = yaml::parse(&mut findings);
        let mut check =
            Check { findings, program: self.program, registry: self.registry, states: &self.states };
        node.iter().for_each(|node| check.step(node));
        match check.findings.list.into_iter().find(Finding::is_error) {
            Some(Finding { message, help, code, .. }) => Err(WrongStep { message, help, code }),
            None => Ok(()),
        }
    }
}

/// What is wrong with a step.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}{}", help.as_ref().map_or(String::new(), |help| format!(" ({help})")))]
pub struct WrongStep {
    message: String,
    help: Option<String>,
    code: &'static str,
}

impl WrongStep {
    /// Whether the step is only in vain: no state takes an event of that name.
    pub fn is_unknown_event(&self) -> bool {
        self.code == code::EVENT
    }
}

struct Check<'p> {
    findings: Findings,
    program: &'p Program,
    registry: &'p Registry,
    /// States by path and by displayed name.
    states: &'p BTreeMap<String, StateId>,
}

fn entries(node: Option<&Node>) -> &Entries {
    match node.map(|node| &node.value) {
        Some(Yaml::Map(entries)) => entries,
        _ => &[],
    }
}

fn text(node: Option<&Node>) -> Option<(Span, &str)> {
    match node.map(|node| (node.span, &node.value)) {
        Some((span, Yaml::String(text))) => Some((span, text)),
        _ => None,
    }
}

impl Check<'_> {
    fn case(&mut self, case: &Node) {
        self.scripts(case.get("skills"));
        self.scripts(case.get("charts"));
        self.given(case.get("given"));
        self.profile(case.get("profile"));
        case.get("steps").map_or(&[][..], Node::items).iter().for_each(|step| self.step(step));
    }

    fn unknown<'n>(
        &mut self,
        code: &'static str,
        span: Span,
        what: &str,
        name: &str,
        known: impl Iterator<Item = &'n str>,
    ) {
        self.findings.unknown(code, (span, name), format!("there is no {what} `{name}`"), known, None);
    }

    fn state(&mut self, span: Span, name: &str) -> Option<StateId> {
        let found = self.states.get(name).copied();
        if found.is_none() {
            let known: Vec<String> = self.states.keys().cloned().collect();
            self.unknown(code::STATE, span, "state", name, known.iter().map(String::as_str));
        }
        found
    }

    /// How skills end, by the name of a skill or of a state that runs one.
    fn scripts(&mut self, node: Option<&Node>) {
        for (name, endings) in entries(node) {
            let Some(manifest) = self.scripted(name) else { continue };
            let one = std::slice::from_ref(endings);
            let endings = if let Yaml::List(items) = &endings.value { items } else { one };
            endings.iter().for_each(|ending| self.ending(ending, &manifest));
        }
    }

    fn scripted(&mut self, name: &Named) -> Option<SkillManifest> {
        let of = |id: StateId| match &self.program.state(id).kind {
            Kind::Skill { manifest } => Some((**manifest).clone()),
            _ => None,
        };
        let ids = 0..StateId::try_from(self.program.len()).unwrap_or(StateId::MAX);
        if let Some(manifest) = ids.clone().filter_map(of).find(|manifest| manifest.name == name.text) {
            return Some(manifest);
        }
        match self.states.get(&name.text).copied() {
            Some(id) => {
                let found = of(id);
                if found.is_none() {
                    let message = format!("`{}` runs no skill", name.text);
                    let help = matches!(self.program.state(id).kind, Kind::Chart { .. }).then(|| {
                        "it is another chart: `charts: {NAME: success}` stands in for it".to_owned()
                    });
                    self.findings.error_help(code::SKILL, name.span, message, help);
                }
                found
            }
            None if self.registry.manifest(&name.text).is_some() => {
                let message = format!("the chart does not use the skill `{}`", name.text);
                self.findings.error(code::SKILL, name.span, message);
                None
            }
            None => {
                let used: Vec<String> = ids.filter_map(of).map(|manifest| manifest.name).collect();
                let known = used.iter().map(String::as_str).chain(self.states.keys().map(String::as_str));
                let known: Vec<String> = known.map(str::to_owned).collect();
                let known = known.iter().map(String::as_str);
                self.unknown(code::SKILL, name.span, "skill or state", &name.text, known);
                None
            }
        }
    }

    /// Time that goes by, s.
    fn time(&mut self, node: Option<&Node>) {
        let seconds = node.and_then(|node| Type::Duration.convert(node.literal()).ok()?.as_f64());
        if let Some((node, seconds)) = node.zip(seconds) {
            unit_of_time(node, seconds, &mut self.findings);
        }
    }

    fn ending(&mut self, node: &Node, manifest: &SkillManifest) {
        self.time(node.get("after"));
        let outcome = text(Some(node)).or_else(|| text(node.get("outcome")));
        if let Some((span, outcome)) = outcome.filter(|_| !manifest.open) {
            let known = ["success", "failure", "never"].into_iter();
            let known = known.chain(manifest.outcomes.iter().map(String::as_str));
            if !known.clone().any(|known| known == outcome) {
                self.unknown(code::EVENT, span, "outcome", outcome, known);
            }
        }
        self.values("output", node.get("outputs"), &manifest.outputs, manifest.open);
    }

    fn values(&mut self, what: &str, node: Option<&Node>, declared: &[Parameter], open: bool) {
        for (name, value) in entries(node) {
            match declared.iter().find(|declared| declared.name == name.text) {
                Some(parameter) => self.value(value, &parameter.ty),
                None if open => {}
                None => {
                    let known = declared.iter().map(|declared| declared.name.as_str());
                    self.unknown(code::INPUT, name.span, what, &name.text, known);
                }
            }
        }
    }

    fn value(&mut self, node: &Node, ty: &Type) {
        if let Err(error) = stand_in::read(ty, &node.literal().to_json()) {
            self.findings.error(code::TYPE, node.span, error.to_string());
        }
    }

    fn given(&mut self, node: Option<&Node>) {
        let inputs: Vec<Parameter> = self.program.inputs().cloned().collect();
        self.values("input", node, &inputs, false);
        for (name, value) in entries(node) {
            let kind = inputs.iter().find(|input| input.name == name.text).and_then(|input| input.names);
            if let (Some(kind), Some((span, text))) =
                (kind, text(Some(value)).filter(|(_, text)| !text.is_empty()))
                && let Err(unknown) = self.registry.known_name(kind, text, self.program.file())
            {
                let known = unknown.known.iter().map(String::as_str);
                self.findings.unknown(code::REFERENCE, (span, text), unknown.message(), known, None);
            }
        }
    }

    fn profile(&mut self, node: Option<&Node>) {
        let Some((span, name)) = text(node) else { return };
        if !self.program.profiles.contains_key(name) {
            let program = self.program;
            self.unknown(code::INPUT, span, "profile", name, program.profiles.keys().map(String::as_str));
        }
    }

    fn step(&mut self, step: &Node) {
        self.time(step.get("after"));
        self.time(step.get("age"));
        let from = text(step.get("from")).and_then(|(span, name)| self.state(span, name));
        match (text(step.get("event")), step.get("from")) {
            (Some((span, event)), None) => self.event(span, event, step.get("data")),
            (Some((span, event)), Some(_)) => {
                if let Some(from) = from {
                    self.event_of(from, span, event, step.get("data"));
                }
            }
            (None, _) => {}
        }
        if let Some((span, channel)) = text(step.get("channel")) {
            let program = self.program;
            let known = &program.named_channels;
            match (known.get(channel), step.get("value")) {
                (Some(named), Some(value)) => self.channel_value(value, named),
                (Some(_), None) => {}
                (None, _) => {
                    let names = known.keys().map(String::as_str);
                    self.unknown(code::CHANNEL, span, "channel", channel, names);
                }
            }
        }
        if let Some(expect) = step.get("expect") {
            self.expect(expect);
        }
    }

    /// A channel's value, which of what is observed may be nothing, or a list of all matches.
    fn channel_value(&mut self, node: &Node, channel: &NamedChannel) {
        match (&channel.ty, &node.value) {
            (_, Yaml::Null) if matches!(channel.source, ChannelSource::Memory { .. }) => {}
            (Type::List(of), Yaml::List(items)) => items.iter().for_each(|item| self.fields(item, of)),
            (ty, _) => self.fields(node, ty),
        }
    }

    /// A value may leave fields out; what is there must fit.
    fn fields(&mut self, node: &Node, ty: &Type) {
        let Type::Record(fields) = ty else { return self.value(node, ty) };
        if !matches!(node.value, Yaml::Map(_)) {
            return self.value(node, ty);
        }
        for (name, value) in entries(Some(node)) {
            match fields.get(&name.text) {
                Some(ty) => self.value(value, ty),
                None => {
                    let known = fields.keys().map(String::as_str);
                    self.unknown(code::CHANNEL, name.span, "field", &name.text, known);
                }
            }
        }
    }

    /// An event from outside.
    fn event(&mut self, span: Span, event: &str, data: Option<&Node>) {
        let value = data.map_or(armarium_values::Value::Null, |node| {
            armarium_values::Value::from_json(&node.literal().to_json())
        });
        let predefined = event.starts_with("error.") || event.starts_with("done.");
        match self.program.accepts(event, &value) {
            Err(EventRefused::Unknown { help, .. }) if !predefined => {
                let message = format!("the chart takes no event `{event}`");
                self.findings.error_help(code::EVENT, span, message, Some(help));
            }
            Err(error @ EventRefused::Data { .. }) => {
                let span = data.map_or(span, |node| node.span);
                self.findings.error(code::TYPE, span, error.to_string());
            }
            _ => {}
        }
    }

    /// An outcome or a watch of a state.
    fn event_of(&mut self, from: StateId, span: Span, event: &str, data: Option<&Node>) {
        let program = self.program;
        let state = program.state(from);
        let watches =
            state.watches.iter().map(|w| program.event_names.name(program.watches[*w as usize].name));
        let mut known: Vec<&str> = watches.collect();
        if let Kind::Skill { manifest } = &state.kind {
            if manifest.open {
                return;
            }
            if !known.contains(&event) && event != "failure" {
                self.values("output", data, &manifest.outputs, false);
            }
            known.extend(["success", "failure"]);
            known.extend(manifest.outcomes.iter().map(String::as_str));
        }
        if !known.contains(&event) {
            let what = format!("outcome or watch of `{}` called", state.name);
            self.unknown(code::EVENT, span, &what, event, known.into_iter());
        }
    }

    fn expect(&mut self, expect: &Node) {
        for active in expect.get("active").map_or(&[][..], Node::items) {
            if let Some((span, name)) = text(Some(active)) {
                self.state(span, name);
            }
        }
        let program = self.program;
        let instance = &program.instances[0];
        for (what, declared) in [("locals", &instance.locals), ("outputs", &instance.outputs)] {
            for (name, _) in entries(expect.get(what)) {
                if !declared.iter().any(|variable| variable.declaration.name == name.text) {
                    let known = declared.iter().map(|variable| variable.declaration.name.as_str());
                    self.unknown(code::VARIABLE, name.span, &what[..what.len() - 1], &name.text, known);
                }
            }
        }
        if let Some((span, outcome)) = text(expect.get("outcome")) {
            let own = program.outcomes();
            let known = ["success", "failure"].into_iter().chain(own.iter().map(String::as_str));
            if !known.clone().any(|known| known == outcome) {
                self.unknown(code::EVENT, span, "outcome of the chart called", outcome, known);
            }
        }
    }
}
