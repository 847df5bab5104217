//! The commands of `armarium memory`, each on a memory that runs, or on a file.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::remote::Running;

fn memory(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.current_dir(folder).arg("memory").args(args);
    command.output().expect("the program of this package can be started")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What a command prints that succeeds.
fn printed(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    text(&output.stdout)
}

fn rows(printed: &str) -> Vec<Value> {
    printed.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A file with this many entities, closed.
fn file(folder: &Path, entities: usize) {
    let line = |number: usize| {
        let instances = json!([{"attributes": {"text": {"string": "x".repeat(200)}}, "confidence": 1.0}]);
        let snapshot = json!({
            "id": format!("Things/p/e{number}"), "version": 1, "referenced_ns": 5, "sent_ns": 5, "arrived_ns": 5,
            "instances": instances,
        });
        format!("{snapshot}\n")
    };
    std::fs::write(folder.join("things.jsonl"), (0..entities).map(line).collect::<String>())
        .expect("it can be written");
    printed(&memory(folder, &["--store", "m.redb", "import", "things.jsonl"]));
}

/// A memory that runs as a process of its own.
struct Served<'f> {
    folder: &'f Path,
    name: &'f str,
    process: Running,
    endpoint: String,
}

impl<'f> Served<'f> {
    fn start(folder: &'f Path, name: &'f str, more: &[&str]) -> Self {
        let args = ["memory", "serve", "--name", name, "--listen", "tcp/127.0.0.1:0"];
        let mut process = Running::start(folder, &[&args, more].concat());
        let line = process.wait_for("memory of ");
        let endpoint = line.split(" at ").nth(1).and_then(|rest| rest.split([',', ' ']).next());
        let endpoint = endpoint.expect("it says where it listens").to_owned();
        Self { folder, name, process, endpoint }
    }

    fn args<'a>(&'a self, args: &[&'a str]) -> Vec<&'a str> {
        [&["--agent", self.name, "--connect", &self.endpoint, "--json"], args].concat()
    }

    fn ask(&self, args: &[&str]) -> Output {
        memory(self.folder, &self.args(args))
    }

    /// As [`Self::ask`], by somebody who reaches another one, too.
    fn ask_beside(&self, other: &Self, args: &[&str]) -> Output {
        memory(self.folder, &[&self.args(&["--connect", &other.endpoint]), args].concat())
    }

    fn said(&self, args: &[&str]) -> String {
        printed(&self.ask(args))
    }

    /// Puts an entity. Returns its version.
    fn put(&self, id: &str, more: &[&str]) -> u64 {
        let said = self.said(&[&["put", id], more].concat());
        rows(&said)[0]["version"].as_u64().expect("a number")
    }
}

/// A bit is flipped in one of 3000 entities.
#[test]
fn of_a_damaged_file_everything_intact_is_exported() {
    let folder = folder();
    let path = folder.path();
    file(path, 3000);
    let mut bytes = std::fs::read(path.join("m.redb")).expect("it is there");
    let contents: Vec<usize> =
        bytes.windows(100).enumerate().filter(|(_, part)| *part == [b'x'; 100]).map(|(at, _)| at).collect();
    bytes[contents[contents.len() / 2]] ^= 1;
    std::fs::write(path.join("m.redb"), bytes).expect("it can be written");

    let verified = memory(path, &["--store", "m.redb", "verify"]);
    let said = text(&verified.stdout);
    assert_eq!(verified.status.code(), Some(1), "{said}");
    assert!(
        said.contains("does not have its checksum") && said.contains("is not as it was written"),
        "{said}"
    );

    let exported = memory(path, &["--store", "m.redb", "export", "-o", "rest.jsonl"]);
    let said = text(&exported.stderr);
    assert_eq!(exported.status.code(), Some(1), "{said}");
    assert!(said.contains("1 places cannot be read") && said.contains("the 2999 snapshots"), "{said}");
    let rest = std::fs::read_to_string(path.join("rest.jsonl")).expect("it was written");
    assert_eq!(rest.lines().count(), 2999);
    let imported = memory(path, &["--store", "new.redb", "import", "rest.jsonl"]);
    assert!(printed(&imported).contains("2999"), "{imported:?}");
    printed(&memory(path, &["--store", "m.redb", "get", "Things/p/e1"]));
    printed(&memory(path, &["--store", "m.redb", "stats"]));
}

#[test]
fn of_a_file_everything_is_shown_and_written() {
    let folder = folder();
    file(folder.path(), 3);
    let store = |args: &[&str]| memory(folder.path(), &[&["--store", "m.redb"], args].concat());
    for name in ["all.jsonl", "all.mcap"] {
        assert_eq!(printed(&store(&["export", "-o", name])), "snapshots          3\n");
    }
    assert_eq!(printed(&store(&["export"])).lines().count(), 3);
    assert_eq!(rows(&printed(&store(&["put", "Things/p/e1", "--expect", "1", "--json"])))[0]["version"], 2);
    let last = rows(&printed(&store(&["tail", "--last", "2", "--json"])));
    assert_eq!(last.iter().map(|row| row["id"].as_str()).collect::<Vec<_>>()[1], Some("Things/p/e1"));
    let history = rows(&printed(&store(&["get", "Things/p/e1", "--history", "--json"])));
    assert_eq!(history.len(), 2);
    let counted = printed(&store(&["stats"]));
    assert!(counted.contains("entities           3\n") && !counted.contains("working"), "{counted}");
}

#[test]
fn what_is_asked_wrongly_is_refused_with_what_to_do() {
    let folder = folder();
    file(folder.path(), 1);
    for (args, expected) in [
        (&["retain"][..], "<--days <DAYS>|--megabytes <MB>>"),
        (&["put", "a/b/c", "--ttl", "1x"], "in ms, s, min or h, for instance `10min`"),
        (&["tail"], "--last N shows what changed last"),
        (&["top", "--once"], "give --agent instead of --store"),
        (&["lag"], "give --agent instead of --store"),
        (&["serve", "--megabytes", "0"], "even an empty file is larger"),
    ] {
        let refused = memory(folder.path(), &[&["--store", "m.redb"], args].concat());
        let said = text(&refused.stderr);
        assert!(refused.status.code() == Some(2) && said.contains(expected), "{args:?}: {said}");
    }
}

#[test]
fn a_memory_that_runs_answers_and_goes_on_after_its_end() {
    let folder = folder();
    let path = folder.path();
    let serve = || Served::start(path, "alice", &["--store", "a.redb", "--keep", "Rated=at-most:0.01"]);
    let alice = serve();
    assert_eq!(alice.put("Notes/me/n", &["--set", "x=1.5"]), 1);
    alice.said(&["snapshot", "save", "morning"]);

    let tail = [&["memory"], &alice.args(&["tail", "Notes", "--last", "1", "--count", "2"])[..]].concat();
    let mut tail = Running::start(path, &tail);
    tail.wait_for("Notes/me/n");
    alice.put("Notes/me/short", &["--ttl", "500ms"]);
    let (status, said) = tail.end();
    assert_eq!(status, Some(0), "{said}");
    let gone = &rows(&said)[2];
    assert!(gone["id"] == "Notes/me/short" && gone["removed"] == true, "{said}");
    assert_eq!(alice.ask(&["get", "Notes/me/short"]).status.code(), Some(1));

    assert_eq!(alice.put("Notes/me/n", &["--set", "x=2.5"]), 2);
    let changed = &rows(&alice.said(&["diff", "morning"]))[0];
    assert_eq!(changed["counts"], json!({"added": 0, "removed": 0, "changed": 1}), "{changed}");
    let top = rows(&alice.said(&["top", "--once"]));
    let mine = top.iter().find(|row| row["owner"] == "me").expect("who has written is there");
    assert!(mine["entities"].as_u64() >= Some(1) && mine["updates_per_s"] == 0, "{mine}");
    alice.said(&["plot", "Notes/me/n.x", "-o", "n.svg"]);
    assert!(std::fs::read_to_string(path.join("n.svg")).expect("it was drawn").contains("<svg"));
    assert!(rows(&alice.said(&["health"]))[0]["answered_in_us"].as_u64() > Some(0));
    let metrics = alice.said(&["metrics"]);
    assert!(
        metrics.contains("armarium_memory_entities{agent=\"alice\"} ") && metrics.ends_with("# EOF\n"),
        "{metrics}"
    );
    assert!(rows(&alice.said(&["stats"]))[0]["snapshots"].as_u64() >= Some(2));
    alice.said(&["backup", "monday.redb"]);
    let kept = memory(path, &["--store", "monday.redb", "get", "Notes/me/n"]);
    assert!(printed(&kept).contains("version 2"), "{kept:?}");

    // Versions of what is not stored are not given again either.
    assert_eq!((1..=3).map(|_| alice.put("Rated/me/r", &[])).collect::<Vec<_>>(), [1, 2, 3]);
    alice.process.signal("TERM");
    let (status, said) = alice.process.end();
    assert_eq!(status, Some(0), "{said}");
    let alice = serve();
    assert_eq!(alice.put("Notes/me/n", &["--expect", "2"]), 3);
    assert_eq!(alice.put("Rated/me/r", &["--expect", "3"]), 4);
    alice.process.signal("KILL");
    drop(alice.process);
    let alice = serve();
    assert_eq!(alice.put("Notes/me/n", &["--expect", "3"]), 4);
    assert!(alice.put("Rated/me/r", &[]) > 4);
}

#[test]
fn who_follows_whom_and_how_far_behind_is_seen_from_both_sides() {
    let folder = folder();
    let alice = Served::start(folder.path(), "alice", &[]);
    let bob = Served::start(folder.path(), "bob", &["--connect", &alice.endpoint]);
    assert_eq!(bob.said(&["lag"]), "");
    for entity in ["one", "one", "two"] {
        alice.put(&format!("Notes/me/{entity}"), &[]);
    }
    // What a follower writes.
    let origin = r#"origin={"map": {"agent": {"string": "alice"}, "provider": {"string": "me"}, "version": {"int": 1}}}"#;
    bob.put("Notes/alice.me/one", &["--set", origin]);
    let (agent, state) = (["--set", "agent=alice"], ["--set", "state=followed", "--set", "missed=7"]);
    let segments = ["--set", r#"segments=["Notes"]"#];
    bob.put("Following/bob/alice", &[&agent[..], &state, &segments].concat());
    bob.put(
        "Following/bob/carol",
        &["--set", "agent=carol", "--set", "state=looked for", "--set", "why=it is away"],
    );

    let lag = bob.ask_beside(&alice, &["lag"]);
    assert_eq!(lag.status.code(), Some(1), "{lag:?}");
    let lag = rows(&text(&lag.stdout));
    assert_eq!(lag.len(), 2, "{lag:?}");
    let behind = |row: &Value| ["entities", "behind", "versions", "missed"].map(|name| row[name].as_u64());
    assert!(lag[0]["follows"] == "alice" && behind(&lag[0]) == [1, 2, 2, 7].map(Some), "{lag:?}");
    assert!(lag[1]["state"] == "looked for" && lag[1]["why"] == "it is away", "{lag:?}");

    let top = rows(&printed(&alice.ask_beside(&bob, &["top", "--once"])));
    let followers: Vec<&Value> = top.iter().filter(|row| row["followed_by"].is_string()).collect();
    assert!(followers.len() == 1 && followers[0]["followed_by"] == "bob", "{top:?}");
    assert_eq!(behind(followers[0]), [1, 2, 2, 7].map(Some));
}

#[test]
fn who_is_followed_is_up_to_date_soon() {
    let folder = folder();
    let pose = r#"pose={"pose": {"frame": "world", "position": [0, 0, 0], "orientation": [0, 0, 0, 1]}}"#;
    let alice = Served::start(folder.path(), "alice", &[]);
    alice.put("AgentInstances/alice/alice", &["--set", pose]);
    alice.put("Notes/me/one", &[]);
    let follow = ["--connect", &alice.endpoint, "--follow", "alice:Notes"];
    let bob = Served::start(folder.path(), "bob", &follow);
    bob.put("AgentInstances/bob/bob", &["--set", pose]);
    let lag = (0..100).map(|_| bob.ask_beside(&alice, &["lag"])).find(|lag| {
        let rows = rows(&text(&lag.stdout));
        lag.status.success() && rows.iter().any(|row| row["entities"] == 2)
    });
    let lag = rows(&text(&lag.expect("it is up to date at last").stdout));
    assert!(lag.len() == 1 && lag[0]["state"] == "followed" && lag[0]["clock_ahead_s"].is_f64(), "{lag:?}");
    let top = rows(&alice.said(&["top", "--once"]));
    let notes = top.iter().find(|row| row["owner"] == "me").expect("who has written is there");
    assert!(notes["segment"] == "Notes" && notes["entities"] == 1, "{top:?}");
}

/// A run's file, a robot's file and an agent that runs: one question to all three, each answer with its clock.
#[test]
fn several_memories_are_read_side_by_side() {
    let folder = folder();
    file(folder.path(), 1);
    let nameless = json!({
        "id": "ObjectInstances/p/cup", "version": 1, "referenced_ns": 5, "arrived_ns": 5, "instances": [{}],
    });
    std::fs::write(folder.path().join("nameless.jsonl"), format!("{nameless}\n")).expect("it can be written");
    let refused = memory(folder.path(), &["--store", "m.redb", "import", "nameless.jsonl"]);
    assert!(text(&refused.stderr).contains("`class` is missing"), "{refused:?}");
    std::fs::rename(folder.path().join("m.redb"), folder.path().join("run.redb")).expect("it is closed");
    std::fs::write(folder.path().join("none.jsonl"), "").expect("it can be written");
    printed(&memory(folder.path(), &["--store", "robot.redb", "import", "none.jsonl"]));
    printed(&memory(folder.path(), &["--store", "robot.redb", "put", "Things/p/e0", "--set", "text=robot"]));
    let agent = Served::start(folder.path(), "alice", &[]);
    agent.put("Things/p/e0", &["--set", "text=alice"]);

    let others = ["--beside", "robot.redb", "--beside", "alice", "--connect", &agent.endpoint];
    let of_run = |args: &[&str]| memory(folder.path(), &[&["--store", "run.redb"], args, &others].concat());
    let told = rows(&printed(&of_run(&["query", "Things", "--json"])));
    let whose: Vec<_> = told.iter().map(|row| (&row["memory"], &row["referenced_clock"])).collect();
    let [run, day] = ["run", "day"].map(Value::from);
    let [one, two, three] = ["run.redb", "robot.redb", "alice"].map(Value::from);
    assert_eq!(whose, [(&one, &run), (&two, &day), (&three, &day)]);
    assert_eq!(rows(&printed(&of_run(&["get", "Things/p/e0", "--json"]))), told);
    let table = printed(&of_run(&["ls", "Things"]));
    let firsts: Vec<_> = table.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(firsts, ["memory", "run.redb", "robot.redb", "alice", "3"], "{table}");
    let of_agent = agent.ask(&["get", "Things/p/e0", "--beside", "run.redb"]);
    assert_eq!(rows(&printed(&of_agent)).len(), 2);

    // A run's time says nothing of the others' memories, and theirs nothing of the run's: who can answer does.
    let asked = of_run(&["query", "Things", "--at", "7", "--json"]);
    let said = text(&asked.stderr);
    assert_eq!((asked.status.code(), rows(&text(&asked.stdout)).len()), (Some(1), 1), "{said}");
    for other in ["robot.redb", "alice"] {
        assert!(
            said.contains(&format!("{other}: the query cannot be answered: it asks by a run's time")),
            "{said}"
        );
    }
    let second = Served::start(folder.path(), "bob", &["--connect", &agent.endpoint]);
    second.put("Things/p/e0", &[]);
    let with_bob = agent.ask_beside(&second, &["ls", "--beside", "bob", "--listen", "tcp/127.0.0.1:0"]);
    assert_eq!(rows(&printed(&with_bob)).len(), 2);
    for (args, wrong) in [
        (["ls", "--beside", "absent.redb"], "there is no file `absent.redb`"),
        (["ls", "--beside", "carol"], "`carol`"),
        (["ls", "--beside", "alice"], "--beside alice: it is asked already"),
    ] {
        let said = text(&agent.ask(&args).stderr);
        assert!(said.contains(wrong), "{said}");
    }
    let twice = memory(folder.path(), &["--store", "run.redb", "ls", "--beside", "./run.redb"]);
    assert!(text(&twice.stderr).contains("it is asked already"), "{twice:?}");
    let idle = memory(folder.path(), &["--store", "run.redb", "ls", "--beside", "robot.redb", "--as", "me"]);
    assert!(text(&idle.stderr).contains("leave one of them out"), "{idle:?}");
}
