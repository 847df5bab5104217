//! Events that belong to the state that they come from: outcomes and watches. Who may take them is said here once.

use crate::program::{Kind, Program, StateId};

/// An outcome or a watch.
pub(super) struct Scoped {
    /// The state that it comes from.
    pub(super) state: StateId,
    pub(super) name: String,
    /// Whether only that state's own transitions may take it.
    pub(super) own_only: bool,
    pub(super) watch: bool,
    /// The final state that gives it.
    pub(super) at: Option<StateId>,
}

/// All of a program.
pub(super) fn scoped(program: &Program) -> Vec<Scoped> {
    let mut all = Vec::new();
    let mut add = |state: StateId, name: &str, own_only: bool, watch: bool, at: Option<StateId>| {
        all.push(Scoped { state, name: name.to_owned(), own_only, watch, at });
    };
    for (id, state) in (0..).zip(&program.states).skip(1) {
        for watch in &state.watches {
            let name = program.watches[*watch as usize].name;
            add(id, program.symbols.name(name), false, true, None);
        }
        match &state.kind {
            Kind::Skill { manifest } => {
                add(id, "success", state.region, false, None);
                manifest.outcomes.iter().for_each(|name| add(id, name, state.region, false, None));
            }
            Kind::Final { outcome } => {
                // The composite around ends; the inside of a chart ends the state that uses it.
                let Some(mut parent) = state.parent else { continue };
                if program.state(parent).chart_root {
                    parent = program.state(parent).parent.unwrap_or(0);
                }
                let region = program.state(parent).region;
                let outcome = program.symbols.name(*outcome);
                add(parent, outcome, region, false, Some(id));
                if region && let Some(parallel) = program.state(parent).parent {
                    // It ends when all its regions have; where one never does, nobody need handle it.
                    let own_only = program.state(parallel).region || !can_end(program, parallel);
                    add(parallel, outcome, own_only, false, Some(id));
                }
            }
            Kind::Parallel => {
                add(id, "success", state.region || !can_end(program, id), false, None);
            }
            _ => {}
        }
    }
    all
}

/// Whether all regions of a parallel state can come to an end.
fn can_end(program: &Program, parallel: StateId) -> bool {
    let ends = |region: &StateId| {
        let region = program.state(*region);
        let is_final = |child: &StateId| matches!(program.state(*child).kind, Kind::Final { .. });
        match region.kind {
            Kind::Skill { .. } | Kind::Chart { .. } | Kind::Parallel => true,
            _ => region.children.iter().any(is_final),
        }
    };
    program.state(parallel).children.iter().all(ends)
}
