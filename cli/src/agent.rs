//! `armarium agent --name NAME CHARTS...`: offers charts, skills, its memory and its cameras to other agents: those of a
//! simulated robot, or of one who only watches through images that another agent offers.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_bus::Session;
use armarium_memoryx::{Consolidator, MemoryServer, WorkingMemory, keep_within};
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{self, Registry};
use armarium_runtime::exec::{ChartSkill, ExecOptions, Executor, Peers, RunResult, Stop};
use armarium_runtime::program::Program;
use armarium_runtime::remote::{Agents, Offers, hear, serve};
use armarium_runtime::skill::Limits;
use armarium_simulator::World;
use armarium_states::observers;
use armarium_viewer::progress::Progress;
use armarium_visionx::providers::{StereoProvider, offer as offer_images};
use tokio::task::JoinSet;

use crate::body::{Body, watching_mind};
use crate::catalog;
use crate::connection::{AccessArgs, Connection, ConnectionArgs, be_the_only_one};
use crate::following::{Followee, follow_when_there};
use crate::logging;
use crate::memory::keep::KeepArgs;
use crate::render_findings::{Shown, any_error, render, summary};
use crate::stage::{Mind, Stage};
use crate::watching::{self, Eyes};

/// What `agent` takes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct AgentArgs {
    /// The name by which other agents call it.
    #[arg(long)]
    pub(crate) name: String,
    /// Charts to offer, or folders of charts. Skills are offered always.
    #[arg(value_name = "CHARTS")]
    pub(crate) offered: Vec<PathBuf>,
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
    #[command(flatten)]
    pub(crate) access: AccessArgs,
    /// Images that another agent offers, as the agent's eyes. It has no robot then, only skills that move nothing, and
    /// stands where the world says.
    #[arg(long, value_name = "AGENT/PROVIDER")]
    pub(crate) eyes: Option<Eyes>,
    /// A chart that the agent runs from the beginning; the agent ends with it.
    #[arg(long, value_name = "CHART")]
    pub(crate) run: Option<PathBuf>,
    /// An agent whose memory is followed as soon as it is there: its `ObjectInstances` and `ObjectRelations`, or the core
    /// segment that is named; may be repeated.
    #[arg(long, value_name = "AGENT[:SEGMENT]")]
    pub(crate) follow: Vec<Followee>,
    /// End when the standard input does: for an agent that another process starts.
    #[arg(long)]
    pub(crate) while_input: bool,
    /// The simulated world that the agent's robot is in; the default kitchen if not given.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// Seeds everything that varies in the world.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// The file of long-term memory: what was learned and what others committed is there again when the agent is started
    /// anew; what was seen can be asked for. One snapshot a second is kept of what is seen and learned, and all of the rest.
    #[arg(long, value_name = "FILE", default_value = "armarium-agent.redb")]
    pub(crate) store: PathBuf,
    #[command(flatten)]
    pub(crate) kept: KeepArgs,
    /// Show what happens as lines of text.
    #[arg(short, long)]
    pub(crate) verbose: bool,
}

/// Why an agent cannot begin.
enum NotBegun {
    Findings(Vec<Shown>),
    Message(String),
}

fn message(error: impl std::fmt::Display) -> NotBegun {
    NotBegun::Message(error.to_string())
}

/// Offers until Ctrl-C. Returns the exit status: 0 when it was ended so, 1 when what it ran has failed, 2 when it could
/// not begin.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &AgentArgs, out: &mut dyn Write) -> io::Result<u8> {
    let access = args.access.of(&args.name);
    let connection = match Connection::for_images(&args.connection, access.as_ref()) {
        Ok(connection) => connection,
        Err(message) => return writeln!(out, "error: {message}").map(|()| 2),
    };
    let agents = connection.agents(&args.name);
    // Simulation, skills and charts share the session's threads; one that is busy holds up no answer.
    match connection.runtime().block_on(offer(args, &connection.session, &agents, out)) {
        Ok(status) => Ok(status),
        Err(NotBegun::Message(message)) => writeln!(out, "error: {message}").map(|()| 2),
        Err(NotBegun::Findings(findings)) => {
            write!(out, "{}", render(&findings, false, 100))?;
            writeln!(out, "{}", summary(&findings)).map(|()| 2)
        }
    }
}

