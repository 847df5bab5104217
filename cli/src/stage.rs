//! The stage of a simulated run: world, robot, memory with prior knowledge and what was kept of earlier runs, and the
//! skills that work with them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_bus::Session;
use armarium_memoryx::{
    Backing, Consolidator, Limits, LongTermMemory, MemoryError, ObjectClass, Pattern, Policies, Policy,
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
/// Core segment of what was learned.
const MOTIONS: &str = "Motions";
/// Core segments of what is seen of a world.
const SEEN: [&str; 6] =
    ["ObjectInstances", "ObjectRelations", "AgentInstances", "EnvironmentModels", "HumanHands", "HumanPoses"];

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
    /// The mind of a run: prior knowledge of the world's things, and the motions that were kept in a store.
    pub(crate) fn of_run(world: &World, store: &Path) -> Result<Self, StageError> {
        let policies = Policies::all(Policy::Nothing).with(MOTIONS, Policy::AtMost { hz: 1.0 });
        let memory = WorkingMemory::new(tokio_clock());
        Self::open(world, store, policies, memory, |segment| segment == MOTIONS)
    }

    /// The mind of an agent that others write to: what they and it have committed is kept and is there again, but for what
    /// was seen. That stays in the store: the simulated world that was seen begins anew.
    pub(crate) fn of_agent(
        world: &World,
        store: &Path,
        policies: Policies,
        session: &Session,
    ) -> Result<Self, StageError> {
        let clock = session.clone();
        let memory = WorkingMemory::new(Arc::new(move || clock.now_ns())).with_limits(Limits::of_agent());
        Self::open(world, store, policies, memory, |segment| !SEEN.contains(&segment))
    }

    /// What an agent keeps where nothing is said: of what is seen and learned one snapshot a second, and all of the rest.
    pub(crate) fn usual_policies() -> Policies {
        let thinned = SEEN.into_iter().chain([MOTIONS]);
        let usual = Policies::all(Policy::Everything).with("ObjectClasses", Policy::OnChange);
        thinned.fold(usual, |policies, segment| policies.with(segment, Policy::AtMost { hz: 1.0 }))
    }

    fn open(
        world: &World,
        store: &Path,
        policies: Policies,
        memory: WorkingMemory,
        is_loaded: impl Fn(&str) -> bool,
    ) -> Result<Self, StageError> {
        if let Some(folder) = store.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder)
                .map_err(|source| StageError::Folder { folder: folder.into(), source })?;
        }
        let long_term = Arc::new(LongTermMemory::open(store)?);
        let kept = Arc::new(Consolidator::new(Arc::clone(&long_term), policies));
        let memory = memory.with_backing(Arc::clone(&kept) as Arc<dyn Backing>);
        for segment in long_term.segments()?.iter().filter(|segment| is_loaded(segment)) {
            long_term.load_into(&memory, Pattern::segment(segment))?;
        }
        prior_knowledge(world)?.put_into(&memory)?;
        Ok(Self { memory: Arc::new(memory), kept })
    }
}

impl Stage {
    /// Sets the stage; the simulation is to be spawned. With `scenery`, its cameras are in another process.
    pub(crate) fn set(
        world: &World,
        seed: u64,
        mind: Mind,
        truth_sinks: Vec<Box<dyn TruthSink>>,
        scenery: Option<Box<dyn ScenerySink>>,
    ) -> Result<(Self, Simulation), StageError> {
        let start = postures::home(&Arc::new(Model::armar3()));
        let options = Options { truth_sinks, start: Some(start), scenery, ..Options::default() };
        let simulation = Simulation::new(world, seed, options)?;
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
