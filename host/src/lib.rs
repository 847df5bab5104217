//! An agent as a process: its connection, memory, robot, cameras and skills put together, the run of a chart, and the report.
//!
//! - [`run()`]: runs a chart with the simulated robot, from its files to its report.
//! - [`agent`]: offers charts, skills, memory and cameras to others.
//! - [`catalog`]: the skills and channels that charts may name.
//! - [`image_coding`]: images in a memory as JPEG files.
//! - [`cameras`]: simulated cameras in a process of their own. [`replay`]: replays a recorded run.
//! - [`mod@sweep`]: many runs of a chart, and how many hold. [`mod@bench`]: one skill under test, in a few lines.
//! - [`Console`]: the output for people.
//!
//! The program `armarium` reads a command line and starts what is here; a program of your own does the same with its
//! own skills (see `examples/own_agent.rs`). This room prints nothing and reads no command line.

mod address;
pub mod agent;
mod agent_config;
mod backend;
pub mod bench;
pub mod cameras;
pub mod catalog;
pub mod charts;
pub mod connection;
mod console;
mod driven;
mod error;
mod frame_sampler;
pub mod image_coding;
mod live;
mod live_service;
mod memory_log;
mod names;
mod network;
mod other_agents;
mod other_robots;
mod recording;
mod remote_eyes;
pub mod replay;
mod report;
mod report_folder;
mod robot_service;
pub mod run;
mod run_config;
mod run_log;
mod side_tasks;
mod signals;
pub mod simulated;
pub mod sweep;
mod told_scene;
mod world_file;

pub use address::{Address, AddressError};
pub use agent::run_agent;
pub use agent_config::AgentConfig;
pub use catalog::SkillFactory;
pub use connection::Connection;
pub use console::{Console, Silent, WorldClock};
pub use driven::RobotAt;
pub use error::HostError;
pub use live::OpenPage;
pub use live_service::RemoteRun;
pub use robot_service::RobotService;
pub use run::{RunEnded, run};
pub use run_config::{LiveOptions, RunConfig};
pub use world_file::WorldFile;
