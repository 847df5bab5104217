//! The stage of a simulated run: world, robot, memory with prior knowledge and what was kept of earlier runs, and the
//! skills that work with them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_memoryx::{
    Backing, Consolidator, LongTermMemory, MemoryError, ObjectClass, Pattern, Policies, Policy,
    PriorKnowledge, StoreError, WorkingMemory, tokio_clock,
};
use armarium_robot::{Model, postures};
use armarium_simulator::cameras::ScenerySink;
use armarium_simulator::{Handle, Options, Referee, Simulation, SimulationError, TruthSink, World};
use armarium_states::Equipment;

/// Name of the coach's tool in prior knowledge.
const COACH_TOOL: &str = "coach_tool";
/// Size of the tool that the coach demonstrates with, m.
const COACH_TOOL_SIZE: [f64; 3] = [0.08, 0.08, 0.08];
/// Core segment whose entities the long-term store keeps and gives back.
const KEPT_SEGMENT: &str = "Motions";

/// Why a stage cannot be set.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StageError {
    /// Robot and world do not fit.
    #[error("the world cannot be simulated: {0}")]
    Simulation(#[from] SimulationError),
    /// Prior knowledge or kept motions do not fit into memory.
    #[error("memory: {0}")]
    Memory(#[from] MemoryError),
    /// The long-term store cannot be used.
    #[error("the long-term store: {0}")]
    Store(#[from] StoreError),
    /// The folder of the long-term store cannot be made.
    #[error("the long-term store's folder `{folder}` cannot be made: {source}")]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// Everything that a chart runs on.
pub(crate) struct Stage {
    pub(crate) referee: Referee,
    pub(crate) handle: Handle,
    pub(crate) equipment: Equipment,
    pub(crate) mind: Mind,
}

/// What an agent knows, and what it keeps of it; clones are the same.
#[derive(Clone)]
pub(crate) struct Mind {
    pub(crate) memory: Arc<WorkingMemory>,
    pub(crate) kept: Arc<Consolidator>,
}

impl Mind {
    /// A memory with prior knowledge of the world's things and with what was kept in a store.
    pub(crate) fn open(world: &World, store: &Path) -> Result<Self, StageError> {
        if let Some(folder) = store.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder)
                .map_err(|source| StageError::Folder { folder: folder.into(), source })?;
        }
        let long_term = Arc::new(LongTermMemory::open(store)?);
        let policies = Policies::all(Policy::Nothing).with(KEPT_SEGMENT, Policy::AtMost { hz: 1.0 });
        let kept = Arc::new(Consolidator::new(Arc::clone(&long_term), policies));
        let memory = WorkingMemory::new(tokio_clock()).with_backing(Arc::clone(&kept) as Arc<dyn Backing>);
        long_term.load_into(&memory, Pattern::segment(KEPT_SEGMENT))?;
        prior_knowledge(world)?.put_into(&memory)?;
        Ok(Self { memory: Arc::new(memory), kept })
    }
}

impl Stage {
    /// Sets the stage; the simulation is to be spawned. With `scenery`, its cameras are in another process.
    pub(crate) fn set(
        world: &World,
        seed: u64,
        store: &Path,
        truth_sinks: Vec<Box<dyn TruthSink>>,
        scenery: Option<Box<dyn ScenerySink>>,
    ) -> Result<(Self, Simulation), StageError> {
        let start = postures::home(&Arc::new(Model::armar3()));
        let options = Options { truth_sinks, start: Some(start), scenery, ..Options::default() };
        let simulation = Simulation::new(world, seed, options)?;
        let mind = Mind::open(world, store)?;
        let equipment = Equipment {
            robot: simulation.robot(),
            images: simulation.images(),
            memory: Arc::<WorkingMemory>::clone(&mind.memory),
            agent: world.robot.name.clone(),
            seed,
        };
        let stage = Self { referee: simulation.referee(), handle: simulation.handle(), equipment, mind };
        Ok((stage, simulation))
    }
}

/// What the robot knows beforehand of things: name, colour, size and mass, never where they are. Of those that this
/// world describes, and of the usual ones, so that one that is not there can be looked for.
fn prior_knowledge(world: &World) -> Result<PriorKnowledge, MemoryError> {
    let mut prior = PriorKnowledge::new();
    let usual = World::default().objects;
    let missing = usual.iter().filter(|u| world.objects.iter().all(|o| o.name != u.name));
    for object in world.objects.iter().chain(missing) {
        prior.add(ObjectClass::new(&object.name, object.color, object.size).with_mass(object.mass))?;
    }
    prior.add(ObjectClass::new(COACH_TOOL, world.coach.tool.color, COACH_TOOL_SIZE))?;
    Ok(prior)
}
