//! Why a run or an agent cannot start or continue. Nothing has moved, unless the error says so.

use std::path::PathBuf;

use armarium_bus::SessionError;
use armarium_memoryx::MemoryError;
use armarium_robot::RobotError;
use armarium_robot::driver::DriverError;
use armarium_runtime::remote::ServeError;
use armarium_runtime::skill::InputError;
use armarium_simulator::SimulationError;
use armarium_source::Finding;
use armarium_viewer::recorder::RecorderError;

/// Why a run or an agent cannot start or continue.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HostError {
    /// A chart, world or other file has errors.
    #[error("{}", .0.iter().find(|f| f.is_error()).map_or_else(String::new, ToString::to_string))]
    Findings(Vec<Finding>),
    /// The world has no agent of that name.
    #[error("the world `{world}` has no agent `{name}` (it has {known}); give its file with --world")]
    UnknownAgent {
        /// The world.
        world: String,
        /// The requested name.
        name: String,
        /// The agents of the world.
        known: String,
    },
    /// Robot and world do not fit together.
    #[error("the world cannot be simulated: {0}")]
    Simulation(#[from] SimulationError),
    /// The memory refuses.
    #[error("memory: {0}")]
    Memory(#[from] MemoryError),
    /// The network fails.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another process uses the name.
    #[error("there is an agent called `{name}` already: choose another --name")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// Nobody shows a live page under that name.
    #[error(
        "no agent called `{agent}` shows a live page; `armarium run CHART --name {agent} --live` does (on another machine: also --listen there, and --connect here)"
    )]
    NoLivePage {
        /// The agent.
        agent: String,
    },
    /// A chart needs another agent, and there is no session.
    #[error("`{name}` is at another agent: give --connect tcp/HOST:PORT or --listen")]
    NotConnected {
        /// The name in the chart.
        name: String,
    },
    /// An input cannot be read.
    #[error("--set {name}={text}: {why}")]
    Input {
        /// The input.
        name: String,
        /// The given text.
        text: String,
        /// The reason.
        why: String,
    },
    /// An input of the chart that a world's robot runs cannot be read.
    #[error("robot `{robot}`: inputs: {name}: `{text}`: {why}")]
    RobotInput {
        /// The robot.
        robot: String,
        /// The input.
        name: String,
        /// The given text.
        text: String,
        /// The reason.
        why: String,
    },
    /// The inputs do not fit the chart.
    #[error(transparent)]
    Inputs(#[from] InputError),
    /// A file or folder cannot be used.
    #[error("{what} `{path}`: {source}")]
    File {
        /// The file's role, and the failed operation.
        what: &'static str,
        /// Its path.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder holds runs of another chart, with other arguments, or with files that have changed since.
    #[error(
        "`{path}` holds another sweep, or its chart, world or robot has changed since: give another --out, or remove it"
    )]
    OtherSweep {
        /// The folder.
        path: PathBuf,
    },
    /// The first run of a sweep with some inputs refused its files or arguments.
    #[error("the first run cannot begin, and the sweep ends: {said}")]
    Refused {
        /// What it said.
        said: String,
    },
    /// Another run writes to the folder.
    #[error("another run writes its report to `{path}`: wait for its end, or give another --report")]
    ReportInUse {
        /// The folder.
        path: PathBuf,
    },
    /// The record of a run cannot be read.
    #[error("{}, line {line}: {why}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// The reason.
        why: String,
    },
    /// The live page cannot be served.
    #[error("the live page cannot listen at {address}: {source}; `--live-port 0` takes a port that is free")]
    Live {
        /// The address.
        address: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The recording cannot be written.
    #[error("the recording cannot be written: {0}")]
    Recorder(#[from] RecorderError),
    /// Required images are not available.
    #[error("the images `{provider}` cannot be used: {why}")]
    Images {
        /// The provider.
        provider: String,
        /// The reason.
        why: String,
    },
    /// The robot's driver cannot be used.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// The robot cannot be used as asked.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Something that a run whose robot is not simulated cannot have.
    #[error("a run with --driver or --robot-at: {0}")]
    Driven(&'static str),
    /// Another agent of the world cannot be started, or has ended.
    #[error("{0}")]
    OtherAgent(String),
    /// A chart or skill cannot be offered to others.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The operating system reports an error.
    #[error("{0}")]
    System(#[from] std::io::Error),
}
