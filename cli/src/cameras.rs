//! `armarium cameras --name NAME`: the simulated cameras in a process of their own, for `run --cameras NAME`.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_bus::SessionConfig;
use armarium_host::Connection;
use armarium_host::cameras::{CamerasConfig, serve_cameras};

use crate::connection_args::{ConnectionArgs, explained};
use crate::console::{Terminal, refuse};
use crate::stopped::stopped;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct CamerasArgs {
    /// The name by which a run addresses them.
    #[arg(long)]
    pub(crate) name: String,
    /// The simulated world, the same as the run's; the default kitchen if not given.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// The run's seed.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

/// Renders the scenes of runs until Ctrl-C. Returns the exit status.
pub(crate) fn run(args: &CamerasArgs, out: &mut dyn Write) -> io::Result<u8> {
    let session = match args.connection.config() {
        Ok(session) => SessionConfig { shared_memory: true, ..session },
        Err(error) => return writeln!(out, "error: {}", explained(&error)).map(|()| 2),
    };
    let connection = match Connection::open(&session) {
        Ok(connection) => connection,
        Err(error) => return refuse(&error, out),
    };
    let config = CamerasConfig { name: args.name.clone(), world: args.world.clone(), seed: args.seed };
    let console = Terminal::for_notes(false);
    let served = connection.runtime().block_on(async {
        tokio::select! {
            biased;
            () = stopped() => Ok(()),
            failed = serve_cameras(&config, connection.session(), &console) => failed,
        }
    });
    match served {
        Ok(()) => Ok(0),
        Err(error) => refuse(&error, out),
    }
}
