//! The world's robots besides the first that run charts of their own: in this process, in the run's time, each with its own
//! guard, cameras, memory and skills. Their charts send events to each other by the robots' names.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use armarium_knowledge::AgentMemory;
use armarium_runtime::channels::Channels;
use armarium_runtime::exec::{
    Controller, DeliveryError, Executor, Peers, Raised, RemoteEvent, RunResult, Subscribers, Transport,
};
use armarium_simulator::world::RobotSpec;
use armarium_simulator::{RobotInWorld, World};
use armarium_states::{Equipment, observers};
use armarium_values::report::{Block, Section};
use armarium_visionx::Workers;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use parking_lot::Mutex;
use serde_json::{Value as Json, json};
use tokio::task::{JoinHandle, JoinSet};

use crate::charts::{executor, load};
use crate::console::Console;
use crate::error::HostError;
use crate::network::AgentNetwork;
use crate::run_config::RunConfig;
use crate::run_log::{RunLog, RunLogger};
use crate::simulated::{equipment_of, memory_without_store};

/// The robots that run charts of their own, before they begin.
#[derive(Default)]
pub(crate) struct OtherRobots(Vec<OtherRobot>);

struct OtherRobot {
    name: String,
    chart: String,
    executor: Executor,
    equipment: Equipment,
    log: Arc<Mutex<RunLog>>,
    observers: Vec<JoinHandle<()>>,
    _memory: AgentMemory,
}

/// What became of the chart of another robot.
pub(crate) struct OtherRobotEnded {
    name: String,
    chart: String,
    result: RunResult,
    log: Arc<Mutex<RunLog>>,
}

/// Events among the charts of this process; those to anybody else go on.
pub(crate) struct InProcess {
    charts: BTreeMap<String, Subscribers>,
    otherwise: Option<Arc<dyn Transport>>,
}

impl InProcess {
    /// The way among the robots of a world, and from them to others.
    pub(crate) fn of(world: &World, network: &AgentNetwork) -> Arc<Self> {
        let own = (world.robot.name.clone(), network.peers.subscribers.clone());
        let others = commanded(world).map(|(_, spec)| (spec.name.clone(), Subscribers::default()));
        Arc::new(Self {
            charts: [own].into_iter().chain(others).collect(),
            otherwise: network.peers.transport.clone(),
        })
    }

    /// What a chart of the robot `name` is run with.
    pub(crate) fn peers(self: &Arc<Self>, name: &str) -> Peers {
        let subscribers = self.charts.get(name).cloned().unwrap_or_default();
        let alone = self.charts.len() == 1;
        let among: Arc<dyn Transport> = Arc::<Self>::clone(self);
        Peers { transport: if alone { self.otherwise.clone() } else { Some(among) }, subscribers }
    }
}

impl Transport for InProcess {
    fn deliver(&self, sent: RemoteEvent) -> BoxFuture<'static, Result<(), DeliveryError>> {
        let (agent, chart) = match sent.to.split_once('/') {
            Some((agent, chart)) => (agent.to_owned(), Some(chart.to_owned())),
            None => (sent.to.clone(), None),
        };
        let Some(charts) = self.charts.get(&agent).cloned() else {
            let nobody = async move { Err(DeliveryError::NoAgent { agent }) };
            return self.otherwise.as_ref().map_or_else(|| nobody.boxed(), |other| other.deliver(sent));
        };
        async move {
            match charts.raise(chart.as_deref(), &sent.event, &sent.data).await? {
                Raised { charts: 0, .. } => Err(DeliveryError::NoChart { agent, chart }),
                Raised { dropped: Some(reason), .. } => Err(DeliveryError::Dropped { agent, reason }),
                Raised { .. } => Ok(()),
            }
        }
        .boxed()
    }
}

/// The robots that run charts of their own, with their numbers in the world.
pub(crate) fn commanded(world: &World) -> impl Iterator<Item = (usize, &RobotSpec)> {
    let others = (1..).zip(&world.robots);
    others.filter(|(_, spec)| spec.runs.is_some())
}

