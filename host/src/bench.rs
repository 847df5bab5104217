//! A test bench for skills: one skill, the simulated robot in its world or a robot of the test's own, virtual time, a few lines.
//! `docs/skills.md` has an example, and `armarium new --skill` writes one.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::Memory;
use armarium_robot::Robot;
use armarium_runtime::channels::Channels;
use armarium_runtime::chart;
use armarium_runtime::exec::{ExecOptions, Executor};
use armarium_runtime::skill::{Skill, SkillManifest};
use armarium_simulator::{Referee, World};
use armarium_states::{Equipment, observers};
use armarium_values::Value;

use crate::catalog::{self, SkillFactory};
use crate::error::HostError;
use crate::simulated::{StagedRobot, memory_without_store};

/// How long a skill may take, unless the test says otherwise.
const LONGEST: Duration = Duration::from_secs(600);

/// A skill under test, with what surrounds it.
#[must_use]
pub struct Bench {
    skill: SkillFactory,
    world: World,
    seed: u64,
    inputs: BTreeMap<String, Value>,
    robot: Option<Arc<dyn Robot>>,
    longest: Duration,
}

/// How a skill ended, and what it left.
pub struct Benched {
    /// Its outcome; `failure` with a reason, `stopped` if it took too long.
    pub outcome: String,
    /// Why, where it did not succeed.
    pub reason: Option<String>,
    /// What it gave.
    pub outputs: BTreeMap<String, Value>,
    /// How long it took, in the robot's time.
    pub took: Duration,
    /// The robot, as the skill left it.
    pub robot: Arc<dyn Robot>,
    /// The memory that it read and wrote.
    pub memory: Arc<dyn Memory>,
    /// Reads the simulator's truth, which the skill does not see.
    pub referee: Referee,
}

impl Bench {
    /// A skill in the default world.
    pub fn new(make: impl Fn(&Equipment) -> Arc<dyn Skill> + Send + Sync + 'static) -> Self {
        Self {
            skill: Arc::new(make),
            world: World::default(),
            seed: 1,
            inputs: BTreeMap::new(),
            robot: None,
            longest: LONGEST,
        }
    }

    /// In another world.
    pub fn world(self, world: World) -> Self {
        Self { world, ..self }
    }

