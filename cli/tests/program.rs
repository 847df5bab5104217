//! The program as people use it: what it prints, what it leaves, and its exit status.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn armarium(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_armarium"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program of this package can be started")
}

fn status(output: &Output) -> i32 {
    output.status.code().expect("the program was not killed")
}

fn said(output: &Output) -> String {
    let text = [output.stdout.as_slice(), output.stderr.as_slice()].concat();
    String::from_utf8(text).expect("the program prints UTF-8")
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn report(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("report.json")).expect("the run left a report");
    serde_json::from_str(&text).expect("the report is JSON")
}

#[test]
fn the_charts_that_ship_are_in_order() {
    let charts = std::fs::read_dir(repository().join("statecharts")).expect("the folder is there");
    let mut files: Vec<String> = charts
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.extension().is_some_and(|e| e == "yaml"))
        .map(|path| path.display().to_string())
        .collect();
    files.sort();
    assert!(!files.is_empty());
    let args: Vec<&str> = ["check"].into_iter().chain(files.iter().map(String::as_str)).collect();
    let output = armarium(&repository(), &args);
    assert_eq!((status(&output), said(&output).trim()), (0, "all files are in order"));
}

#[test]
fn a_wrong_chart_is_said_with_place_and_remedy_and_nothing_moves() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = "statechart: Typo\ninitial: Go\nstates:\n  Go: {skill: MoveJoint, transitions: {success: Done, failure: Done}}\n  Done: {final: success}\n";
    std::fs::write(folder.path().join("typo.yaml"), chart).expect("the folder can be written");
    for command in ["check", "run"] {
        let output = armarium(folder.path(), &[command, "typo.yaml"]);
        let text = said(&output);
        assert_eq!(status(&output), 2, "{text}");
        assert!(text.contains("typo.yaml:4:15") && text.contains("did you mean `MoveJoints`?"), "{text}");
    }
    assert!(!folder.path().join("report").exists());
}

#[test]
fn a_wrong_input_is_an_error_of_the_command_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = repository().join("statecharts/wiping.yaml").display().to_string();
    for (given, expected) in [
        ("contact_forc=3", "did you mean `contact_force`?"),
        ("contact_force=99", "outside of the allowed range"),
        ("contact_force=3 m", "contact_force"),
    ] {
        let output = armarium(folder.path(), &["run", &chart, "--set", given]);
        assert_eq!(status(&output), 2, "{}", said(&output));
        assert!(said(&output).contains(expected), "{}", said(&output));
    }
}

#[test]
fn what_new_writes_is_in_order_runs_and_repeats() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let here = folder.path();
    assert_eq!(status(&armarium(here, &["new", "mine"])), 0);
    assert_eq!(status(&armarium(here, &["new", "mine"])), 2, "nothing is overwritten");
    assert_eq!(status(&armarium(here, &["check", "mine/chart.yaml", "mine/world.yaml"])), 0);
    let run = |name: &str| {
        let args = ["run", "mine/chart.yaml", "--world", "mine/world.yaml", "--report", name, "--seed", "7"];
        let output = armarium(here, &args);
        assert_eq!(status(&output), 0, "{}", said(&output));
        report(&here.join(name))
    };
    let (first, second) = (run("a"), run("b"));
    assert_eq!(first["outcome"], "success");
    assert_eq!(first["seed"], 7);
    assert_eq!(first["trace_sha256"].as_str().map(str::len), Some(64));
    assert_eq!(first["trace_sha256"], second["trace_sha256"], "the same seed gives the same run");
    for file in ["report.html", "run.mcap"] {
        assert!(here.join("a").join(file).metadata().is_ok_and(|m| m.len() > 1000), "{file} is there");
    }
}

#[test]
fn a_run_that_fails_says_why_and_through_which_states() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = "statechart: Far\ninitial: Go\nstates:\n  Go: {skill: LookAt, with: {point: [0.0, -5.0, 1.0], timeout: 1s}, transitions: {success: Done}}\n  Done: {final: success}\n";
    std::fs::write(folder.path().join("far.yaml"), chart).expect("the folder can be written");
    let output = armarium(folder.path(), &["run", "far.yaml", "--report", "out"]);
    assert_eq!(status(&output), 1, "{}", said(&output));
    let report = report(&folder.path().join("out"));
    assert_eq!(report["outcome"], "failure");
    assert!(report["reason"].as_str().is_some_and(|r| r.contains("out of the head's range")), "{report}");
    assert!(report["chain"].as_array().is_some_and(|c| c.iter().any(|s| s == "Go")), "{report}");
}

#[test]
fn skills_are_listed_and_unknown_ones_refused() {
    let output = armarium(&repository(), &["skills", "MoveTcp"]);
    assert_eq!(status(&output), 0);
    assert!(said(&output).contains("takes target: Pose"), "{}", said(&output));
    assert_eq!(status(&armarium(&repository(), &["skills", "Fly"])), 2);
}
