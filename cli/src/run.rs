//! `armarium run CHART`: checks the chart, sets the stage, runs it in the simulator, and leaves recording and report.

mod beside;
mod reach;

use std::collections::BTreeMap;
use std::io::{self, IsTerminal as _, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use armarium_runtime::channels::Channels;
use armarium_runtime::chart::Finding;
use armarium_runtime::exec::{ExecOptions, Executor, Peers, RunResult, TraceSink, Transport};
use armarium_runtime::program::Program;
use armarium_runtime::skill::Limits;
use armarium_simulator::cameras::ScenerySink;
use armarium_simulator::{Simulation, TruthSink, World};
use armarium_states::observers;
use armarium_values::Value;
use armarium_viewer::progress::{Progress, Status};
use armarium_viewer::recorder::Recorder;

use crate::cameras;
use crate::catalog;
use crate::chronicle::{Chronicle, Story};
use crate::company::{Beginning, Company, Told};
use crate::connection::{Connection, ConnectionArgs};
use crate::gallery::Gallery;
use crate::judge::{self, Case, JointLog};
use crate::logging;
use crate::recording::{RunDigest, SharedRecorder, TruthTopics, attach_sources, locked, record_robot};
use crate::render_findings::{Shown, any_error, render, summary};
use crate::replay::{self, Recorded};
use crate::scene::Scene;
use crate::stage::{Mind, Stage};

/// How long by the wall clock a skill may keep the program's thread to itself.
const HANGS: std::time::Duration = std::time::Duration::from_secs(10);

/// What `run` takes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RunArgs {
    /// The chart to run.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// The simulated world; if not given, NAME.world.yaml beside the chart NAME.yaml, or else the default kitchen.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// Seeds everything that varies.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder for report.json, report.html and run.mcap.
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub(crate) report: PathBuf,
    /// The long-term store that motions are kept in.
    #[arg(long, value_name = "FILE", default_value = "armarium.redb")]
    pub(crate) store: PathBuf,
    /// An input of the chart, for instance `contact_force=10` or `patience=30s`; may be repeated.
    #[arg(long = "set", value_name = "INPUT=VALUE", value_parser = parse_input)]
    pub(crate) inputs: Vec<(String, String)>,
    /// The chart's profile whose defaults are used.
    #[arg(long)]
    pub(crate) profile: Option<String>,
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// As fast as the machine (`max`), or in real time (`1`). With other agents it is real time.
    #[arg(long, value_enum, default_value_t = Speed::Max)]
    pub(crate) speed: Speed,
    /// The name by which other agents can send events to this run.
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Look through the cameras of `armarium cameras --name NAME`, in another process, with the same world and seed.
    #[arg(long, value_name = "NAME")]
    pub(crate) cameras: Option<String>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
    /// Record the run for `armarium replay`.
    #[arg(long, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,
    /// Show what happens as lines of text.
    #[arg(short, long)]
    pub(crate) verbose: bool,
}

/// How fast simulated time goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Speed {
    /// Virtual time: as fast as the machine, repeatable bit for bit.
    Max,
    /// Real time.
    #[value(name = "1")]
    RealTime,
}

pub(crate) fn parse_input(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("write it as INPUT=VALUE")?;
    Ok((name.to_owned(), value.to_owned()))
}

/// The given inputs as values of the types that the chart declares; what the chart does not have stays text and is
/// refused when the run is made, with a suggestion.
///
/// # Errors
/// One sentence for people.
pub(crate) fn read_inputs_of(
    given: &[(String, String)],
    program: &Program,
) -> Result<BTreeMap<String, Value>, String> {
    let read = |(name, text): &(String, String)| {
        let declared = program.inputs().find(|input| input.name == *name);
        let value = declared.map_or_else(|| Ok(Value::from(text.as_str())), |input| input.ty.read(text));
        value.map(|v| (name.clone(), v)).map_err(|e| format!("--set {name}={text}: {e}"))
    };
    given.iter().map(read).collect()
}

/// Why a run did not begin; nothing has moved.
enum NotBegun {
    Findings(Vec<Shown>),
    Message(String),
}

