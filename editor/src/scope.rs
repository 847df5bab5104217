//! The names that can be used at a state: what completion offers. Which of them a name is, the compiler finds.

use armarium_runtime::chart::{Chart, Library, Outline, OutlineKind, Registry};
use armarium_runtime::skill::{Parameter, SkillManifest};
use armarium_values::Type;

/// What can be seen from a state of a chart.
pub(crate) struct StateScope<'s> {
    pub(crate) library: &'s Library,
    pub(crate) registry: &'s Registry,
    pub(crate) chart: &'s Chart,
    pub(crate) outline: &'s Outline,
    /// The state.
    pub(crate) state: usize,
}

impl<'s> StateScope<'s> {
    /// The states whose names are known here, nearest first, each with its shortest path.
    pub(crate) fn visible(&self) -> Vec<(usize, String)> {
        let states = &self.outline.states;
        let mut found: Vec<(usize, String)> = Vec::new();
        for around in std::iter::successors(Some(self.state), |state| states[*state].parent) {
            for child in &states[around].children {
                let name = &states[*child].name;
                // A nearer state of that name hides it.
                if !found.iter().any(|(_, known)| known == name) {
                    found.push((*child, name.clone()));
                }
            }
        }
        found
    }

    /// What a state gives when it has ended.
    pub(crate) fn outputs(&self, state: usize) -> &'s [Parameter] {
        self.parameters(state, |manifest| &manifest.outputs, |chart| &chart.outputs)
    }

    /// What a state takes.
    pub(crate) fn inputs(&self, state: usize) -> &'s [Parameter] {
        self.parameters(state, |manifest| &manifest.inputs, |chart| &chart.inputs)
    }

    /// What the skill or chart of a state declares.
    fn parameters(
        &self,
        state: usize,
        of_skill: impl Fn(&'s SkillManifest) -> &'s Vec<Parameter>,
        of_chart: impl Fn(&'s Chart) -> &'s Vec<Parameter>,
    ) -> &'s [Parameter] {
        match &self.outline.states[state].kind {
            OutlineKind::Skill(name) | OutlineKind::Remote(name) => {
                self.registry.manifest(name).map_or(&[], |manifest| of_skill(manifest))
            }
            OutlineKind::Chart(name) => self.library.charts.get(name).map_or(&[], |chart| of_chart(chart)),
            _ => &[],
        }
    }

    /// The manifest of the skill that a state runs.
    pub(crate) fn manifest(&self, state: usize) -> Option<&'s SkillManifest> {
        match &self.outline.states[state].kind {
            OutlineKind::Skill(name) | OutlineKind::Remote(name) => {
                self.registry.manifest(name).map(|m| &**m)
            }
            _ => None,
        }
    }

    /// How a state can end, and what its watches see.
    pub(crate) fn outcomes(&self, state: usize) -> Vec<String> {
        let of = &self.outline.states[state];
        let finals = |outline: &Outline, of: usize| -> Vec<String> {
            let children = outline.states[of].children.iter();
            let outcome = |child: &usize| match &outline.states[*child].kind {
                OutlineKind::Final(outcome) => Some(outcome.clone()),
                _ => None,
            };
            children.filter_map(outcome).collect()
        };
        let mut outcomes = match &of.kind {
            OutlineKind::Skill(_) | OutlineKind::Remote(_) => {
                let more = self.manifest(state).map_or(&[][..], |manifest| &manifest.outcomes);
                std::iter::once("success".to_owned()).chain(more.iter().cloned()).collect()
            }
            OutlineKind::Chart(name) => {
                self.library.charts.get(name).map_or_else(Vec::new, |chart| finals(&Outline::of(chart), 0))
            }
            OutlineKind::Composite => finals(self.outline, state),
            OutlineKind::Parallel => {
                let regions = of.children.iter().flat_map(|region| finals(self.outline, *region));
                std::iter::once("success".to_owned()).chain(regions).collect()
            }
            _ => Vec::new(),
        };
        if !matches!(of.kind, OutlineKind::Waits | OutlineKind::Final(_) | OutlineKind::History { .. }) {
            outcomes.push("failure".into());
        }
        outcomes.extend(of.watches.iter().cloned());
        let mut seen = Vec::new();
        outcomes.retain(|outcome| {
            !seen.contains(outcome) && {
                seen.push(outcome.clone());
                true
            }
        });
        outcomes
    }

    /// The names that expressions begin with, each with its type; a state's type is that of its outputs.
    pub(crate) fn roots(
        &self,
        channels: &armarium_runtime::chart::ChannelSchema,
        event: Type,
    ) -> Vec<(String, Type, String)> {
        let record = |parameters: &[Parameter]| {
            Type::Record(parameters.iter().map(|p| (p.name.clone(), p.ty.clone())).collect())
        };
        let channels =
            channels.names().map(|name| (name.to_owned(), channels.get(name).cloned().unwrap_or(Type::Any)));
        let event = Type::Record([("name".to_owned(), Type::String), ("data".to_owned(), event)].into());
        let mut roots = vec![
            ("inputs".to_owned(), record(&self.chart.inputs), "what the chart takes".to_owned()),
            ("locals".to_owned(), record(&self.chart.locals), "what the chart remembers".to_owned()),
            ("outputs".to_owned(), record(&self.chart.outputs), "what the chart gives".to_owned()),
            (
                "channels".to_owned(),
                Type::Record(channels.collect()),
                "what observers and skills publish".to_owned(),
            ),
            ("event".to_owned(), event, "the event that is answered".to_owned()),
        ];
        for (state, name) in self.visible() {
            let ty = self.outputs_below(state);
            if !matches!(&ty, Type::Record(fields) if fields.is_empty()) {
                roots.push((name, ty, "what the state gave when it ended".to_owned()));
            }
        }
        roots
    }

    /// What a state gives, and under the names of the states inside it what those give.
    fn outputs_below(&self, state: usize) -> Type {
        let own = self.outputs(state).iter().map(|output| (output.name.clone(), output.ty.clone()));
        let mut fields: std::collections::BTreeMap<String, Type> = own.collect();
        for child in &self.outline.states[state].children {
            let ty = self.outputs_below(*child);
            if !matches!(&ty, Type::Record(fields) if fields.is_empty()) {
                fields.insert(self.outline.states[*child].name.clone(), ty);
            }
        }
        Type::Record(fields)
    }
}

/// A parameter in one line: `force: float in N = 8.0`.
pub(crate) fn shown(parameter: &Parameter) -> String {
    let default =
        parameter.default.as_ref().map_or_else(String::new, |value| format!(" = {}", value.to_json()));
    let bound =
        |bound: Option<f64>, text: &str| bound.map_or_else(String::new, |bound| format!(", {text} {bound}"));
    let bounds = bound(parameter.minimum, "at least") + &bound(parameter.maximum, "at most");
    format!("{}: {}{default}{bounds}", parameter.name, parameter.ty)
}
