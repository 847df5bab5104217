//! A run of a chart with the simulated robot or one behind a driver, from its files to its report. [`run`] executes the phases one after the
//! other; each is a function below it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use armarium_knowledge::AgentMemory;
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::Registry;
use armarium_runtime::exec::{Controller, RunResult};
use armarium_simulator::cameras::ScenerySink;
use armarium_simulator::{Handle, RobotInWorld, Simulation, TruthSink, World};
use armarium_states::observers;
use armarium_values::report::{Figure, Section};
use armarium_viewer::live::{RunHeader, ShownTimeline};
use armarium_viewer::progress::ProgressLine;
use armarium_viewer::recorder::Recorder;
use armarium_visionx::{ImageSource, Workers};
use parking_lot::Mutex;
use tokio::task::JoinHandle;

use crate::cameras;
use crate::charts::{executor, load};
use crate::console::{Console, WorldClock};
use crate::driven::{self, OutsideRobot, RobotAt};
use crate::error::HostError;
use crate::frame_sampler::FrameSampler;
use crate::live::{self, Live, OpenPage};
use crate::network::AgentNetwork;
use crate::other_agents::{OtherAgents, OtherAgentsRecord, Sharing};
use crate::other_robots::{InProcess, OtherRobotEnded, OtherRobots};
use crate::recording::{RunDigest, SharedRecorder, TruthTopics, attach_report, attach_sources, record_robot};
use crate::report::{self, JointLog, ReportedRun, WrittenReport};
use crate::report_folder::ReportFolder;
use crate::run_config::RunConfig;
use crate::run_log::{self, RunLog, RunLogger};
use crate::side_tasks;
use crate::simulated::{StagedRobot, memory_of_run};
use crate::world_file::WorldFile;

/// How long a robot goes on after a run that has not succeeded: it stands long before.
const BRAKING: Duration = Duration::from_millis(500);

/// How a run ended.
#[derive(Clone, Debug)]
pub struct RunEnded {
    /// Outcome and reason.
    pub result: RunResult,
    /// The content of `report.json`.
    pub report: serde_json::Value,
    /// The figures that referees measured, with their requirements.
    pub figures: Vec<Figure>,
    /// The sections of the report, as they are drawn.
    pub sections: Vec<Section>,
    /// Whether the recording was written to its end.
    pub recorded: bool,
    /// Whether the report was written.
    pub reported: bool,
    /// The folder with the report.
    pub folder: PathBuf,
    /// The live page, which is served as long as this lives.
    pub page: Option<Arc<OpenPage>>,
}

/// Checks the chart, runs it in the simulator, and writes recording and report. Ctrl-C ends the run, also with a
/// report.
///
/// # Errors
/// [`HostError`] when the run cannot start, in which case nothing has moved, or when its report cannot be written.
#[expect(clippy::disallowed_methods, reason = "the report says how long the run took by the wall")]
pub fn run(config: &RunConfig, console: &Arc<dyn Console>) -> Result<RunEnded, HostError> {
    let began = Instant::now();
    let mut world =
        WorldFile::of(&config.chart, config.world.as_deref(), config.seed).map_err(HostError::Findings)?;
    if let Some(robot) = &config.robot {
        world.world.robot.model.clone_from(robot);
        world.world.robot.arm = None;
        world.world.robot.load().map_err(HostError::Findings)?;
    }
    let (arm, probes) = config.wants();
    if world.world.probes.is_empty() {
        world.world.probes = probes;
    }
    let mut world = world.for_arm(&arm, config.world.is_some())?;
    if let Some(works) = world.other_than(&arm)? {
        console.note(&format!(
            "warning: the chart works with `{arm}`, the world with `{works}`: coach and figures are about the latter"
        ));
    }
    let name = world.called(config.name.as_deref());
    let network = match config.session(&world.world, name.is_some()) {
        Some(session) => AgentNetwork::open(&session, name.as_deref(), &**console)?,
        None => AgentNetwork::default(),
    };
    let outside = match (&config.robot_at, &network.connection) {
        (Some(at), Some(connection)) => {
            let caller = name.as_deref().unwrap_or(&world.world.robot.name);
            Some(OutsideRobot::connect(at, &world.world, caller, connection)?)
        }
        _ => None,
    };
    let waits = outside.as_ref().is_some_and(OutsideRobot::waits);
    let alone = network.connection.is_none() || (waits && name.is_none() && config.cameras.is_none());
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let virtual_time = !config.real_time && alone;
    let workers = if virtual_time { Workers::Joined } else { Workers::Threads };
    builder.enable_all().start_paused(virtual_time);
    let performing = perform(config, &world, (&network, outside), workers, console, began);
    let mut ended = builder.build()?.block_on(performing)?;
    if let Some(page) = ended.page.as_mut().and_then(Arc::get_mut) {
        page.keep(network);
    }
    Ok(ended)
}

