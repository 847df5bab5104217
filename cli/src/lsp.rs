//! `armarium lsp`: the language server for editors, on standard input and output.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_editor::{Catalog, serve_stdio};
use armarium_host::catalog;
use armarium_simulator::World;
use armarium_source::Finding;

use crate::console;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LspArgs {
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Worlds whose objects charts may name, besides those beside the chart.
    #[arg(long = "world", value_name = "FILE")]
    pub(crate) worlds: Vec<PathBuf>,
    /// Standard input and output are used in any case; some editors say so.
    #[arg(long, hide = true)]
    pub(crate) stdio: bool,
}

/// The skills and channels that ship, for reading their declarations, and the names that exist before a run, also in
/// `worlds`.
pub(crate) fn known(worlds: &[PathBuf]) -> Result<Catalog, Vec<Finding>> {
    let worlds: Vec<World> = worlds.iter().map(|file| World::load(file, 1)).collect::<Result<_, _>>()?;
    Ok(Catalog { registry: catalog::checking_registry(&worlds), channels: catalog::channels() })
}

/// Serves an editor until it says `exit`. Returns the exit status: 1 when the editor breaks the protocol, 2 when a world is
/// wrong.
pub(crate) fn run(args: &LspArgs, err: &mut dyn Write) -> io::Result<u8> {
    let known = match known(&args.worlds) {
        Ok(known) => known,
        Err(findings) => return console::show(&findings, err).map(|()| 2),
    };
    match serve_stdio(known, &args.charts) {
        Ok(()) => Ok(0),
        Err(error) => writeln!(err, "error: {error}").map(|()| 1),
    }
}
