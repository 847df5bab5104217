//! A simulated robot in its world with the skills' equipment; and what such an agent knows and keeps.

use std::path::Path;
use std::sync::Arc;

use armarium_knowledge::{AgentMemory, GraspPose, MemoryConfig, ObjectClass, PriorKnowledge, Restored};
use armarium_memoryx::{MemoryError, MemoryLimits, Policies, Policy, WorkingMemory};
use armarium_robot::JointHistory;
use armarium_simulator::cameras::ScenerySink;
use armarium_simulator::world::{BodyShape, BodySpec, RobotSpec};
use armarium_simulator::{Handle, Options, Referee, RobotInWorld, Simulation, TruthSink, World};
use armarium_states::{CorrectedImages, Equipment, RunningMotions};
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, Pose};
use armarium_visionx::{HandDetection, ImageSource, JoinedImages, Workers};
use nalgebra::Isometry3;
use parking_lot::RwLock;

use crate::error::HostError;

/// Name of the coach's tool in prior knowledge.
const COACH_TOOL: &str = "coach_tool";
/// Size of the tool that the coach demonstrates with, m.
const COACH_TOOL_SIZE: [f64; 3] = [0.08, 0.08, 0.08];
/// Core segment of learned motions.
const MOTIONS: &str = "Motions";
/// Core segments of perceived data.
const PERCEIVED: [&str; 6] =
    ["ObjectInstances", "ObjectRelations", "AgentInstances", "EnvironmentModels", "HumanHands", "HumanPoses"];

/// A robot with what its skills need, and what a run needs of its world. What moves it, a [`Simulation`] or a driver, is to be
/// spawned.
pub struct StagedRobot {
    /// Judges with the simulator's truth, where there is one.
    pub referee: Referee,
    /// Gives the robot's time, and ends its world.
    pub handle: Handle,
    /// The skills' equipment.
    pub equipment: Equipment,
}

impl StagedRobot {
    /// Places the robot into its world. With `scenery`, its cameras are in another process.
    ///
    /// # Errors
    /// [`HostError::Simulation`] when robot and world do not fit together.
    pub fn new(
        world: &World,
        seed: u64,
        memory: &Arc<WorkingMemory>,
        truth_sinks: Vec<Box<dyn TruthSink>>,
        scenery: Option<Box<dyn ScenerySink>>,
    ) -> Result<(Self, Simulation), HostError> {
        let options = Options { truth_sinks, scenery, ..Options::default() };
        let simulation = Simulation::new(world, seed, options)?;
        let equipment = equipment_of(&simulation.robots()[0], &world.robot, memory, seed);
        Ok((Self { referee: simulation.referee(), handle: simulation.handle(), equipment }, simulation))
    }

    /// Sees through other cameras at the same place.
    pub(crate) fn see_through(&mut self, images: Arc<dyn ImageSource>) {
        self.equipment.images = through_own_eyes(&self.equipment, images);
    }
}

/// What the skills of a robot in a world work with.
pub(crate) fn equipment_of(
    robot: &RobotInWorld,
    spec: &RobotSpec,
    memory: &Arc<WorkingMemory>,
    seed: u64,
) -> Equipment {
    let RobotInWorld { name, robot, images } = robot;
    // The task ends with the robot.
    let (history, _) = JointHistory::of(&**robot);
    let mut transforms = Transforms::new();
    transforms.attach(history);
    let transforms = Arc::new(RwLock::new(transforms));
    let mut equipment = Equipment {
        images: Arc::clone(images),
        workers: Workers::Joined,
        hands: HandDetection::default(),
        robot: Arc::clone(robot),
        transforms,
        memory: Arc::<WorkingMemory>::clone(memory),
        agent: name.clone(),
        seed,
        motions: RunningMotions::default(),
        works: spec.arm(robot.model()).map(|arm| arm.name.clone()),
    };
    equipment.images = through_own_eyes(&equipment, Arc::clone(images));
    equipment
}

/// Images with the true pose that the robot's camera had when they were taken.
fn through_own_eyes(equipment: &Equipment, images: Arc<dyn ImageSource>) -> Arc<dyn ImageSource> {
    let Equipment { robot, transforms, memory, agent, .. } = equipment;
    let camera = Frame(robot.model().camera_frame().to_owned());
    let joined = Arc::new(JoinedImages::new(images, transforms, camera));
    Arc::new(CorrectedImages::new(joined, Arc::clone(memory), agent))
}

