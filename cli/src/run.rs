//! `armarium run CHART`: checks the chart, runs it in the simulator, and writes recording and report.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::SessionConfig;
use armarium_host::{Address, Console, HostError, LiveOptions, RobotAt, RunConfig, RunEnded};
use armarium_values::Type;
use armarium_viewer::live::PageAddress;
use serde_json::json;

use crate::connection_args::{AccessArgs, ConnectionArgs, LiveArgs, explained};
use crate::console::{JsonLines, Terminal, refuse};
use crate::logging;
use crate::stopped::stopped;
use crate::vision::Detector;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RunArgs {
    /// The chart to run.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// The simulated world; if not given, NAME.world.yaml beside the chart NAME.yaml, or else the default kitchen.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// The robot, by its name (`armarium robot list`) or its file, instead of the world's.
    #[arg(long, value_name = "FILE|NAME")]
    pub(crate) robot: Option<String>,
    /// Seed of all random variation.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// How people's hands are found.
    #[arg(long, value_enum, default_value_t = Detector::Skin)]
    pub(crate) detector: Detector,
    /// Folder for report.json, report.html and run.mcap. If it holds a report already, or another run writes to it, `DIR-2`,
    /// `DIR-3` ... is used.
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub(crate) report: PathBuf,
    /// Overwrite a report that is there already.
    #[arg(long)]
    pub(crate) force: bool,
    /// Stop the run after this time of the robot, for instance `10min`.
    #[arg(long = "for", value_name = "TIME", value_parser = read_time)]
    pub(crate) longest: Option<Duration>,
    /// End the recording when its file has this size, for instance `2GB`; the run goes on. What was collected since the last write
    /// (2 s of the run at most) and the index come on top.
    #[arg(long = "most", value_name = "SIZE", value_parser = read_size)]
    pub(crate) largest_recording: Option<u64>,
    /// The long-term store of motions.
    #[arg(long, value_name = "FILE", default_value = "armarium.redb")]
    pub(crate) store: PathBuf,
    /// A core segment that is kept in the store, too, and known again at the start, for instance `EnvironmentModels`; may be repeated.
    #[arg(long, value_name = "SEGMENT")]
    pub(crate) remember: Vec<String>,
    /// An input of the chart, for instance `contact_force=10` or `patience=30s`; may be repeated.
    #[arg(long = "set", value_name = "INPUT=VALUE", value_parser = parse_input)]
    pub(crate) inputs: Vec<(String, String)>,
    /// The chart's profile whose defaults are used.
    #[arg(long)]
    pub(crate) profile: Option<String>,
    /// Additional folders in which charts find other charts by name.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// As fast as the machine (`max`), or in real time (`1`). With other agents it is always real time.
    #[arg(long, value_enum, default_value_t = Speed::Max)]
    pub(crate) speed: Speed,
    /// The name by which other agents can send events to this run.
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Use the cameras of `armarium cameras --name NAME`, in another process, with the same world and seed.
    #[arg(long, value_name = "NAME")]
    pub(crate) cameras: Option<String>,
    /// Move the robot by a driver in another process (`docs/wire-robot.md`) instead of the simulator. The world then only says
    /// what the agent knows.
    #[arg(long, value_name = "AGENT/NAME")]
    pub(crate) driver: Option<Address>,
    /// Do everything but send targets to the driver: nothing moves.
    #[arg(long, requires = "driver")]
    pub(crate) dry: bool,
    /// Use the robot behind the guard of another process (`armarium robot serve`) instead of the simulated one.
    #[arg(long, value_name = "AGENT/NAME", conflicts_with = "driver")]
    pub(crate) robot_at: Option<Address>,
    /// Multiply all commanded velocities, for instance `0.05` for the first try with a real arm.
    #[arg(long, value_name = "FACTOR")]
    pub(crate) speed_scale: Option<f64>,
    #[command(flatten)]
    pub(crate) live: LiveArgs,
    /// As --live, and the page may act: pause, step, breakpoints, events, outcomes of skills, stop.
    #[arg(long)]
    pub(crate) live_control: bool,
    /// As --live, and the program stays after the run's end until Ctrl-C, so that the page can look back.
    #[arg(long)]
    pub(crate) live_hold: bool,
    /// Serve the topics of the recording to Foxglove on this port of this machine (0: one that is free); its address is printed.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    pub(crate) foxglove: Option<u16>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
    #[command(flatten)]
    pub(crate) access: AccessArgs,
    /// Record the run for `armarium replay`.
    #[arg(long, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,
    /// Print events as lines of text.
    #[arg(short, long)]
    pub(crate) verbose: bool,
    /// Print each item of the trace as a line of JSON, and at last a line with the outcome and the report's folder.
    #[arg(long, conflicts_with = "verbose")]
    pub(crate) json: bool,
}

/// Speed of simulated time.
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

pub(crate) fn read_time(text: &str) -> Result<Duration, String> {
    let seconds = Type::Duration.read(text).map_err(|error| error.to_string())?.as_f64().unwrap_or(0.0);
    Duration::try_from_secs_f64(seconds)
        .ok()
        .filter(|time| !time.is_zero())
        .ok_or_else(|| "a time greater than 0 is needed, for instance `10min`".to_owned())
}