async fn perform(
    config: &RunConfig,
    world: &WorldFile,
    (network, outside): (&AgentNetwork, Option<OutsideRobot>),
    workers: Workers,
    console: &Arc<dyn Console>,
    began: Instant,
) -> Result<RunEnded, HostError> {
    let (mut setup, mover) = RunSetup::prepare(config, &world.world, network, outside, &**console).await?;
    (setup.robot.equipment.workers, setup.robot.equipment.hands) = (workers, config.hands);
    let equipment = &setup.robot.equipment;
    let (program, registry) = load(config, equipment, &world.world, network, &**console).await?;
    network.explain_events(&program, &**console);
    let folder = ReportFolder::take(&config.report, config.keep_reports)?;
    let config = &RunConfig { report: folder.path.clone(), ..config.clone() };
    if config.robot_at.is_some() {
        console.note("the robot is not simulated here; of the world, only what is known of it is used");
    }
    match &world.file {
        Some(file) => console.note(&format!("the world is {}{}", file.display(), world.world.mirror_note())),
        None => console.note(&format!("the world is the default kitchen{}", world.world.mirror_note())),
    }
    let handle = setup.robot.handle.clone();
    console.world_begins(Arc::new(move || handle.now_ns()));
    let others = setup.start_other_agents(config, world, network, &mover).await?;
    let chart = program.name().to_owned();
    let logger = setup.logger(&registry, console);
    let channels = Channels::new().with_memory(observers::memory(equipment));
    let among = InProcess::of(&world.world, network);
    let file = (&world.world, world.file.as_deref());
    let robots =
        OtherRobots::prepare(config, file, (&mover.robots(), workers), (network, &among), &logger, console)
            .await?;
    let peers = (among.peers(&world.world.robot.name), robots.is_empty() && !network.listens());
    let subtitle = format!("world `{}`, seed {}", world.world.name, config.seed);
    let simulation = mover.simulation();
    let header = live::header(
        config,
        (&chart, subtitle),
        &registry,
        equipment,
        simulation,
        &live::body_names(&world.world),
    );
    let executor = executor(config, program, (registry, &channels), &logger, equipment, peers, console)?;
    setup.open_recording(config, &chart, &world.world, &header, &**console)?;
    // Before anybody can hold up the run through its page.
    let stopping = tokio::spawn(side_tasks::stop_on_signal(executor.controller()));
    let virtual_time = workers == Workers::Joined;
    let page =
        setup.open_page(config, (executor.controller(), virtual_time), &logger.log, network, console).await?;

    let joints = Arc::new(Mutex::new(JointLog::default()));
    let mut tasks = setup.side_tasks(&logger, &joints, console, began);
    tasks.push(stopping);
    tasks.extend(config.longest.map(|longest| {
        let clock = setup.robot.handle.clone();
        tokio::spawn(side_tasks::stop_after(longest, clock, executor.controller()))
    }));
    tasks.extend(config.largest_recording.map(|most| {
        let file = config.report.join("run.mcap");
        tokio::spawn(side_tasks::bound_recording(file, most, setup.recorder.clone()))
    }));
    tasks.extend(observers::start(&setup.robot.equipment, &channels));
    tasks.extend(others.as_ref().map(|others| tokio::spawn(others.watch(executor.controller()))));
    let (outside, mut sensed) = (config.robot_at.is_some(), setup.robot.equipment.robot.sensed());
    let world_task = tokio::spawn(mover.run(setup.robot.handle.clone(), Arc::clone(console)));
    if outside {
        // Where its joints are is known with the first sample. If none comes, the skills fail with the reason.
        let _ = sensed.changed().await;
    }
    let controller = executor.controller();
    let (result, robots) = robots.run_beside(executor.run(), controller).await;

    let others = match others {
        Some(others) => others.close().await,
        None => OtherAgentsRecord::default(),
    };
    // A robot that others use, too, goes on; the leases of this run have ended.
    if !matches!(config.robot_at, Some(RobotAt::Guard(_))) {
        setup.robot.equipment.robot.stop("the run has ended");
        if result.outcome != "success" {
            // How it came to stand is part of the truth, and of the recording.
            tokio::time::sleep(BRAKING).await;
        }
    }
    setup.robot.handle.stop();
    tasks.iter().for_each(JoinHandle::abort);
    let _ = world_task.await;
    if let Err(error) = setup.memory.flush() {
        console.note(&format!("warning: what was learned was not kept: {error}"));
    }
    let acted = page.map_or_else(Vec::new, |acted| acted.lock().clone());
    setup.report(
        config,
        &chart,
        &world.world,
        (result, began, acted),
        (&logger.log, &joints, &others, &robots),
        console,
    )
}

