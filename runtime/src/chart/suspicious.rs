//! Charts that are valid but probably not meant so: ends that cannot come, outputs that nothing sets, events that nobody takes, texts that look
//! like expressions, states that nothing leads out of, and `always` transitions that never rest.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_source::yaml::{Named, Node, Yaml};
use armarium_source::{Edit, Finding, Findings, LayoutEntry, Remedy, Severity, Span, code};
use armarium_values::expr::nearest;
use armarium_values::{Type, Value};

use super::flatten::Tree;
use super::library::Library;
use super::lint::raised;
use super::model::{self, ActionKind, Chart, WrittenAction};
use super::scoped::{can_end, reached};
use super::symbols::HeadSection;
use crate::program::{Kind, Pattern, Program, StateId};

/// What is suspicious in charts that can be compiled.
pub(super) fn suspicious(program: &Program, tree: &Tree<'_>, library: &Library) -> Vec<Finding> {
    let mut search = Suspects { program, tree, findings: Vec::new() };
    search.never_ends();
    search.dead_ends(library);
    search.loose_limits();
    search.restless();
    let mut findings = search.findings;
    let reached = reached(program);
    let taken = TakenEvents::of(program, &reached);
    let mut uses = uses(tree, &reached);
    for chart in library.charts.values() {
        let used = uses.remove(chart.name.as_str()).unwrap_or_default();
        findings.extend(written(chart, &taken, &used));
    }
    findings
}

/// The events that transitions of states take that can be reached.
#[derive(Default)]
struct TakenEvents<'p> {
    exact: BTreeSet<&'p str>,
    prefixes: Vec<&'p Pattern>,
}

impl<'p> TakenEvents<'p> {
    fn of(program: &'p Program, reached: &[bool]) -> Self {
        let mut taken = Self::default();
        for transition in program.transitions.iter().filter(|t| reached[t.source as usize]) {
            match &transition.pattern {
                Pattern::None => {}
                Pattern::Exact(name) => {
                    taken.exact.insert(name);
                }
                pattern if taken.prefixes.contains(&pattern) => {}
                pattern => taken.prefixes.push(pattern),
            }
        }
        taken
    }

    fn takes(&self, event: &str) -> bool {
        self.exact.contains(event) || self.prefixes.iter().any(|pattern| pattern.matches(event))
    }
}

/// What is known of the states of a chart, wherever it is used.
#[derive(Default)]
struct ChartUses {
    /// What they give: `State.output`.
    given: BTreeSet<String>,
    /// Where the names of those stand that can be reached.
    reached: BTreeSet<usize>,
}

/// The uses of charts, by their names.
fn uses<'t>(tree: &'t Tree<'_>, reached: &[bool]) -> BTreeMap<&'t str, ChartUses> {
    let mut uses: BTreeMap<&str, ChartUses> = BTreeMap::new();
    for (id, flat) in (0..).zip(&tree.states).skip(1) {
        let used = uses.entry(tree.chart_of(id)).or_default();
        used.given.extend(flat.outputs.iter().map(|(output, ..)| format!("{}.{output}", flat.name())));
        if reached[id as usize] {
            used.reached.insert(flat.model.name.span.start);
        }
    }
    uses
}

struct Suspects<'a, 'l> {
    program: &'a Program,
    tree: &'a Tree<'l>,
    findings: Vec<Finding>,
}

impl Suspects<'_, '_> {
    fn add(&mut self, severity: Severity, code: &'static str, state: StateId, text: String, help: &str) {
        let flat = self.tree.state(state);
        let mut findings = Findings::new(Arc::clone(&self.tree.sources[flat.source as usize]));
        findings.add(severity, code, flat.model.name.span, text, Some(help.to_owned()));
        self.findings.append(&mut findings.list);
    }

    /// Regions without an end, where the end of the parallel state around them is waited for: by a transition, or, around
    /// everything, by another region that ends.
    fn never_ends(&mut self) {
        let reached = reached(self.program);
        for id in self.program.ids() {
            let state = self.program.state(id);
            if !matches!(state.kind, Kind::Parallel) {
                continue;
            }
            let ends = |region: &StateId| can_end(self.program, *region, &|end| reached[end as usize]);
            let around = if state.chart_root { state.parent.filter(|user| *user != 0) } else { Some(id) };
            let waited = around.map_or_else(
                || state.children.iter().any(ends),
                |around| {
                    let own = &self.tree.state(around).model.transitions;
                    own.iter().any(|t| t.event.as_ref().is_some_and(|event| event.text == "success"))
                },
            );
            let endless: Vec<StateId> =
                state.children.iter().copied().filter(|region| !ends(region)).collect();
            for region in endless.into_iter().filter(|_| waited) {
                let name = &self.program.state(region).name;
                let what = match around {
                    Some(around) => format!("`success` of `{}`", self.program.state(around).name),
                    None => format!("an end of `{}`", state.name),
                };
                let message = format!("the region `{name}` never ends, so that {what} never comes");
                let help = "give the region a final state, or leave the parallel state by another event";
                self.add(Severity::Warning, code::ENDLESS, region, message, help);
                // Of several states to which nothing follows, it is not known which is meant.
                let mut last = self.program.ids().filter(|id| self.can_be_final(*id, region));
                if let (Some(last), None) = (last.next(), last.next()) {
                    self.end_at(last);
                }
            }
        }
    }

