//! A chart's skill moves the simulated arm at full joint speed and ends, is cancelled, panics or hangs. Each time
//! the robot stands still within 200 ms, and the chart reports what happened.
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use armarium_robot::{Lease, LeaseLimits, Robot};
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::RunResult;
use armarium_runtime::exec::{ExecOptions, Executor};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_simulator::{Options, Simulation, TruthSample, TruthSink, World};
use armarium_values::{Type, Value};
use futures::FutureExt;
use futures::future::BoxFuture;

/// A joint slower than this stands still, rad/s (m/s).
const STANDING: f64 = 0.01;
/// Time within which every joint must stand still, ns.
const WITHIN_NS: u64 = 200_000_000;

const CHART: &str = r#"
statechart: FullSpeed
inputs:
  ending: {type: string}
initial: Moving
states:
  Moving:
    skill: MoveAtFullSpeed
    with: {ending: "${inputs.ending}"}
    after: {500ms: Done}
    transitions: {success: Done, failure: Failed}
  Done:   {final: success}
  Failed: {final: failure}
"#;

/// Moves the right arm at full speed for 400 ms, then ends as configured.
struct MoveAtFullSpeed {
    robot: Arc<dyn Robot>,
    /// Time of the last command, ns.
    commanded_ns: Arc<Mutex<u64>>,
}

impl MoveAtFullSpeed {
    fn command(robot: &Arc<dyn Robot>, arm: &Lease, at: &Mutex<u64>) {
        if arm.command(&[0.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0]).is_ok() {
            *at.lock().unwrap() = robot.sensed().borrow().stamp_ns;
        }
    }
}

impl Skill for MoveAtFullSpeed {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("MoveAtFullSpeed", "Moves as fast as the joints can.")
            .input("ending", Type::String, "How it ends.")
            .limb("right_arm")
            .grace(Duration::from_millis(300))
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let (robot, at) = (Arc::clone(&self.robot), Arc::clone(&self.commanded_ns));
        async move {
            let ending = context.inputs["ending"].as_str().unwrap().to_owned();
            let arm = robot.lease("right_arm", &context.state, LeaseLimits::default()).unwrap();
            let mut sensed = robot.sensed();
            for _ in 0..400 {
                sensed.changed().await.unwrap();
                Self::command(&robot, &arm, &at);
            }
            match ending.as_str() {
                "ends" => return Ok(Outcome::success()),
                "panics" => panic!("this skill panics at full speed"),
                "is silent" => std::future::pending().await,
                _ => {}
            }
            loop {
                tokio::select! {
                    biased;
                    () = context.cancel.cancelled(), if ending == "is cancelled" => return Ok(Outcome::success()),
                    changed = sensed.changed() => changed.unwrap(),
                }
                Self::command(&robot, &arm, &at);
            }
        }
        .boxed()
    }
}

/// The fastest joint of each control step: time in ns, speed.
#[derive(Clone, Default)]
struct Speeds(Arc<Mutex<Vec<(u64, f64)>>>);

impl TruthSink for Speeds {
    fn sample(&mut self, sample: &TruthSample) {
        let fastest = sample.velocity.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        self.0.lock().unwrap().push((sample.stamp_ns, fastest));
    }
}

/// Runs the chart. Returns the result, the time of the last command and the speeds.
async fn run(ending: &str) -> (RunResult, u64, Vec<(u64, f64)>) {
    let speeds = Speeds::default();
    let options = Options { truth_sinks: vec![Box::new(speeds.clone())], ..Options::default() };
    let simulation = Simulation::new(&World::default(), 1, options).unwrap();
    let (robot, handle) = (simulation.robot(), simulation.handle());
    let commanded_ns = Arc::new(Mutex::new(0));
    let mut registry = Registry::new();
    registry.add(Arc::new(MoveAtFullSpeed {
        robot: Arc::clone(&robot),
        commanded_ns: Arc::clone(&commanded_ns),
    }));
    let checked = check(&load_text("full_speed.yaml", CHART, &[]), &registry, &ChannelSchema::new());
    let stopper = Arc::clone(&robot);
    let options = ExecOptions {
        inputs: BTreeMap::from([("ending".to_owned(), Value::from(ending))]),
        on_stuck: Some(Box::new(move |state| stopper.stop(&format!("the skill of `{state}` hangs")))),
        ..ExecOptions::default()
    };
    let executor = Executor::new(checked.program.unwrap(), registry, Channels::new(), options).unwrap();
    let world = tokio::spawn(simulation.run());
    let result = executor.run().await;
    tokio::time::sleep(Duration::from_millis(600)).await;
    handle.stop();
    world.await.unwrap();
    let last = *commanded_ns.lock().unwrap();
    let speeds = speeds.0.lock().unwrap().clone();
    (result, last, speeds)
}

#[tokio::test(start_paused = true)]
async fn whatever_a_skill_does_the_robot_stands() {
    let endings = [
        ("ends", "success"),
        ("is cancelled", "success"),
        ("panics", "failure"),
        ("is silent", "failure"),
        ("commands on", "failure"),
    ];
    for (ending, outcome) in endings {
        let (result, commanded_ns, speeds) = run(ending).await;
        assert_eq!(result.outcome, outcome, "{ending}: {:?}", result.reason);
        let said = result.reason.unwrap_or_default();
        match ending {
            "panics" => assert!(said.contains("panic"), "{said}"),
            "is silent" | "commands on" => assert!(said.contains("Moving"), "{said}"),
            _ => {}
        }
        let peak = speeds.iter().fold(0.0f64, |m, (_, v)| m.max(*v));
        assert!(peak > 0.95, "{ending}: only {peak} rad/s");
        let late = speeds.iter().filter(|(t, _)| *t >= commanded_ns + WITHIN_NS);
        let rest = late.clone().fold(0.0f64, |m, (_, v)| m.max(*v));
        assert!(late.count() > 100 && rest < STANDING, "{ending}: {rest} rad/s");
    }
}
