//! An agent: offers charts, skills, its memory and its cameras to other agents, and may run a chart of its own. It
//! has a simulated robot, or only receives images from another agent.
//!
//! A program of your own starts here: [`AgentConfig::new`], a few fields, [`run_agent`].

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_bus::{KeyError, Session, SessionConfig, SessionError};
use armarium_knowledge::{AgentMemory, agent_pose_update};
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{self, Outline, Registry};
use armarium_runtime::exec::{ChartSkill, ExecOptions, Executor, Peers, RunResult, Stop, TraceSink};
use armarium_runtime::program::Program;
use armarium_runtime::remote::{Agents, Offers, receive_events, serve};
use armarium_runtime::skill::Limits;
use armarium_simulator::World;
use armarium_source::{Disk, Files as _, outermost};
use armarium_states::observers;
use armarium_viewer::live::PageAddress;
use armarium_visionx::providers::{StereoProvider, offer as offer_images};

use crate::agent_config::AgentConfig;
use crate::backend::Backend;
use crate::catalog;
use crate::connection::{Connection, take_name};
use crate::console::Console;
use crate::error::HostError;
use crate::live::{self, RecordedEvents, ServiceView};
use crate::names::Names;
use crate::recording::record_robot;
use crate::remote_eyes;
use crate::side_tasks;
use crate::simulated::{StagedRobot, memory_of_agent};

/// Serves until `until` completes or the agent's own chart has ended; then returns the chart's result, if any.
///
/// # Errors
/// [`HostError`] when the agent cannot start or cannot continue.
pub fn run_agent(
    config: &AgentConfig,
    console: &dyn Console,
    until: impl Future<Output = ()>,
) -> Result<Option<RunResult>, HostError> {
    let mut session = SessionConfig { shared_memory: true, ..config.session.clone() };
    if let Some(access) = &config.access {
        let no_name = |error: KeyError| SessionError::Config { what: error.to_string() };
        session.access_control = Some(access.rules().map_err(no_name)?);
    }
    let connection = Connection::open(&session)?;
    let agents = connection.agents(&config.name);
    // Simulation, skills and charts share the session's threads; a busy one does not delay answers.
    connection.runtime().block_on(serve_agent(config, connection.session(), &agents, console, until))
}

async fn serve_agent(
    config: &AgentConfig,
    session: &Session,
    agents: &Agents,
    console: &dyn Console,
    until: impl Future<Output = ()>,
) -> Result<Option<RunResult>, HostError> {
    let mut until = std::pin::pin!(until);
    let _name = take_name(session, &config.name).await?;
    let world =
        config.world.as_deref().map_or_else(|| Ok(World::default()), |file| World::load(file, config.seed));
    let world = world.map_err(HostError::Findings)?;
    let mut kept = memory_of_agent(&config.name, &world, &config.store, config.policies.clone())?;
    kept.retention = config.retention;
    kept.access.clone_from(&config.access);
    kept.follow.clone_from(&config.follow);
    let clock = session.clone();
    let memory = AgentMemory::open(kept, Arc::new(move || clock.now_ns()))?;
    let simulated = match &config.eyes {
        None => Some(StagedRobot::new(&world, config.seed, memory.memory(), Vec::new(), None)?),
        Some(_) => {
            let root_from_agent = remote_eyes::agent_of(&world, &config.name)?.root_from_agent();
            memory.memory().commit_now(vec![agent_pose_update(&config.name, &root_from_agent)?])?;
            None
        }
    };
    let _served = memory.share(session).await?;
    let backend = match (simulated, &config.eyes) {
        (Some((robot, simulation)), _) => Backend::simulated(config, robot, simulation),
        (None, eyes) => {
            let eyes = eyes.as_ref().expect("an agent without a robot has eyes");
            let view = tokio::select! {
                biased;
                () = &mut until => return Ok(None),
                view = remote_eyes::open(session, eyes, |what| console.note(what)) => view?,
            };
            Backend::eyes_only(config, (world.model()?, view), memory.memory())
        }
    };
    let frame = backend.equipment.robot.model().camera_frame();
    let cameras = StereoProvider::new(Arc::clone(&backend.equipment.images), frame);
    let _cameras = offer_images(session, &config.name, Arc::new(cameras)).await?;
    console.world_begins(Arc::clone(&backend.clock));
    let view = match &config.live {
        Some(address) => Some(Arc::new(show(address, config, (session, &memory), &backend, console).await?)),
        None => None,
    };
    let ended = act(config, (session, agents), (backend, view), until, console).await?;
    if let Err(error) = memory.flush() {
        console.note(&format!("warning: what was learned was not kept: {error}"));
    }
    Ok(ended)
}

/// Opens the agent's live page: its robot, its memory, and the chart that it runs itself.
async fn show(
    address: &PageAddress,
    config: &AgentConfig,
    (session, memory): (&Session, &AgentMemory),
    backend: &Backend,
    console: &dyn Console,
) -> Result<ServiceView, HostError> {
    let chart = config.run.as_deref().map(|chart| live::outline_of(chart, &config.charts));
    let outline = chart.unwrap_or(Outline { states: Vec::new(), transitions: Vec::new() });
    let (robot, known) = (&backend.equipment.robot, (&backend.registry, backend.equipment.robot.model()));
    let title = (config.name.as_str(), format!("the robot `{}`", robot.model().name()));
    let view =
        ServiceView::open(address, title, outline, (known.0, known.1.as_ref()), session, console).await?;
    let recorder = || view.recorder.clone();
    // Both end with what they record.
    record_robot(robot, side_tasks::sensor_of(&backend.equipment), recorder());
    let clock = Arc::clone(&backend.clock);
    tokio::spawn(side_tasks::record_memory(Arc::clone(memory.memory()), recorder(), clock));
    Ok(view)
}

