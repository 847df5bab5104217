//! `armarium world`: world files of the simulator.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_source::{Source, draw};

use crate::console::show;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct WorldArgs {
    #[command(subcommand)]
    command: WorldCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum WorldCommand {
    /// Print a world whose ranges have become values, as a run with this seed sees it.
    #[command(
        after_help = "A range is written `{from: 2 kg, to: 3 kg}`, `{from: 1, to: 4, step: 1}` or `{one_of: [ellipse, eight]}`.\n\n\
        Example: armarium world random kitchen.world.yaml --seed 3 > kitchen-3.world.yaml"
    )]
    Random {
        /// The world file.
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// The seed.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
}

/// Prints to `out`. Returns the exit status: 0, or 2 when the file is wrong.
pub(crate) fn run(args: &WorldArgs, out: &mut dyn Write) -> io::Result<u8> {
    let WorldCommand::Random { file, seed } = &args.command;
    let drawn = Source::read(file).map_err(|finding| vec![*finding]).and_then(|source| draw(source, *seed));
    let read = drawn.and_then(|drawn| drawn.read::<armarium_simulator::World>().map(|_| drawn));
    match read {
        Ok(drawn) => write!(out, "{}", drawn.text()).map(|()| 0),
        Err(findings) => show(&findings, &mut io::stderr()).map(|()| 2),
    }
}
