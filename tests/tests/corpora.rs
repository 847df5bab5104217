//! What fuzzing has found is tried again: every file of `fuzz/corpus`.

use std::path::PathBuf;

use armarium_tests::{hostile, repository};

/// The files of a corpus, in order.
fn corpus(name: &str) -> Vec<PathBuf> {
    let folder = repository::root().join("fuzz/corpus").join(name);
    let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    files.sort();
    assert!(files.len() >= 10, "{} holds {} files", folder.display(), files.len());
    files
}

fn each(name: &str, act: impl Fn(&[u8])) {
    for file in corpus(name) {
        let bytes = std::fs::read(&file).expect("the file can be read");
        let tried = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| act(&bytes)));
        assert!(tried.is_ok(), "{} breaks it", file.display());
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
fn edits() {
    each("edits", text(hostile::edits));
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
