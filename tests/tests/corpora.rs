//! What fuzzing has found is tried again: every file of `fuzz/corpus`.

use std::path::PathBuf;

use armarium_tests::{hostile, repository};

/// The files of a corpus, in order.
fn corpus(name: &str) -> Vec<PathBuf> {
    let folder = repository::root().join("fuzz/corpus").join(name);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.expect("the folder can be read").path()).collect();
    files.sort();
    assert!(files.len() >= 10, "{} holds {} files", folder.display(), files.len());
    files
}

fn each(name: &str, act: impl Fn(&[u8])) {
    for file in corpus(name) {
        // The test's output names the file that it fails with.
        println!("{}", file.display());
        act(&std::fs::read(&file).expect("the file can be read"));
    }
}

fn text(act: impl Fn(&str)) -> impl Fn(&[u8]) {
    move |bytes| {
        if let Ok(text) = std::str::from_utf8(bytes) {
            act(text);
        }
    }
}

#[test]
fn charts() {
    each("loader", text(hostile::chart));
}

#[test]
fn expressions() {
    each("expressions", text(hostile::expression));
}

#[test]
fn documents() {
    each("importer", text(hostile::document));
}

#[test]
fn frames() {
    each("frames", hostile::frame);
}
