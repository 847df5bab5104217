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
    assert_eq!(status(&armarium(here, &["check", "mine/chart.yaml", "mine/chart.world.yaml"])), 0);
    let run = |name: &str| {
        let args = ["run", "mine/chart.yaml", "--report", name, "--seed", "7"];
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

/// A folder with a chart that declares a channel, one that uses it, and one that cannot be read.
fn charts() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("it can be written");
    };
    write(
        "dock.yaml",
        "statechart: Dock\ndescription: >\n  Drives to\n  the dock.\ninputs: {speed: {type: float, unit: m/s, default: 0.2, description: How fast.}}\n\
         outputs: {volts: {type: float, unit: V}}\nevents: {go: {}}\n\
         channels: {battery: {description: The accumulator., type: {volts: {type: float, unit: V, description: at rest}}}}\n\
         initial: A\nstates:\n  A: {watch: {full: \"channels.battery.volts > 12.0\"}, transitions: {go: Done, full: Full}}\n\
         \x20 Full: {final: full}\n  Done: {final: success}\n",
    );
    write("broken.yaml", "statechart: Broken\nstates: [\n");
    std::fs::create_dir(folder.path().join("more")).expect("it can be made");
    write(
        "more/see.yaml",
        "statechart: See\ninitial: A\nstates:\n  A: {after: {1s: B}}\n  B: {final: success}\n",
    );
    folder
}

#[test]
fn charts_within_reach_are_listed_beside_the_skills() {
    let folder = charts();
    let output = armarium(folder.path(), &["skills", "Dock"]);
    let expected = "Dock  (chart, ./dock.yaml)\n    Drives to the dock.\n    takes speed: float in m/s = 0.2  How fast.\n    \
                    gives volts: float in V  \n    outcomes: success, failure, full\n    takes the events: go\n\n";
    assert_eq!((status(&output), said(&output).as_str()), (0, expected));
    assert!(said(&armarium(folder.path(), &["skills"])).contains("./broken.yaml is no chart as it is"));
    let output = armarium(folder.path(), &["skills", "Dock", "See", "MoveTcp", "--json", "--charts", "more"]);
    let json: Value = serde_json::from_slice(&output.stdout).expect("it is JSON");
    let kinds: Vec<_> =
        json.as_array().expect("a list").iter().map(|one| (&one["kind"], &one["name"])).collect();
    assert_eq!(
        format!("{kinds:?}"),
        r#"[(String("skill"), String("MoveTcp")), (String("chart"), String("Dock")), (String("chart"), String("See"))]"#
    );
    assert_eq!(json[1]["outcomes"], serde_json::json!(["success", "failure", "full"]));
    assert_eq!((&json[1]["inputs"][0]["name"], &json[1]["file"]), (&"speed".into(), &"./dock.yaml".into()));
    let output = armarium(folder.path(), &["skills", "See"]);
    assert_eq!(status(&output), 2, "it is in another folder");
    assert_eq!(status(&armarium(folder.path(), &["skills", "--charts", "nowhere"])), 2);
}

