//! A simulated robot in its world, with what skills work with; and what such an agent knows and keeps.

use std::path::Path;
use std::sync::Arc;

use armarium_memoryx::{
    AgentConfig, AgentMemory, Limits, MemoryError, ObjectClass, Policies, Policy, PriorKnowledge, Restored,
    WorkingMemory,
};
use armarium_robot::{Model, postures};
use armarium_simulator::cameras::ScenerySink;
use armarium_simulator::{Handle, Options, Referee, Simulation, TruthSink, World};
use armarium_states::Equipment;

use crate::error::HostError;

/// Name of the coach's tool in prior knowledge.
const COACH_TOOL: &str = "coach_tool";
/// Size of the tool that the coach demonstrates with, m.
const COACH_TOOL_SIZE: [f64; 3] = [0.08, 0.08, 0.08];
/// Core segment of what was learned.
const MOTIONS: &str = "Motions";
/// Core segments of what is seen of a world.
const SEEN: [&str; 6] =
    ["ObjectInstances", "ObjectRelations", "AgentInstances", "EnvironmentModels", "HumanHands", "HumanPoses"];

/// A simulated robot. Its [`Simulation`] is to be spawned.
pub struct SimulatedRobot {
    /// Judges by the simulator's truth.
    pub referee: Referee,
    /// Tells the time of the world, and ends it.
    pub handle: Handle,
    /// What skills work with.
    pub equipment: Equipment,
}

impl SimulatedRobot {
    /// Puts the robot into its world. With `scenery`, its cameras are in another process.
    ///
    /// # Errors
    /// [`HostError::Simulation`] when the robot and the world do not fit.
    pub fn new(
        world: &World,
        seed: u64,
        memory: &Arc<WorkingMemory>,
        truth_sinks: Vec<Box<dyn TruthSink>>,
        scenery: Option<Box<dyn ScenerySink>>,
    ) -> Result<(Self, Simulation), HostError> {
        let start = postures::home(&Arc::new(Model::armar3()));
        let options = Options { truth_sinks, start: Some(start), scenery, ..Options::default() };
        let simulation = Simulation::new(world, seed, options)?;
        let equipment = Equipment {
            robot: simulation.robot(),
            images: simulation.images(),
            memory: Arc::<WorkingMemory>::clone(memory),
            agent: world.robot.name.clone(),
            seed,
        };
        Ok((Self { referee: simulation.referee(), handle: simulation.handle(), equipment }, simulation))
    }
}

/// The memory of a run: prior knowledge of the world's things, and the motions that the store holds.
///
/// # Errors
/// [`HostError::Memory`] when the store cannot be used.
pub fn memory_of_run(world: &World, store: &Path) -> Result<AgentMemory, HostError> {
    let mut config = AgentConfig::new(&world.robot.name).with_store(store);
    config.policies = Policies::all(Policy::Nothing).with(MOTIONS, Policy::AtMost { hz: 1.0 });
    config.restored = Restored::Only(vec![MOTIONS.to_owned()]);
    config.limits = Limits::default();
    config.prior = prior_knowledge(world)?;
    Ok(AgentMemory::open(&config, armarium_memoryx::tokio_clock())?)
}

/// How the memory of an agent is put together that others write to: what they and it commit is kept and is there again after
/// a start. What was seen stays in the store only, since the simulated world begins anew.
///
/// # Errors
/// [`HostError::Memory`] when prior knowledge does not fit.
pub fn memory_of_agent(
    name: &str,
    world: &World,
    store: &Path,
    policies: Policies,
) -> Result<AgentConfig, HostError> {
    let mut config = AgentConfig::new(name).with_store(store);
    config.policies = policies;
    config.restored = Restored::AllBut(SEEN.map(str::to_owned).to_vec());
    config.prior = prior_knowledge(world)?;
    Ok(config)
}

/// What an agent keeps where nothing is said: of what is seen and learned one snapshot a second, and all of the rest.
#[must_use]
pub fn usual_policies() -> Policies {
    let thinned = SEEN.into_iter().chain([MOTIONS]);
    let usual = Policies::all(Policy::Everything).with("ObjectClasses", Policy::OnChange);
    thinned.fold(usual, |policies, segment| policies.with(segment, Policy::AtMost { hz: 1.0 }))
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