/// The memory of a run: prior knowledge of the world's objects, and the motions in the store, which other runs may use at the
/// same time. Core segments of `remember` are kept there and known again, too.
///
/// # Errors
/// [`HostError::Memory`] when the store cannot be used.
pub fn memory_of_run(world: &World, store: &Path, remember: &[String]) -> Result<AgentMemory, HostError> {
    let mut config = MemoryConfig::new(&world.robot.name).with_store(store);
    config.shared = true;
    let kept: Vec<String> = remember.iter().cloned().chain([MOTIONS.to_owned()]).collect();
    let policies = Policies::all(Policy::Nothing);
    config.policies =
        kept.iter().fold(policies, |all, segment| all.with(segment, Policy::AtMost { hz: 1.0 }));
    config.restored = Restored::Only(kept);
    config.limits = MemoryLimits::default();
    config.prior = prior_knowledge(world)?;
    Ok(AgentMemory::open(config, armarium_memoryx::tokio_clock())?)
}

/// The memory of a robot of which nothing is kept: prior knowledge of the world's objects.
pub(crate) fn memory_without_store(world: &World, robot: &str) -> Result<AgentMemory, HostError> {
    let mut config = MemoryConfig::new(robot);
    config.prior = prior_knowledge(world)?;
    Ok(AgentMemory::open(config, armarium_memoryx::tokio_clock())?)
}

/// The memory configuration of an agent that others write to. All commits are stored and loaded again at the start,
/// except perceived data: these stay in the store only, because the simulated world begins anew.
///
/// # Errors
/// [`HostError::Memory`] when prior knowledge is invalid.
pub fn memory_of_agent(
    name: &str,
    world: &World,
    store: &Path,
    policies: Policies,
) -> Result<MemoryConfig, HostError> {
    let mut config = MemoryConfig::new(name).with_store(store);
    config.policies = policies;
    config.restored = Restored::AllBut(PERCEIVED.map(str::to_owned).to_vec());
    config.prior = prior_knowledge(world)?;
    Ok(config)
}

/// The default policies: one snapshot per second of perceived and learned data, object classes when they change, and
/// everything else.
pub fn usual_policies() -> Policies {
    let thinned = PERCEIVED.into_iter().chain([MOTIONS]);
    let usual = Policies::all(Policy::Everything).with("ObjectClasses", Policy::OnChange);
    thinned.fold(usual, |policies, segment| policies.with(segment, Policy::AtMost { hz: 1.0 }))
}

/// How a body is held at its handles.
fn grasps(body: &BodySpec) -> Vec<GraspPose> {
    let grasp = |(i, grasp): (usize, Isometry3<f64>)| GraspPose {
        name: format!("handle_{}", i + 1),
        pose: Pose::new(Frame::from(armarium_knowledge::prior::OBJECT_FRAME), &grasp),
        approach: None,
        aperture: None,
    };
    body.handle_grasps().into_iter().enumerate().map(grasp).collect()
}

/// Prior knowledge of objects: name, colour, size and mass, never the position. It has the objects of this world and
/// the usual ones, so that the robot can also look for an object that is absent.
pub(crate) fn prior_knowledge(world: &World) -> Result<PriorKnowledge, MemoryError> {
    let mut prior = PriorKnowledge::new();
    let usual = World::default().objects;
    let missing = usual.iter().filter(|u| world.named_bodies().all(|body| body.name != u.name));
    for object in world.objects.iter().chain(missing) {
        prior.add(ObjectClass::new(&object.name, object.color, object.size).with_mass(object.mass))?;
    }
    let known = |body: &&BodySpec| {
        body.shape == BodyShape::Box || (body.shape == BodyShape::Tray && !body.handle_places().is_empty())
    };
    for body in world.bodies.iter().filter(known) {
        let mut class = ObjectClass::new(&body.name, body.color, body.size).with_mass(body.mass);
        class.grasps = grasps(body);
        prior.add(class)?;
    }
    prior.add(ObjectClass::new(COACH_TOOL, world.coach.tool.color, COACH_TOOL_SIZE))?;
    Ok(prior)
}
