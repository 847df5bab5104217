//! A program of your own, with a skill that Armarium does not have: the robot greets a person by name.
//!
//! `cargo run --example own_agent -p armarium-host -- CHART` runs a chart that may use the skill; without a chart it
//! runs the one below.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use armarium_host::{Console, RunConfig, Silent, SkillFactory, run};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_states::Equipment;
use armarium_values::Type;
use futures::FutureExt;
use futures::future::BoxFuture;

const CHART: &str = "
statechart: Welcome
inputs: {guest: {type: string, default: Ada}}
initial: Greet
states:
  Greet: {skill: Greet, with: {guest: \"${inputs.guest}\"}, transitions: {success: Done, failure: Failed}}
  Done: {final: success}
  Failed: {final: failure}
";

/// Says hello.
struct Greet(Equipment);

impl Skill for Greet {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Greet", "Greets somebody by name.").input(
            "guest",
            Type::String,
            "Who is greeted.",
        )
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let robot = Arc::clone(&self.0.robot);
        async move {
            robot.say(&format!("Hello, {}!", context.text("guest")?));
            Ok(Outcome::success())
        }
        .boxed()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::temp_dir().join("armarium-own-agent");
    std::fs::create_dir_all(&folder)?;
    let given = std::env::args().nth(1).map(PathBuf::from);
    let chart = given.unwrap_or_else(|| folder.join("welcome.yaml"));
    if !chart.exists() {
        std::fs::write(&chart, CHART)?;
    }
    let greet: SkillFactory =
        Arc::new(|equipment: &Equipment| Arc::new(Greet(equipment.clone())) as Arc<dyn Skill>);
    let config = RunConfig {
        skills: vec![greet],
        report: folder.join("report"),
        store: folder.join("memory.redb"),
        ..RunConfig::new(chart)
    };
    let console: Arc<dyn Console> = Arc::new(Silent);
    let ended = run(&config, &console)?;
    let report = config.report.join("report.html");
    writeln!(std::io::stdout(), "{}; the report is {}", ended.result.outcome, report.display())?;
    Ok(())
}
