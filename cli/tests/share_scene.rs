//! Two agents as two processes in one simulated world, who share what they know.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn armarium(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.current_dir(folder).args(args).output().expect("the program of this package can be started")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), output.stderr.as_slice()].concat()).into_owned()
}

fn chart(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../statecharts").join(name)
}

/// With either arm, both at once: most of it is waiting for the clock. In the mirrored world, Alice stands and sees as mirrored as
/// everything else.
#[test]
fn bob_grasps_by_what_alice_sees_and_alice_learns_that_he_holds_it() {
    std::thread::scope(|scope| {
        for side in ["right", "left"] {
            scope.spawn(move || grasps_with(side));
        }
    });
}

fn grasps_with(side: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = chart("share_scene.yaml").display().to_string();
    let arm = format!("arm={side}_arm");
    let files = ["--report", "report", "--store", "bob.redb"];
    let output = armarium(folder.path(), &[&["run", &chart, "--set", &arm][..], &files].concat());
    let log = std::fs::read_to_string(folder.path().join("report/alice.log")).unwrap_or_default();
    assert_eq!(output.status.code(), Some(0), "{}\nalice: {log}", said(&output));
    let text = std::fs::read_to_string(folder.path().join("report/report.json")).expect("a report");
    let report: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(report["outcome"], "success");
    let error_m = report["grasp"]["position_error_m"].as_f64().expect("the sponge was grasped");
    assert!(error_m < 0.015, "{error_m} m");

    let rows = report["memories"]["rows"].as_array().expect("both memories are in the report");
    let knows = |agent: &str, id: &str, says: &str| {
        rows.iter().find(|row| row["agent"] == agent && row["id"] == id && row["says"] == says)
    };
    let seen = knows("bob", "ObjectInstances/alice.alice/sponge", "seen").expect("Alice told Bob");
    assert_eq!(seen["origin"], "alice");
    assert!(seen["error_m"].as_f64().is_some_and(|e| e < 0.02), "{seen}");
    assert_eq!(knows("bob", "ObjectInstances/bob/sponge", "seen"), None, "his view is covered");
    let hand = format!("bob/{side}_hand");
    let held = knows("alice", "ObjectInstances/bob.bob/sponge", &format!("in {hand}"));
    let held = held.expect("Bob told Alice");
    assert_eq!(held["origin"], "bob");
    assert!(held["error_m"].as_f64().is_some_and(|e| e < 0.02), "{held}");
    // He carries it, and her memory carries it along.
    let carried =
        |row: &&Value| row["agent"] == "alice" && row["id"] == held["id"] && row["says"] == held["says"];
    let carried: Vec<&Value> = rows.iter().filter(carried).collect();
    let way = |row: &Value| row["position"][2].as_f64().expect("a place");
    assert!(way(carried[carried.len() - 1]) > way(carried[0]) + 0.04, "he lifts it further");
    let errors = carried.iter().map(|row| row["error_m"].as_f64().expect("the truth is known"));
    let worst = errors.fold(0.0, f64::max);
    assert!(worst < 0.01, "where it was carried, her memory was off by {worst} m");
    let relation = format!("sponge in {hand}");
    let about = format!("ObjectRelations/bob.bob/sponge-in-{side}_hand");
    assert!(knows("alice", &about, &relation).is_some());
}

/// A chart that waits, and a world with an agent who runs `watch`.
fn waiting(watch: Option<&str>) -> (tempfile::TempDir, Output) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("the folder can be written");
    };
    write("wait.yaml", "statechart: Wait\ninitial: Waiting\nstates: {Waiting: {}}\n");
    write(
        "wait.world.yaml",
        "world: two\nrobot: {name: bob}\nagents: [{name: alice, at: [0.3, 1.4, 1.5], runs: watch.yaml}]\n",
    );
    if let Some(watch) = watch {
        write("watch.yaml", watch);
    }
    let output = armarium(folder.path(), &["run", "wait.yaml"]);
    (folder, output)
}

#[test]
fn an_agent_that_ends_stops_the_run() {
    let watch = "statechart: Watch\ninitial: Waiting\nstates:\n  Waiting: {after: {5s: Failed}}\n  Failed: {final: failure}\n";
    let (folder, output) = waiting(Some(watch));
    let text = said(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("the agent `alice` has ended"), "{text}");
    assert!(folder.path().join("report/report.json").exists(), "{text}");
}

#[test]
fn an_agent_that_cannot_begin_is_said() {
    let (folder, output) = waiting(None);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("the agent `alice` has ended") && text.contains("alice.log"), "{text}");
    assert!(!folder.path().join("report/report.json").exists());
}
