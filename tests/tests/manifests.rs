//! What the manifests of skills that ship say of channels is what the skills do in a run.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use armarium_host::{Console, RunConfig, Silent, SkillFactory, catalog, run};
use armarium_memoryx::{Commit, EntityId};
use armarium_motion::{
    Motion, PeriodicDmp, PeriodicDmpConfig, PeriodicOrientationDmp, PhaseSample, SurfaceCorrection,
};
use armarium_runtime::channels::Channels;
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_states::Equipment;
use armarium_values::{Pose, Reference, Type, Value};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use nalgebra::{Isometry3, Vector3};

/// Every skill that has to do with channels runs for a moment; the hand circles in the air over the table.
const CHART: &str = r#"
statechart: Moments
initial: Put
states:
  Put: {skill: PutMotion, transitions: {success: Stand}}
  Stand: {skill: MoveJoints, with: {posture: wipe}, transitions: {success: Imitate}}
  Imitate:
    skill: ImitateMotion
    with: {motion: "${Put.motion}", grasp: "${Put.grasp}"}
    after: {4s: Fit}
    transitions: {success: Fit}
  Fit:
    skill: ForceAdaptation
    with: {motion: "${Put.motion}", force: 8 N, grasp: "${Put.grasp}"}
    after: {3s: Wipe}
    transitions: {success: Wipe, failure: Wipe}
  Wipe:
    parallel:
      Execution:
        initial: Wiping
        states:
          Wiping: {skill: ExecuteMotion, with: {motion: "${Put.motion}", force: 8 N, grasp: "${Put.grasp}"}}
      Coaching:
        initial: Early
        states:
          Early: {after: {100ms: ByForce}}
          ByForce: {skill: ForceCoaching, with: {motion: "${Put.motion}"}, after: {200ms: ByVision}}
          ByVision: {skill: VisionCoaching, with: {motion: "${Put.motion}"}}
      Looking:
        initial: AtNeeds
        states:
          AtNeeds: {skill: GazeSelection}
    after: {600ms: Play}
  Play:
    parallel:
      Execution:
        initial: Playing
        states:
          Playing: {skill: PlayMotion, with: {motion: "${Put.motion}", periods: 0}}
      Coaching:
        initial: Early
        states:
          Early: {after: {100ms: ByArms}}
          ByArms: {skill: BodyCoaching, with: {motion: "${Put.motion}"}}
    after: {4s: Done}
  Done: {final: success}
"#;

/// What skills read and publish, by the skill's name.
type Uses = Arc<Mutex<BTreeMap<String, Used>>>;

#[derive(Clone, Debug, Default, PartialEq)]
struct Used {
    reads: BTreeSet<String>,
    publishes: BTreeSet<String>,
}

/// A skill with channels of its own, in which can be seen what it does.
struct Watched {
    skill: Arc<dyn Skill>,
    uses: Uses,
}

impl Skill for Watched {
    fn manifest(&self) -> SkillManifest {
        self.skill.manifest()
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let (manifest, uses) = (self.manifest(), Arc::clone(&self.uses));
        let (all, own) = (context.channels.clone(), Channels::new());
        let mut skill = self.skill.run(SkillContext { channels: own.clone(), ..context });
        async move {
            let channels = catalog::channels();
            let mut used = Used::default();
            let mut demands = Vec::new();
            let mut often = tokio::time::interval(Duration::from_millis(5));
            loop {
                let ended = tokio::select! {
                    biased;
                    ended = &mut skill => Some(ended),
                    _ = often.tick() => None,
                };
                for name in channels.names() {
                    if *own.wanted(name).borrow() > 0 && used.reads.insert(name.to_owned()) {
                        demands.push(all.demand(name));
                    }
                    if manifest.reads.iter().any(|read| read == name) {
                        all.newest(name).into_iter().for_each(|sample| own.publish(name, sample.value));
                    } else if let Some(sample) = own.newest(name) {
                        used.publishes.insert(name.to_owned());
                        all.publish(name, sample.value);
                    }
                }
                if let Some(ended) = ended {
                    uses.lock().unwrap().insert(manifest.name, used);
                    return ended;
                }
            }
        }
        .boxed()
    }
}

