//! `armarium reproduce NAME`: runs an experiment of the papers and leaves its figures as JSON and its plots as SVG.
//!
//! Each experiment is a file of its own here: its settings with their defaults (`settings!`), and an
//! [`Experiment`](experiment::Experiment) that turns them into figures and plots. A new one needs a line in
//! [`all`] besides. The algorithms are those of `armarium-motion`; what stands here is the papers' set-up around them.

mod arm4;
mod coaching;
mod dpdmp;
mod dual_arm;
mod dual_arm_plots;
mod dual_arm_robot;
mod experiment;
mod force;
mod humanoid;
mod humanoid_arm;
mod humanoid_coach;
mod ilc;
mod ilc_plots;
mod oscillator;
mod phase;
mod planar;
mod servo;
mod settings;
#[cfg(test)]
mod tests;

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_values::expr::nearest;

use self::experiment::{Entry, Outcome, ReproduceError};
use self::settings::Key;

/// Every experiment that there is, in the order listed.
fn all() -> Vec<Entry> {
    vec![
        Entry::of::<coaching::Coaching>(),
        Entry::of::<oscillator::Oscillator>(),
        Entry::of::<dpdmp::Dpdmp>(),
        Entry::of::<ilc::Ilc>(),
        Entry::of::<force::Force>(),
        Entry::of::<servo::Servo>(),
        Entry::of::<dual_arm::DualArm>(),
        Entry::of::<humanoid::HumanoidCoaching>(),
    ]
}

/// What `reproduce` takes.
#[derive(Clone, Debug, clap::Args)]
#[command(after_long_help = long_listing())]
pub(crate) struct ReproduceArgs {
    /// The experiment; without it they are listed.
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// A setting, for instance `gamma=50`, `o=1.8,-0.6` or `psi=pi/4`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = settings::split)]
    pub(crate) settings: Vec<(String, String)>,
    /// Folder for NAME.json and the plots; made if it is not there.
    #[arg(long, value_name = "DIR", default_value = "reproduced")]
    pub(crate) out: PathBuf,
}

/// Runs the experiment. Returns the exit status: 0, 1 when it fails, 2 when its name or a setting is wrong.
///
/// # Errors
/// When `out` or the files cannot be written.
pub(crate) fn run(args: &ReproduceArgs, out: &mut dyn Write) -> io::Result<u8> {
    let entries = all();
    let Some(name) = &args.name else {
        write!(out, "{}", listing(&entries))?;
        return Ok(0);
    };
    let Some(entry) = entries.iter().find(|entry| entry.name == *name) else {
        let hint = nearest(name, entries.iter().map(|entry| entry.name));
        let hint =
            hint.map_or("`armarium reproduce` lists them".to_owned(), |n| format!("did you mean `{n}`?"));
        writeln!(out, "error: there is no experiment `{name}`: {hint}")?;
        return Ok(2);
    };
    match (entry.run)(&args.settings) {
        Ok((inputs, outcome)) => {
            let files = save(&args.out, entry.name, inputs, &outcome)?;
            summarise(entry.name, &outcome, &files, out)?;
            Ok(0)
        }
        Err(error) => {
            writeln!(out, "error: {name}: {error}")?;
            Ok(if matches!(error, ReproduceError::Setting { .. }) { 2 } else { 1 })
        }
    }
}

/// Writes the JSON and the plots and returns their paths.
fn save(dir: &Path, name: &str, inputs: serde_json::Value, outcome: &Outcome) -> io::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(dir)?;
    let mut json = serde_json::Map::new();
    json.insert("experiment".into(), name.into());
    json.insert("inputs".into(), inputs);
    json.extend(outcome.figures.clone());
    let path = dir.join(format!("{name}.json"));
    std::fs::write(&path, serde_json::to_string_pretty(&json)? + "\n")?;
    let mut paths = vec![path];
    for (stem, svg) in &outcome.plots {
        let path = dir.join(format!("{stem}.svg"));
        std::fs::write(&path, svg)?;
        paths.push(path);
    }
    Ok(paths)
}

/// The figures that are short enough for a terminal, and where the rest is.
fn summarise(name: &str, outcome: &Outcome, files: &[PathBuf], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{name}")?;
    for (figure, value) in &outcome.figures {
        let text = value.to_string();
        let text = if text.len() > 90 { "(in the JSON)" } else { &text };
        writeln!(out, "    {figure:<28} {text}")?;
    }
    for file in files {
        writeln!(out, "wrote {}", file.display())?;
    }
    Ok(())
}

fn listing(entries: &[Entry]) -> String {
    let mut text =
        "Experiments of the papers; `armarium reproduce --help` lists their settings.\n".to_owned();
    for entry in entries {
        text += &format!("    {:<18} {}\n", entry.name, entry.about);
    }
    text
}

fn long_listing() -> String {
    let mut text = "Experiments and their settings with defaults:\n".to_owned();
    for entry in all() {
        text += &format!("\n  {}: {}\n", entry.name, entry.about);
        for Key { name, default, doc } in &entry.keys {
            text += &format!("    {:<30} {doc}\n", format!("{name}={default}"));
        }
    }
    text
}
