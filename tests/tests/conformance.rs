//! The public SCXML suites: each case is imported and driven under virtual time through its expected
//! configurations. The cases are read from a folder beside the repository, or from the folder in `SCXML_SUITE`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use armarium_runtime::chart::{self, ChannelSchema, Registry};
use armarium_runtime::import::{self, Imported};
use armarium_runtime::stepping::Stepper;
use armarium_tests::outside::not_run;
use armarium_tests::repository;
use armarium_values::Value;
use serde_json::Value as Json;

/// The folder of the suites, if there is one.
fn suite() -> Option<PathBuf> {
    let folder = std::env::var_os("SCXML_SUITE").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| repository::root().join("../shared/conformance/scxml"));
    folder.is_dir().then_some(folder)
}

fn cases(folder: &Path, found: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).expect("the suite can be read");
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            cases(&path, found);
        } else if path.extension().is_some_and(|e| e == "scxml") {
            found.push(path);
        }
    }
}

/// The active leaves, by their SCXML ids, sorted.
fn configuration(stepper: &Stepper, imported: &Imported) -> Vec<String> {
    let own = |name: String| imported.renamed.get(&name).cloned().unwrap_or(name);
    let mut ids: Vec<String> = stepper.snapshot().configuration.into_iter().map(own).collect();
    ids.sort();
    ids
}

fn expected(case: &Json, key: &str) -> Vec<String> {
    let ids = case[key].as_array().expect("a configuration is a list");
    let mut ids: Vec<String> = ids.iter().filter_map(Json::as_str).map(str::to_owned).collect();
    ids.sort();
    ids
}

fn run(case: &Path) -> Result<(), String> {
    let text = std::fs::read_to_string(case).map_err(|e| e.to_string())?;
    let name = case.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let imported = import::scxml(&text, &name).map_err(|errors| format!("import: {errors:?}"))?;
    let library = chart::load_text("imported.yaml", &imported.yaml, &[]);
    let checked = chart::check(&library, &Registry::new(), &ChannelSchema::new());
    let findings: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
    let program = checked.program.ok_or_else(|| format!("{}\n{}", findings.join("\n"), imported.yaml))?;
    let mut stepper = Stepper::new(program, &BTreeMap::new(), None).map_err(|e| e.to_string())?;
    let script = std::fs::read_to_string(case.with_extension("json")).map_err(|e| e.to_string())?;
    let script: Json = serde_json::from_str(&script).map_err(|e| e.to_string())?;

    let strict = !case.components().any(|part| part.as_os_str() == "w3c-ecma");
    let compare = |stepper: &Stepper, at: &str, wanted: Vec<String>| {
        let found = configuration(stepper, &imported);
        if strict && found != wanted {
            return Err(format!("{at}: {found:?} instead of {wanted:?}\n{}", imported.yaml));
        }
        Ok(())
    };
    stepper.start();
    compare(&stepper, "at the start", expected(&script, "initialConfiguration"))?;
    for event in script["events"].as_array().expect("events are a list") {
        let after = event["after"].as_u64().unwrap_or(0);
        stepper.advance(Duration::from_millis(after));
        let name = event["event"]["name"].as_str().expect("an event has a name");
        stepper.event(name, Value::from_json(&event["event"]["data"]));
        compare(&stepper, name, expected(event, "nextConfiguration"))?;
    }
    if !strict {
        stepper.advance(Duration::from_secs(60));
        let found = configuration(&stepper, &imported);
        if found != ["pass"] {
            return Err(format!("it ends in {found:?}\n{}", imported.yaml));
        }
    }
    Ok(())
}

#[test]
fn the_public_scxml_suites_pass() {
    let Some(folder) = suite() else {
        return not_run("the SCXML suites are not here; SCXML_SUITE names their folder");
    };
    let mut found = Vec::new();
    cases(&folder, &mut found);
    assert!(!found.is_empty(), "{} holds no case", folder.display());
    let results = found.iter().map(|case| (case, run(case)));
    let failed =
        results.filter_map(|(case, result)| result.err().map(|e| format!("{}: {e}", case.display())));
    let failed: Vec<String> = failed.collect();
    assert!(failed.is_empty(), "{} of {} cases\n{}", failed.len(), found.len(), failed.join("\n"));
}
