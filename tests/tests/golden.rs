//! Tests every rule of the check by one bad chart and its good twin: `golden/CODE-what.bad.yaml` and `.good.yaml`.
//! The findings of all bad charts are in `golden/findings.txt`; `GOLDEN=write` rewrites it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_runtime::chart::{self, ChannelSchema, Refused, Registry};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_tests::repository;
use armarium_values::{Type, Unit};
use futures::FutureExt as _;
use futures::future::BoxFuture;

/// A skill that has only a manifest.
struct Declared(SkillManifest);

impl Skill for Declared {
    fn manifest(&self) -> SkillManifest {
        self.0.clone()
    }
    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        async { Ok(Outcome::success()) }.boxed()
    }
}

fn registry() -> Registry {
    let newton = Type::quantity(Unit::N);
    let act =
        SkillManifest::new("Act", "Acts.").optional("force", newton, 1.0, "Any force.").outcome("blocked");
    let arm = SkillManifest::new("Arm", "Moves the arm.").limb("right_arm");
    let needs = SkillManifest::new("Needs", "Needs something.").input("what", Type::String, "Anything.");
    let says = SkillManifest::new("Says", "Says something.").output("said", Type::String, "What it said.");
    let skills = [act, arm, needs, says].into_iter().map(|m| Arc::new(Declared(m)) as Arc<dyn Skill>);
    let mut registry: Registry = skills.collect();
    // The offers of the agent bob, and a query that it refused.
    let dance = SkillManifest::new("bob/Dance", "Dances.").input("steps", Type::Int, "How many.");
    registry.add_remote(Arc::new(Declared(dance)));
    let reason = "`bob` does not offer `Dnce`".to_owned();
    registry.refuse_remote("bob/Dnce", Refused { reason, help: Some("did you mean `Dance`?".into()) });
    registry
}

fn folder() -> PathBuf {
    repository::root().join("tests/golden")
}

/// The findings of a file, one per line, with paths relative to the folder.
fn findings(file: &Path) -> Vec<String> {
    let wrist = Type::record([("push", Type::list(Type::quantity(Unit::N)))]);
    let channels = ChannelSchema::new().with("wrist", wrist);
    let library = chart::load(file, &[folder().join("charts")]);
    let checked = chart::check(&library, &registry(), &channels);
    let here = format!("{}/", folder().display());
    checked.findings.iter().map(|f| f.to_string().replace(&here, "")).collect()
}

fn files(ending: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder()).expect("the folder is there").flatten().map(|e| e.path());
    let mut files: Vec<PathBuf> = entries.filter(|p| p.to_string_lossy().ends_with(ending)).collect();
    files.sort();
    files
}

fn code(file: &Path) -> String {
    let name = file.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    name.split('-').next().unwrap_or("").to_owned()
}

#[test]
fn a_wrong_chart_is_found_by_its_rule_and_its_good_twin_is_in_order() {
    let (mut said, mut wrong) = (String::new(), Vec::new());
    for bad in files(".bad.yaml") {
        let (code, found) = (format!("[{}]", code(&bad)), findings(&bad));
        if !found.iter().any(|f| f.contains(&code)) {
            wrong.push(format!("{} is not found: {found:?}", bad.display()));
        }
        said.extend(found.iter().map(|line| format!("{line}\n")));
        let good = bad.to_string_lossy().replace(".bad.", ".good.");
        wrong.extend(findings(Path::new(&good)));
    }
    assert_eq!(wrong, Vec::<String>::new());
    let kept = folder().join("findings.txt");
    if std::env::var_os("GOLDEN").is_some() {
        std::fs::write(&kept, &said).expect("the folder can be written");
    }
    assert_eq!(said, std::fs::read_to_string(&kept).unwrap_or_default(), "GOLDEN=write writes it anew");
}

/// Codes without a golden case, each with where it is tested.
const ELSEWHERE: [&str; 6] = [
    "E001", // a file that cannot be read: the loader's tests
    "E008", // two things of one name: no part of charts; the worlds' tests
    "E009", // too many levels or states: the loader's tests build them
    "E028", // values out of their range: no part of charts; the worlds' tests
    "E029", // things that do not exist: no part of charts; the worlds' tests
    "E025", // forms that a build does not run: `remote` without its feature
];

#[test]
fn every_code_has_its_case() {
    let codes = armarium_source::code::TABLE.iter().map(|(code, _)| *code);
    let have: BTreeSet<String> = files(".bad.yaml").iter().map(|f| code(f)).collect();
    let missing: Vec<&str> = codes.filter(|c| !have.contains(*c) && !ELSEWHERE.contains(c)).collect();
    assert_eq!(missing, Vec::<&str>::new());
}