/// What moves the robot.
enum Mover {
    Simulation(Box<Simulation>),
    Outside(driven::Mover),
}

impl Mover {
    /// The robots of the world, as far as they are simulated.
    fn robots(&self) -> Vec<RobotInWorld> {
        match self {
            Self::Simulation(simulation) => simulation.robots(),
            Self::Outside(_) => Vec::new(),
        }
    }

    fn simulation(&self) -> Option<&Simulation> {
        match self {
            Self::Simulation(simulation) => Some(simulation),
            Self::Outside(_) => None,
        }
    }

    /// Until `handle` ends it, or the robot is lost.
    async fn run(self, handle: Handle, console: Arc<dyn Console>) {
        match self {
            Self::Simulation(simulation) => simulation.run().await,
            Self::Outside(mover) => mover.run(handle, console).await,
        }
    }
}

/// What a chart runs with: the robot in its world, its memory, and the recorders.
struct RunSetup {
    memory: Arc<AgentMemory>,
    robot: StagedRobot,
    frames: Arc<FrameSampler>,
    recorder: SharedRecorder,
    digest: RunDigest,
    live: Option<Live>,
}

impl RunSetup {
    async fn prepare(
        config: &RunConfig,
        world: &World,
        network: &AgentNetwork,
        outside: Option<OutsideRobot>,
        console: &dyn Console,
    ) -> Result<(Self, Mover), HostError> {
        let recorder = SharedRecorder::default();
        let digest = RunDigest::default();
        let live = Live::prepare(config);
        let mut sinks: Vec<Box<dyn TruthSink>> = vec![
            Box::new(digest.clone()),
            Box::new(TruthTopics::new(recorder.clone(), live::body_names(world))),
        ];
        if let Some(live) = &live {
            sinks.push(Box::new(live.gate.clone()));
        }
        let (scenery, cameras) = match (&config.cameras, &network.connection) {
            (Some(name), Some(connection)) => {
                let (scenery, cameras) = cameras::connect(name, connection).await?;
                (Some(Box::new(scenery) as Box<dyn ScenerySink>), Some(cameras))
            }
            _ => (None, None),
        };
        let memory = Arc::new(memory_of_run(world, &config.store, &config.remember)?);
        let (seed, known) = (config.seed, memory.memory());
        let (mut robot, mover) = match outside {
            Some(outside) => {
                let (robot, mover) =
                    outside.stage(world, seed, known, config.speed_scale, (&digest, console))?;
                (robot, Mover::Outside(mover))
            }
            None => {
                let (robot, simulation) = StagedRobot::new(world, seed, known, sinks, scenery)?;
                if let Some(scale) = config.speed_scale {
                    robot.equipment.robot.set_speed_scale(scale)?;
                }
                (robot, Mover::Simulation(Box::new(simulation)))
            }
        };
        if let Some(cameras) = cameras {
            robot.see_through(cameras);
        }
        let cameras = Arc::clone(&robot.equipment.images);
        let frames = Arc::new(FrameSampler::of(cameras, world, recorder.clone()));
        robot.equipment.images = Arc::clone(&frames) as Arc<dyn ImageSource>;
        Ok((Self { memory, robot, frames, recorder, digest, live }, mover))
    }

