//! Judges a run by its output folder. The exit status is 0 if the run succeeded, every figure of `report.json`
//! meets its requirement, and recomputing the figures from `run.mcap` alone gives the same values.
//!
//! Speed is not judged: it depends more on the machine than on a change.

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use armarium_simulator::referee::judged_figures;
use armarium_tests::recorded;
use armarium_values::report::Figure;
use serde_json::Value;

/// Sections in every report of the whole scenario.
const SECTIONS: [&str; 12] = [
    "grasp",
    "imitation",
    "force",
    "wiped_fraction",
    "coaching",
    "gestures",
    "outcome",
    "seed",
    "simulated_s",
    "wall_s",
    "real_time_factor",
    "trace_sha256",
];

/// Figures that every run of the whole scenario must have.
const NEEDED: [&str; 8] = [
    "position error",
    "frequency error",
    "path error, RMS",
    "error, RMS",
    "contact lost",
    "largest at touchdown",
    "wiped fraction",
    "right",
];

fn complaints(report: &Value, figures: &[Figure]) -> Vec<String> {
    let mut complaints = Vec::new();
    if report["outcome"] != "success" {
        complaints.push(format!("the run ended in {}: {}", report["outcome"], report["reason"]));
    }
    let absent = SECTIONS.iter().filter(|name| report.get(**name).is_none_or(Value::is_null));
    complaints.extend(absent.map(|name| format!("`{name}` is absent")));
    let unjudged = NEEDED.iter().filter(|name| !figures.iter().any(|figure| figure.name == **name));
    complaints.extend(unjudged.map(|name| format!("`{name}` cannot be judged")));
    let missed = figures.iter().filter(|figure| figure.passed() == Some(false));
    complaints.extend(
        missed.map(|f| {
            format!("{}, {}: {:?} {}, wanted {:?}", f.group, f.name, f.value, f.unit, f.requirement)
        }),
    );
    complaints
}

fn show(out: &mut impl Write, figures: &[Figure]) -> io::Result<()> {
    for figure in figures {
        let value = figure.value.map_or("-".to_owned(), |v| format!("{v:.*}", figure.digits));
        let verdict = match figure.passed() {
            Some(true) => "met",
            Some(false) => "MISSED",
            None => "",
        };
        writeln!(out, "{:24} {:26} {value:>9} {:3} {verdict}", figure.group, figure.name, figure.unit)?;
    }
    Ok(())
}

fn main() -> io::Result<ExitCode> {
    let mut out = io::stdout().lock();
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        writeln!(out, "usage: figures FOLDER")?;
        return Ok(ExitCode::from(2));
    };
    let report: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("report.json"))?)?;
    let figures = judged_figures(&report);
    show(&mut out, &figures)?;
    let mut complaints = complaints(&report, &figures);
    match recorded::read(&folder.join("run.mcap")) {
        Ok(run) => {
            complaints.extend(recorded::disagreements(&report, &run.figures()));
            writeln!(out, "computed again from {} recorded steps", run.log.records.len())?;
        }
        Err(why) => complaints.push(format!("the recording cannot be read: {why}")),
    }
    for complaint in &complaints {
        writeln!(out, "wrong: {complaint}")?;
    }
    Ok(if complaints.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn good() -> Value {
        json!({
            "outcome": "success", "seed": 1, "simulated_s": 150.0, "wall_s": 70.0, "real_time_factor": 2.1,
            "trace_sha256": "00", "wiped_fraction": 0.97, "coaching": [],
            "grasp": {"position_error_m": 0.004},
            "imitation": {"frequency_hz": 0.5, "demonstrated_frequency_hz": 0.5, "path_rms_m": 0.004},
            "force": {"mean_n": 8.0, "desired_n": 8.0, "rms_error_n": 0.5, "max_n": 10.0, "contact_lost_s": 0.0,
                      "touchdown_max_n": 12.0, "cycles": 8},
            "gestures": {"accuracy": 0.95},
        })
    }

    #[test]
    fn a_good_report_has_no_complaints_and_each_change_for_the_worse_has_one() {
        assert_eq!(complaints(&good(), &judged_figures(&good())), Vec::<String>::new());
        let worse = [
            ("/outcome", json!("failure")),
            ("/trace_sha256", Value::Null),
            ("/grasp/position_error_m", json!(0.016)),
            ("/imitation/frequency_hz", json!(0.506)),
            ("/force/contact_lost_s", json!(0.001)),
            ("/force/touchdown_max_n", json!(25.5)),
            ("/wiped_fraction", json!(0.949)),
            ("/gestures/accuracy", json!(0.89)),
        ];
        for (place, value) in worse {
            let mut report = good();
            *report.pointer_mut(place).expect("the place exists") = value;
            assert_eq!(complaints(&report, &judged_figures(&report)).len(), 1, "{place}");
        }
    }
}
