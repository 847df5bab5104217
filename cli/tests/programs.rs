//! `import`, `step`, `check` and `test` as the programs that people and other programs start.
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const DOCUMENT: &str = "<scxml xmlns='http://www.w3.org/2005/07/scxml' version='1.0' initial='a'>
<state id='a'><transition event='t' target='b'/></state>
<state id='b' initial='b1'><state id='b1'><onentry><send event='late' delay='100ms'/></onentry>
<transition event='late' target='b-2'/></state><final id='b-2'/><transition event='done.state.b' target='end'/></state>
<final id='end'/></scxml>";

/// Starts the program in a folder, with `input` on its standard input.
fn armarium(folder: &Path, args: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_armarium"))
        .args(args)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program can be started");
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    child.wait_with_output().expect("it was started")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// The JSON lines on the standard output.
fn lines(output: &Output) -> Vec<serde_json::Value> {
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_document_is_imported_and_driven() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("demo.scxml"), DOCUMENT).unwrap();
    let imported = armarium(folder.path(), &["import", "demo.scxml"], "");
    assert!(imported.status.success() && imported.stderr.is_empty(), "{}", text(&imported.stderr));
    std::fs::write(folder.path().join("demo.yaml"), &imported.stdout).unwrap();

    let events =
        "{\"name\": \"t\"}\n{\"name\": \"unknown\", \"after_ms\": 99}\n{\"name\": \"x\", \"after_ms\": 1}\n";
    let steps = lines(&armarium(folder.path(), &["step", "demo.yaml", "--events", "-"], events));
    let active: Vec<&str> = steps.iter().map(|s| s["configuration"][0].as_str().unwrap()).collect();
    assert_eq!(active, ["a", "b1", "b1", "end"]);
    let names: Vec<Option<&str>> = steps.iter().map(|s| s["event"].as_str()).collect();
    assert_eq!(names, [None, Some("t"), Some("unknown"), Some("x")]);
    assert_eq!(steps[1]["states"], serde_json::json!(["b", "b1"]));

    std::fs::write(folder.path().join("events.jsonl"), "{\"name\": \"t\"}\n").unwrap();
    let driven = ["step", "demo.yaml", "--events", "events.jsonl", "--repeat", "3", "--quiet"];
    let driven = lines(&armarium(folder.path(), &driven, ""));
    assert_eq!((driven.len(), driven[0]["events"].as_u64()), (1, Some(3)));
    assert!(driven[0]["events_per_s"].is_number() && driven[0]["seconds"].is_number());
}

#[test]
fn a_skill_s_outcome_comes_from_its_state() {
    let folder = tempfile::tempdir().unwrap();
    let chart = "statechart: C\ninputs: {n: {type: int, default: 1}}\nlocals: {got: {type: int, default: 0}}\ninitial: A\nstates:\n  A: {skill: OpenHand, enter: [{assign: {locals.got: \"${inputs.n + 1}\"}}], transitions: {success: B, failure: B}}\n  B: {final: success}\n";
    std::fs::write(folder.path().join("c.yaml"), chart).unwrap();
    let args = ["step", "c.yaml", "--set", "n=4", "--events", "-"];
    let steps = lines(&armarium(folder.path(), &args, "{\"name\": \"success\", \"from\": \"A\"}\n"));
    assert_eq!(steps[0]["locals"]["got"], 5);
    assert_eq!(steps[1]["configuration"], serde_json::json!(["B"]));
}

#[test]
fn events_of_a_file_that_the_chart_does_not_take_are_errors_and_a_failed_run_has_status_1() {
    let folder = tempfile::tempdir().unwrap();
    let chart = "statechart: C\nevents: {go: {}}\ninitial: A\nstates:\n  A: {transitions: {go: B}}\n  B: {skill: OpenHand, transitions: {success: Done, failure: Failed}}\n  Done: {final: success}\n  Failed: {final: failure}\n";
    std::fs::write(folder.path().join("c.yaml"), chart).unwrap();
    let stepped = |events: &str| {
        std::fs::write(folder.path().join("e.jsonl"), events).unwrap();
        let output = armarium(folder.path(), &["step", "c.yaml", "--events", "e.jsonl"], "");
        (output.status.code(), text(&output.stderr))
    };
    let go = "{\"name\": \"go\"}\n";
    assert_eq!(stepped(go), (Some(0), String::new()));
    let (status, said) = stepped(&format!("{go}{{\"name\": \"goo\"}}\n"));
    assert!(
        status == Some(2) && said.starts_with("error: line 2 of the events: the chart takes no"),
        "{said}"
    );
    let (status, said) = stepped("{\"name\": \"success\", \"from\": \"B\"}\n");
    assert!(status == Some(2) && said.contains("`B` has no skill that runs"), "{said}");
    assert_eq!(stepped(&format!("{go}{{\"name\": \"failure\", \"from\": \"B\"}}\n")).0, Some(1));
}

#[test]
fn what_is_wrong_ends_with_status_2_and_is_json_where_that_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let chart = "statechart: C\ninitial: A\nstates: {A: {transitions: {go: B}}}\n";
    std::fs::write(folder.path().join("c.yaml"), chart).unwrap();
    let checked = armarium(folder.path(), &["check", "c.yaml", "--json"], "");
    assert_eq!(checked.status.code(), Some(2));
    let found: serde_json::Value = serde_json::from_slice(&checked.stdout).unwrap();
    assert!(found.as_array().unwrap().iter().all(|f| f["code"].is_string() && f["line"].is_u64()), "{found}");
    for args in
        [&["import", "c.yaml"][..], &["step", "c.yaml"], &["step", "nowhere.yaml"], &["replay", "c.yaml"]]
    {
        assert_eq!(armarium(folder.path(), args, "").status.code(), Some(2), "{args:?}");
    }
}

#[test]
fn a_run_in_the_simulator_is_recorded_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let chart = "statechart: Hand\ninitial: Open\nstates:\n  Open: {skill: OpenHand, transitions: {success: Rest, failure: Failed}}\n  Rest: {after: {200ms: Done}}\n  Done: {final: success}\n  Failed: {final: failure}\n";
    std::fs::write(folder.path().join("hand.yaml"), chart).unwrap();
    let ran =
        armarium(folder.path(), &["run", "hand.yaml", "--record", "run.jsonl", "--store", "s.redb"], "");
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let replayed = armarium(folder.path(), &["replay", "run.jsonl"], "");
    assert!(replayed.status.success(), "{}", text(&replayed.stdout));
    assert!(text(&replayed.stdout).contains("the same states"));
    let early = text(&armarium(folder.path(), &["replay", "run.jsonl", "--until", "1ms"], "").stdout);
    assert!(early.contains("active at the end: Open"), "{early}");

    // A chart that has been changed since is noticed, with the event at which it began to differ.
    std::fs::write(folder.path().join("hand.yaml"), chart.replace("success: Rest", "success: Done")).unwrap();
    let changed = armarium(folder.path(), &["replay", "run.jsonl"], "");
    assert_eq!(changed.status.code(), Some(1));
    assert!(text(&changed.stdout).contains("with event success from Open"), "{}", text(&changed.stdout));
}