    /// With another seed of the world's random variation.
    pub fn seed(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// With an input; those that are not given have their defaults.
    pub fn input(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.inputs.insert(name.to_owned(), value.into());
        self
    }

    /// With a robot of the test's own, for instance [`armarium_robot::DummyRobot`], instead of the simulated one.
    pub fn robot(self, robot: Arc<dyn Robot>) -> Self {
        Self { robot: Some(robot), ..self }
    }

    /// Stopped after this time of the robot; otherwise after ten minutes.
    pub fn at_most(self, longest: Duration) -> Self {
        Self { longest, ..self }
    }

    /// Runs the skill to its end, in virtual time.
    ///
    /// # Errors
    /// [`HostError`] when world and robot do not fit together, or the inputs do not fit the skill.
    pub fn run(self) -> Result<Benched, HostError> {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all().start_paused(true).build()?.block_on(self.perform())
    }

    async fn perform(self) -> Result<Benched, HostError> {
        let memory = memory_without_store(&self.world, &self.world.robot.name)?;
        let (mut robot, simulation) =
            StagedRobot::new(&self.world, self.seed, memory.memory(), Vec::new(), None)?;
        if let Some(own) = self.robot {
            robot.equipment.robot = own;
        }
        let manifest = (self.skill)(&robot.equipment).manifest();
        let registry = catalog::registry(&robot.equipment, &[self.skill]);
        let library = chart::load_text("bench.yaml", &chart_of(&manifest, &self.inputs), &[]);
        let checked = chart::check(&library, &registry, &catalog::channels());
        let program = checked.program.ok_or(HostError::Findings(checked.findings))?;
        let channels = Channels::new();
        let options = ExecOptions { inputs: self.inputs, ..ExecOptions::default() };
        let executor = Executor::new(program, registry, channels.clone(), options)?;
        let controller = executor.controller();
        let longest = self.longest;
        let watch = tokio::spawn(async move {
            tokio::time::sleep(longest).await;
            controller.stop(format!("it took more than {} s", longest.as_secs_f64()));
        });
        let observers = observers::start(&robot.equipment, &channels);
        let began = tokio::time::Instant::now();
        let world = tokio::spawn(simulation.run());
        let result = executor.run().await;
        let took = began.elapsed();
        watch.abort();
        observers.iter().for_each(tokio::task::JoinHandle::abort);
        robot.equipment.robot.stop("the skill has ended");
        robot.handle.stop();
        let _ = world.await;
        Ok(Benched {
            outcome: result.outcome,
            reason: result.reason,
            outputs: result.outputs,
            took,
            robot: robot.equipment.robot,
            memory: robot.equipment.memory,
            referee: robot.referee,
        })
    }
}

/// A chart of one state that runs the skill and ends as it ends, with its outputs.
fn chart_of(manifest: &SkillManifest, given: &BTreeMap<String, Value>) -> String {
    let mut text = String::from("statechart: Bench\ninputs:\n");
    for name in given.keys() {
        let _ = writeln!(text, "  {name}: any");
    }
    text.push_str("outputs:\n");
    for output in &manifest.outputs {
        let _ = writeln!(text, "  {}: any", output.name);
    }
    let _ = writeln!(text, "initial: Run\nstates:\n  Run:\n    skill: {}\n    with:", manifest.name);
    for name in given.keys() {
        let _ = writeln!(text, "      {name}: \"${{inputs.{name}}}\"");
    }
    text.push_str("    transitions:\n");
    let outcomes: Vec<&str> =
        ["success"].into_iter().chain(manifest.outcomes.iter().map(String::as_str)).collect();
    for (number, outcome) in outcomes.iter().enumerate() {
        let _ = writeln!(text, "      {outcome}: {{target: End{number}, do: [");
        for output in &manifest.outputs {
            let _ = writeln!(text, "        {{assign: {{outputs.{0}: \"${{Run.{0}}}\"}}}},", output.name);
        }
        text.push_str("      ]}\n");
    }
    for (number, outcome) in outcomes.iter().enumerate() {
        let _ = writeln!(text, "  End{number}: {{final: {outcome}}}");
    }
    text
}

#[cfg(test)]
mod tests {
    use armarium_runtime::skill::{Outcome, SkillContext, SkillResult};
    use armarium_values::Type;
    use futures::FutureExt as _;
    use futures::future::BoxFuture;

    use super::*;

    /// Gives half of a number, refuses negative ones, and takes its time.
    struct Halve;

    impl Skill for Halve {
        fn manifest(&self) -> SkillManifest {
            SkillManifest::new("Halve", "Halves a number.")
                .input("number", Type::FLOAT, "Any number.")
                .output("half", Type::FLOAT, "Half of it.")
                .outcome("negative")
        }
        fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
            async move {
                context.cancel.run_until_cancelled(tokio::time::sleep(Duration::from_secs(2))).await;
                let number = context.number("number")?;
                Ok(if number < 0.0 {
                    Outcome::named("negative").with("half", number / 2.0)
                } else {
                    Outcome::success().with("half", number / 2.0)
                })
            }
            .boxed()
        }
    }

    fn halve(number: f64) -> Bench {
        Bench::new(|_| Arc::new(Halve)).input("number", number)
    }

    #[test]
    fn a_skill_ends_with_its_outcome_outputs_and_time() {
        let ended = halve(3.0).run().expect("it runs");
        assert_eq!((ended.outcome.as_str(), ended.outputs["half"].as_f64()), ("success", Some(1.5)));
        assert_eq!(ended.took, Duration::from_secs(2));
        assert_eq!(halve(-1.0).run().expect("it runs").outcome, "negative");
    }

    #[test]
    fn a_skill_that_takes_too_long_is_stopped_and_wrong_inputs_are_named() {
        let ended = halve(3.0).at_most(Duration::from_secs(1)).run().expect("it runs");
        assert_eq!(
            (ended.outcome.as_str(), ended.reason.as_deref()),
            ("stopped", Some("it took more than 1 s"))
        );
        let missing = Bench::new(|_| Arc::new(Halve)).run().map(|ended| ended.outcome);
        assert!(missing.is_err_and(|error| error.to_string().contains("number")));
    }
}
