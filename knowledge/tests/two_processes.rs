//! Two processes keep motions in one file at the same time: each opens it only for a moment, and nothing is lost.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use armarium_knowledge::{AgentMemory, MemoryConfig, Restored};
use armarium_memoryx::{Commit, EntityId, LongTermMemory, Pattern, Policies, Policy, Query};
use armarium_values::Value;

/// Tells the second process what to do: the file, and its own name.
const CHILD: &str = "ARMARIUM_TEST_WRITER";
/// The name of a writer that opens the file for itself.
const ALONE: &str = "alone";
/// How many versions each writes.
const VERSIONS: i64 = 40;

fn shared(file: &Path) -> AgentMemory {
    shared_with(file, Policy::Everything)
}

fn shared_with(file: &Path, policy: Policy) -> AgentMemory {
    let mut config = MemoryConfig::new("local").with_store(file);
    config.shared = true;
    config.policies = Policies::all(Policy::Nothing).with("Motions", policy);
    config.restored = Restored::Only(vec!["Motions".into()]);
    AgentMemory::open(config, Arc::new(|| 1)).unwrap()
}

/// The motion that all write.
fn wiping() -> EntityId {
    EntityId::new("Motions", "local", "wiping").unwrap()
}

/// Commits a version of the motion, with its writer's name and a number.
fn commit(agent: &AgentMemory, at_ms: u64, by: &str, number: i64) {
    let content = [("by", by.into()), ("number", Value::Int(number))];
    agent.memory().commit_now(vec![Commit::new(wiping(), at_ms * 1_000_000, content)]).unwrap();
}

/// Commits many versions, and says a line for each.
fn write(file: &Path, writer: &str, said: &mut dyn Write) {
    let agent = shared(file);
    for number in 0..VERSIONS {
        commit(&agent, 0, writer, number);
        writeln!(said, "{number}").unwrap();
    }
    agent.flush().unwrap();
}

/// Not a test of its own: what the other processes of the test below do.
#[test]
fn as_another_process() {
    if let Ok(task) = std::env::var(CHILD) {
        let (writer, file) = task.split_once(' ').unwrap();
        if writer == ALONE {
            return own(Path::new(file), &mut std::io::stdout());
        }
        write(Path::new(file), writer, &mut std::io::stdout());
    }
}

/// Opens the file for itself, commits, says so, and keeps it until the standard input ends; or says that it cannot.
fn own(file: &Path, said: &mut dyn Write) {
    let config = MemoryConfig::new("local").with_store(file);
    match AgentMemory::open(config, Arc::new(|| 1)) {
        Ok(agent) => {
            (0..10).for_each(|number| commit(&agent, 0, ALONE, number));
            writeln!(said, "has it").unwrap();
            let _ = std::io::stdin().lines().count();
        }
        Err(error) => writeln!(said, "lost: {error}").unwrap(),
    }
}

/// Of two processes that are started at once on a new file, one has it, and the other is told so.
#[test]
fn exactly_one_process_gets_a_new_file() {
    let folder = tempfile::tempdir().unwrap();
    for round in 0..20 {
        let file = folder.path().join(format!("{round}.redb"));
        let mut children = [ALONE, ALONE].map(|name| start(name, &file));
        let said = children.each_mut().map(|child| {
            let lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
            lines.into_iter().find(|line| line.contains("has it") || line.contains("lost: ")).unwrap()
        });
        for mut child in children {
            drop(child.stdin.take());
            child.wait().unwrap();
        }
        let winners = said.iter().filter(|line| line.contains("has it")).count();
        assert_eq!(winners, 1, "{said:?}");
        let store = LongTermMemory::open(&file).unwrap();
        assert_eq!(store.query(&Query::history(Pattern::any())).unwrap().len(), 10);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 20, "nothing else is left in the folder");
}

fn start(writer: &str, file: &Path) -> Child {
    let mut program = Command::new(std::env::current_exe().unwrap());
    program
        .args(["two_processes::as_another_process", "--exact"])
        .env(CHILD, format!("{writer} {}", file.display()));
    program.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
}

