//! An agent as a process: its connection, memory, robot, cameras and skills put together, the run of a chart, and the report.
//!
//! - [`run`]: a chart with the simulated robot, from its files to its report.
//! - [`agent`]: what others reach: charts, skills, memory and cameras.
//! - [`catalog`]: the skills and channels that charts may name.
//! - [`cameras`]: simulated cameras in a process of their own. [`replay`]: a recorded run, played again.
//! - [`Console`]: where all of them tell people how it goes.
//!
//! The program `armarium` reads a command line and starts what is here; a program of one's own does the same with skills of its
//! own (see `examples/own_agent.rs`). This room prints nothing and reads no command line.

pub mod agent;
mod backend;
pub mod cameras;
pub mod catalog;
mod company;
pub mod connection;
mod console;
mod error;
mod frame_sampler;
mod memory_log;
mod network;
mod recording;
mod remote_eyes;
pub mod replay;
mod report;
pub mod run;
mod run_log;
mod side_tasks;
pub mod simulated;
mod world_file;

pub use agent::{AgentConfig, run_agent};
pub use catalog::SkillFactory;
pub use connection::Connection;
pub use console::{Clock, Console, Silent};
pub use error::HostError;
pub use remote_eyes::{Eyes, EyesError};
pub use run::{RunConfig, RunEnded, run};
pub use world_file::WorldFile;
