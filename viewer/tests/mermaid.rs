//! Mermaid reads and draws what is written for it, and shows every text as it was.
//!
//! It needs Node.js and the npm packages `mermaid` (11) and `jsdom`; the variable `ARMARIUM_NODE_MODULES` names their
//! folder. Without it the test says that it was not run; with `ARMARIUM_COMPLETE` it fails.

use std::path::{Path, PathBuf};
use std::process::Command;

use armarium_runtime::chart::{Library, Outline, load, load_text};
use armarium_viewer::chart::{Format, Theme, render};

use crate::outside::not_run;

/// Names and texts that have a meaning in Mermaid's language.
const ODD: &str = r#"statechart: Odd
initial: State
after: {60s: End}
states:
  State:
    transitions:
      a: {target: Note, if: 'x < 3 && y > 4 || z == "%%{a}" && w >= 2'}
      b: {target: Style, if: "size(m) <= 1 ? s == '<b>;--> #5' : n - 1 < 0"}
  Note: {transitions: {a: Class}}
  Style: {transitions: {a: Class}}
  Class: {transitions: {a: Default}}
  Default: {transitions: {a: Direction}}
  Direction: {transitions: {a: Click}}
  Click: {transitions: {a: Fork}}
  Fork: {transitions: {a: end}}
  end: {transitions: {a: TB}}
  TB: {transitions: {a: Par}}
  Par:
    parallel:
      L: {initial: A, states: {A: {transitions: {x: B, y: M.C, z: Par, w: End}}, B: {}}}
      M: {initial: C, states: {C: {transitions: {x: D}}, D: {final: success}, H: {history: deep, default: C}}}
    transitions: {success: End, again: Par, inner: Par.L.B}
  End: {final: success}
"#;

fn modules() -> Option<PathBuf> {
    let modules = std::env::var_os("ARMARIUM_NODE_MODULES").map(PathBuf::from);
    let modules = modules.filter(|folder| folder.join("mermaid").is_dir() && folder.join("jsdom").is_dir());
    if modules.is_none() {
        not_run("ARMARIUM_NODE_MODULES names no folder with the npm packages mermaid and jsdom");
    }
    modules
}

fn write(library: &Library, folder: &Path) -> PathBuf {
    let outline = Outline::of(&library.charts[&library.root]);
    let file = folder.join(format!("{}.mmd", library.root));
    let text = render(&outline, Format::Mermaid, Theme::Auto).expect("only PNG can fail");
    std::fs::write(&file, text).expect("it can be written");
    file
}

#[test]
fn mermaid_draws_every_chart_and_shows_every_text_as_it_was() {
    let Some(modules) = modules() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shipped = [
        "await_cup",
        "carry_box",
        "find_together",
        "grasp_object",
        "guide",
        "guide_both",
        "learn_wiping",
        "look_around",
        "reach_told",
        "share_scene",
        "take_together",
        "teach",
        "watch_table",
        "wiping",
    ];
    let charts = shipped.map(|name| load(&here.join(format!("../statecharts/{name}.yaml")), &[]));
    let charts = charts.into_iter().chain([load_text("odd.yaml", ODD, &[])]);
    let files: Vec<PathBuf> = charts.map(|library| write(&library, folder.path())).collect();
    let mut node = Command::new("node");
    let output =
        node.arg(here.join("tests/mermaid.mjs")).arg(modules).args(&files).output().expect("node runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let shown: serde_json::Value = serde_json::from_slice(&output.stdout).expect("it prints JSON");
    for file in &files {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        assert!(shown[&name].as_array().is_some_and(|texts| texts.len() > 3), "{name}");
    }
    let odd: Vec<&str> =
        shown["Odd.mmd"].as_array().into_iter().flatten().filter_map(|t| t.as_str()).collect();
    for text in [
        "a [x < 3 && y > 4 || z == \"%%{a}\" && w >= 2]",
        "b [size(m) <= 1 ? s == '<b>;--> #5' : n - 1 < 0]",
        "State",
        "end",
        "after 60s",
        "inner",
    ] {
        assert!(odd.contains(&text), "{text} in {odd:?}");
    }
}
