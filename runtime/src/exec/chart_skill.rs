//! A chart as a skill: the caller gives its inputs and gets its outcome and outputs; a cancel ends it in order.
//! Other agents start charts this way.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt as _;
use futures::future::BoxFuture;
use tokio::sync::watch;

use super::{ExecOptions, Executor, Peers, RunResult, TraceSink};
use crate::chart::Registry;
use crate::program::Program;
use crate::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use crate::trace::{TraceEvent, TraceItem};

/// Stops the robot because the skill of this state is stuck.
pub type Stop = Arc<dyn Fn(&str) + Send + Sync>;

/// Gives what receives the trace of one more run of a chart.
pub type SinkOfRun = Arc<dyn Fn() -> Option<Box<dyn TraceSink>> + Send + Sync>;

/// Time that the chart itself needs to end, in addition to its skills.
const END_GRACE: Duration = Duration::from_millis(500);

/// A chart that can be started like a skill.
pub struct ChartSkill {
    program: Arc<Program>,
    description: String,
    registry: Registry,
    stop: Stop,
    peers: Peers,
    sinks: Option<SinkOfRun>,
}

impl fmt::Debug for ChartSkill {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ChartSkill").field(&self.program).finish()
    }
}

impl ChartSkill {
    /// Wraps a chart with the skills that it uses; `stop` is called when one of them does not return.
    pub fn new(program: Arc<Program>, description: &str, registry: Registry, stop: Stop) -> Self {
        let (description, peers) = (description.to_owned(), Peers::default());
        Self { program, description, registry, stop, peers, sinks: None }
    }

    /// Connects the chart with other agents: it sends them events and receives theirs.
    #[must_use]
    pub fn with_peers(mut self, peers: Peers) -> Self {
        self.peers = peers;
        self
    }

    /// Lets the trace of each run be received.
    #[must_use]
    pub fn traced(mut self, sinks: SinkOfRun) -> Self {
        self.sinks = Some(sinks);
        self
    }
}

impl Skill for ChartSkill {
    fn manifest(&self) -> SkillManifest {
        let mut manifest = SkillManifest::new(self.program.name(), &self.description);
        manifest.inputs = self.program.inputs().cloned().collect();
        manifest.outputs = self.program.outputs().cloned().collect();
        manifest.outcomes = self.program.outcomes();
        manifest.limbs = self.program.limbs();
        manifest.grace = self.program.grace() + END_GRACE;
        manifest
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let stop = Arc::clone(&self.stop);
        let also = self.sinks.as_ref().and_then(|sinks| sinks());
        let options = ExecOptions {
            closed: false,
            inputs: context.inputs,
            profile: None,
            limits: context.limits,
            sink: Some(Box::new(Leaves { inside: context.inside, also })),
            on_stuck: Some(Box::new(move |state| stop(state))),
            peers: self.peers.clone(),
        };
        let executor =
            Executor::new(Arc::clone(&self.program), self.registry.clone(), context.channels, options);
        let cancel = context.cancel;
        async move {
            let executor = executor.map_err(|error| Failure::new(error.to_string()))?;
            let controller = executor.controller();
            let run = executor.run();
            tokio::pin!(run);
            let result = tokio::select! {
                biased;
                result = &mut run => result,
                () = cancel.cancelled() => {
                    controller.stop("whoever started it has cancelled it");
                    run.await
                }
            };
            ended(result)
        }
        .boxed()
    }
}

fn ended(result: RunResult) -> SkillResult {
    if result.outcome != "failure" {
        return Ok(Outcome { name: result.outcome, outputs: result.outputs });
    }
    let reason = result.reason.unwrap_or_else(|| "the chart failed without saying why".into());
    let through = if result.chain.is_empty() {
        String::new()
    } else {
        format!(" (through {})", result.chain.join(" < "))
    };
    Err(Failure::new(reason + &through))
}

/// Publishes the active states, and passes the trace on.
struct Leaves {
    inside: watch::Sender<Vec<String>>,
    also: Option<Box<dyn TraceSink>>,
}

impl TraceSink for Leaves {
    fn record(&mut self, event: &TraceEvent) {
        if let TraceItem::Configuration { leaves } = &event.item {
            self.inside.send_replace(leaves.clone());
        }
        if let Some(also) = &mut self.also {
            also.record(event);
        }
    }
}