#[test]
fn channels_are_listed_with_who_publishes_and_who_reads_them() {
    let folder = charts();
    let output = armarium(folder.path(), &["channels"]);
    let text = said(&output);
    assert_eq!(status(&output), 0);
    for part in [
        "battery\n    The accumulator.\n    channels.battery.volts: float in V  at rest\n    declared by: Dock\n    read by: chart Dock\n",
        "published by: ExecuteMotion, ForceAdaptation, ImitateMotion, PlayMotion\n    read by: BodyCoaching, observer of `hand`\n",
        "channels.wrist.push: list<float in N>",
        "published by: observer of `hand`\n    read by: ExecuteMotion, GazeSelection, VisionCoaching\n",
        "ObjectInstances  (in memory; `observe: {NAME: \"ObjectInstances/*/*\"}`)\n    Things that were seen",
        "channels.NAME.pose: Pose  pose of the object",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let json: Value =
        serde_json::from_slice(&armarium(folder.path(), &["channels", "--json"]).stdout).expect("it is JSON");
    let battery = &json.as_array().expect("a list")[0];
    assert_eq!(
        (&battery["name"], &battery["fields"][0]["unit"], &battery["read_by"][0]),
        (&"battery".into(), &"V".into(), &"chart Dock".into())
    );
    assert_eq!(status(&armarium(folder.path(), &["channels", "--charts", "nowhere"])), 2);
}

#[test]
fn a_sweep_runs_each_seed_and_value_once_and_says_how_many_held() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = "statechart: Wait\ninputs:\n  long: {type: duration, default: 1s}\ninitial: A\nstates:\n  \
                 A: {after: {\"${inputs.long}\": B, 2s: Late}}\n  B: {final: success}\n  Late: {final: failure}\n";
    std::fs::write(folder.path().join("wait.yaml"), chart).expect("it can be written");
    let world = "world: w\nobjects: [{name: cup, at: [0.3, 0.5], mass: {from: 0.1 kg, to: 0.2 kg}}]\n";
    std::fs::write(folder.path().join("wait.world.yaml"), world).expect("it can be written");
    let args = ["sweep", "wait.yaml", "--seeds", "1..2", "--set", "long=1s,3s", "--jobs", "2"];
    let output = armarium(folder.path(), &args);
    assert_eq!(status(&output), 1, "{}", said(&output));
    assert!(said(&output).contains("2 of 2 held: 100.0 % (34.2 to 100.0 %)  long=1s"), "{}", said(&output));
    assert!(said(&output).contains("0 of 2 held: 0.0 % (0.0 to 65.8 %)  long=3s"), "{}", said(&output));
    let page = std::fs::read_to_string(folder.path().join("sweep/sweep.html")).expect("the page is there");
    assert!(page.contains("href=\"long-3s-seed-1/report.html\""));
    // It goes on where it was ended: what has run does not run again, a further seed does.
    let more = ["sweep", "wait.yaml", "--seeds", "1..3", "--set", "long=1s", "--json"];
    let output = armarium(folder.path(), &more);
    let lines: Vec<Value> =
        said(&output).lines().map(|line| serde_json::from_str(line).expect("it is JSON")).collect();
    assert_eq!(
        (status(&output), lines.len(), &lines[0]["seed"], &lines[1]["rate"]["held"]),
        (0, 2, &3.into(), &3.into())
    );
    let other = armarium(folder.path(), &["sweep", "wait.yaml", "--seeds", "1", "--for", "1min"]);
    assert_eq!(status(&other), 2);
    assert!(said(&other).contains("holds another sweep"), "{}", said(&other));

    let wrong = ["sweep", "wait.yaml", "--seeds", "1..3", "--set", "long=maybe", "--out", "wrong"];
    let ended = armarium(folder.path(), &wrong);
    assert_eq!(status(&ended), 2, "{}", said(&ended));
    assert!(said(&ended).contains("--set long=maybe") && !said(&ended).contains("[1/3]"), "{}", said(&ended));

    let bounded = ["sweep", "wait.yaml", "--seeds", "1", "--for", "500ms", "--out", "short", "--json"];
    let output = armarium(folder.path(), &bounded);
    let last = said(&output).lines().last().map(str::to_owned).expect("a line with the rates");
    let last: Value = serde_json::from_str(&last).expect("it is JSON");
    assert_eq!((status(&output), &last["rate"]["held"], &last["rate"]["runs"]), (1, &0.into(), &1.into()));

    let drawn = armarium(folder.path(), &["world", "random", "wait.world.yaml", "--seed", "3"]);
    assert_eq!(status(&drawn), 0);
    let mass = said(&drawn)
        .split_once("mass: ")
        .and_then(|(_, rest)| rest.split_once(" kg"))
        .map(|(mass, _)| mass.parse());
    assert!(matches!(mass, Some(Ok(mass)) if (0.1..=0.2_f64).contains(&mass)), "{}", said(&drawn));
}
