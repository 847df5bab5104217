//! `armarium run CHART`: checks the chart, runs it in the simulator, and writes recording and report.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_host::{RunConfig, RunEnded};

use crate::connection_args::{ConnectionArgs, explained};
use crate::console::{Terminal, refuse};
use crate::logging;

/// Arguments of `run`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RunArgs {
    /// The chart to run.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// The simulated world; if not given, NAME.world.yaml beside the chart NAME.yaml, or else the default kitchen.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// Seed of all random variation.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder for report.json, report.html and run.mcap.
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub(crate) report: PathBuf,
    /// The long-term store of motions.
    #[arg(long, value_name = "FILE", default_value = "armarium.redb")]
    pub(crate) store: PathBuf,
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
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
    /// Record the run for `armarium replay`.
    #[arg(long, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,
    /// Print events as lines of text.
    #[arg(short, long)]
    pub(crate) verbose: bool,
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

/// Runs the chart and prints to `out`. Returns the exit status: 0 success, 1 a failed run, 2 an invalid file or
/// argument.
///
/// # Errors
/// When `out` or a report cannot be written.
pub(crate) fn run(args: &RunArgs, out: &mut dyn Write) -> io::Result<u8> {
    if let Err(error) = logging::check_environment() {
        return writeln!(out, "error: {error}").map(|()| 2);
    }
    let session = match args.connection.config() {
        Ok(session) => Some(session).filter(|_| args.connection.is_given()),
        Err(error) => return writeln!(out, "error: {}", explained(&error)).map(|()| 2),
    };
    let config = RunConfig {
        charts: args.charts.clone(),
        world: args.world.clone(),
        seed: args.seed,
        inputs: args.inputs.clone(),
        profile: args.profile.clone(),
        report: args.report.clone(),
        store: args.store.clone(),
        record: args.record.clone(),
        real_time: args.speed == Speed::RealTime,
        name: args.name.clone(),
        cameras: args.cameras.clone(),
        session,
        program: std::env::current_exe().ok(),
        ..RunConfig::new(&args.chart)
    };
    match armarium_host::run(&config, &Terminal::with_progress(args.verbose)) {
        Ok(ended) => conclude(&ended, &args.report, out),
        Err(error) => refuse(&error, out),
    }
}

/// Prints how the run ended and where its report is.
fn conclude(ended: &RunEnded, folder: &Path, out: &mut dyn Write) -> io::Result<u8> {
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
    let result = &ended.result;
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