/// Puts a circle over the table into memory, fitted to a surface, and says how a tool would be held for it.
struct PutMotion(Equipment);

impl Skill for PutMotion {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("PutMotion", "Puts a motion into memory.")
            .output("motion", Type::motion(), "The motion.")
            .output("grasp", Type::map(Type::Any), "How the tool would be held.")
    }

    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        let (memory, agent) = (Arc::clone(&self.0.memory), self.0.agent.clone());
        let model = Arc::clone(self.0.robot.model());
        async move {
            // High enough that looking for a surface does not find the table.
            let tcp = model.link_pose(model.ready("right_arm"), model.link("tcp_right").unwrap());
            let [x, y, z]: [f64; 3] = tcp.translation.vector.into();
            let z = z + 0.06;
            let sample = |k: u32| {
                let phase = TAU * f64::from(k) / 200.0;
                let (s, c) = (0.04 * libm::sin(phase), 0.04 * libm::cos(phase));
                PhaseSample { phase, y: vec![x + c, y + s, z], dy: vec![-s, c, 0.0], ddy: vec![-c, -s, 0.0] }
            };
            let mut circle = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
            circle.learn_batch(&(0..200).map(sample).collect::<Vec<_>>()).unwrap();
            let surface = SurfaceCorrection::new(vec![0.0; 36], 90.0, [0.0, 0.0, 1.0]).unwrap();
            let mut turning = PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).unwrap();
            turning.learn_period(&[tcp.rotation; 8]).unwrap();
            let motion = Motion::in_space("circle", "root", 0.4, circle).unwrap().with_surface(Some(surface));
            let motion = motion.with_orientation(Some(turning));
            let json = serde_json::to_value(&motion).unwrap();
            let id = EntityId::new("Motions", &agent, "circle").unwrap();
            let attributes = BTreeMap::from([("motion".to_owned(), Value::from_json(&json))]);
            memory.commit(vec![Commit::new(id.clone(), 0, attributes)]).await.unwrap();
            let tcp = Isometry3::from_parts(Vector3::new(x, y, z).into(), tcp.rotation);
            let grasp = Value::record([("tcp", Value::Pose(Pose::new("root".into(), &tcp)))]);
            let motion = Reference { kind: "Motion".into(), id: id.to_string() };
            Ok(Outcome::success().with("motion", Value::Reference(motion)).with("grasp", grasp))
        }
        .boxed()
    }
}

#[test]
fn skills_read_and_publish_what_their_manifests_say() {
    let folder = tempfile::tempdir().unwrap();
    let chart = folder.path().join("moments.yaml");
    std::fs::write(&chart, CHART).unwrap();
    let uses = Uses::default();
    let registry = catalog::idle_registry();
    let watched = registry.manifests().map(|manifest| {
        let (name, uses) = (manifest.name.clone(), Arc::clone(&uses));
        let make: SkillFactory = Arc::new(move |equipment: &Equipment| {
            let shipped = armarium_states::skills(equipment).into_iter();
            let skill = shipped.filter(|skill| skill.manifest().name == name).last().unwrap();
            Arc::new(Watched { skill, uses: Arc::clone(&uses) }) as Arc<dyn Skill>
        });
        make
    });
    let put: SkillFactory =
        Arc::new(|equipment: &Equipment| Arc::new(PutMotion(equipment.clone())) as Arc<dyn Skill>);
    let config = RunConfig {
        skills: watched.chain([put]).collect(),
        report: folder.path().join("report"),
        store: folder.path().join("memory.redb"),
        longest: Some(Duration::from_secs(60)),
        ..RunConfig::new(chart)
    };
    let console: Arc<dyn Console> = Arc::new(Silent);
    let ended = run(&config, &console).unwrap();
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let uses = uses.lock().unwrap();
    let mut wrong = Vec::new();
    for manifest in registry.manifests() {
        let says = Used {
            reads: manifest.reads.iter().cloned().collect(),
            publishes: manifest.publishes.iter().cloned().collect(),
        };
        let used = uses.get(&manifest.name).cloned().unwrap_or_default();
        if says != used {
            wrong.push(format!("{} says {says:?}, and did {used:?}", manifest.name));
        }
    }
    assert_eq!(wrong, Vec::<String>::new());
}
