//! A chart without a robot: a kettle heats water while the user chooses a tea, in virtual time.
//!
//! `cargo run --example tea -p armarium-runtime`

use std::sync::Arc;
use std::time::Duration;

use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::exec::{ExecOptions, Executor};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_runtime::trace::{TraceEvent, TraceItem};
use armarium_values::{Type, Value};
use futures::FutureExt;
use futures::future::BoxFuture;

const CHART: &str = r#"
statechart: Tea
inputs:
  target: {type: float, default: 95.0, maximum: 100.0, description: Degrees Celsius to heat the water to.}
  steep:  {type: duration, default: 3min}
outputs:
  tea: {type: string}
events: {chosen: {}}

initial: Prepare
states:
  Prepare:
    parallel:
      Water:
        initial: Heating
        states:
          Heating: {skill: Heat, with: {target: "${inputs.target}"}, transitions: {success: Hot}}
          Hot: {final: success}
      Choice:
        initial: Asking
        states:
          Asking: {transitions: {chosen: {target: Chosen, do: [{assign: {outputs.tea: "${event.data.tea}"}}]}}}
          Chosen: {final: success}
    after: {10min: Failed}
    transitions: {success: Steep, failure: Failed}
  Steep:
    enter: [{log: "${outputs.tea} steeps for ${inputs.steep} s"}]
    after: {"${inputs.steep}": Done}
  Done: {final: success}
  Failed: {final: failure}
"#;

/// Heats by one degree per second and publishes the water's temperature.
struct Heat;

impl Skill for Heat {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Heat", "Heats water, one degree Celsius a second.")
            .input("target", Type::FLOAT, "Degrees Celsius to reach.")
            .output("temperature", Type::FLOAT, "Degrees Celsius that were reached.")
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        async move {
            let target = context.inputs.get("target").and_then(Value::as_f64);
            let target = target.ok_or_else(|| Failure::new("there is no target"))?;
            let mut temperature = 20.0;
            while temperature < target {
                tokio::select! {
                    biased;
                    () = context.cancel.cancelled() => return Ok(Outcome::success()),
                    () = tokio::time::sleep(Duration::from_secs(1)) => temperature += 1.0,
                }
                context.channels.publish("kettle", Value::record([("temperature", temperature.into())]));
            }
            Ok(Outcome::success().with("temperature", temperature))
        }
        .boxed()
    }
}

#[tokio::main(flavor = "current_thread", start_paused = true)]
#[expect(clippy::print_stdout, reason = "an example shows what it does")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut registry = Registry::new();
    registry.add(Arc::new(Heat));
    let schema = ChannelSchema::new().with("kettle", Type::record([("temperature", Type::FLOAT)]));

    let checked = check(&load_text("tea.yaml", CHART, &[]), &registry, &schema);
    checked.findings.iter().for_each(|finding| println!("{finding}"));
    let program = checked.program.ok_or("the chart has errors")?;

    let show = |event: &TraceEvent| {
        let seconds = event.at_ns / 1_000_000_000;
        match &event.item {
            TraceItem::Configuration { leaves } => println!("{seconds:4} s  {}", leaves.join(" | ")),
            TraceItem::Log { text, .. } => println!("{seconds:4} s  {text}"),
            _ => {}
        }
    };
    let options = ExecOptions { sink: Some(Box::new(show)), ..ExecOptions::default() };
    let executor = Executor::new(program, registry, Channels::new(), options)?;
    let controller = executor.controller();
    let choosing = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(30)).await;
        controller.raise("chosen", Value::record([("tea", "Assam".into())]))
    });
    let result = executor.run().await;
    choosing.await?;
    println!("{}: {:?}", result.outcome, result.outputs);
    Ok(())
}
