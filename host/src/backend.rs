//! The body of an agent: a simulated robot, or only the images of another agent.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use armarium_memoryx::{Memory, WorkingMemory};
use armarium_robot::Model;
use armarium_runtime::chart::Registry;
use armarium_simulator::{Handle, Simulation};
use armarium_states::{Equipment, RunningMotions};
use armarium_visionx::Workers;
use armarium_visionx::providers::StereoView;

use crate::agent_config::AgentConfig;
use crate::catalog;
use crate::console::WorldClock;
use crate::remote_eyes::RemoteEyes;
use crate::simulated::StagedRobot;

/// What an agent acts with: its equipment, its skills and its clock.
pub(crate) struct Backend {
    pub(crate) equipment: Equipment,
    pub(crate) registry: Registry,
    pub(crate) clock: WorldClock,
    /// Runs until the agent ends, or until the sensors end.
    pub(crate) task: Pin<Box<dyn Future<Output = ()> + Send>>,
    /// Whether it has the inputs of the observers.
    pub(crate) observes: bool,
}

impl Backend {
    /// The simulated robot with its sensors.
    pub(crate) fn simulated(config: &AgentConfig, mut robot: StagedRobot, simulation: Simulation) -> Self {
        let (handle, ending) = (robot.handle.clone(), EndOnDrop(robot.handle));
        (robot.equipment.workers, robot.equipment.hands) = (Workers::Threads, config.hands);
        Self {
            registry: catalog::registry(&robot.equipment, &config.skills),
            equipment: robot.equipment,
            clock: Arc::new(move || handle.now_ns()),
            task: Box::pin(async move {
                let _ending = ending;
                simulation.run().await;
            }),
            observes: true,
        }
    }

    /// The images of another agent and no limbs: only skills that move nothing.
    pub(crate) fn eyes_only(
        config: &AgentConfig,
        (model, view): (Arc<Model>, Arc<StereoView>),
        memory: &Arc<WorkingMemory>,
    ) -> Self {
        let now_ns = Arc::new(AtomicU64::new(0));
        let eyes = RemoteEyes::new(model, view, Arc::clone(&now_ns));
        let equipment = Equipment {
            robot: Arc::clone(&eyes.robot),
            images: Arc::clone(&eyes.images),
            workers: Workers::Threads,
            hands: config.hands,
            memory: Arc::<WorkingMemory>::clone(memory) as Arc<dyn Memory>,
            agent: config.name.clone(),
            seed: config.seed,
            transforms: Arc::default(),
            motions: RunningMotions::default(),
            works: None,
        };
        let registry = catalog::registry(&equipment, &config.skills);
        let still = registry.manifests().filter(|manifest| !manifest.moves());
        let still: Vec<String> = still.map(|manifest| manifest.name.clone()).collect();
        Self {
            registry: still.iter().filter_map(|name| registry.get(name).cloned()).collect(),
            equipment,
            clock: Arc::new(move || now_ns.load(Ordering::Relaxed)),
            task: Box::pin(eyes.live()),
            observes: false,
        }
    }
}

/// Ends the simulation when its task is dropped.
struct EndOnDrop(Handle);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.0.stop();
    }
}