impl OtherRobots {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Loads and checks their charts, which are named beside the world's `file`; `robots` are those that are simulated.
    pub(crate) async fn prepare(
        config: &RunConfig,
        (world, file): (&World, Option<&Path>),
        (robots, workers): (&[RobotInWorld], Workers),
        (network, among): (&AgentNetwork, &Arc<InProcess>),
        logger: &RunLogger,
        console: &Arc<dyn Console>,
    ) -> Result<Self, HostError> {
        let folder = file.and_then(Path::parent).unwrap_or(Path::new(""));
        let mut all = Vec::new();
        for (number, spec) in commanded(world) {
            let memory = memory_without_store(world, &spec.name)?;
            let seed = config.seed.rotate_left(32) ^ number as u64;
            let robot =
                robots.get(number).ok_or(HostError::Driven("the world has other robots with charts"))?;
            let mut equipment = equipment_of(robot, spec, memory.memory(), seed);
            (equipment.workers, equipment.hands) = (workers, config.hands);
            let text = |value: &Json| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            let config = &RunConfig {
                chart: folder.join(spec.runs.as_deref().unwrap_or_default()),
                inputs: spec.inputs.iter().map(|(name, value)| (name.clone(), text(value))).collect(),
                profile: None,
                record: None,
                ..config.clone()
            };
            let (program, registry) = load(config, &equipment, world, network, &**console).await?;
            let (chart, log) = (program.name().to_owned(), Arc::default());
            let channels = Channels::new().with_memory(observers::memory(&equipment));
            let among = (among.peers(&spec.name), false);
            let logger = logger.of_other(&spec.name, &log);
            let executor =
                executor(config, program, (registry, &channels), &logger, &equipment, among, console)
                    .map_err(|error| of_robot(&spec.name, error))?;
            let observers = observers::start(&equipment, &channels);
            let name = spec.name.clone();
            all.push(OtherRobot { name, chart, executor, equipment, log, observers, _memory: memory });
        }
        Ok(Self(all))
    }

    /// Runs their charts beside the first robot's, until all have ended. When one of them does not succeed, all are stopped, and
    /// the run has failed.
    pub(crate) async fn run_beside(
        self,
        first: impl Future<Output = RunResult>,
        controller: Controller,
    ) -> (RunResult, Vec<OtherRobotEnded>) {
        let mut tasks = JoinSet::new();
        let controllers: Vec<Controller> = self.0.iter().map(|other| other.executor.controller()).collect();
        for (number, other) in self.0.into_iter().enumerate() {
            tasks.spawn(async move { (number, other.run().await) });
        }
        let stop_others = |reason: &str| controllers.iter().for_each(|other| other.stop(reason));
        let (mut result, mut ended) = (None, BTreeMap::new());
        let mut failed: Option<String> = None;
        tokio::pin!(first);
        while result.is_none() || !tasks.is_empty() {
            tokio::select! {
                biased;
                own = &mut first, if result.is_none() => {
                    if own.outcome != SUCCESS {
                        stop_others("the first robot's chart has ended");
                    }
                    result = Some(own);
                }
                Some(Ok((number, other))) = tasks.join_next(), if !tasks.is_empty() => {
                    if other.result.outcome != SUCCESS && failed.is_none() {
                        let reason = other.result.reason.as_deref().unwrap_or("it gives no reason");
                        let reason = format!("the chart of `{}` ends with {}: {reason}", other.name, other.result.outcome);
                        controller.stop(&*reason);
                        stop_others(&reason);
                        failed = Some(reason);
                    }
                    ended.insert(number, other);
                }
            }
        }
        let mut result = result.unwrap_or_else(|| RunResult {
            outcome: FAILURE.into(),
            reason: failed.clone(),
            chain: Vec::new(),
            outputs: BTreeMap::new(),
        });
        if let Some(reason) =
            failed.filter(|reason| result.outcome == SUCCESS || result.reason.as_ref() == Some(reason))
        {
            (result.outcome, result.reason) = (FAILURE.into(), Some(reason));
        }
        (result, ended.into_values().collect())
    }
}

/// An input of a world's robot is not one of the command line.
fn of_robot(robot: &str, error: HostError) -> HostError {
    match error {
        HostError::Input { name, text, why } => {
            HostError::RobotInput { robot: robot.to_owned(), name, text, why }
        }
        other => other,
    }
}

const SUCCESS: &str = "success";
const FAILURE: &str = "failure";

impl OtherRobot {
    async fn run(self) -> OtherRobotEnded {
        let result = self.executor.run().await;
        self.equipment.robot.stop("its chart has ended");
        self.observers.iter().for_each(JoinHandle::abort);
        OtherRobotEnded { name: self.name, chart: self.chart, result, log: self.log }
    }
}

impl OtherRobotEnded {
    /// What `report.json` says of it, by its name.
    pub(crate) fn json(&self) -> (String, Json) {
        let outputs: BTreeMap<_, _> =
            self.result.outputs.iter().map(|(name, value)| (name, value.to_json())).collect();
        let said = json!({
            "chart": self.chart,
            "outcome": self.result.outcome,
            "reason": self.result.reason,
            "outputs": outputs,
        });
        (self.name.clone(), said)
    }

    /// Its section of the report.
    pub(crate) fn section(&self) -> Section {
        let note = match &self.result.reason {
            Some(reason) => format!("{} ends with {}: {reason}", self.chart, self.result.outcome),
            None => format!("{} ends with {}", self.chart, self.result.outcome),
        };
        let states = Block::Gantt(self.log.lock().states.clone());
        Section::new(&format!("Robot {}", self.name), &note, vec![states])
    }
}
