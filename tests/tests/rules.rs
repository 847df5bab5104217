//! Rules of the repository that no compiler checks: manifests, links, required files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use armarium_tests::repository;

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("the file can be read")
}

fn manuals() -> Vec<PathBuf> {
    let root = repository::root();
    let in_docs =
        std::fs::read_dir(root.join("docs")).into_iter().flatten().flatten().map(|entry| entry.path());
    let top = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"].map(|name| root.join(name));
    top.into_iter().chain(in_docs).filter(|path| path.extension().is_some_and(|e| e == "md")).collect()
}

/// Targets of Markdown links to files, without their anchors.
fn links(text: &str) -> Vec<&str> {
    text.split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .filter(|link| !link.contains("://") && !link.starts_with('#') && !link.contains(char::is_whitespace))
        .filter_map(|link| link.split('#').next())
        .collect()
}

#[test]
fn links_are_found_in_text() {
    let text = "see [a](docs/a.md#b), [c](https://x.y), [d](#here) and ![e](e.png)";
    assert_eq!(links(text), ["docs/a.md", "e.png"]);
}

#[test]
fn every_room_says_what_it_is_and_takes_the_common_lints() {
    for room in repository::rooms() {
        assert!(room.description.len() > 20, "{} has no description", room.name);
        let manifest = read(&room.manifest);
        assert!(
            manifest.contains("[lints]\nworkspace = true"),
            "{} does not take the common lints",
            room.name
        );
    }
}

#[test]
fn every_link_of_the_manuals_leads_somewhere() {
    let mut broken = Vec::new();
    for manual in manuals() {
        let folder = manual.parent().expect("a file has a folder").to_path_buf();
        let text = read(&manual);
        let lost = links(&text).into_iter().filter(|link| !folder.join(link).exists());
        broken.extend(lost.map(|link| format!("{}: {link}", manual.display())));
    }
    assert_eq!(broken, Vec::<String>::new());
}

#[test]
fn the_licences_lie_beside_the_readme() {
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        assert!(read(&repository::root().join(name)).len() > 1000, "{name}");
    }
}

/// The check of every change runs the commands that the README gives.
#[test]
fn the_check_runs_the_commands_of_the_readme() {
    let root = repository::root();
    let (readme, check) = (read(&root.join("README.md")), read(&root.join(".ci/run")));
    for command in ["cargo test --workspace", "cargo run --release -- run statecharts/wiping.yaml"] {
        assert!(readme.contains(command), "README.md: {command}");
        assert!(check.contains(command), ".ci/run: {command}");
    }
}

/// The names of the external libraries in the workspace's manifest.
fn libraries(manifest: &str) -> BTreeSet<String> {
    let table = manifest.split("[workspace.dependencies]").nth(1).unwrap_or_default();
    let lines = table.lines().take_while(|line| !line.starts_with('['));
    let names = lines.filter_map(|line| line.split_once(" = ").map(|(name, _)| name.trim().to_owned()));
    names.filter(|name| !name.starts_with("armarium-")).collect()
}

#[test]
fn every_library_is_used_and_its_choice_is_explained() {
    let root = repository::root();
    let libraries = libraries(&read(&root.join("Cargo.toml")));
    let page = read(&root.join("docs/dependencies.md"));
    // The first table explains the choices; the second one says what they cost.
    let choices = page.split("\n## ").next().unwrap_or("");
    let rows = choices.lines().filter(|line| line.starts_with("| `"));
    let first = rows.filter_map(|line| line.split('|').nth(1));
    let explained: BTreeSet<String> =
        first.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(str::to_owned).collect();
    assert_eq!(libraries, explained);
    let manifests: Vec<String> = repository::rooms().iter().map(|room| read(&room.manifest)).collect();
    let used = |name: &&String| {
        let starts = [format!("\n{name}."), format!("\n{name} =")];
        manifests.iter().any(|m| starts.iter().any(|s| m.contains(s)))
    };
    assert_eq!(libraries.iter().filter(|name| !used(name)).collect::<Vec<_>>(), Vec::<&String>::new());
}

