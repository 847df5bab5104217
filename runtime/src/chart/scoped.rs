//! Events that belong to the state that they come from: outcomes and watches. Who may take them is said here once.

use crate::program::{Kind, Program, StateId};

/// An outcome or a watch.
pub(super) struct Scoped<'p> {
    /// The state that it comes from.
    pub(super) state: StateId,
    pub(super) name: &'p str,
    /// Whether only that state's own transitions may take it.
    pub(super) own_only: bool,
    pub(super) watch: bool,
    /// The final state that gives it.
    pub(super) at: Option<StateId>,
}

/// All of a program.
pub(super) fn scoped(program: &Program) -> Vec<Scoped<'_>> {
    let mut all = Vec::new();
    let mut add = |state, name, own_only, watch, at| all.push(Scoped { state, name, own_only, watch, at });
    // The end of a chart's inside is that of the state that uses it.
    let user = |id: StateId| match program.state(id) {
        root if root.chart_root => root.parent.unwrap_or(0),
        _ => id,
    };
    for (id, state) in (0..).zip(&program.states).skip(1) {
        for watch in &state.watches {
            let name = program.watches[*watch as usize].name;
            add(id, program.event_names.name(name), false, true, None);
        }
        match &state.kind {
            Kind::Skill { manifest } => {
                add(id, "success", state.region, false, None);
                manifest.outcomes.iter().for_each(|name| add(id, name, state.region, false, None));
            }
            Kind::Final { outcome } => {
                // The composite around ends.
                let Some(parent) = state.parent.map(user) else { continue };
                let region = program.state(parent).region;
                let outcome = program.event_names.name(*outcome);
                add(parent, outcome, region, false, Some(id));
                if region && let Some(parallel) = program.state(parent).parent {
                    // It ends when all its regions have; where one never does, nobody need handle it.
                    let of = user(parallel);
                    let own_only = program.state(of).region || !can_end(program, parallel, &|_| true);
                    add(of, outcome, own_only, false, Some(id));
                }
            }
            Kind::Parallel => {
                let of = user(id);
                let own_only = program.state(of).region || !can_end(program, id, &|_| true);
                add(of, "success", own_only, false, None);
            }
            _ => {}
        }
    }
    all
}

/// Whether a state can come to an end by itself, by final states of which `reached` holds.
pub(super) fn can_end(program: &Program, state: StateId, reached: &dyn Fn(StateId) -> bool) -> bool {
    let children = &program.state(state).children;
    let is_end =
        |child: &StateId| matches!(program.state(*child).kind, Kind::Final { .. }) && reached(*child);
    match program.state(state).kind {
        Kind::Skill { .. } => true,
        Kind::Parallel | Kind::Chart { .. } => children.iter().all(|child| can_end(program, *child, reached)),
        _ => children.iter().any(is_end),
    }
}

/// The states that some way leads to, whatever the conditions on it.
pub(super) fn reached(program: &Program) -> Vec<bool> {
    let mut reached = vec![false; program.states.len()];
    let mut waiting = vec![0];
    while let Some(id) = waiting.pop() {
        if std::mem::replace(&mut reached[id as usize], true) {
            continue;
        }
        let state = program.state(id);
        match &state.kind {
            Kind::Composite { initial } => waiting.extend(&initial.targets),
            Kind::Chart { .. } | Kind::Parallel => waiting.extend(&state.children),
            Kind::History { default, .. } => waiting.extend(&default.targets),
            _ => {}
        }
        waiting.extend(state.parent);
        for t in state.transitions.iter().chain(&state.always).chain(&state.after) {
            waiting.extend(&program.transitions[*t as usize].targets);
        }
    }
    reached
}
