//! `armarium schema world|chart|test|object|scene|robot`: the JSON schemas that editors check and complete files with.

use std::io::{self, Write};

use armarium_editor::FileKind;

#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct SchemaArgs {
    /// Which schema.
    #[arg(value_enum)]
    pub(crate) of: SchemaOf,
}

/// The kinds of files with a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum SchemaOf {
    /// A world file.
    World,
    /// A chart.
    Chart,
    /// Test cases of a chart.
    Test,
    /// An object class of prior knowledge.
    Object,
    /// A scene of prior knowledge.
    Scene,
    /// A robot file.
    Robot,
}

/// Writes the schema. Returns the exit status 0.
pub(crate) fn run(args: SchemaArgs, out: &mut dyn Write) -> io::Result<u8> {
    let kind = match args.of {
        SchemaOf::World => FileKind::World,
        SchemaOf::Chart => FileKind::Chart,
        SchemaOf::Test => FileKind::Test,
        SchemaOf::Object => FileKind::Object,
        SchemaOf::Scene => FileKind::Scene,
        SchemaOf::Robot => FileKind::Robot,
    };
    let schema = kind.schema(&armarium_host::catalog::idle_registry());
    serde_json::to_writer_pretty(&mut *out, &schema)?;
    writeln!(out)?;
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The schema stored beside the charts is the one that the program prints.
    #[test]
    fn the_schema_of_charts_is_fresh() {
        let mut out = Vec::new();
        run(SchemaArgs { of: SchemaOf::Chart }, &mut out).expect("memory can be written");
        let held = concat!(env!("CARGO_MANIFEST_DIR"), "/../statecharts/chart.schema.json");
        let held = std::fs::read_to_string(held).expect("the schema is there");
        let fresh = String::from_utf8(out).expect("text is UTF-8");
        assert!(held == fresh, "armarium schema chart > statecharts/chart.schema.json");
    }
}