/// Rust files of the repository.
fn sources() -> Vec<PathBuf> {
    let mut folders = vec![repository::root()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let name = entry.file_name();
            if path.is_dir() && name != "target" && name != ".git" {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    files
}

/// The lines on which a `select!` does not begin with `biased`.
fn unbiased(text: &str) -> Vec<usize> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let begins = |line: &str| line.contains(concat!("select", "! {")) && !line.starts_with("//");
    let is_biased =
        |i: usize| lines[i].contains("biased;") || lines.get(i + 1).is_some_and(|l| *l == "biased;");
    (0..lines.len()).filter(|i| begins(lines[*i]) && !is_biased(*i)).map(|i| i + 1).collect()
}

/// `select!` draws its order at random unless it says `biased`; then one run would differ from the next.
#[test]
fn every_select_is_biased() {
    let good = concat!("tokio::select", "! {\n    biased;\n}");
    let bad = concat!("x\nselect", "! {\n    a = b => {}\n}");
    assert_eq!((unbiased(good), unbiased(bad)), (Vec::new(), vec![2]));
    let wrong: Vec<String> = sources()
        .iter()
        .flat_map(|file| {
            unbiased(&read(file)).into_iter().map(move |line| format!("{}:{line}", file.display()))
        })
        .collect();
    assert_eq!(wrong, Vec::<String>::new());
}

/// Names of the robots that ship, of their links, joints, limbs and postures. Words that charts use for any robot, or that are
/// names of other things as well, do not count.
fn names_of_robots() -> BTreeSet<String> {
    const COMMON: [&str; 9] = ["root", "torso", "head", "eyes", "home", "wipe", "ready", "base", "tool"];
    let mut names = BTreeSet::new();
    for robot in armarium_robot::description::shipped_robots() {
        let model = armarium_robot::Model::shipped(robot).expect("the robots that ship are sound");
        names.insert(robot.to_owned());
        // What a platform adds is the same for all robots.
        let (links, joints) = model.platform().map_or((0, 0), |platform| (platform.link.index(), 3));
        names.extend(model.links().iter().skip(links).map(|link| link.name.clone()));
        names.extend(model.joints().iter().skip(joints).map(|joint| joint.name.clone()));
        names.extend(model.limbs().keys().chain(model.postures().keys()).cloned());
        names.remove(armarium_robot::Platform::LIMB);
    }
    names.retain(|name| !COMMON.contains(&name.as_str()));
    names
}

/// The code of a file without its tests and comments.
fn code_of(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.map(|line| format!("{line}\n")).collect()
}

/// A robot is data: nothing outside of `robots/` and tests names one, or a part of one.
#[test]
fn no_code_names_a_robot_or_a_part_of_one() {
    let root = repository::root();
    let names = names_of_robots();
    let is_test = |path: &Path| {
        let parts: Vec<_> = path.iter().filter_map(|part| part.to_str()).collect();
        let file = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("");
        parts.iter().any(|part| ["tests", "robots", "benches", "target"].contains(part))
            || file.ends_with("tests")
            || file == "testing"
    };
    let mut found = Vec::new();
    for file in sources() {
        let path = file.strip_prefix(&root).expect("it is in the repository");
        if is_test(path) {
            continue;
        }
        let code = code_of(&read(&file));
        let strings = code.split('"').skip(1).step_by(2);
        found.extend(
            strings.filter(|text| names.contains(*text)).map(|text| format!("{}: {text}", path.display())),
        );
    }
    assert_eq!(found, Vec::<String>::new());
}

/// Source text of the library rooms, without tests: what others build on.
fn library_sources() -> Vec<(PathBuf, String)> {
    let is_test = |path: &Path| {
        let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        path.iter().any(|part| part == "tests") || stem.ends_with("tests") || stem == "properties"
    };
    let program = repository::root().join("cli");
    let of_library = |path: &PathBuf| {
        path.iter().any(|part| part == "src") && !path.starts_with(&program) && !is_test(path)
    };
    let without_tests = |text: String| {
        // `mod tests;` in a file of its own ends nothing here.
        let tests = text.match_indices("#[cfg(test)]\nmod ").find(|(at, _)| {
            let line = text[*at..].lines().nth(1).unwrap_or_default();
            line.ends_with('{')
        });
        text[..tests.map_or(text.len(), |(at, _)| at)].to_owned()
    };
    sources().into_iter().filter(of_library).map(|path| (path.clone(), without_tests(read(&path)))).collect()
}

#[test]
fn a_public_type_has_a_name_of_its_own_in_the_whole_house() {
    let mut places: std::collections::BTreeMap<String, Vec<String>> = std::collections::BTreeMap::new();
    for (path, text) in library_sources() {
        for line in text.lines() {
            let kinds = ["pub struct ", "pub enum ", "pub trait ", "pub type "];
            let line = line.trim_start();
            let Some(rest) = kinds.iter().find_map(|kind| line.strip_prefix(kind)) else { continue };
            let name = rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
            places.entry(name.to_owned()).or_default().push(path.display().to_string());
        }
    }
    assert!(places.len() > 400, "types are not found: {}", places.len());
    let twice: Vec<_> = places.iter().filter(|(_, places)| places.len() > 1).collect();
    assert!(twice.is_empty(), "one name, two types: {twice:#?}");
}

#[test]
fn errors_of_library_rooms_have_types() {
    let mut untyped = Vec::new();
    for (path, text) in library_sources() {
        let code = code_of(&text).split_whitespace().collect::<Vec<_>>().join(" ");
        // Up to the bracket that closes it, whatever stands inside.
        let inside = |rest: &str| {
            let mut depth = 1;
            let end = rest.char_indices().find(|(at, c)| {
                depth += match c {
                    '<' => 1,
                    '>' if !rest[..*at].ends_with('-') => -1,
                    _ => 0,
                };
                depth == 0
            });
            rest[..end.map_or(0, |(at, _)| at)].trim().trim_end_matches(',').to_owned()
        };
        let results = code.split("-> Result<").skip(1).map(inside);
        untyped.extend(
            results.filter(|of| of.ends_with(", String")).map(|of| format!("{}: {of}", path.display())),
        );
    }
    assert_eq!(untyped, Vec::<String>::new());
}

/// The second parameters of all `Result<_, _>` in a text.
fn error_types(text: &str) -> Vec<String> {
    let parameters = |rest: &str| {
        let (mut depth, mut parts, mut before) = (0, vec![String::new()], ' ');
        for letter in rest.chars() {
            match letter {
                '<' | '(' | '[' => depth += 1,
                // `->` closes nothing.
                '>' if before == '-' => {}
                '>' | ')' | ']' if depth == 0 => break,
                '>' | ')' | ']' => depth -= 1,
                ',' if depth == 0 => parts.push(String::new()),
                _ => {}
            }
            if letter != ',' || depth > 0 {
                parts.last_mut().expect("it has one").push(letter);
            }
            before = letter;
        }
        parts.get(1).map(|part| part.trim().to_owned())
    };
    text.split("Result<").skip(1).filter_map(parameters).filter(|part| !part.is_empty()).collect()
}

/// A library's errors are types, so that a program can tell them apart; only the command line may end in a bare text.
#[test]
fn libraries_have_no_errors_that_are_bare_text() {
    let good = "fn a() -> Result<BTreeMap<String, String>, TreeError>; fn b(f: impl Fn(u8) -> Result<(), io::Error>)";
    assert_eq!(error_types(good), ["TreeError", "io::Error"]);
    let bad = "Result<\n    Vec<(u8, String)>,\n    String,\n>; Result<(), &'static str>";
    assert_eq!(error_types(bad), ["String", "&'static str"]);
    let root = repository::root();
    let mut found = Vec::new();
    for file in sources() {
        let path = file.strip_prefix(&root).expect("it is in the repository");
        let room = path.iter().next().and_then(|room| room.to_str()).unwrap_or("");
        let is_library =
            path.iter().nth(1).is_some_and(|folder| folder == "src") && room != "cli" && room != "tests";
        let is_test =
            path.file_stem().and_then(|stem| stem.to_str()).is_some_and(|stem| stem.ends_with("tests"))
                || path.iter().any(|part| part == "tests" || part == "properties.rs");
        if !is_library || is_test {
            continue;
        }
        let errors = error_types(&code_of(&read(&file)));
        let bare =
            errors.into_iter().filter(|error| ["String", "&str", "&'static str"].contains(&error.as_str()));
        found.extend(bare.map(|error| format!("{}: {error}", path.display())));
    }
    assert_eq!(found, Vec::<String>::new());
}
