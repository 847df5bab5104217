//! What an earlier version wrote is read by this one: charts, test cases, worlds, a memory's file and the record of a run, in
//! `tests/earlier/`. Where one day something there cannot be read, the error must say what to do.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn earlier() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/earlier")
}

fn armarium(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_armarium");
    Command::new(program).current_dir(earlier()).args(arguments).output().expect("the program starts")
}

fn said(arguments: &[&str]) -> String {
    let output = armarium(arguments);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{arguments:?}: {}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn charts_tests_and_worlds_are_still_in_order() {
    let files = std::fs::read_dir(earlier()).expect("the folder is there").filter_map(Result::ok);
    let names: Vec<String> = files.map(|file| file.file_name().to_string_lossy().into_owned()).collect();
    let files: Vec<&str> = names.iter().map(String::as_str).filter(|name| name.ends_with(".yaml")).collect();
    assert!(files.len() > 10, "{files:?}");
    said(&[&["check"], &files[..]].concat());
    said(&["test", "wiping.test.yaml", "grasp_object.test.yaml"]);
}

#[test]
fn a_memory_still_opens_with_all_that_it_knew() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let copy = folder.path().join("store.redb");
    std::fs::copy(earlier().join("store.redb"), &copy).expect("it can be copied");
    let store = copy.to_str().expect("it is text");
    let verified = said(&["memory", "--store", store, "verify"]);
    assert!(
        verified.contains("damaged            0") && verified.contains("intact             3"),
        "{verified}"
    );
    let cup = said(&["memory", "--store", store, "get", "ObjectInstances/me/cup"]);
    assert!(cup.contains("version 2") && cup.contains("position = (0.2, 0.4, 0.9) in root"), "{cup}");
    said(&["run", "wait.yaml", "--store", store, "--report", folder.path().to_str().expect("it is text")]);
}

#[test]
fn the_record_of_a_run_still_replays() {
    let replayed = said(&["replay", "wait.run"]);
    assert!(replayed.contains("2 turns, the same states"), "{replayed}");
}
