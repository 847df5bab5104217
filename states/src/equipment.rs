//! The resources of skills, and an adapter that makes a skill from a manifest and an asynchronous function.

use std::future::Future;
use std::sync::Arc;

use armarium_memoryx::Memory;
use armarium_robot::{Limb, LinkId, Robot};
use armarium_runtime::channels::Channels;
use armarium_runtime::skill::{Failure, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, Value};
use armarium_visionx::{
    ColorMarkerObjectTracking, HandDetection, ImageSource, MarkerStep, Sight, StereoStep, Workers,
};
use futures::future::BoxFuture;
use nalgebra::Isometry3;
use parking_lot::RwLock;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::motions::failed;
use crate::places::Remembered;
use crate::running_motion::RunningMotions;

/// A motion that was published longer ago does not run any more, s.
const RUNS_S: f64 = 0.1;

/// The resources that skills use, as traits. Clones share the same robot, cameras, memory and running motions.
#[derive(Clone)]
pub struct Equipment {
    /// The robot.
    pub robot: Arc<dyn Robot>,
    /// The stereo cameras on its head.
    pub images: Arc<dyn ImageSource>,
    /// Where what looks at their images works.
    pub workers: Workers,
    /// How people's hands are found.
    pub hands: HandDetection,
    /// The agent's memory.
    pub memory: Arc<dyn Memory>,
    /// The agent's name, which is the provider of the entities that its skills write to memory.
    pub agent: String,
    /// Seed of the random numbers of tracking.
    pub seed: u64,
    /// Where the robot's links, its cameras and what else has a frame were in the last seconds, in the time of its samples.
    pub transforms: Arc<RwLock<Transforms>>,
    /// The motions that its skills run now.
    pub motions: RunningMotions,
    /// The arm that works where a skill's input names none, a group of the robot; `None`: the robot's first.
    pub works: Option<String>,
}

impl Equipment {
    /// The arm that works.
    pub(crate) fn arm(&self) -> Result<&Limb, Failure> {
        let model = self.robot.model();
        let works = self.works.as_deref().and_then(|works| model.arm(works));
        let none = || Failure::new(format!("the robot `{}` has no arm: no group with a `tcp`", model.name()));
        works.or_else(|| model.arms().next()).ok_or_else(none)
    }

    /// The arm that executes the motion on the channel `motion`; if none does now, the arm that works.
    pub(crate) fn executing_arm(&self, channels: &Channels) -> Result<&Limb, Failure> {
        let motion = running_motion(channels);
        let name = motion.as_ref().and_then(|motion| motion.get("arm").and_then(Value::as_str));
        let named = name.and_then(|name| self.robot.model().arm(name));
        named.map_or_else(|| self.arm(), Ok)
    }

    /// Its memory, with the frames in which poses there may be.
    pub(crate) fn remembered(&self) -> Remembered<'_> {
        Remembered { memory: &*self.memory, transforms: &self.transforms }
    }

    /// Starts to look with a processor of images; it works until it is dropped.
    pub(crate) fn look(&self, step: impl StereoStep + 'static) -> Sight {
        Sight::start(&self.images, step, self.workers)
    }

    /// A processor that tracks a thing of this colour, seen as of this class; without a diameter, m, it learns that.
    pub(crate) fn track(&self, color: [u8; 3], diameter: Option<f64>, class: &str) -> MarkerStep {
        let calibration = self.images.calibration();
        MarkerStep::new(ColorMarkerObjectTracking::new(calibration, color, diameter, self.seed), class)
    }

    /// A random generator that gives the same numbers in every run with the same seed.
    pub(crate) fn random(&self) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.seed)
    }

    /// Where a link of the robot was at a time of its samples, for instance that of a picture: its pose in the root frame.
    pub(crate) fn link_at(&self, link: LinkId, stamp_ns: u64) -> Result<Isometry3<f64>, Failure> {
        let frame = Frame(self.robot.model().links()[link.index()].name.clone());
        self.transforms.read().transform(&Frame::root(), &frame, stamp_ns).map_err(failed)
    }
}

/// What is published of the motion that runs now.
pub(crate) fn running_motion(channels: &Channels) -> Option<Value> {
    let motion = channels.newest("motion").filter(|s| s.at.elapsed().as_secs_f64() < RUNS_S)?;
    Some(motion.value)
}

/// A skill made of a manifest and a function.
struct FunctionSkill<F> {
    manifest: SkillManifest,
    equipment: Equipment,
    act: F,
}

impl<F, A> Skill for FunctionSkill<F>
where
    F: Fn(Equipment, SkillContext) -> A + Send + Sync + 'static,
    A: Future<Output = SkillResult> + Send + 'static,
{
    fn manifest(&self) -> SkillManifest {
        self.manifest.clone()
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        Box::pin((self.act)(self.equipment.clone(), context))
    }
}

/// A skill that declares `manifest` and runs `act`.
pub(crate) fn skill<F, A>(equipment: &Equipment, manifest: SkillManifest, act: F) -> impl Skill + use<F, A>
where
    F: Fn(Equipment, SkillContext) -> A + Send + Sync + 'static,
    A: Future<Output = SkillResult> + Send + 'static,
{
    FunctionSkill { manifest, equipment: equipment.clone(), act }
}