fn read_size(text: &str) -> Result<u64, String> {
    const UNITS: [(&str, u64); 4] = [("kB", 1_000), ("MB", 1_000_000), ("GB", 1_000_000_000), ("B", 1)];
    let text = text.trim();
    let (number, factor) = UNITS
        .iter()
        .find_map(|(unit, factor)| Some((text.strip_suffix(unit)?, *factor)))
        .unwrap_or((text, 1));
    let number = number.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0);
    number
        .map(|n| (n * factor as f64) as u64)
        .ok_or_else(|| "a size is written like `500MB` or `2GB`".to_owned())
}

/// Runs the chart and prints to `out`. Returns the exit status: 0 success, 1 a failed run, 2 an invalid file or
/// argument.
pub(crate) fn run(args: &RunArgs, out: &mut dyn Write) -> io::Result<u8> {
    if let Err(error) = logging::check_environment() {
        return writeln!(out, "error: {error}").map(|()| 2);
    }
    let (session, address) = match reached(args) {
        Ok(reached) => reached,
        Err(error) => return writeln!(out, "error: {error}").map(|()| 2),
    };
    let config = RunConfig {
        charts: args.charts.clone(),
        world: args.world.clone(),
        robot: args.robot.clone(),
        seed: args.seed,
        hands: args.detector.into(),
        inputs: args.inputs.clone(),
        profile: args.profile.clone(),
        report: args.report.clone(),
        keep_reports: !args.force,
        store: args.store.clone(),
        remember: args.remember.clone(),
        record: args.record.clone(),
        real_time: args.speed == Speed::RealTime,
        name: args.name.clone(),
        cameras: args.cameras.clone(),
        robot_at: args
            .driver
            .clone()
            .map(if args.dry { RobotAt::DryDriver } else { RobotAt::Driver })
            .or(args.robot_at.clone().map(RobotAt::Guard)),
        speed_scale: args.speed_scale,
        session,
        program: std::env::current_exe().ok(),
        longest: args.longest,
        largest_recording: args.largest_recording,
        live: Some(LiveOptions { address, control: args.live_control })
            .filter(|_| args.live.live || args.live_control || args.live_hold),
        foxglove_port: args.foxglove,
        ..RunConfig::new(&args.chart)
    };
    let console: Arc<dyn Console> =
        if args.json { Arc::new(JsonLines) } else { Terminal::with_progress(args.verbose) };
    let ended = armarium_host::run(&config, &console);
    let page = ended.as_ref().ok().and_then(|ended| ended.page.clone()).filter(|_| args.live_hold);
    let status = concluded(ended, args, out)?;
    if let Some(page) = page {
        writeln!(out, "the page stays at {}; Ctrl-C ends it", page.url())?;
        out.flush()?;
        tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(stopped());
    }
    Ok(status)
}

/// How others reach the run, and where its page is served.
fn reached(args: &RunArgs) -> Result<(Option<SessionConfig>, PageAddress), String> {
    let mut session = args.connection.config().map_err(|error| explained(&error))?;
    if let Some(access) = args.access.of(args.name.as_deref().unwrap_or_default()) {
        let no_name = |error| format!("who may reach the run: {error}; `--name` says by what name");
        session.access_control = Some(access.rules().map_err(no_name)?);
    }
    let address = args.live.address(&args.connection).map_err(|error| error.to_string())?;
    Ok((Some(session).filter(|_| args.connection.is_given()), address))
}

/// Prints how the run ended. Returns the exit status.
fn concluded(ended: Result<RunEnded, HostError>, args: &RunArgs, out: &mut dyn Write) -> io::Result<u8> {
    match ended {
        Ok(ended) if args.json => {
            let result = &ended.result;
            let line = json!({
                "outcome": result.outcome,
                "reason": result.reason,
                "figures": ended.figures,
                "report": ended.folder,
            });
            writeln!(io::stdout(), "{line}")?;
            Ok(u8::from(result.outcome != "success" || !ended.recorded || !ended.reported))
        }
        Ok(ended) => conclude(&ended, out),
        Err(error) => refuse(&error, out),
    }
}

/// Prints how the run ended and where its report is.
fn conclude(ended: &RunEnded, out: &mut dyn Write) -> io::Result<u8> {
    for figure in &ended.figures {
        let Some(value) = figure.value else { continue };
        let mark = match figure.passed() {
            Some(true) => "ok ",
            Some(false) => "NO ",
            None => "   ",
        };
        let (group, name, unit, digits) = (&figure.group, &figure.name, &figure.unit, figure.digits);
        writeln!(out, "  {mark} {group}: {name} {value:.digits$} {unit}")?;
    }
    let (result, folder) = (&ended.result, &ended.folder);
    let place = if ended.reported {
        format!("the report is {}", folder.join("report.html").display())
    } else {
        "there is no report".to_owned()
    };
    if result.outcome == "success" {
        writeln!(out, "success; {place}")?;
        return Ok(u8::from(!ended.recorded || !ended.reported));
    }
    let reason = result.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    writeln!(out, "{}{reason}", result.outcome)?;
    if !result.chain.is_empty() {
        writeln!(out, "  through {}", result.chain.join(" < "))?;
    }
    writeln!(out, "{place}")?;
    Ok(1)
}
