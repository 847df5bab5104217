//! The modules inside a room have no cyclic dependencies, so that a module can be read without those that use it.
//!
//! The test looks at the top-level modules of each crate and their `crate::` and `super::` paths, including names that `lib.rs`
//! re-exports. It leaves out `lib.rs`, `main.rs` and tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use armarium_tests::repository;

/// The text of a file without its tests and comments.
fn code(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod ").filter(|at| {
        let rest = &text[*at..];
        rest.find('{').is_some_and(|brace| rest.find(';').is_none_or(|semicolon| brace < semicolon))
    });
    let text = &text[..end.unwrap_or(text.len())];
    text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

fn word(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    &text[..end]
}

/// The first names of all `crate::` paths, including those in braces.
fn crate_paths(code: &str) -> BTreeSet<&str> {
    let mut names = BTreeSet::new();
    for rest in code.split("crate::").skip(1) {
        let Some(group) = rest.strip_prefix('{') else {
            names.insert(word(rest));
            continue;
        };
        let mut depth = 0;
        let mut begins = true;
        for (at, c) in group.char_indices() {
            match c {
                '}' if depth == 0 => break,
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => begins = true,
                c if begins && (c.is_alphabetic() || c == '_') => {
                    names.insert(word(&group[at..]));
                    begins = false;
                }
                _ => {}
            }
        }
    }
    names.remove("");
    names
}

/// The declarations in `lib.rs`: its modules without test modules, and the names that it re-exports from them.
#[derive(Default)]
struct Root<'t> {
    modules: BTreeSet<&'t str>,
    names: BTreeMap<&'t str, &'t str>,
}

impl<'t> Root<'t> {
    fn of(text: &'t str) -> Self {
        let mut root = Self::default();
        let mut of_tests = false;
        for line in text.lines() {
            let bare = line.trim_start_matches("pub ").trim_start_matches("pub(crate) ");
            if let Some(module) = bare.strip_prefix("mod ").filter(|m| m.ends_with(';') && !of_tests) {
                root.modules.insert(word(module));
            }
            of_tests = line.trim() == "#[cfg(test)]";
        }
        for rest in text.split("pub use ").skip(1).chain(text.split("pub(crate) use ").skip(1)) {
            let Some(statement) = rest.split(';').next() else { continue };
            let module = word(statement);
            let names =
                statement.split(['{', '}', ',', ':']).map(|part| part.rsplit(" as ").next().unwrap_or(part));
            root.names.extend(names.map(|name| (word(name.trim()), module)));
        }
        root
    }

    fn module<'s>(&'s self, name: &'s str) -> Option<&'s str> {
        if self.modules.contains(name) {
            return Some(name);
        }
        self.names.get(name).copied().filter(|module| self.modules.contains(module))
    }
}

fn files(folder: &Path, found: &mut Vec<std::path::PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Which top-level module uses which, from the files of a crate (path under `src`, text).
fn arrows(root: &str, files: &[(String, String)]) -> BTreeMap<String, BTreeSet<String>> {
    let root = Root::of(root);
    let mut arrows: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (path, text) in files {
        let own = path.split('/').next().unwrap_or_default().trim_end_matches(".rs");
        if !root.modules.contains(own) || path.contains("tests") {
            continue;
        }
        let mut code = code(text);
        if !path.contains('/') || path.ends_with(&format!("{own}/mod.rs")) {
            // In the file of a top-level module, `super` is the crate.
            code = code.replace("super::", "crate::");
        }
        let used = crate_paths(&code).into_iter().filter_map(|name| root.module(name).map(str::to_owned));
        arrows.entry(own.to_owned()).or_default().extend(used.filter(|used| used != own));
    }
    arrows
}

/// Modules on a cycle, each with its path.
fn circles(arrows: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut found = Vec::new();
    for start in arrows.keys() {
        let mut ways = vec![vec![start.clone()]];
        let mut seen = BTreeSet::new();
        while let Some(way) = ways.pop() {
            for next in arrows.get(way.last().unwrap_or(start)).into_iter().flatten() {
                if next == start {
                    found.push(format!("{} -> {start}", way.join(" -> ")));
                    ways.clear();
                    break;
                }
                if seen.insert(next.clone()) {
                    ways.push(way.iter().cloned().chain([next.clone()]).collect());
                }
            }
        }
    }
    found
}

#[test]
fn modules_form_no_circles() {
    let mut wrong = Vec::new();
    for room in repository::rooms() {
        let src = room.manifest.parent().expect("a manifest lies in a folder").join("src");
        let root = ["lib.rs", "main.rs"].iter().find_map(|name| std::fs::read_to_string(src.join(name)).ok());
        let mut paths = Vec::new();
        files(&src, &mut paths);
        let read = |path: &std::path::PathBuf| {
            let inside = path.strip_prefix(&src).ok()?.to_str()?.to_owned();
            Some((inside, std::fs::read_to_string(path).ok()?))
        };
        let texts: Vec<(String, String)> = paths.iter().filter_map(read).collect();
        let found = circles(&arrows(&root.unwrap_or_default(), &texts));
        wrong.extend(found.into_iter().map(|way| format!("{}: {way}", room.name)));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_circle_is_found_through_braces_and_shorter_names() {
    let root =
        "mod a;\npub mod b;\nmod c;\n#[cfg(test)]\nmod t;\npub use b::{deep::Thing as Short, Other};\n";
    let file = |name: &str, text: &str| (name.to_owned(), text.to_owned());
    let files = [
        file("a/mod.rs", "use crate::{c::X, Short};"),
        file("b.rs", "use crate::c;\n#[cfg(test)]\nmod tests {\nuse crate::a;\n}\n"),
        file("c.rs", "// crate::a\nfn f() { crate::t::g() }"),
        file("t.rs", "use crate::a;"),
    ];
    assert_eq!(circles(&arrows(root, &files)), Vec::<String>::new());
    let mut back = files.to_vec();
    back[2].1 = "use crate::a::Y;".into();
    let found = circles(&arrows(root, &back));
    assert!(found.contains(&"a -> c -> a".to_owned()), "{found:?}");
    assert!(found.iter().any(|way| way.starts_with("b -> c -> a")), "{found:?}");
}
