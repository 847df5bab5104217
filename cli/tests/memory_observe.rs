//! What other programs observe comes into a memory through its updater.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

fn armarium(folder: &Path, args: &[&str], input: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.current_dir(folder).args(["memory", "--store", "m.redb", "--json"]).args(args);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut program = command.spawn().expect("the program of this package can be started");
    let mut to = program.stdin.take().expect("it reads");
    to.write_all(input.as_bytes()).expect("it takes what it is given");
    drop(to);
    program.wait_with_output().expect("it ends")
}

fn cup(x: f64) -> String {
    let covariance = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4];
    let seen = json!({
        "segment": "ObjectInstances", "class": "cup", "stamp_ns": 5, "confidence": 0.6, "full": true,
        "position": [x, 0.5, 0.9], "frame": "root", "covariance": covariance,
    });
    format!("{seen}\n")
}

#[test]
fn a_line_is_an_observation_and_the_updater_joins_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let made = armarium(folder.path(), &["import", "-"], "");
    assert!(made.status.success(), "{made:?}");
    let lines = format!("{}\n{}{}", cup(0.1), cup(0.12), cup(0.8));
    let observed = armarium(folder.path(), &["observe", "--provider", "door"], &lines);
    assert!(observed.status.success(), "{observed:?}");
    let said = String::from_utf8_lossy(&observed.stdout);
    let expected =
        ["ObjectInstances/door/cup 1", "ObjectInstances/door/cup 2", "ObjectInstances/door/cup_2 1"];
    assert_eq!(said.lines().collect::<Vec<_>>(), expected);
    let got = armarium(folder.path(), &["get", "ObjectInstances/door/cup"], "");
    let cup: Value = serde_json::from_slice(&got.stdout).expect("one line of JSON");
    assert!(cup.to_string().contains("0.84"), "surer than each: {cup}");

    for (line, wrong) in [
        ("{", "line 2: EOF"),
        ("{\"segment\": \"S\"}", "line 2: an observation needs `stamp_ns`: a time, ns"),
    ] {
        let refused = armarium(folder.path(), &["observe", "--provider", "door"], &format!("\n{line}\n"));
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains(wrong), "{said}");
    }
}

/// A recording has poses in Foxglove's schema, and only data of one clock.
#[test]
fn what_was_observed_is_exported_for_foxglove() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    assert!(armarium(folder.path(), &["import", "-"], "").status.success());
    let lines = format!("{}{}", cup(0.1), cup(0.12));
    assert!(armarium(folder.path(), &["observe", "--provider", "door"], &lines).status.success());
    let exported = armarium(folder.path(), &["export", "-o", "cups.mcap"], "");
    assert_eq!(String::from_utf8_lossy(&exported.stdout), "{\"snapshots\":2}\n", "{exported:?}");
    let recording = std::fs::read(folder.path().join("cups.mcap")).expect("it is there");
    let has = |words: &str| recording.windows(words.len()).any(|part| part == words.as_bytes());
    assert!(has("foxglove.PoseInFrame") && has("/memory/ObjectInstances/door/position/cup"));
    assert!(has("/memory/ObjectInstances/door/cup"));

    let put = armarium(folder.path(), &["put", "Notes/me/today", "--set", "text=now"], "");
    assert!(put.status.success(), "{put:?}");
    let mixed = armarium(folder.path(), &["export", "-o", "all.mcap"], "");
    assert_eq!(mixed.status.code(), Some(2), "{mixed:?}");
    assert!(String::from_utf8_lossy(&mixed.stderr).contains("not on one timeline"), "{mixed:?}");
    // The same two clocks in a query.
    let asked = armarium(folder.path(), &["query", "*", "--at", "7"], "");
    assert!(String::from_utf8_lossy(&asked.stderr).contains("it asks by a run's time"), "{asked:?}");
    let named = armarium(folder.path(), &["query", "ObjectInstances", "--at", "7"], "");
    assert!(String::from_utf8_lossy(&named.stdout).contains("\"referenced_clock\":\"run\""), "{named:?}");
}