async fn offer(
    args: &AgentArgs,
    session: &Session,
    agents: &Agents,
    out: &mut dyn Write,
) -> Result<u8, NotBegun> {
    let mut asked_to_end = std::pin::pin!(stopped_or(args.while_input));
    let _alive = be_the_only_one(session, &args.name).await.map_err(message)?;
    let world = match &args.world {
        None => World::default(),
        Some(file) => World::load(file)
            .map_err(|errors| NotBegun::Findings(errors.iter().map(Shown::from).collect()))?,
    };
    let policies = args.kept.policies(Mind::usual_policies()).map_err(message)?;
    let retention = args.kept.retention().map_err(message)?;
    let mind = Mind::of_agent(&world, &args.store, policies, session).map_err(message)?;
    let (mind, simulated) = match &args.eyes {
        None => {
            let (stage, simulation) =
                Stage::set(&world, args.seed, mind, Vec::new(), None).map_err(message)?;
            let mind = stage.mind.clone();
            (mind, Some((stage, simulation)))
        }
        Some(_) => (watching_mind(&args.name, &world, mind).map_err(message)?, None),
    };
    let Mind { memory, kept } = mind;
    let mut retaining = JoinSet::new();
    retaining.spawn(keep_within(Arc::clone(kept.store()), Arc::clone(&memory), retention));
    let store = Some(Arc::clone(kept.store()));
    let guarded = args.access.of(&args.name).is_some();
    let _served = MemoryServer::start_guarded(session, &args.name, Arc::clone(&memory), store, guarded)
        .await
        .map_err(message)?;
    let _followed = follow_all(args, session, &memory);
    let body = match (simulated, &args.eyes) {
        (Some((stage, simulation)), _) => Body::simulated(stage, simulation),
        (None, Some(eyes)) => {
            let say = |what: &str| {
                // Whoever does not read this waits all the same.
                let _ = writeln!(out, "{what}").and_then(|()| out.flush()).is_ok();
            };
            let view = tokio::select! {
                biased;
                () = &mut asked_to_end => return Ok(0),
                view = watching::open_eyes(session, eyes, say) => view.map_err(message)?,
            };
            Body::watching(&args.name, args.seed, view, &memory)
        }
        (None, None) => return Err(message("an agent without a robot needs --eyes")),
    };
    let cameras = StereoProvider::new(Arc::clone(&body.equipment.images), "camera_left");
    let _cameras = offer_images(session, &args.name, Arc::new(cameras)).await.map_err(message)?;
    let progress = Progress::new(Box::new(io::stderr()), false);
    logging::install(&progress, Arc::clone(&body.clock), args.verbose, false).map_err(message)?;
    let status = act(args, (session, agents), body, asked_to_end, out).await?;
    keep(&kept, out)?;
    Ok(status)
}

/// Offers charts and skills, and runs the agent's own chart, until it is asked to end.
async fn act(
    args: &AgentArgs,
    (session, agents): (&Session, &Agents),
    body: Body,
    asked_to_end: impl Future<Output = ()>,
    out: &mut dyn Write,
) -> Result<u8, NotBegun> {
    let Body { equipment, mut registry, life, observing, .. } = body;
    let channels = Channels::new();
    let robot = Arc::clone(&equipment.robot);
    let stop: Stop =
        Arc::new(move |what: &str| robot.stop(&format!("the skill of `{what}` does not return")));

    let mut offers = Offers::new(&args.name, session, channels.clone(), Arc::clone(&stop));
    let others = Peers { transport: Some(Arc::new(agents.clone())), ..Peers::default() };
    let mut charts = Vec::new();
    for file in chart_files(&args.offered).map_err(message)? {
        let chart = load(&file, &args.charts, &mut registry, agents, &stop, out).await?;
        charts.push(chart.name);
        offers.add(Arc::new(chart.skill.among(others.clone()))).map_err(message)?;
    }
    let skills: Vec<String> = registry.manifests().map(|m| m.name.clone()).collect();
    for name in &skills {
        if let Some(skill) = registry.get(name) {
            offers.add(Arc::clone(skill)).map_err(message)?;
        }
    }
    let own = match &args.run {
        None => None,
        Some(file) => {
            let program = checked(file, &args.charts, &mut registry, agents, out).await?;
            Some(execute(program, registry.clone(), &channels, (&stop, &others))?)
        }
    };
    say(args, session, &charts, &skills, out).await.map_err(message)?;

    let mut tasks = if observing { observers::start(&equipment, &channels) } else { Vec::new() };
    let life = tokio::spawn(life);
    let own = async {
        match own {
            Some(executor) => executor.run().await,
            None => std::future::pending().await,
        }
    };
    let status = tokio::select! {
        biased;
        () = asked_to_end => 0,
        ended = own => told(&ended, out)?,
        ended = serve(session, offers) => ended.map(|()| 0).map_err(message)?,
        ended = hear(session, &args.name, others.subscribers) => ended.map(|()| 0).map_err(message)?,
    };
    equipment.robot.stop("the agent ends");
    tasks.push(life);
    tasks.iter().for_each(tokio::task::JoinHandle::abort);
    Ok(status)
}

/// Follows others for as long as the tasks live.
fn follow_all(args: &AgentArgs, session: &Session, memory: &Arc<WorkingMemory>) -> JoinSet<()> {
    let mut tasks = JoinSet::new();
    for other in &args.follow {
        let (session, memory) = (session.clone(), Arc::clone(memory));
        let (own, followee) = (args.name.clone(), other.clone());
        tasks.spawn(async move {
            let what = (followee.agent.as_str(), followee.segment.as_deref());
            let _followed = follow_when_there(&session, &memory, &own, what).await;
            std::future::pending::<()>().await;
        });
    }
    tasks
}

