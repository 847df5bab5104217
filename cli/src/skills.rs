//! `armarium skills`: prints the skills that charts can use, with inputs, outputs, outcomes and limbs.

use std::io::{self, Write};

use armarium_host::catalog;
use armarium_runtime::skill::{Parameter, SkillManifest};

/// Arguments of `skills`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct SkillsArgs {
    /// Only these skills.
    #[arg(value_name = "NAME")]
    pub(crate) names: Vec<String>,
}

/// Writes the manifests. Returns the exit status: 2 when a name is unknown.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &SkillsArgs, out: &mut dyn Write) -> io::Result<u8> {
    let registry = catalog::idle_registry();
    if let Some(unknown) = args.names.iter().find(|name| registry.manifest(name).is_none()) {
        writeln!(out, "there is no skill `{unknown}`; `armarium skills` lists them")?;
        return Ok(2);
    }
    for manifest in registry.manifests() {
        if args.names.is_empty() || args.names.contains(&manifest.name) {
            describe(manifest, out)?;
        }
    }
    Ok(0)
}

fn describe(manifest: &SkillManifest, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{}\n    {}", manifest.name, manifest.description)?;
    parameters("takes", &manifest.inputs, out)?;
    parameters("gives", &manifest.outputs, out)?;
    let lists =
        [("outcomes", &manifest.outcomes), ("events", &manifest.events), ("commands", &manifest.limbs)];
    for (title, names) in lists.into_iter().filter(|(_, names)| !names.is_empty()) {
        writeln!(out, "    {title}: {}", names.join(", "))?;
    }
    writeln!(out)
}

fn parameters(title: &str, list: &[Parameter], out: &mut dyn Write) -> io::Result<()> {
    for parameter in list {
        let default = parameter.default.as_ref().map_or_else(String::new, |d| format!(" = {}", d.to_json()));
        writeln!(
            out,
            "    {title} {}: {}{default}  {}",
            parameter.name, parameter.ty, parameter.description
        )?;
    }
    Ok(())
}
