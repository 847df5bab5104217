//! What charts may name in this program: its skills and channels; and the check of a chart against them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{Memory, WorkingMemory, tokio_clock};
use armarium_runtime::chart::{self, ChannelSchema, Checked, Registry};
use armarium_runtime::remote::Agents;
use armarium_simulator::{Options, Simulation, World};
use armarium_states::{Equipment, observers};

use crate::render_findings::Shown;

/// How long other agents may take to be there.
const PATIENCE: Duration = Duration::from_secs(3);

/// The skills that work with `equipment`.
pub(crate) fn registry(equipment: &Equipment) -> Registry {
    armarium_states::skills(equipment).into_iter().collect()
}

/// The channels that observers and skills publish.
pub(crate) fn channels() -> ChannelSchema {
    observers::channels().into_iter().fold(ChannelSchema::new(), |schema, (name, ty)| schema.with(&name, ty))
}

/// The same skills on the default world, for whoever only wants to know what they declare.
pub(crate) fn idle_registry() -> Registry {
    let Ok(simulation) = Simulation::new(&World::default(), 0, Options::default()) else {
        return Registry::new();
    };
    registry(&Equipment {
        robot: simulation.robot(),
        images: simulation.images(),
        memory: Arc::new(WorkingMemory::new(tokio_clock())) as Arc<dyn Memory>,
        agent: "local".into(),
        seed: 0,
    })
}

/// Loads a chart with the charts that it names and checks it.
pub(crate) fn load(file: &Path, folders: &[PathBuf], registry: &Registry) -> Checked {
    chart::check(&chart::load(file, folders), registry, &channels())
}

/// As [`load`], with what other agents offer. Where nobody can be asked, a chart that needs it is refused.
///
/// # Errors
/// One sentence for people.
pub(crate) async fn load_connected(
    file: &Path,
    folders: &[PathBuf],
    registry: &mut Registry,
    agents: Option<&Agents>,
) -> Result<Checked, String> {
    let library = chart::load(file, folders);
    let names = library.remote_names();
    match (agents, names.first()) {
        (Some(agents), _) => agents.resolve(&names, PATIENCE, registry).await,
        (None, Some(name)) => {
            return Err(format!("`{name}` is at another agent: give --connect tcp/HOST:PORT or --listen"));
        }
        (None, None) => {}
    }
    Ok(chart::check(&library, registry, &channels()))
}

/// Loads and checks a chart against the skills of this program, for whoever does not run it.
pub(crate) fn load_idle(file: &Path, folders: &[PathBuf]) -> Checked {
    load(file, folders, &idle_registry())
}

/// Everything that is wrong with a chart.
pub(crate) fn check_chart(file: &Path, folders: &[PathBuf]) -> Vec<Shown> {
    load_idle(file, folders).findings.iter().map(Shown::from).collect()
}
