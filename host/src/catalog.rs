//! The skills and channels that charts may name, and the check of a chart against them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{Memory, tokio_clock};
use armarium_runtime::chart::{self, ChannelSchema, Checked, Registry};
use armarium_runtime::program::Program;
use armarium_runtime::remote::Agents;
use armarium_runtime::skill::Skill;
use armarium_simulator::{Options, Simulation, World};
use armarium_source::Finding;
use armarium_states::{Equipment, RunningMotions, observers};
use armarium_visionx::{HandDetection, Workers};

use crate::console::Console;
use crate::error::HostError;
use crate::names::Names;

const AGENT_TIMEOUT: Duration = Duration::from_secs(3);

/// Constructs an additional skill from the robot, the cameras and the memory.
pub type SkillFactory = Arc<dyn Fn(&Equipment) -> Arc<dyn Skill> + Send + Sync>;

/// The built-in skills and the additional ones `own`, working with `equipment`.
pub fn registry(equipment: &Equipment, own: &[SkillFactory]) -> Registry {
    let own = own.iter().map(|make| make(equipment));
    armarium_states::skills(equipment).into_iter().chain(own).collect()
}

/// The channels that observers and skills publish.
pub fn channels() -> ChannelSchema {
    observers::channels()
}

/// The built-in skills on the default world, for reading their declarations only.
pub fn idle_registry() -> Registry {
    registry_in(&World::default()).unwrap_or_default()
}

/// The built-in skills of the robot that is called by its name or its file, for reading their declarations only.
///
/// # Errors
/// [`HostError::Findings`] when the robot cannot be read, [`HostError::Simulation`] when it cannot be simulated.
pub fn registry_of_robot(robot: &str) -> Result<Registry, HostError> {
    let mut world = World::default();
    robot.clone_into(&mut world.robot.model);
    world.robot.load().map_err(HostError::Findings)?;
    registry_in(&world)
}

fn registry_in(world: &World) -> Result<Registry, HostError> {
    let simulation = Simulation::new(world, 0, Options::default())?;
    let equipment = Equipment {
        robot: simulation.robot(),
        images: simulation.images(),
        workers: Workers::Joined,
        hands: HandDetection::default(),
        memory: Arc::new(armarium_knowledge::working_memory(tokio_clock())) as Arc<dyn Memory>,
        agent: "local".into(),
        seed: 0,
        transforms: Arc::default(),
        motions: RunningMotions::default(),
        works: None,
    };
    Ok(registry(&equipment, &[]))
}

/// As [`idle_registry`], with the names that exist before a run: postures of the robot, and object classes of the default
/// world, of `worlds`, and of the worlds beside a chart.
pub fn checking_registry(worlds: &[World]) -> Registry {
    idle_registry().with_names(Arc::new(Names::of_check(worlds)))
}

/// Loads a chart with the charts that it names, and checks it.
pub fn load(file: &Path, folders: &[PathBuf], registry: &Registry) -> Checked {
    chart::check(&chart::load(file, folders), registry, &channels())
}

/// Loads and checks a chart against the built-in skills, without running it.
pub fn load_idle(file: &Path, folders: &[PathBuf]) -> Checked {
    load(file, folders, &idle_registry())
}

/// As [`load`], with the charts and skills that other agents offer.
///
/// # Errors
/// [`HostError::NotConnected`] when the chart names another agent and there is no session.
pub async fn load_connected(
    file: &Path,
    folders: &[PathBuf],
    registry: &mut Registry,
    agents: Option<&Agents>,
) -> Result<Checked, HostError> {
    let library = chart::load(file, folders);
    let names = library.remote_names();
    match (agents, names.first()) {
        (Some(agents), _) => agents.resolve(&names, AGENT_TIMEOUT, registry).await,
        (None, Some(name)) => return Err(HostError::NotConnected { name: name.clone() }),
        (None, None) => {}
    }
    Ok(chart::check(&library, registry, &channels()))
}

/// The program of a chart without errors; reports its warnings.
///
/// # Errors
/// [`HostError::Findings`] with all that is wrong.
pub fn runnable(checked: Checked, console: &dyn Console) -> Result<Arc<Program>, HostError> {
    let is_wrong = checked.findings.iter().any(Finding::is_error);
    match checked.program {
        Some(program) if !is_wrong => {
            if !checked.findings.is_empty() {
                console.warnings(&checked.findings);
            }
            Ok(program)
        }
        _ => Err(HostError::Findings(checked.findings)),
    }
}