fn execute(
    program: Arc<Program>,
    registry: Registry,
    channels: &Channels,
    (stop, others): (&Stop, &Peers),
) -> Result<Executor, NotBegun> {
    let stop = Arc::clone(stop);
    let options = ExecOptions {
        limits: Limits::default(),
        on_stuck: Some(Box::new(move |state| stop(state))),
        others: others.clone(),
        ..ExecOptions::default()
    };
    Executor::new(program, registry, channels.clone(), options).map_err(message)
}

/// Says how the agent's own chart ended; its exit status.
fn told(ended: &RunResult, out: &mut dyn Write) -> Result<u8, NotBegun> {
    let reason = ended.reason.as_deref().unwrap_or("no reason was given");
    let good = ended.outcome == "success";
    let line = if good { "success".to_owned() } else { format!("{}: {reason}", ended.outcome) };
    writeln!(out, "the chart has ended: {line}").map_err(message)?;
    Ok(u8::from(!good))
}

fn keep(kept: &Consolidator, out: &mut dyn Write) -> Result<(), NotBegun> {
    match kept.flush() {
        Ok(_) => Ok(()),
        Err(error) => writeln!(out, "warning: what was learned was not kept: {error}").map_err(message),
    }
}

struct Chart {
    name: String,
    skill: ChartSkill,
}

async fn load(
    file: &Path,
    folders: &[PathBuf],
    registry: &mut Registry,
    agents: &Agents,
    stop: &Stop,
    out: &mut dyn Write,
) -> Result<Chart, NotBegun> {
    let program = checked(file, folders, registry, agents, out).await?;
    let library = chart::load(file, folders);
    let description = library.charts.get(program.name()).map_or("", |chart| chart.description.as_str());
    let name = program.name().to_owned();
    Ok(Chart { name, skill: ChartSkill::new(program, description, registry.clone(), Arc::clone(stop)) })
}

/// A chart that is in order; warnings are said.
async fn checked(
    file: &Path,
    folders: &[PathBuf],
    registry: &mut Registry,
    agents: &Agents,
    out: &mut dyn Write,
) -> Result<Arc<Program>, NotBegun> {
    let checked = catalog::load_connected(file, folders, registry, Some(agents)).await.map_err(message)?;
    let findings: Vec<Shown> = checked.findings.iter().map(Shown::from).collect();
    let program = match checked.program {
        Some(program) if !any_error(&findings) => program,
        _ => return Err(NotBegun::Findings(findings)),
    };
    if !findings.is_empty() {
        write!(out, "{}", render(&findings, false, 100)).map_err(message)?;
    }
    Ok(program)
}

/// The charts that are named, and those of the folders that are.
fn chart_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).map_err(|e| format!("{}: {e}", path.display()))?;
        let mut inside: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        inside.sort();
        files.extend(inside.into_iter().filter(|file| is_chart(file)));
    }
    Ok(files)
}

/// Whether a file of a folder is a chart: YAML with the key `statechart` at its outermost level.
fn is_chart(file: &Path) -> bool {
    file.extension().is_some_and(|e| e == "yaml" || e == "yml")
        && std::fs::read_to_string(file)
            .is_ok_and(|text| text.lines().any(|line| line.starts_with("statechart:")))
}

async fn say(
    args: &AgentArgs,
    session: &Session,
    charts: &[String],
    skills: &[String],
    out: &mut dyn Write,
) -> io::Result<()> {
    writeln!(out, "agent {}, process {}", args.name, session.id())?;
    if !charts.is_empty() {
        writeln!(out, "  charts: {}", charts.join(", "))?;
    }
    writeln!(out, "  skills: {}", skills.join(", "))?;
    for endpoint in session.endpoints().await {
        writeln!(out, "  listens on {endpoint}")?;
    }
    out.flush()
}

/// Waits for Ctrl-C, or for the system's request to end.
pub(crate) async fn stopped() {
    let interrupted = tokio::signal::ctrl_c();
    let Ok(mut terminated) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) else {
        let _ = interrupted.await.is_ok();
        return;
    };
    tokio::select! {
        biased;
        _ = interrupted => {}
        _ = terminated.recv() => {}
    }
}

/// As [`stopped`]; if asked for, also for the end of the standard input.
async fn stopped_or(while_input: bool) {
    tokio::select! {
        biased;
        () = stopped() => {}
        () = input_ended(), if while_input => {}
    }
}

/// Waits until nobody can write to the standard input any more.
#[expect(
    clippy::disallowed_methods,
    reason = "agents live in real time, and nothing can wait for this thread"
)]
async fn input_ended() {
    // A thread of its own, which does not hold up the end of the program as one of the runtime's would.
    let (ended, waiting) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // What is said there is not for this program; an input that cannot be read has ended too.
        let _ = io::copy(&mut io::stdin().lock(), &mut io::sink()).is_ok();
        let _ = ended.send(()).is_ok();
    });
    // The sender is only dropped after it has sent.
    let _ = waiting.await.is_ok();
}