    /// Starts and connects the world's other agents, on the connection's threads.
    async fn start_other_agents(
        &self,
        config: &RunConfig,
        world: &WorldFile,
        network: &AgentNetwork,
        mover: &Mover,
    ) -> Result<Option<OtherAgents>, HostError> {
        let (Some(connection), Some(world_file)) = (&network.connection, &world.file) else {
            return Ok(None);
        };
        let alone = world.world.agents.is_empty() && world.world.robots.is_empty();
        if alone {
            return Ok(None);
        }
        let Mover::Simulation(simulation) = mover else {
            return Err(HostError::Driven("the world has other agents, which are simulated only"));
        };
        let sharing = Sharing {
            session: connection.session().clone(),
            world: world.world.clone(),
            world_file: world_file.clone(),
            memory: Arc::clone(&self.memory),
            eyes: simulation.agents(),
            folder: config.report.clone(),
            program: config.program.clone(),
            clock: self.robot.handle.clone(),
        };
        let started = connection.runtime().spawn(OtherAgents::start(sharing)).await;
        started.map_err(|error| HostError::OtherAgent(error.to_string()))?.map(Some)
    }

    fn logger(&self, registry: &Registry, console: &Arc<dyn Console>) -> RunLogger {
        RunLogger {
            log: Arc::new(Mutex::new(RunLog::default())),
            digest: self.digest.clone(),
            recorder: self.recorder.clone(),
            referee: self.robot.referee.clone(),
            clock: self.robot.handle.clone(),
            console: Arc::clone(console),
            judged: run_log::judged(registry),
            robot: None,
            gate: self.live.as_ref().map(|live| live.gate.clone()),
        }
    }

    fn open_recording(
        &self,
        config: &RunConfig,
        chart: &str,
        world: &World,
        header: &RunHeader,
        console: &dyn Console,
    ) -> Result<(), HostError> {
        let metadata = BTreeMap::from([
            ("chart".to_owned(), chart.to_owned()),
            ("world".to_owned(), world.name.clone()),
            ("seed".to_owned(), config.seed.to_string()),
        ]);
        let mut opened = Recorder::create(&config.report.join("run.mcap"), metadata)?;
        attach_sources(&mut opened, &config.chart, world, header)?;
        if let Some(live) = &self.live {
            live.timeline.begin(header);
            opened.tell(Arc::new(live.timeline.clone()));
        }
        if let Some(port) = config.foxglove_port {
            let address = opened.serve_foxglove(port)?;
            console.note(&format!("Foxglove finds this run at {address}"));
        }
        self.recorder.begin(opened);
        Ok(())
    }