/// Runs the chart; what is to be said goes to `out`. Returns the exit status: 0 success, 1 a run that failed, 2 a file
/// or argument that is wrong.
///
/// # Errors
/// When `out` or a report cannot be written.
pub(crate) fn run(args: &RunArgs, out: &mut dyn Write) -> io::Result<u8> {
    let began = Instant::now();
    let mut scene = match Scene::of(&args.chart, args.world.as_deref()) {
        Ok(scene) => scene,
        Err(errors) => return show(&errors.iter().map(Shown::from).collect::<Vec<_>>(), out).map(|()| 2),
    };
    let name = scene.called(args.name.as_deref());
    let connection = match &args.cameras {
        None if scene.world.agents.is_empty() => Connection::if_asked(&args.connection, name.is_some()),
        // The other agents' eyes are images too.
        None | Some(_) => Connection::for_images(&args.connection, None).map(Some),
    };
    let connection = match connection {
        Ok(connection) => connection,
        Err(message) => return writeln!(out, "error: {message}").map(|()| 2),
    };
    let caller = name.as_deref().unwrap_or("armarium run");
    let agents = connection.as_ref().map(|connection| connection.agents(caller));
    let others =
        Peers { transport: agents.clone().map(|a| Arc::new(a) as Arc<dyn Transport>), ..Peers::default() };
    let _hears = match (&connection, &name) {
        (Some(connection), Some(name)) => match reach::listen(connection, name, &others.subscribers, out)? {
            Ok(hears) => Some(hears),
            Err(message) => return writeln!(out, "error: {message}").map(|()| 2),
        },
        _ => None,
    };
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().start_paused(args.speed == Speed::Max && agents.is_none());
    let runtime = builder.build()?;
    let reached = reach::Reach { connection: connection.as_ref(), agents: agents.as_ref(), others };
    match runtime.block_on(perform(args, scene, began, reached, out)) {
        Ok(status) => Ok(status),
        Err(NotBegun::Message(message)) => {
            writeln!(out, "error: {message}")?;
            Ok(2)
        }
        Err(NotBegun::Findings(findings)) => {
            show(&findings, out)?;
            Ok(2)
        }
    }
}

fn show(findings: &[Shown], out: &mut dyn Write) -> io::Result<()> {
    let colour = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    write!(out, "{}", render(findings, colour, 100))?;
    writeln!(out, "{}", summary(findings))
}

/// Shows what is wrong with a chart.
pub(crate) fn show_findings(findings: &[Finding], out: &mut dyn Write) -> io::Result<()> {
    show(&findings.iter().map(Shown::from).collect::<Vec<_>>(), out)
}

fn begin_error(error: impl std::fmt::Display) -> NotBegun {
    NotBegun::Message(error.to_string())
}