    /// States that wait for nothing, beside states with which their composite can end. (Where nothing ends, that is meant.)
    fn dead_ends(&mut self, library: &Library) {
        let mut events = BTreeSet::new();
        for chart in library.charts.values() {
            events.extend(chart.events.iter().map(|(event, _)| event.text.clone()));
            raised(&chart.root, &mut events);
        }
        let sources = |id: StateId| match &self.program.state(id).kind {
            Kind::Skill { manifest } => manifest.open || !manifest.events.is_empty(),
            kind => matches!(kind, Kind::Parallel),
        };
        // What a waiting state without watches and actions cannot get: it neither fails nor errs.
        let any = !events.is_empty() || !self.program.watches.is_empty() || self.program.ids().any(sources);
        let never = |event: &str| match event {
            "failure" | "error.execution" => true,
            "*" | "error.*" => !any,
            _ => false,
        };
        let finals =
            self.program.ids().filter(|id| matches!(self.program.state(*id).kind, Kind::Final { .. }));
        let ending: BTreeSet<StateId> = finals.filter_map(|id| self.program.state(id).parent).collect();
        for id in self.program.ids() {
            let state = self.program.state(id);
            let leads_on = |id: StateId| {
                let of = self.program.state(id);
                !(of.transitions.is_empty() && of.always.is_empty() && of.after.is_empty())
            };
            let model = self.tree.state(id).model;
            let own = model.transitions.iter().filter_map(|t| t.event.as_ref());
            let waits_in_vain = !model.transitions.is_empty()
                && model.watch.is_empty()
                && model.enter.is_empty()
                && model.always.is_empty()
                && model.after.is_empty()
                && model.transitions.iter().all(|t| t.guard.is_none())
                && own.clone().all(|event| never(&event.text));
            let others_end = state.parent.is_some_and(|parent| ending.contains(&parent));
            let around = self.program.outward(id).skip(usize::from(waits_in_vain));
            let alone = matches!(state.kind, Kind::Atomic) && !around.into_iter().any(leads_on);
            if alone && others_end {
                let what = if waits_in_vain {
                    let names: Vec<String> = own.map(|event| format!("`{}`", event.text)).collect();
                    format!("`{}` waits for {}, which nothing there raises", state.name, names.join(" and "))
                } else {
                    format!("nothing leads out of `{}`", state.name)
                };
                let message = format!("{what}: a run that comes there stays for ever");
                let help = "give it a transition, or make it a `final` state";
                self.add(Severity::Warning, code::ENDLESS, id, message, help);
                if self.can_be_final(id, id) {
                    self.end_at(id);
                }
            }
        }
    }

    /// Whether a state in a region only waits, without a way out, and in the file of that region.
    fn can_be_final(&self, id: StateId, region: StateId) -> bool {
        let (flat, state) = (self.tree.state(id), self.program.state(id));
        let model = flat.model;
        let acts = !(model.enter.is_empty() && model.exit.is_empty() && model.watch.is_empty());
        matches!(state.kind, Kind::Atomic)
            && !acts
            && model.transitions.is_empty()
            && model.always.is_empty()
            && model.after.is_empty()
            && flat.source == self.tree.state(region).source
            && (id == region || state.parent == Some(region))
    }

    /// The finding that was added last is put right by a state that is final.
    fn end_at(&mut self, id: StateId) {
        let owner = Some(self.tree.state(id).model.name.span);
        let remedy =
            Remedy::Add { owner, sections: Vec::new(), key: "final".into(), value: "success".into() };
        if let Some(finding) = self.findings.last_mut() {
            finding.remedy = Some(remedy);
        }
    }

