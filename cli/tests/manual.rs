//! The manual's charts and worlds are in order, its test cases pass, and every key of the language stands in one of them.

use std::path::Path;
use std::process::Command;

fn page(name: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name);
    std::fs::read_to_string(file).expect("the page is there")
}

fn manual() -> String {
    page("docs/statecharts.md")
}

/// What `armarium` prints about files in a folder, if it ends well.
fn said(folder: &Path, command: &str, files: &[String]) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_armarium")).arg(command).args(files).current_dir(folder).output();
    let output = output.expect("the program starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{command}: {text}");
    text
}

/// The YAML of the manual that begins with a key.
fn blocks<'m>(manual: &'m str, key: &str) -> Vec<&'m str> {
    let parts = manual.split("```yaml\n").skip(1).filter_map(|part| part.split("```").next());
    parts.filter(|block| block.starts_with(key)).collect()
}

#[test]
fn the_charts_of_the_manual_are_in_order_and_their_cases_pass() {
    let manual = manual();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut files = Vec::new();
    for chart in blocks(&manual, "statechart:") {
        let name =
            chart.lines().next().and_then(|line| line.split_whitespace().nth(1)).expect("a chart has a name");
        files.push(format!("{name}.yaml"));
        std::fs::write(folder.path().join(format!("{name}.yaml")), chart).expect("it can be written");
    }
    let mut tests = Vec::new();
    for (number, cases) in blocks(&manual, "test:").into_iter().enumerate() {
        tests.push(format!("{number}.test.yaml"));
        std::fs::write(folder.path().join(format!("{number}.test.yaml")), cases).expect("it can be written");
    }
    assert!(files.len() > 3 && tests.len() > 2);
    assert_eq!(said(folder.path(), "check", &files).trim(), "all files are in order");
    said(folder.path(), "test", &tests);
}

#[test]
fn the_worlds_and_charts_of_other_pages_are_in_order() {
    let (simulator, memory, readme) = (page("docs/simulator.md"), page("docs/memory.md"), page("README.md"));
    let world = [blocks(&simulator, "world:"), blocks(&simulator, "robots:")].concat().concat();
    // What another robot of this world runs.
    let helper = "statechart: Helper\ninputs: {back: {type: float}}\ninitial: Done\nstates: {Done: {final: success}}\n";
    let scene = blocks(&memory, "scene:").concat();
    let written = [
        ("kitchen.world.yaml", world.as_str()),
        ("helper.yaml", helper),
        ("breakfast.yaml", &scene),
        ("cup.yaml", "object: cup\ncolor: [40, 90, 200]\nsize: [80 mm, 80 mm, 100 mm]\nmass: 0.2 kg\n"),
        ("Greet.yaml", &blocks(&readme, "statechart: Greet").concat()),
    ];
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in written {
        assert!(text.lines().count() > 3, "{name}");
        std::fs::write(folder.path().join(name), text).expect("it can be written");
    }
    let files = written.map(|(name, _)| name.to_owned());
    assert_eq!(said(folder.path(), "check", &files).trim(), "all files are in order");
}

#[test]
fn every_key_of_the_language_stands_in_an_example() {
    let schema = include_str!("../../statecharts/chart.schema.json");
    let schema: serde_json::Value = serde_json::from_str(schema).expect("the schema is JSON");
    let manual = manual();
    let charts = blocks(&manual, "statechart:").concat();
    let mut missing = Vec::new();
    for place in ["/properties", "/$defs/state/properties", "/$defs/action/properties"] {
        let keys = schema.pointer(place).and_then(serde_json::Value::as_object).expect("the schema has keys");
        // A remote state needs another process: its example is the agents' test.
        let absent = keys.keys().filter(|key| *key != "remote" && !charts.contains(&format!("{key}:")));
        missing.extend(absent.cloned());
    }
    assert_eq!(missing, Vec::<String>::new());
}
