//! `armarium agent --name NAME CHARTS...`: offers charts, skills, memory and cameras to other agents.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_host::{Address, AgentConfig, run_agent};
use armarium_knowledge::Followee;
use armarium_runtime::exec::RunResult;

use crate::connection_args::{AccessArgs, ConnectionArgs, LiveArgs, explained};
use crate::console::{Terminal, refuse};
use crate::logging;
use crate::memory::keep::KeepArgs;
use crate::stopped::{stopped, stopped_or_input_ended};
use crate::vision::Detector;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct AgentArgs {
    /// The name by which other agents call it.
    #[arg(long)]
    pub(crate) name: String,
    /// Charts to offer, or folders of charts. Skills are offered always.
    #[arg(value_name = "CHARTS")]
    pub(crate) offered: Vec<PathBuf>,
    /// Additional folders in which charts find other charts by name.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
    #[command(flatten)]
    pub(crate) access: AccessArgs,
    /// Images of another agent, used as the agent's eyes. The agent then has no robot, only skills that move nothing,
    /// and its pose is the one in the world file.
    #[arg(long, value_name = "AGENT/PROVIDER")]
    pub(crate) eyes: Option<Address>,
    /// A chart that the agent runs from the start; the agent ends with it.
    #[arg(long, value_name = "CHART")]
    pub(crate) run: Option<PathBuf>,
    /// An agent whose memory is followed as soon as it is available: its `ObjectInstances` and `ObjectRelations`, or
    /// the named core segment (`*`: all of them); may be repeated.
    #[arg(long, value_name = "AGENT[:SEGMENT]")]
    pub(crate) follow: Vec<Followee>,
    /// End when the standard input closes: for an agent that another process starts.
    #[arg(long)]
    pub(crate) while_input: bool,
    /// The simulated world that the agent's robot is in; the default kitchen if not given.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// Seed of all random variation in the world.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// How people's hands are found.
    #[arg(long, value_enum, default_value_t = Detector::Skin)]
    pub(crate) detector: Detector,
    /// The file of long-term memory. What was learned and what others committed is loaded again at the next start;
    /// what was seen can be queried. By default one snapshot a second is kept of what is seen and learned, and all of
    /// the rest.
    #[arg(long, value_name = "FILE", default_value = "armarium-agent.redb")]
    pub(crate) store: PathBuf,
    #[command(flatten)]
    pub(crate) kept: KeepArgs,
    #[command(flatten)]
    pub(crate) live: LiveArgs,
    /// Show what happens as lines of text.
    #[arg(short, long)]
    pub(crate) verbose: bool,
}

/// Serves until Ctrl-C. Returns the exit status: 0 when it was ended so, 1 when its chart has failed, 2 when it could
/// not start.
pub(crate) fn run(args: &AgentArgs, out: &mut dyn Write) -> io::Result<u8> {
    let config = match logging::check_environment().and_then(|()| config(args)) {
        Ok(config) => config,
        Err(message) => return writeln!(out, "error: {message}").map(|()| 2),
    };
    let while_input = args.while_input;
    let until = async move { if while_input { stopped_or_input_ended().await } else { stopped().await } };
    match run_agent(&config, &Terminal::for_notes(args.verbose), until) {
        Ok(None) => Ok(0),
        Ok(Some(ended)) => conclude(&ended, out),
        Err(error) => refuse(&error, out),
    }
}

fn config(args: &AgentArgs) -> Result<AgentConfig, String> {
    let mut config = AgentConfig::new(&args.name);
    config.offered.clone_from(&args.offered);
    config.charts.clone_from(&args.charts);
    config.run.clone_from(&args.run);
    config.world.clone_from(&args.world);
    config.seed = args.seed;
    config.hands = args.detector.into();
    config.eyes.clone_from(&args.eyes);
    config.follow.clone_from(&args.follow);
    config.store.clone_from(&args.store);
    config.policies = args.kept.policies(config.policies)?;
    config.retention = args.kept.retention()?;
    config.session = args.connection.config().map_err(|error| explained(&error))?;
    config.access = args.access.of(&args.name);
    let address = args.live.address(&args.connection).map_err(|error| error.to_string())?;
    config.live = Some(address).filter(|_| args.live.live);
    Ok(config)
}

/// Prints how the agent's own chart ended; returns the exit status.
fn conclude(ended: &RunResult, out: &mut dyn Write) -> io::Result<u8> {
    let reason = ended.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    writeln!(out, "the chart has ended: {}{reason}", ended.outcome)?;
    Ok(u8::from(ended.outcome != "success"))
}
