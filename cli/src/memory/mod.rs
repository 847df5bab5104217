//! `armarium memory`: reads, writes, follows, saves and repairs the memory of agents.
//!
//! Each command works on the memory of a running agent (`--agent`, over Zenoh) or on a long-term file that no process
//! has open (`--store`). This file reads the command line; [`reach`] finds the memory, [`work`] does the work,
//! [`show`] prints.

use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use crate::connection_args::{ConnectionArgs, explained};
use crate::failure::CommandFailure;
use crate::{logging, warnings};

mod following;
pub(crate) mod keep;
mod lag;
mod observe;
mod plot;
mod reach;
mod recording;
mod serve;
mod show;
mod top;
mod work;

/// The name of a memory without a given name.
const LOCAL: &str = "local";

#[derive(Clone, Debug, Args)]
pub(crate) struct MemoryArgs {
    /// The agent whose memory it is.
    #[arg(long, global = true, default_value = LOCAL, value_name = "NAME")]
    agent: String,
    /// The name of the writer, as in its certificate: a memory with access rules accepts commits only from known
    /// writers, into provider segments with their names.
    #[arg(long = "as", global = true, value_name = "NAME")]
    writer: Option<String>,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// A long-term file instead of a running agent.
    #[arg(long, global = true, value_name = "FILE")]
    store: Option<PathBuf>,
    /// Print JSON, one object per line, instead of tables.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: MemoryCommand,
}

impl MemoryArgs {
    /// Checks that no option needs a running agent, when a file is named.
    fn only_a_file(&self) -> Result<(), CommandFailure> {
        let asks_agent = self.command.others().iter().any(|name| reach::file_named(name).is_none());
        let wrong = if matches!(&self.command, MemoryCommand::Watch(watch) if watch.last == 0) {
            "a file that no agent has open does not change: --last N shows what changed last"
        } else if self.agent != LOCAL || (self.writer.is_some() && !asks_agent) {
            "--agent and --as name an agent, --store a file that no agent has open: leave one of them out"
        } else if !self.connection.connect.is_empty() && !asks_agent {
            "--connect reaches an agent, --store opens a file that none has open: leave one of them out"
        } else {
            return Ok(());
        };
        Err(CommandFailure::Argument(wrong.into()))
    }
}

#[derive(Clone, Debug, Subcommand)]
enum MemoryCommand {
    /// List entities: version, time, confidence and attributes.
    Ls(LsArgs),
    /// Show an entity, or its history.
    Get(GetArgs),
    /// Write an entity, or remove it.
    Put(PutArgs),
    /// Join what another program observes with what is known: a line of JSON on standard input for each observation.
    Observe(observe::ObserveArgs),
    /// Show changes as they come; with `--last`, first those that came last (of a file: only these).
    #[command(alias = "tail")]
    Watch(WatchArgs),
    /// Show who writes what, how fast, and what it takes: each owner of provider segments by core segment; whom the agent follows,
    /// and who in sight follows it. Every second until Ctrl-C.
    Top {
        /// Show one second, and end.
        #[arg(long)]
        once: bool,
    },
    /// Print the numbers of `stats` in OpenMetrics text, for programs that collect metrics.
    Metrics,
    /// Commit and remove an entity, and say how long that took. Exit status 1 when it fails.
    Health,
    /// Query by pattern, time, place and expression.
    Query(QueryArgs),
    /// Store the whole working memory under a name, and load it back.
    Snapshot(SnapshotArgs),
    /// Say how far the agent is behind those that it follows: entities, versions, since when, what was missed, and how far their
    /// clocks are ahead of its own. Exit status 1 when it is behind, or still looks for one of them.
    Lag,
    /// Say what has changed since a named snapshot was taken: added (+), removed (-) and changed (~) entities.
    Diff {
        /// The name of the earlier one.
        #[arg(value_name = "NAME")]
        from: String,
        /// The name of the later one; the present if not given.
        #[arg(value_name = "NAME")]
        to: Option<String>,
    },
    /// Draw an attribute over time, as SVG: a number, or the parts of a vector or a pose.
    Plot(PlotArgs),
    /// Copy long-term memory into a new file beside its own, while it is in use.
    Backup {
        /// The name of the copy.
        #[arg(value_name = "FILE")]
        name: String,
    },
    /// Write snapshots as JSON lines, or as a recording for Foxglove.
    Export(ExportArgs),
    /// Store the snapshots of JSON lines, with their versions; a file named by `--store` is created if it does not
    /// exist.
    Import {
        /// The file; `-` is standard input.
        file: PathBuf,
    },
    /// Join fragmented data and return free space.
    Compact,
    /// Read everything and check it.
    Verify,
    /// Count entities, snapshots and bytes.
    Stats,
    /// Remove what is too old or too much.
    Retain(RetainArgs),
    /// Draw conclusions from memory once: spatial relations between objects, or their usual places.
    Infer {
        /// What to conclude.
        what: Inferences,
    },
    /// Run the memory of an agent until Ctrl-C.
    Serve(serve::MemoryServeArgs),
}

