//! Why a run or an agent cannot begin, or cannot go on. Nothing has moved unless it says so.

use std::path::PathBuf;

use armarium_bus::SessionError;
use armarium_memoryx::MemoryError;
use armarium_runtime::remote::ServeError;
use armarium_runtime::skill::InputError;
use armarium_simulator::SimulationError;
use armarium_source::Finding;
use armarium_viewer::recorder::RecorderError;

/// Why a run or an agent cannot begin, or cannot go on.
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
        /// Who is asked for.
        name: String,
        /// Who there is.
        known: String,
    },
    /// Robot and world do not fit.
    #[error("the world cannot be simulated: {0}")]
    Simulation(#[from] SimulationError),
    /// Memory refuses.
    #[error("memory: {0}")]
    Memory(#[from] MemoryError),
    /// The network refuses.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another process has the name.
    #[error("there is an agent called `{name}` already: choose another --name")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// A chart needs another agent, and nothing says where it is.
    #[error("`{name}` is at another agent: give --connect tcp/HOST:PORT or --listen")]
    NotConnected {
        /// What the chart names.
        name: String,
    },
    /// An input cannot be read.
    #[error("--set {name}={text}: {why}")]
    Input {
        /// The input.
        name: String,
        /// What was given.
        text: String,
        /// What is wrong with it.
        why: String,
    },
    /// The inputs do not fit the chart.
    #[error(transparent)]
    Inputs(#[from] InputError),
    /// A file or folder cannot be used.
    #[error("{what} `{path}`: {source}")]
    File {
        /// What it is, and what was to be done with it.
        what: &'static str,
        /// Where it is.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The record of a run cannot be read.
    #[error("{}, line {line}: {why}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// What is wrong with it.
        why: String,
    },
    /// The recording cannot be written.
    #[error("the recording cannot be written: {0}")]
    Recorder(#[from] RecorderError),
    /// Images that are needed cannot be had.
    #[error("the images `{provider}` cannot be used: {why}")]
    Images {
        /// Who offers them, or is to.
        provider: String,
        /// Why not.
        why: String,
    },
    /// Another agent of the world cannot be started, or has ended.
    #[error("{0}")]
    OtherAgent(String),
    /// What is offered to others cannot be offered.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The operating system refuses.
    #[error("{0}")]
    System(#[from] std::io::Error),
}