    /// Opens the live page, if there is to be one. Gives what is done through it.
    async fn open_page(
        &mut self,
        config: &RunConfig,
        acting: (Controller, bool),
        log: &Arc<Mutex<RunLog>>,
        network: &AgentNetwork,
        console: &Arc<dyn Console>,
    ) -> Result<Option<Arc<Mutex<Vec<String>>>>, HostError> {
        let (Some(live), Some(options)) = (&mut self.live, &config.live) else { return Ok(None) };
        let (recorder, clock) = (&self.recorder, &self.robot.handle);
        let (referee, log) = (self.robot.referee.clone(), Arc::clone(log));
        let shown = ShownTimeline {
            report: Some(Arc::new(move || report::so_far(referee.sections(), &log.lock()))),
            image: Some(live::newest_image(Arc::clone(&self.frames))),
            ..ShownTimeline::default()
        };
        let others = network.connection.as_ref().zip(config.name.as_deref());
        live.open(options, acting, (recorder, clock), shown, others, &**console).await.map(Some)
    }

    /// The tasks beside the chart.
    fn side_tasks(
        &self,
        logger: &RunLogger,
        joints: &Arc<Mutex<JointLog>>,
        console: &Arc<dyn Console>,
        began: Instant,
    ) -> Vec<JoinHandle<()>> {
        let (equipment, handle) = (&self.robot.equipment, self.robot.handle.clone());
        let clock: WorldClock = Arc::new(move || handle.now_ns());
        vec![
            record_robot(&equipment.robot, side_tasks::sensor_of(equipment), self.recorder.clone()),
            tokio::spawn(side_tasks::watch_perception(
                Arc::clone(self.memory.memory()),
                self.robot.referee.clone(),
                self.recorder.clone(),
                Arc::clone(&clock),
            )),
            tokio::spawn(side_tasks::record_memory(
                Arc::clone(self.memory.memory()),
                self.recorder.clone(),
                clock,
            )),
            tokio::spawn(side_tasks::log_joints(equipment.clone(), Arc::clone(joints))),
            tokio::spawn(side_tasks::show_progress(
                Arc::clone(console),
                equipment.clone(),
                Arc::clone(&logger.log),
                began,
            )),
        ]
    }

    fn report(
        &mut self,
        config: &RunConfig,
        chart: &str,
        world: &World,
        (result, began, acted): (RunResult, Instant, Vec<String>),
        (log, joints, others, robots): (
            &Mutex<RunLog>,
            &Mutex<JointLog>,
            &OtherAgentsRecord,
            &[OtherRobotEnded],
        ),
        console: &Arc<dyn Console>,
    ) -> Result<RunEnded, HostError> {
        let simulated_s = self.robot.handle.now_ns() as f64 * 1e-9;
        let log = log.lock();
        console.finished(&ProgressLine {
            simulated_s,
            wall_s: began.elapsed().as_secs_f64(),
            states: vec![result.outcome.clone()],
            force_n: None,
        });
        let states_at = |t_ns: u64| log.states_at(t_ns as f64 * 1e-9);
        let mut pictures = self.frames.pictures(&states_at);
        pictures.extend(others.pictures(&states_at));
        let case = ReportedRun {
            chart,
            world,
            seed: config.seed,
            profile: config.profile.as_deref(),
            hands: config.hands,
            result: &result,
            simulated_s,
            wall_s: began.elapsed().as_secs_f64(),
            trace_sha256: self.digest.hex(),
            referee: &self.robot.referee,
            log: &log,
            pictures,
            joints: joints.lock().plots(self.robot.equipment.robot.model()),
            memory_log: &others.memory_log,
            robots,
            acted,
        };
        let WrittenReport { json: report, figures, sections, files } = report::write(&config.report, case);
        if let Err(error) = &files {
            let folder = config.report.display();
            console.note(&format!("warning: the report cannot be written to {folder}: {error}"));
        }
        self.recorder.write(|recorder| attach_report(recorder, &sections));
        let recorded = self.recorder.finish();
        let page = self.live.take().and_then(|live| {
            live.timeline.report(sections.clone());
            let RunResult { outcome, reason, chain, .. } = &result;
            live.end(serde_json::json!({"outcome": outcome, "reason": reason, "chain": chain})).map(Arc::new)
        });
        let (reported, folder) = (files.is_ok(), config.report.clone());
        Ok(RunEnded { result, report, figures, sections, recorded, reported, folder, page })
    }
}
