//! Charts that observe memory, run for real: what this robot sees itself, and what another agent in another process sees.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn armarium(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.current_dir(folder).args(args).output().expect("the program of this package can be started")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), output.stderr.as_slice()].concat()).into_owned()
}

fn chart(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../statecharts");
    folder.join(name).display().to_string()
}

fn report(folder: &Path, name: &str) -> Value {
    let text = std::fs::read_to_string(folder.join(name).join("report.json")).expect("a report");
    serde_json::from_str(&text).expect("JSON")
}

fn place(report: &Value, output: &str) -> [f64; 3] {
    let of = &report["outputs"][output];
    assert_eq!(of["frame"], "root", "{report}");
    std::array::from_fn(|axis| of["components"][axis].as_f64().expect("three numbers"))
}

#[test]
fn a_chart_waits_until_somebody_moves_a_cup_and_its_run_is_repeatable_and_replays() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = chart("await_cup.yaml");
    let mut digests = Vec::new();
    for name in ["first", "second"] {
        let record = format!("{name}.run");
        let files = ["--report", name, "--store", "local.redb", "--record", &record];
        let output = armarium(folder.path(), &[&["run", &chart][..], &files].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        let report = report(folder.path(), name);
        let (from, to) = (place(&report, "from"), place(&report, "to"));
        // The cup stands at (0.25, 0.74) on a table of 0.95 m; the person pushes it towards the robot.
        assert!((from[0] - 0.25).abs() < 0.03 && (from[1] - 0.74).abs() < 0.03, "{from:?}");
        assert!(from[1] - to[1] > 0.1, "{from:?} {to:?}");
        digests.push((report["trace_sha256"].clone(), report["outputs"].clone()));
        let replayed = armarium(folder.path(), &["replay", &record]);
        assert_eq!(replayed.status.code(), Some(0), "{}", said(&replayed));
    }
    assert_eq!(digests[0], digests[1]);
}

#[test]
fn a_chart_acts_on_what_another_agent_sees() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = chart("reach_told.yaml");
    let output = armarium(folder.path(), &["run", &chart, "--report", "report", "--store", "bob.redb"]);
    let log = std::fs::read_to_string(folder.path().join("report/alice.log")).unwrap_or_default();
    assert_eq!(output.status.code(), Some(0), "{}\nalice: {log}", said(&output));
    let report = report(folder.path(), "report");
    assert_eq!(report["outputs"]["told"]["id"], "ObjectInstances/alice.alice/sponge");
    // Where the sponge of the default world stands, in Bob's frame, although Alice has another.
    let at = place(&report, "at");
    assert!((at[0] - 0.35).abs() < 0.03 && (at[1] - 0.50).abs() < 0.03, "{at:?}");
}

#[test]
fn the_cases_beside_these_charts_take_every_transition() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cases = ["await_cup.test.yaml", "reach_told.test.yaml"].map(chart);
    let output = armarium(folder.path(), &["test", "--complete", &cases[0], &cases[1]]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}