impl MemoryCommand {
    /// The other memories that are asked, too.
    fn others(&self) -> &[String] {
        match self {
            Self::Ls(LsArgs { others, .. })
            | Self::Get(GetArgs { others, .. })
            | Self::Query(QueryArgs { others, .. }) => &others.beside,
            _ => &[],
        }
    }

    /// Whether it writes entities, or compares them with the present ones. Others read what is stored.
    fn needs_working_memory(&self) -> bool {
        match self {
            Self::Put(_) | Self::Observe(_) | Self::Watch(_) | Self::Infer { .. } | Self::Health => true,
            Self::Snapshot(args) => {
                matches!(args.command, SnapshotCommand::Save { .. } | SnapshotCommand::Load { .. })
            }
            Self::Diff { to, .. } => to.is_none(),
            _ => false,
        }
    }
}

/// The built-in inferences.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Inferences {
    /// Which object is on, in, near or left of which.
    SpatialRelations,
    /// Where objects are likely found, from all earlier days.
    UsualPlaces,
}

impl Inferences {
    fn inference(self) -> std::sync::Arc<dyn armarium_knowledge::Inference> {
        match self {
            Self::SpatialRelations => std::sync::Arc::new(armarium_knowledge::SpatialRelations),
            Self::UsualPlaces => std::sync::Arc::new(armarium_knowledge::UsualPlaces),
        }
    }
}

/// Which entities: `SEGMENT/PROVIDER/ENTITY`, each with `*` for anything; missing parts match anything.
#[derive(Clone, Debug, Args)]
struct PatternArg {
    /// For instance `ObjectInstances` or `ObjectInstances/*/cup*`.
    #[arg(default_value = "*")]
    pattern: String,
}

/// Other memories that answer the same question.
#[derive(Clone, Debug, Args)]
struct BesideArgs {
    /// Ask another memory, too, a running agent's or a file's (a name with `/` or `.redb` at its end), and say of each row whose it
    /// is. May be given several times.
    #[arg(long, value_name = "AGENT|FILE")]
    beside: Vec<String>,
}

#[derive(Clone, Debug, Args)]
struct LsArgs {
    #[command(flatten)]
    pattern: PatternArg,
    #[command(flatten)]
    others: BesideArgs,
}

#[derive(Clone, Debug, Args)]
struct GetArgs {
    /// The address, `SEGMENT/PROVIDER/ENTITY`.
    id: String,
    #[command(flatten)]
    others: BesideArgs,
    /// All versions that still exist, long-term memory included.
    #[arg(long)]
    history: bool,
    /// The state at this time, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS", conflicts_with = "history")]
    at: Option<u64>,
    /// The state just before this time, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS", conflicts_with_all = ["history", "at"])]
    before: Option<u64>,
    /// The newest N of them.
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
}

#[derive(Clone, Debug, Args)]
struct PutArgs {
    /// The address, `SEGMENT/PROVIDER/ENTITY`.
    id: String,
    /// An attribute: plain JSON or text, or `{"vector": {"frame": "root", "components": [0, 0, 1]}}`.
    #[arg(long = "set", value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// Confidence, 0 to 1.
    #[arg(long, default_value_t = 1.0)]
    confidence: f64,
    /// Refuse unless this is the newest version; 0: the entity must not exist.
    #[arg(long, value_name = "VERSION")]
    expect: Option<u64>,
    /// The time that the data describe, ns since 1970 (below a year: since the start of a simulated run); now if not given.
    #[arg(long, value_name = "NS")]
    time: Option<u64>,
    /// The memory removes the entity after this time, for instance `10s` or `2h`, if nobody writes it again.
    #[arg(long, value_name = "TIME", value_parser = read_ttl)]
    ttl: Option<Duration>,
    /// Remove the entity.
    #[arg(long, conflicts_with_all = ["set", "ttl"])]
    remove: bool,
}

#[derive(Clone, Debug, Args)]
struct WatchArgs {
    #[command(flatten)]
    pattern: PatternArg,
    /// Only snapshots for which a CEL expression is true.
    #[arg(long, value_name = "CEL")]
    filter: Option<String>,
    /// First the N entities that have changed last, as they are.
    #[arg(long, value_name = "N", default_value_t = 0)]
    last: usize,
    /// End after this many changes.
    #[arg(long, value_name = "N")]
    count: Option<usize>,
}