fn contents(file: &Path) -> Vec<(u64, String, i64)> {
    let store = LongTermMemory::open(file).unwrap();
    assert!(store.verify().unwrap().is_intact());
    let all = store.query(&Query::history(Pattern::any())).unwrap();
    let one = |snapshot: &Arc<armarium_memoryx::Snapshot>| {
        let by = snapshot.attribute("by").and_then(Value::as_str).unwrap().to_owned();
        (snapshot.version, by, snapshot.attribute("number").and_then(Value::as_int).unwrap())
    };
    all.iter().map(one).collect()
}

#[test]
fn writers_in_two_processes_lose_nothing() {
    let folder = tempfile::tempdir().unwrap();
    // The file is made by whoever comes first.
    let file: PathBuf = folder.path().join("armarium.redb");
    let children = ["ann", "ben", "cid"].map(|writer| start(writer, &file));
    let ended = children.map(|child| child.wait_with_output().unwrap());
    assert!(ended.iter().all(|output| output.status.success()));
    let contents = contents(&file);
    let versions: BTreeSet<u64> = contents.iter().map(|(version, ..)| *version).collect();
    assert_eq!((contents.len(), versions.len()), (120, 120));
    for writer in ["ann", "ben", "cid"] {
        let of: BTreeMap<u64, i64> =
            contents.iter().filter(|(_, by, _)| by == writer).map(|(version, _, n)| (*version, *n)).collect();
        assert_eq!(of.into_values().collect::<Vec<_>>(), (0..VERSIONS).collect::<Vec<_>>(), "{writer}");
    }
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 1, "nothing else is left in the folder");
}

#[test]
fn a_writer_that_is_killed_damages_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("armarium.redb");
    write(&file, "first", &mut std::io::sink());
    for lines in [1, 3, 9, 15, 30] {
        let mut child = start("killed", &file);
        let said = BufReader::new(child.stdout.take().unwrap()).lines();
        // The harness says two lines before.
        assert_eq!(said.take(lines + 2).count(), lines + 2);
        child.kill().unwrap();
        child.wait().unwrap();
        write(&file, "after", &mut std::io::sink());
    }
    let contents = contents(&file);
    let of = |writer: &str| contents.iter().filter(|(_, by, _)| by == writer).count();
    assert_eq!((of("first"), of("after")), (40, 200));
    assert!(of("killed") >= 1 + 3 + 9 + 15 + 30, "what was acknowledged is there: {}", of("killed"));
}

#[test]
fn what_runs_restore_is_what_the_others_kept_last() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("armarium.redb");
    let (first, second) = (shared(&file), shared(&file));
    commit(&first, 0, "first", 1);
    commit(&second, 0, "second", 2);
    commit(&first, 0, "first again", 3);
    let third = shared(&file);
    let newest = third.memory().latest_now(&wiping()).unwrap();
    assert_eq!((newest.version, newest.attribute("by")), (3, Some(&Value::from("first again"))));
}

/// A rate holds versions back: what one writer has left out is no place for the other's.
#[test]
fn what_is_written_last_is_the_newest_whatever_its_version_was() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("armarium.redb");
    let rated = || shared_with(&file, Policy::AtMost { hz: 1.0 });
    let (first, second) = (rated(), rated());
    for (number, at_ms) in [0, 100, 200, 300, 5000].into_iter().enumerate() {
        commit(&first, at_ms, &format!("first {number}"), 0);
    }
    for (number, at_ms) in [0, 2000, 2100].into_iter().enumerate() {
        commit(&second, at_ms, &format!("second {number}"), 0);
    }
    second.flush().unwrap();
    let newest = rated().memory().latest_now(&wiping()).unwrap();
    assert_eq!(newest.attribute("by"), Some(&Value::from("second 2")));
    drop((first, second));
    let store = LongTermMemory::open(&file).unwrap();
    let all = store.query(&Query::history(Pattern::any())).unwrap();
    let by: BTreeMap<u64, &str> =
        all.iter().map(|s| (s.version, s.attribute("by").and_then(Value::as_str).unwrap())).collect();
    let expected = [(1, "first 0"), (5, "first 4"), (6, "second 0"), (7, "second 1"), (8, "second 2")];
    assert_eq!(by, BTreeMap::from(expected));
}
