//! The experiments of the papers: each takes settings and returns figures and plots.
//!
//! Each experiment is a file: its settings with their defaults (`settings!`), and an
//! `Experiment` that computes figures and plots from them. A new experiment also needs a line
//! in [`all`]. [`fingertips`] judges the tracking of hands before a simulated camera. The algorithms are those of `armarium-motion`; this room contains only the papers' set-up around them.
//! It prints nothing and knows no command line.

mod arm4;
mod coaching;
mod dpdmp;
mod dual_arm;
mod error;
mod experiment;
pub mod fingertips;
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

use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

pub use self::error::ExperimentError;
pub use self::experiment::{Entry, ExperimentResult};
pub use self::settings::SettingInfo;

/// All experiments, in the order listed.
pub fn all() -> Vec<Entry> {
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

/// Writes `NAME.json` with inputs and figures, and the plots, into a folder, which is created if it does not exist.
/// Returns the paths of the files.
///
/// # Errors
/// When a file cannot be written.
pub fn save(
    folder: &Path,
    name: &str,
    inputs: Value,
    outcome: &ExperimentResult,
) -> io::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)?;
    let mut json = Map::new();
    json.insert("experiment".into(), name.into());
    json.insert("inputs".into(), inputs);
    json.extend(outcome.figures.clone());
    let path = folder.join(format!("{name}.json"));
    std::fs::write(&path, serde_json::to_string_pretty(&json)? + "\n")?;
    let mut paths = vec![path];
    for (stem, svg) in &outcome.plots {
        let path = folder.join(format!("{stem}.svg"));
        std::fs::write(&path, svg)?;
        paths.push(path);
    }
    Ok(paths)
}
