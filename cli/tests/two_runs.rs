//! Two runs at the same time in one folder: both run to their end, each with a report of its own, and one store keeps what both
//! have learned.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

const CHART: &str = "statechart: Nod
inputs: {far: {type: float, unit: m, default: 0.6}}
initial: Look
states:
  Look: {skill: LookAt, with: {point: \"${[0.2, inputs.far, 1.0]}\"}, transitions: {success: Wait, failure: Failed}}
  Wait: {after: {20s: Done}}
  Done: {final: success}
  Failed: {final: failure}
";

fn start(folder: &Path, args: &[&str]) -> Child {
    let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
    program.current_dir(folder).args(["run", "nod.yaml"]).args(args);
    program.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts")
}

fn report(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("report.json")).expect("there is a report");
    serde_json::from_str(&text).expect("it is JSON")
}

#[test]
fn two_runs_in_one_folder_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("nod.yaml"), CHART).expect("it can be written");
    let runs: Vec<Child> = ["1", "2", "3"]
        .map(|seed| {
            start(
                folder.path(),
                &["--seed", seed, "--set", &format!("far=0.{seed}5"), "--record", &format!("{seed}.jsonl")],
            )
        })
        .into();
    let mut said = Vec::new();
    for run in runs {
        let output = run.wait_with_output().expect("it ends");
        let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert_eq!(output.status.code(), Some(0), "{text}");
        said.push(text);
    }
    let mut seeds = Vec::new();
    for name in ["report", "report-2", "report-3"] {
        let report = report(&folder.path().join(name));
        seeds.push(report["seed"].as_u64().expect("a seed"));
        assert_eq!(
            report["inputs"]["far"].as_f64(),
            Some([0.15, 0.25, 0.35][seeds[seeds.len() - 1] as usize - 1])
        );
        assert!(
            folder.path().join(name).join("run.mcap").exists()
                && folder.path().join(name).join("report.html").exists()
        );
        assert!(
            said.iter().any(|text| text.contains(&format!("the report is {name}/report.html"))),
            "{said:?}"
        );
    }
    seeds.sort_unstable();
    assert_eq!(seeds, [1, 2, 3]);
    // A run alone gives the same as one beside others.
    let beside = folder.path().join("report");
    let seed = report(&beside)["seed"].to_string();
    let output =
        start(folder.path(), &["--seed", &seed, "--set", &format!("far=0.{seed}5"), "--report", "alone"])
            .wait_with_output();
    assert!(output.expect("it ends").status.success());
    assert_eq!(report(&beside)["trace_sha256"], report(&folder.path().join("alone"))["trace_sha256"]);
}
