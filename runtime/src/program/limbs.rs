//! Which limbs the states of a chart command: those that their skills always command, and those that an input names,
//! where its value is known before the run. Literals and defaults are known, also those of charts inside.

use std::collections::{BTreeMap, BTreeSet};

use super::{Binding, Kind, Program, StateId, Term};

/// The limbs of a program's states.
pub(crate) struct Limbs<'p> {
    program: &'p Program,
    /// What transitions give to the states that they enter.
    given: BTreeMap<StateId, Vec<&'p Binding>>,
    /// Whether the chart's own inputs are known by their defaults.
    by_default: bool,
}

impl Program {
    /// The limbs that skills of the chart command whatever its inputs are, in alphabetical order.
    pub fn limbs(&self) -> Vec<String> {
        let limbs = Limbs::new(self, false);
        let all = (0..).zip(&self.states).flat_map(|(state, _)| limbs.of(state));
        all.map(str::to_owned).collect::<BTreeSet<_>>().into_iter().collect()
    }
}

impl<'p> Limbs<'p> {
    /// The limbs with the chart's own inputs at their defaults if `by_default`, else without those that these name.
    pub(crate) fn new(program: &'p Program, by_default: bool) -> Self {
        let mut given: BTreeMap<StateId, Vec<&Binding>> = BTreeMap::new();
        for transition in program.transitions.iter().filter(|transition| !transition.with.is_empty()) {
            if let [target] = transition.targets.as_slice() {
                given.entry(*target).or_default().extend(&transition.with);
            }
        }
        Self { program, given, by_default }
    }

    /// The limbs that a state's skill commands, as far as that is known.
    pub(crate) fn of(&self, state: StateId) -> BTreeSet<&'p str> {
        let Kind::Skill { manifest } = &self.program.state(state).kind else { return BTreeSet::new() };
        let mut limbs: BTreeSet<&str> = manifest.limbs.iter().map(String::as_str).collect();
        for (input, named) in &manifest.limbs_by_input {
            let declared = manifest.inputs.iter().find(|parameter| parameter.name == *input);
            let default = declared.and_then(|parameter| parameter.default.as_ref()?.as_str());
            let mut known = InputTexts { limbs: self, texts: BTreeSet::new(), seen: BTreeSet::new() };
            known.add(state, input, default);
            let named = known.texts.iter().filter_map(|name| named.get(*name));
            limbs.extend(named.flatten().map(String::as_str));
        }
        limbs
    }
}

/// The texts that may be given to one input.
struct InputTexts<'l, 'p> {
    limbs: &'l Limbs<'p>,
    texts: BTreeSet<&'p str>,
    /// The slots of charts' inputs that were followed.
    seen: BTreeSet<u32>,
}

impl<'p> InputTexts<'_, 'p> {
    /// Adds what is given to an input of a state.
    fn add(&mut self, state: StateId, input: &str, default: Option<&'p str>) {
        let program = self.limbs.program;
        let by_transitions = self.limbs.given.get(&state).into_iter().flatten().copied();
        let bindings = program.state(state).with.iter().chain(by_transitions);
        let given: Vec<&Binding> = bindings.filter(|binding| binding.parameter.name == input).collect();
        if given.is_empty() {
            self.texts.extend(default);
        }
        for binding in given {
            match &binding.term {
                Term::Literal(value) => self.texts.extend(value.as_str()),
                Term::Expr(code) => code.expr.variable().into_iter().for_each(|slot| self.follow(slot)),
                _ => {}
            }
        }
    }

    /// Adds what may be the value of a chart's input.
    fn follow(&mut self, slot: u32) {
        let program = self.limbs.program;
        let inputs =
            program.instances.iter().enumerate().flat_map(|(i, it)| it.inputs.iter().map(move |v| (i, v)));
        let found = inputs.into_iter().find(|(_, variable)| variable.slot == slot);
        let Some((instance, variable)) = found.filter(|_| self.seen.insert(slot)) else { return };
        let default = variable.declaration.default.as_ref().and_then(|default| default.as_str());
        if instance > 0 {
            self.add(program.instances[instance].owner, &variable.declaration.name, default);
        } else if self.limbs.by_default {
            self.texts.extend(default);
        }
    }
}