/// Offers charts and skills, and runs the agent's own chart, until the agent is to end.
async fn act(
    config: &AgentConfig,
    (session, agents): (&Session, &Agents),
    (backend, view): (Backend, Option<Arc<ServiceView>>),
    until: impl Future<Output = ()>,
    console: &dyn Console,
) -> Result<Option<RunResult>, HostError> {
    let Backend { equipment, registry, task, observes, clock } = backend;
    let sink = view.as_ref().map(|view| {
        let (recorder, clock) = (view.recorder.clone(), Arc::clone(&clock));
        Box::new(RecordedEvents { recorder, clock, ends: None }) as Box<dyn TraceSink>
    });
    let mut registry = registry.with_names(Arc::new(Names::of_agent(equipment.robot.model())));
    let channels = Channels::new().with_memory(observers::memory(&equipment));
    let robot = Arc::clone(&equipment.robot);
    let stop: Stop =
        Arc::new(move |what: &str| robot.stop(&format!("the skill of `{what}` does not return")));

    let mut offers = Offers::new(&config.name, session, channels.clone(), Arc::clone(&stop));
    let peers = Peers { transport: Some(Arc::new(agents.clone())), ..Peers::default() };
    let mut charts = Vec::new();
    for file in chart_files(&config.offered)? {
        let program = load(&file, config, &mut registry, agents, console).await?;
        charts.push(program.name().to_owned());
        let mut skill = offered(&file, config, program, &registry, &stop).with_peers(peers.clone());
        if let Some(view) = &view {
            let outline = live::outline_of(&file, &config.charts);
            skill = skill.traced(live::shown_runs(view, outline, &registry, &clock));
        }
        offers.add(Arc::new(skill))?;
    }
    let skills: Vec<String> = registry.manifests().map(|m| m.name.clone()).collect();
    for skill in skills.iter().filter_map(|name| registry.get(name)) {
        offers.add(Arc::clone(skill))?;
    }
    let own = match &config.run {
        None => None,
        Some(file) => {
            let program = load(file, config, &mut registry, agents, console).await?;
            Some(execute(program, registry.clone(), &channels, (&stop, &peers), sink)?)
        }
    };
    introduce(config, session, &charts, &skills, console).await;

    let mut tasks = if observes { observers::start(&equipment, &channels) } else { Vec::new() };
    let task = tokio::spawn(task);
    let own = async {
        match own {
            Some(executor) => executor.run().await,
            None => std::future::pending().await,
        }
    };
    let ended = tokio::select! {
        biased;
        () = until => None,
        ended = own => Some(ended),
        ended = serve(session, offers) => ended.map(|()| None)?,
        ended = receive_events(session, &config.name, peers.subscribers) => ended.map(|()| None)?,
    };
    equipment.robot.stop("the agent ends");
    tasks.push(task);
    tasks.iter().for_each(tokio::task::JoinHandle::abort);
    Ok(ended)
}

fn execute(
    program: Arc<Program>,
    registry: Registry,
    channels: &Channels,
    (stop, peers): (&Stop, &Peers),
    sink: Option<Box<dyn TraceSink>>,
) -> Result<Executor, HostError> {
    let stop = Arc::clone(stop);
    let options = ExecOptions {
        limits: Limits::default(),
        sink,
        on_stuck: Some(Box::new(move |state| stop(state))),
        peers: peers.clone(),
        ..ExecOptions::default()
    };
    Ok(Executor::new(program, registry, channels.clone(), options)?)
}

/// A chart as a skill for other agents.
fn offered(
    file: &Path,
    config: &AgentConfig,
    program: Arc<Program>,
    registry: &Registry,
    stop: &Stop,
) -> ChartSkill {
    let library = chart::load(file, &config.charts);
    let description = library.charts.get(program.name()).map_or("", |chart| chart.description.as_str());
    ChartSkill::new(program, description, registry.clone(), Arc::clone(stop))
}

/// Loads a chart without errors; reports its warnings.
async fn load(
    file: &Path,
    config: &AgentConfig,
    registry: &mut Registry,
    agents: &Agents,
    console: &dyn Console,
) -> Result<Arc<Program>, HostError> {
    let checked = catalog::load_connected(file, &config.charts, registry, Some(agents)).await?;
    catalog::runnable(checked, console)
}

/// The named chart files, and the charts in the named folders.
fn chart_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, HostError> {
    let is_chart =
        |file: &PathBuf| Disk.head(file).is_some_and(|head| outermost(&head, "statechart").is_some());
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        std::fs::read_dir(path).map_err(|source| HostError::File {
            what: "the folder of charts cannot be read:",
            path: path.clone(),
            source,
        })?;
        files.extend(Disk.list(path).into_iter().filter(is_chart));
    }
    Ok(files)
}

/// Reports what the agent offers and where it listens.
async fn introduce(
    config: &AgentConfig,
    session: &Session,
    charts: &[String],
    skills: &[String],
    console: &dyn Console,
) {
    console.note(&format!("agent {}, process {}", config.name, session.id()));
    if !charts.is_empty() {
        console.note(&format!("  charts: {}", charts.join(", ")));
    }
    console.note(&format!("  skills: {}", skills.join(", ")));
    for endpoint in session.endpoints().await {
        console.note(&format!("  listens on {endpoint}"));
    }
}
