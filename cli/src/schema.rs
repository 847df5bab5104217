//! `armarium schema world`: the JSON schema that editors check and complete files with.

use std::io::{self, Write};

use armarium_simulator::World;

/// What `schema` takes.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct SchemaArgs {
    /// Which schema.
    #[arg(value_enum)]
    pub(crate) of: SchemaOf,
}

/// What has a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum SchemaOf {
    /// A world file.
    World,
}

/// Writes the schema. Returns the exit status 0.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: SchemaArgs, out: &mut dyn Write) -> io::Result<u8> {
    let schema = match args.of {
        SchemaOf::World => World::schema(),
    };
    serde_json::to_writer_pretty(&mut *out, &schema)?;
    writeln!(out)?;
    Ok(0)
}
