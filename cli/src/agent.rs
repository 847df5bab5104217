//! `armarium agent --name NAME CHARTS...`: offers charts, the skills of the simulated robot, its memory and its
//! cameras to other agents.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_bus::Session;
use armarium_memoryx::MemoryServer;
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{self, Registry};
use armarium_runtime::exec::{ChartSkill, Others, Stop};
use armarium_runtime::remote::{Agents, Offers, hear, serve};
use armarium_simulator::World;
use armarium_states::observers;
use armarium_viewer::progress::Progress;
use armarium_visionx::providers::{StereoProvider, offer as offer_images};

use crate::catalog;
use crate::connection::{AccessArgs, Connection, ConnectionArgs, be_the_only_one};
use crate::logging;
use crate::render_findings::{Shown, any_error, render, summary};
use crate::stage::Stage;

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
    /// The simulated world that the agent's robot is in; the default kitchen if not given.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// Seeds everything that varies in the world.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// The long-term store that motions are kept in.
    #[arg(long, value_name = "FILE", default_value = "armarium-agent.redb")]
    pub(crate) store: PathBuf,
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

/// Offers until Ctrl-C. Returns the exit status: 0 when it was ended so, 2 when it could not begin.
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
        Ok(()) => Ok(0),
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
) -> Result<(), NotBegun> {
    let _alive = be_the_only_one(session, &args.name).await.map_err(message)?;
    let world = match &args.world {
        None => World::default(),
        Some(file) => World::load(file)
            .map_err(|errors| NotBegun::Findings(errors.iter().map(Shown::from).collect()))?,
    };
    let (stage, simulation) =
        Stage::set(&world, args.seed, &args.store, Vec::new(), None).map_err(message)?;
    let (memory, long_term) = (Arc::clone(&stage.memory), Arc::clone(stage.kept.store()));
    let guarded = args.access.of(&args.name).is_some();
    let _memory = MemoryServer::start_guarded(session, &args.name, memory, Some(long_term), guarded)
        .await
        .map_err(message)?;
    let cameras = StereoProvider::new(Arc::clone(&stage.equipment.images), "camera_left");
    let _cameras = offer_images(session, &args.name, Arc::new(cameras)).await.map_err(message)?;
    let progress = Progress::new(Box::new(io::stderr()), false);
    logging::install(&progress, stage.handle.clone(), args.verbose, false).map_err(message)?;
    let channels = Channels::new();
    let robot = Arc::clone(&stage.robot);
    let stop: Stop =
        Arc::new(move |what: &str| robot.stop(&format!("the skill of `{what}` does not return")));

    let mut registry = catalog::registry(&stage.equipment);
    let mut offers = Offers::new(&args.name, session, channels.clone(), Arc::clone(&stop));
    let others = Others { post: Some(Arc::new(agents.clone())), ..Others::default() };
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
    say(args, session, &charts, &skills, out).await.map_err(message)?;

    let mut observing = observers::start(&stage.equipment, &channels);
    observing.push(tokio::spawn(simulation.run()));
    tokio::select! {
        biased;
        () = stopped() => {}
        ended = serve(session, offers) => ended.map_err(message)?,
        ended = hear(session, &args.name, others.hearers) => ended.map_err(message)?,
    }
    stage.robot.stop("the agent ends");
    stage.handle.stop();
    observing.iter().for_each(tokio::task::JoinHandle::abort);
    if let Err(error) = stage.kept.flush() {
        writeln!(out, "warning: what was learned was not kept: {error}").map_err(message)?;
    }
    Ok(())
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
    let checked = catalog::load_connected(file, folders, registry, Some(agents)).await.map_err(message)?;
    let findings: Vec<Shown> = checked.findings.iter().map(Shown::from).collect();
    let program = match checked.program {
        Some(program) if !any_error(&findings) => program,
        _ => return Err(NotBegun::Findings(findings)),
    };
    if !findings.is_empty() {
        write!(out, "{}", render(&findings, false, 100)).map_err(message)?;
    }
    let library = chart::load(file, folders);
    let description = library.charts.get(program.name()).map_or("", |chart| chart.description.as_str());
    let name = program.name().to_owned();
    Ok(Chart { name, skill: ChartSkill::new(program, description, registry.clone(), Arc::clone(stop)) })
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