async fn perform(
    args: &RunArgs,
    Scene { world, file }: Scene,
    began: Instant,
    reach::Reach { connection, agents, others }: reach::Reach<'_>,
    out: &mut dyn Write,
) -> Result<u8, NotBegun> {
    let recorder: SharedRecorder = Arc::new(Mutex::new(None));
    let digest = RunDigest::default();
    let sinks: Vec<Box<dyn TruthSink>> =
        vec![Box::new(digest.clone()), Box::new(TruthTopics(Arc::clone(&recorder)))];
    let (told, cameras) = match (&args.cameras, connection) {
        (Some(name), Some(connection)) => {
            let (told, cameras) = cameras::connect(name, connection).await.map_err(NotBegun::Message)?;
            (Some(Box::new(told) as Box<dyn ScenerySink>), Some(cameras))
        }
        _ => (None, None),
    };
    let mind = Mind::of_run(&world, &args.store).map_err(begin_error)?;
    let set = Stage::set(&world, args.seed, mind, sinks, told);
    let (mut stage, simulation) = set.map_err(begin_error)?;
    let cameras = cameras.unwrap_or_else(|| Arc::clone(&stage.equipment.images));
    let gallery = Arc::new(Gallery::of(cameras, &world, Arc::clone(&recorder)));
    stage.equipment.images = Arc::clone(&gallery) as Arc<dyn armarium_visionx::ImageSource>;

    let mut registry = catalog::registry(&stage.equipment);
    let checked = catalog::load_connected(&args.chart, &args.charts, &mut registry, agents).await;
    let checked = checked.map_err(NotBegun::Message)?;
    let findings: Vec<Shown> = checked.findings.iter().map(Shown::from).collect();
    let program = match checked.program {
        Some(program) if !any_error(&findings) => program,
        _ => return Err(NotBegun::Findings(findings)),
    };
    if !findings.is_empty() {
        show(&findings, out).map_err(begin_error)?;
    }
    let chart = program.name().to_owned();
    std::fs::create_dir_all(&args.report).map_err(|e| {
        NotBegun::Message(format!("the folder `{}` cannot be made: {e}", args.report.display()))
    })?;

    let terminal = io::stderr().is_terminal();
    let progress = Progress::new(Box::new(io::stderr()), terminal);
    let colour = terminal && std::env::var_os("NO_COLOR").is_none();
    let handle = stage.handle.clone();
    logging::install(&progress, Arc::new(move || handle.now_ns()), args.verbose, colour)
        .map_err(begin_error)?;
    let company = match connection.zip(file).filter(|_| !world.agents.is_empty()) {
        Some((connection, world_file)) => {
            Some(gather(connection, &stage, &simulation, (&world, world_file), &args.report).await?)
        }
        None => None,
    };
    let printer = progress.clone();
    let chronicle = Chronicle {
        story: Arc::new(Mutex::new(Story::default())),
        digest: digest.clone(),
        recorder: Arc::clone(&recorder),
        referee: stage.referee.clone(),
        clock: stage.handle.clone(),
        print: Arc::new(move |line| printer.print(line)),
        verbose: args.verbose,
    };
    let channels = Channels::new();
    let robot = Arc::clone(&stage.equipment.robot);
    let inputs = read_inputs_of(&args.inputs, &program).map_err(NotBegun::Message)?;
    let options = ExecOptions {
        inputs: inputs.clone(),
        profile: args.profile.clone(),
        limits: Limits::default(),
        sink: Some(recorded(args, inputs, Box::new(chronicle.clone()))?),
        on_stuck: Some(Box::new(move |state| robot.stop(&format!("the skill of `{state}` does not return")))),
        others,
    };
    let executor = Executor::new(program, registry, channels.clone(), options).map_err(begin_error)?;
    // Robot and skills share one thread here: where a skill blocks it, no report can be written any more.
    let printer = progress.clone();
    let executor = executor.hang_after(
        HANGS,
        Some(Box::new(move |state| {
            printer.print(&format!(
                "the skill of `{state}` blocks the program; the robot stands, no report is written"
            ));
            std::process::exit(1);
        })),
    );
    let metadata = BTreeMap::from([
        ("chart".to_owned(), chart.clone()),
        ("world".to_owned(), world.name.clone()),
        ("seed".to_owned(), args.seed.to_string()),
    ]);
    let mut opened = Recorder::create(&args.report.join("run.mcap"), metadata).map_err(begin_error)?;
    attach_sources(&mut opened, &args.chart, &world).map_err(begin_error)?;
    *locked(&recorder) = Some(opened);

    let joints = Arc::new(Mutex::new(JointLog::default()));
    let mut helpers = vec![
        record_robot(&stage.equipment.robot, Arc::clone(&recorder)),
        tokio::spawn(beside::watch_gestures(
            stage.mind.memory.clone(),
            stage.referee.clone(),
            Arc::clone(&recorder),
        )),
        tokio::spawn(beside::log_joints(Arc::clone(&stage.equipment.robot), Arc::clone(&joints))),
        tokio::spawn(beside::stop_on_signal(executor.controller())),
        tokio::spawn(beside::show_progress(
            progress.clone(),
            Arc::clone(&stage.equipment.robot),
            Arc::clone(&chronicle.story),
            began,
        )),
    ];
    helpers.extend(observers::start(&stage.equipment, &channels));
    helpers.extend(company.as_ref().map(|company| tokio::spawn(company.watch(executor.controller()))));
    let world_task = tokio::spawn(simulation.run());
    let result = executor.run().await;
    let told = match company {
        Some(company) => company.close().await,
        None => Told::default(),
    };
    stage.equipment.robot.stop("the run has ended");
    stage.handle.stop();
    for helper in helpers {
        helper.abort();
    }
    let _ = world_task.await;
    if let Err(error) = stage.mind.kept.flush() {
        writeln!(out, "warning: what was learned was not kept: {error}").map_err(begin_error)?;
    }
    if let Some(recorder) = locked(&recorder).take() {
        recorder.finish().map_err(begin_error)?;
    }

    let simulated_s = stage.handle.now_ns() as f64 * 1e-9;
    let story = locked(&chronicle.story);
    progress.finish(&Status {
        simulated_s,
        wall_s: began.elapsed().as_secs_f64(),
        states: vec![result.outcome.clone()],
        force_n: None,
    });
    let states_at = |t_ns: u64| story.states_at(t_ns as f64 * 1e-9);
    let mut pictures = gallery.pictures(&states_at);
    pictures.extend(told.pictures(&states_at));
    let case = Case {
        chart: &chart,
        world: &world,
        seed: args.seed,
        result: &result,
        simulated_s,
        wall_s: began.elapsed().as_secs_f64(),
        trace_sha256: digest.hex(),
        referee: &stage.referee,
        story: &story,
        pictures,
        joints: locked(&joints).plots(stage.equipment.robot.model()),
        diary: &told.diary,
    };
    let figures = judge::write(&args.report, case).map_err(|e| {
        NotBegun::Message(format!("the report cannot be written to `{}`: {e}", args.report.display()))
    })?;
    conclude(&result, &figures, &args.report, out).map_err(begin_error)
}