    /// Limits that are looser than those around them.
    fn loose_limits(&mut self) {
        for id in self.program.ids() {
            let flat = self.tree.state(id);
            let Some(around) = flat.parent.map(|parent| self.tree.state(parent).limits) else { continue };
            let (own, held) = (flat.model.limits, flat.limits);
            let loose =
                |own: Option<f64>, held: Option<f64>| own.filter(|own| held.is_some_and(|held| held < *own));
            let found = [
                loose(own.force_n, held.force_n).map(|own| ("force", own, around.force_n, "N")),
                loose(own.speed_m_s, held.speed_m_s).map(|own| ("speed", own, around.speed_m_s, "m/s")),
            ];
            for (what, own, around, unit) in found.into_iter().flatten() {
                let (around, name) = (around.unwrap_or(own), self.program.state(id).name.clone());
                let message = format!(
                    "the {what} of {own} {unit} in `{name}` has no effect: around it {around} {unit} holds"
                );
                let help = "an inner state can only tighten limits";
                self.add(Severity::Warning, code::UNUSED, id, message, help);
            }
        }
    }

    /// `always` transitions without a condition that lead back to where they began.
    fn restless(&mut self) {
        let mut told = BTreeSet::new();
        let mut followed = vec![false; self.program.states.len()];
        for id in self.program.ids() {
            let mut way = vec![id];
            while let Some(next) = way.last().and_then(|at| self.at_once(*at)) {
                if let Some(from) = way.iter().position(|s| *s == next) {
                    if told.insert(next) {
                        let names: Vec<&str> =
                            way[from..].iter().map(|s| &*self.program.state(*s).name).collect();
                        let message = match names.as_slice() {
                            [name] => format!("`always` leads from `{name}` to itself without a condition"),
                            _ => format!(
                                "`always` leads in a circle without a condition: {}",
                                names.join(" -> ")
                            ),
                        };
                        let help = "add `if`, or wait with `after`";
                        self.add(Severity::Error, code::RESTLESS, next, message, help);
                        let waits = self.after_for_always(next);
                        if let Some(finding) = self.findings.last_mut() {
                            finding.remedy = waits;
                        }
                    }
                    break;
                }
                if followed[next as usize] {
                    break;
                }
                way.push(next);
            }
            way.iter().for_each(|state| followed[*state as usize] = true);
        }
    }

    /// `after: {1s: Target}` in the place of `always: Target`.
    fn after_for_always(&self, state: StateId) -> Option<Remedy> {
        let flat = self.tree.state(state);
        let [target] = &flat.model.always.first()?.targets[..] else { return None };
        let source = &self.tree.sources[flat.source as usize];
        let written = |entry: &&LayoutEntry| entry.value == Some(target.span.start);
        let key = source.layout().entries.iter().find(written).filter(|entry| {
            !entry.item && source.text.get(entry.key.start..entry.key.end) == Some("always")
        })?;
        let edits = [(key.key, "after".to_owned()), (target.span, format!("{{1s: {}}}", target.text))];
        Some(Remedy::Replace(edits.into_iter().map(|(span, text)| Edit { span, text }).collect()))
    }

    /// The state that is active at once after `state` was entered, where that is certain.
    fn at_once(&self, state: StateId) -> Option<StateId> {
        let [always] = self.program.state(state).always[..] else { return None };
        let transition = &self.program.transitions[always as usize];
        let mut at = match (&transition.targets[..], &transition.guard) {
            // Without a target it stays, and fires again.
            ([], None) => return Some(state),
            ([target], None) => *target,
            _ => return None,
        };
        // A composite is entered at its initial state, unless it leaves at once itself.
        while let Kind::Composite { initial } = &self.program.state(at).kind {
            let [inner] = initial.targets[..] else { break };
            at = inner;
        }
        Some(at)
    }
}

/// What is suspicious in a chart as it is written.
fn written<'p>(chart: &'p Chart, taken: &'p TakenEvents<'p>, used: &'p ChartUses) -> Vec<Finding> {
    let findings = Findings::new(Arc::clone(&chart.source));
    let mut found = WrittenCheck { findings, chart, assigned: BTreeSet::new(), lost: false, taken, used };
    found.state(&chart.root);
    found.defaults();
    for time in chart.inputs.iter().chain(&chart.locals).filter(|declared| declared.ty == Type::Duration) {
        if time.default.as_ref().and_then(Value::as_f64).is_some_and(|seconds| seconds < 0.0) {
            let at = place_of(chart, &[HeadSection::Inputs, HeadSection::Locals], &time.name);
            let message = format!("`{}` is a time and begins below 0", time.name);
            let help = Some("times are 0 or more".to_owned());
            found.findings.add(Severity::Warning, code::SUSPICIOUS, at, message, help);
        }
    }
    for output in &chart.outputs {
        if output.default.is_none() && !found.assigned.contains(&output.name) {
            let at = place_of(chart, &[HeadSection::Outputs], &output.name);
            let message = format!("nothing sets the output `{}`", output.name);
            let help = format!("set it with `assign: {{outputs.{}: ...}}`, or remove it", output.name);
            found.findings.add(Severity::Warning, code::UNSET, at, message, Some(help));
            // Where nothing reads it, and no state sets it that cannot be reached.
            if !chart.source.text.contains(&format!("outputs.{}", output.name)) {
                found.findings.remedy(Remedy::Remove(at));
            }
        }
    }
    found.findings.list
}