/// An image as it is kept in memory; `coding` and `data` say how.
fn image(version: u64, coding: &str, data: &[u8]) -> String {
    let text = |text: &str| json!({"string": text});
    let fields = json!({
        "width": {"int": 64}, "height": {"int": 48}, "format": text("rgb8"), "coding": text(coding), "data": {"bytes": data},
    });
    let instances = json!([{"attributes": {"picture": {"map": fields}}, "confidence": 1.0}]);
    let stamps = [version, version, version].map(|n| n * 1_000_000_000);
    let snapshot = json!({
        "id": "Images/door/left", "version": version, "referenced_ns": stamps[0], "sent_ns": stamps[1], "arrived_ns": stamps[2],
        "instances": instances,
    });
    format!("{snapshot}\n")
}

/// Images come out as pictures that Foxglove shows, whether memory has them raw or as JPEG files.
#[test]
fn images_are_exported_for_foxglove() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let pixels = vec![120; 64 * 48 * 3];
    let mut file = Vec::new();
    let coded =
        armarium_visionx::encode_jpeg(&mut file, &pixels, (64, 48), armarium_visionx::JpegPixel::Rgb, 85);
    coded.expect("an image");
    let lines = [image(1, "raw", &pixels), image(2, "jpeg", &file)].concat();
    assert!(armarium(folder.path(), &["import", "-"], &lines).status.success());
    let exported = armarium(folder.path(), &["export", "-o", "door.mcap"], "");
    assert_eq!(String::from_utf8_lossy(&exported.stdout), "{\"snapshots\":2}\n", "{exported:?}");
    let recording = std::fs::read(folder.path().join("door.mcap")).expect("it is there");
    let has = |words: &str| recording.windows(words.len()).any(|part| part == words.as_bytes());
    assert!(has("foxglove.CompressedImage") && has("/memory/Images/door/picture/left"));
    let mut read = Command::new(env!("CARGO_BIN_EXE_armarium"));
    read.current_dir(folder.path()).args(["image", "stats", "door.mcap", "--json"]);
    let read = read.output().expect("the program of this package can be started");
    let said = String::from_utf8_lossy(&read.stdout);
    assert!(said.contains("\"frames\":2") && said.contains("\"sizes\":[[[64,48]]]"), "{read:?}");
}

/// What a run has kept can lie in a robot's memory beside what the robot has: each is asked by its own clock.
#[test]
fn a_run_is_read_beside_a_robot() {
    let (run, robot) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    assert!(armarium(run.path(), &["import", "-"], "").status.success());
    assert!(armarium(run.path(), &["observe", "--provider", "run"], &cup(0.1)).status.success());
    let kept = armarium(run.path(), &["export"], "");
    let imported = armarium(robot.path(), &["import", "-"], &String::from_utf8_lossy(&kept.stdout));
    assert!(imported.status.success(), "{imported:?}");
    let put = armarium(robot.path(), &["put", "ObjectInstances/robot/cup", "--set", "class=cup"], "");
    assert!(put.status.success(), "{put:?}");

    let both = armarium(robot.path(), &["query", "ObjectInstances/*/cup"], "");
    let both = String::from_utf8_lossy(&both.stdout).into_owned();
    let clocks: Vec<Value> =
        both.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect();
    let clock = |provider: &str| {
        let of = clocks.iter().find(|one| one["id"] == format!("ObjectInstances/{provider}/cup"));
        of.expect("it is there")["referenced_clock"].clone()
    };
    assert_eq!((clock("run"), clock("robot")), ("run".into(), "day".into()));
    let of_run = armarium(robot.path(), &["query", "ObjectInstances/run", "--at", "7"], "");
    assert_eq!(String::from_utf8_lossy(&of_run.stdout).lines().count(), 1, "{of_run:?}");
    let mixed = armarium(robot.path(), &["query", "ObjectInstances", "--at", "7"], "");
    assert!(String::from_utf8_lossy(&mixed.stderr).contains("it asks by a run's time"), "{mixed:?}");
}