/// The sink of a run, with a record beside it where one is asked for.
fn recorded(
    args: &RunArgs,
    inputs: BTreeMap<String, Value>,
    sink: Box<dyn TraceSink>,
) -> Result<Box<dyn TraceSink>, NotBegun> {
    let Some(file) = &args.record else { return Ok(sink) };
    let (chart, charts, profile) = (args.chart.clone(), args.charts.clone(), args.profile.clone());
    let beginning = replay::Beginning { chart, charts, inputs, profile };
    let recorded = Recorded::begin(file, &beginning, sink);
    let recorded = recorded.map_err(|e| NotBegun::Message(format!("{}: {e}", file.display())))?;
    Ok(Box::new(recorded))
}

/// Brings in the world's other agents, on the connection's threads.
async fn gather(
    connection: &Connection,
    stage: &Stage,
    simulation: &Simulation,
    (world, world_file): (&World, PathBuf),
    folder: &Path,
) -> Result<Company, NotBegun> {
    let beginning = Beginning {
        session: connection.session.clone(),
        world: world.clone(),
        world_file,
        memory: Arc::clone(&stage.mind.memory),
        store: Arc::clone(stage.mind.kept.store()),
        eyes: simulation.agents(),
        folder: folder.to_owned(),
        clock: stage.handle.clone(),
    };
    let gathered = connection.runtime().spawn(Company::gather(beginning)).await;
    gathered.map_err(begin_error)?.map_err(NotBegun::Message)
}

/// Says how the run ended and where its report is.
fn conclude(
    result: &RunResult,
    figures: &serde_json::Value,
    folder: &Path,
    out: &mut dyn Write,
) -> io::Result<u8> {
    for figure in armarium_viewer::report::figures(figures) {
        let Some(value) = figure.value else { continue };
        let mark = match figure.passed() {
            Some(true) => "ok ",
            Some(false) => "NO ",
            None => "   ",
        };
        let (group, name, unit, digits) = (&figure.group, &figure.name, &figure.unit, figure.digits);
        writeln!(out, "  {mark} {group}: {name} {value:.digits$} {unit}")?;
    }
    if result.outcome == "success" {
        writeln!(out, "success; the report is {}", folder.join("report.html").display())?;
        return Ok(0);
    }
    let reason = result.reason.as_deref().unwrap_or("no reason was given");
    writeln!(out, "{}: {reason}", result.outcome)?;
    if !result.chain.is_empty() {
        writeln!(out, "  through {}", result.chain.join(" < "))?;
    }
    writeln!(out, "the report is {}", folder.join("report.html").display())?;
    Ok(1)
}