/// Where an input, local or output is declared.
fn place_of(chart: &Chart, sections: &[HeadSection], name: &str) -> Span {
    let is_it =
        |(section, declared): &&(HeadSection, Named)| sections.contains(section) && declared.text == name;
    chart.declared.iter().find(is_it).map_or_else(Span::default, |(_, at)| at.span)
}

struct WrittenCheck<'p> {
    findings: Findings,
    chart: &'p Chart,
    /// Outputs that some action sets.
    assigned: BTreeSet<String>,
    /// Whether what is read stands in a state that cannot be reached.
    lost: bool,
    taken: &'p TakenEvents<'p>,
    used: &'p ChartUses,
}

impl WrittenCheck<'_> {
    fn state(&mut self, state: &model::WrittenState) {
        let lost = std::mem::replace(&mut self.lost, !self.used.reached.contains(&state.name.span.start));
        self.values(&state.with);
        self.actions(&state.enter);
        self.actions(&state.exit);
        for transition in state.transitions.iter().chain(&state.always).chain(&state.after) {
            self.values(&transition.with);
            self.actions(&transition.actions);
        }
        if let model::WrittenKind::Composite { initial: entry, .. }
        | model::WrittenKind::History { default: entry, .. } = &state.kind
        {
            self.actions(&entry.actions);
        }
        state.kind.children().iter().for_each(|child| self.state(child));
        self.lost = lost;
    }

    fn actions(&mut self, actions: &[WrittenAction]) {
        for action in actions {
            match &action.kind {
                ActionKind::Assign(entries) => {
                    for (name, _) in entries.iter().filter(|_| !self.lost) {
                        let output = name.text.strip_prefix("outputs.").unwrap_or(&name.text);
                        self.assigned.insert(output.split('.').next().unwrap_or(output).to_owned());
                    }
                    self.values(entries);
                }
                ActionKind::Raise { event, data } => {
                    self.heard(event);
                    data.iter().for_each(|node| self.value(node));
                }
                ActionKind::Send { event, to, data, .. } => {
                    if to.is_none() {
                        self.heard(event);
                    }
                    data.iter().for_each(|node| self.value(node));
                }
                ActionKind::If { then, otherwise, .. } => {
                    self.actions(then);
                    self.actions(otherwise);
                }
                ActionKind::Foreach { body, .. } => self.actions(body),
                ActionKind::Log(node) => self.value(node),
                ActionKind::Cancel(_) => {}
            }
        }
    }

    /// An event that is raised here must be taken by someone.
    fn heard(&mut self, event: &Named) {
        if !self.taken.takes(&event.text) {
            let message = format!("nobody takes the event `{}`", event.text);
            let near = nearest(&event.text, self.taken.exact.iter().copied());
            let help = match near {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("add `transitions: {{{}: ...}}` where it matters", event.text),
            };
            self.findings.add(Severity::Warning, code::UNHEARD, event.span, message, Some(help));
            near.into_iter().for_each(|near| self.findings.remedy(Remedy::replace(event.span, near)));
        }
    }

    fn values(&mut self, entries: &[(Named, Node)]) {
        entries.iter().for_each(|(_, node)| self.value(node));
    }

    /// A text that looks like an expression without its `${}`, or like one with it.
    fn value(&mut self, node: &Node) {
        match &node.value {
            Yaml::String(text) => self.text(node, text),
            Yaml::List(items) => items.iter().for_each(|item| self.value(item)),
            Yaml::Map(entries) => match entries.as_slice() {
                [(key, Node { value: Yaml::Null, .. })] => self.text(node, &format!("{{{}}}", key.text)),
                entries => self.values(entries),
            },
            _ => {}
        }
    }

    fn text(&mut self, node: &Node, text: &str) {
        let Some(meant) = self.meant(text) else { return };
        let quote = if meant.contains('"') { '\'' } else { '"' };
        let meant = format!("{quote}{meant}{quote}");
        let help = format!("write `{meant}` if its value is meant");
        let message = format!("`{}` is a text here, not an expression", text.trim());
        self.findings.add(Severity::Warning, code::SUSPICIOUS, node.span, message, Some(help));
        let inner = meant[1..meant.len() - 1].to_owned();
        let known = |name: &str| {
            let declared = |(section, at): &(HeadSection, Named)| {
                name.strip_prefix(section.key())
                    .and_then(|rest| rest.strip_prefix('.'))
                    .is_some_and(|rest| rest.split('.').next() == Some(&at.text))
            };
            name.starts_with("channels.")
                || name.starts_with("event.")
                || self.gives(name)
                || self.chart.declared.iter().any(declared)
        };
        // Where a name stands for nothing, what is meant is not certain.
        let mut names = inner.split("${").skip(1).map(|rest| &rest[..end_of_name(rest)]);
        if !inner.contains(quote) && names.all(known) {
            self.findings.remedy(Remedy::replace(node.span, meant));
        }
    }

    /// Whether a name is what a state of the chart gives.
    fn gives(&self, name: &str) -> bool {
        self.used.given.contains(name)
    }

    /// Defaults are literals: what looks like an expression there stays a text.
    fn defaults(&mut self) {
        let chart = self.chart;
        for declared in chart.inputs.iter().chain(&chart.locals).chain(&chart.outputs) {
            let text = declared.default.as_ref().and_then(Value::as_str);
            if let Some(text) = text.filter(|text| self.meant(text).is_some()) {
                let sections = [HeadSection::Inputs, HeadSection::Locals, HeadSection::Outputs];
                let at = place_of(chart, &sections, &declared.name);
                let message = format!("the default of `{}` is the text `{text}`", declared.name);
                let help =
                    "a default is no expression: set the value with `assign` where it is known".to_owned();
                self.findings.add(Severity::Warning, code::SUSPICIOUS, at, message, Some(help));
            }
        }
    }

    /// A text with `${}` around what looks like an expression in it; `None` where nothing does.
    fn meant(&self, text: &str) -> Option<String> {
        let is_variable = |name: &str| is_path(name) || self.gives(name);
        let all = text.trim();
        let (name, rest) = all.split_at(end_of_name(all));
        if is_variable(name) && (rest.is_empty() || rest.trim_start().starts_with(OPERATORS)) {
            return Some(format!("${{{all}}}"));
        }
        let inner = all.strip_prefix("{{").and_then(|inner| inner.strip_suffix("}}")).map(str::trim);
        if let Some(inner) = inner.filter(|inner| !inner.is_empty() && !inner.contains(['{', '}'])) {
            return Some(format!("${{{inner}}}"));
        }
        let (mut meant, mut rest, mut found) = (String::new(), text, false);
        while let Some(at) = rest.find(['{', '$']) {
            meant.push_str(&rest[..at]);
            rest = &rest[at..];
            if rest.starts_with("${") {
                // This one is an expression.
                let end = rest.find('}').map_or(rest.len(), |end| end + 1);
                meant.push_str(&rest[..end]);
                rest = &rest[end..];
                continue;
            }
            match variable_in_brackets(rest).filter(|(name, _)| is_variable(name)) {
                Some((name, after)) => {
                    meant.push_str(&format!("${{{name}}}"));
                    (rest, found) = (after, true);
                }
                None => {
                    meant.push_str(&rest[..1]);
                    rest = &rest[1..];
                }
            }
        }
        found.then(|| meant + rest)
    }
}

/// What follows a variable in an expression.
const OPERATORS: [char; 12] = ['+', '-', '*', '/', '<', '>', '=', '!', '?', '&', '|', '['];

fn end_of_name(text: &str) -> usize {
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '.')).unwrap_or(text.len());
    text[..end].trim_end_matches('.').len()
}

/// The variable that a text begins with, as other languages write it, and what comes after: `{{ a.b }}`, `$(a.b)`, `{a.b}`, `$a.b`.
fn variable_in_brackets(text: &str) -> Option<(&str, &str)> {
    let in_brackets = [("{{", "}}"), ("$(", ")"), ("{", "}")].into_iter().find_map(|(open, close)| {
        let (name, after) = text.strip_prefix(open)?.split_once(close)?;
        Some((name.trim(), after))
    });
    in_brackets.or_else(|| {
        let name = text.strip_prefix('$')?;
        Some(name.split_at(end_of_name(name)))
    })
}

/// `inputs.force`, `channels.wrist.push`.
pub(super) fn is_path(text: &str) -> bool {
    let Some((first, rest)) = text.split_once('.') else { return false };
    matches!(first, "inputs" | "locals" | "outputs" | "channels" | "event")
        && rest.split('.').all(super::read::is_name)
}