#[derive(Clone, Debug, Args)]
struct QueryArgs {
    #[command(flatten)]
    pattern: PatternArg,
    #[command(flatten)]
    others: BesideArgs,
    /// Only snapshots for which a CEL expression is true: `class == 'cup' && position.z > 0.8`.
    #[arg(long, value_name = "CEL")]
    filter: Option<String>,
    /// All versions instead of the newest.
    #[arg(long)]
    history: bool,
    /// Versions that describe this time or later, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS")]
    from: Option<u64>,
    /// Versions that describe this time or earlier, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS")]
    to: Option<u64>,
    /// The state at this time, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS", conflicts_with_all = ["history", "from", "to"])]
    at: Option<u64>,
    /// The state just before this time, ns since 1970; below a year, since the start of a simulated run.
    #[arg(long, value_name = "NS", conflicts_with_all = ["history", "from", "to", "at"])]
    before: Option<u64>,
    /// Include long-term memory.
    #[arg(long)]
    long_term: bool,
    /// The nearest to this point, m.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    near: Option<String>,
    /// How many of the nearest, of each memory that is asked.
    #[arg(long, default_value_t = 10, requires = "near", conflicts_with = "radius")]
    count: usize,
    /// All within this distance of the point, m, instead of the nearest.
    #[arg(long, value_name = "M", requires = "near", allow_negative_numbers = true)]
    radius: Option<f64>,
    /// All inside this box, m.
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, conflicts_with = "near")]
    in_box: Option<String>,
    /// The frame of points and boxes.
    #[arg(long, default_value = "root")]
    frame: String,
    /// At most N of each entity, the newest.
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// At most N snapshots of each memory that is asked.
    #[arg(long, value_name = "N")]
    most: Option<usize>,
}

#[derive(Clone, Debug, Args)]
struct SnapshotArgs {
    #[command(subcommand)]
    command: SnapshotCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum SnapshotCommand {
    /// Store working memory under a name.
    Save {
        /// The name.
        name: String,
    },
    /// Restore the named content in working memory.
    Load {
        /// The name.
        name: String,
    },
    /// List the names.
    Ls,
    /// Forget a name.
    Rm {
        /// The name.
        name: String,
    },
}

#[derive(Clone, Debug, Args)]
struct PlotArgs {
    /// The address and the attribute, `SEGMENT/PROVIDER/ENTITY.ATTRIBUTE`.
    #[arg(value_name = "ENTITY.ATTRIBUTE")]
    what: String,
    /// The file; standard output if not given.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Debug, Args)]
struct ExportArgs {
    #[command(flatten)]
    pattern: PatternArg,
    /// The file; standard output if not given. A file `*.mcap` is a recording in Foxglove's schemas.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Debug, Args)]
#[group(required = true, multiple = true)]
struct RetainArgs {
    /// How long snapshots are kept, days.
    #[arg(long, value_name = "DAYS", allow_negative_numbers = true)]
    days: Option<f64>,
    /// Most megabytes of records.
    #[arg(long, value_name = "MB", allow_negative_numbers = true)]
    megabytes: Option<f64>,
}

fn read_ttl(text: &str) -> Result<Duration, String> {
    crate::run::read_time(text)
        .map_err(|_| "a time greater than 0 is needed, in ms, s, min or h, for instance `10min`".into())
}

impl From<armarium_bus::SessionError> for CommandFailure {
    fn from(error: armarium_bus::SessionError) -> Self {
        use armarium_bus::SessionError;
        match &error {
            SessionError::OffLoopback { .. } | SessionError::Config { .. } => {
                Self::Argument(explained(&error))
            }
            _ => Self::Refused(explained(&error)),
        }
    }
}

impl From<armarium_host::HostError> for CommandFailure {
    fn from(error: armarium_host::HostError) -> Self {
        match error {
            armarium_host::HostError::Session(error) => error.into(),
            armarium_host::HostError::Memory(error) => error.into(),
            error => Self::Refused(error.to_string()),
        }
    }
}

impl From<armarium_memoryx::MemoryError> for CommandFailure {
    fn from(error: armarium_memoryx::MemoryError) -> Self {
        use armarium_memoryx::MemoryError;
        match &error {
            MemoryError::Name { .. } | MemoryError::Query { .. } => Self::Argument(error.to_string()),
            _ => Self::Refused(error.to_string()),
        }
    }
}

impl From<armarium_memoryx::StoreError> for CommandFailure {
    fn from(error: armarium_memoryx::StoreError) -> Self {
        match &error {
            armarium_memoryx::StoreError::Locked { .. } => Self::Refused(format!(
                "{error}; or ask the agent that has it open, with --agent instead of --store"
            )),
            _ => Self::Refused(error.to_string()),
        }
    }
}

/// Executes a command. Returns the exit status: 0 when it was done, 1 when the memory refused or is damaged, 2 for an
/// invalid argument.
pub(crate) fn run(args: &MemoryArgs, out: &mut dyn Write, errors: &mut dyn Write) -> io::Result<u8> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    // A server prints the time of each log line.
    let serves = matches!(args.command, MemoryCommand::Serve(_));
    let done = match if serves { logging::install_dated() } else { warnings::show() } {
        Ok(()) => runtime.block_on(work::carry_out(args, out)),
        Err(what) => Err(CommandFailure::Argument(what)),
    };
    let status = done.or_else(|failure| failure.say(errors))?;
    // Tasks that still wait for the network end with the program.
    runtime.shutdown_background();
    Ok(status)
}
