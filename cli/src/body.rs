//! What an agent acts with: a simulated robot, or eyes that another agent lends to one who only watches.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use armarium_memoryx::{Memory, WorkingMemory};
use armarium_runtime::chart::Registry;
use armarium_simulator::{Handle, Simulation, World};
use armarium_states::Equipment;
use armarium_visionx::providers::StereoView;

use crate::catalog;
use crate::following::stands;
use crate::logging::Clock;
use crate::stage::{Mind, Stage};
use crate::watching::{self, Standing};

/// What an agent acts with.
pub(crate) struct Body {
    pub(crate) equipment: Equipment,
    pub(crate) registry: Registry,
    pub(crate) clock: Clock,
    /// Lives until the agent ends, or until there is nothing more to sense.
    pub(crate) life: Pin<Box<dyn Future<Output = ()> + Send>>,
    /// Whether it has what the observers observe.
    pub(crate) observing: bool,
}

/// The mind of an agent who only watches, which says where it stands: as the world says of the agent of that name.
///
/// # Errors
/// One sentence for people.
pub(crate) fn watching_mind(name: &str, world: &World, mind: Mind) -> Result<Mind, String> {
    let agent = watching::agent_of(world, name)?;
    let stand = stands(name, &agent.root_from_agent()).and_then(|stand| mind.memory.commit_now(vec![stand]));
    stand.map_err(|e| e.to_string())?;
    Ok(mind)
}

impl Body {
    /// The simulated robot with its senses.
    pub(crate) fn simulated(stage: Stage, simulation: Simulation) -> Self {
        let (handle, ending) = (stage.handle.clone(), EndOnDrop(stage.handle));
        Self {
            registry: catalog::registry(&stage.equipment),
            equipment: stage.equipment,
            clock: Arc::new(move || handle.now_ns()),
            life: Box::pin(async move {
                let _ending = ending;
                simulation.run().await;
            }),
            observing: true,
        }
    }

    /// The eyes of the agent `name`, and no limb.
    pub(crate) fn watching(
        name: &str,
        seed: u64,
        view: Arc<StereoView>,
        memory: &Arc<WorkingMemory>,
    ) -> Self {
        let now_ns = Arc::new(AtomicU64::new(0));
        let standing = Standing::new(view, Arc::clone(&now_ns));
        let equipment = Equipment {
            robot: Arc::clone(&standing.robot),
            images: Arc::clone(&standing.images),
            memory: Arc::<WorkingMemory>::clone(memory) as Arc<dyn Memory>,
            agent: name.to_owned(),
            seed,
        };
        Self {
            registry: watching::registry(&equipment),
            equipment,
            clock: Arc::new(move || now_ns.load(Ordering::Relaxed)),
            life: Box::pin(standing.live()),
            observing: false,
        }
    }
}

/// Ends the simulation with the task that lives it.
struct EndOnDrop(Handle);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.0.stop();
    }
}
