//! Tests every rule of the check by one bad chart and its good twin: `golden/CODE-what.bad.yaml` and `.good.yaml`.
//! The findings of all bad charts are in `golden/findings.txt`; `GOLDEN=write` rewrites it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_runtime::chart::{self, ChannelSchema, KnownNames, MemorySegment, Refused, Registry};
use armarium_runtime::skill::{
    NameKind, Outcome, Parameter, Skill, SkillContext, SkillManifest, SkillResult,
};
use armarium_source::{Finding, applied};
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

/// The names that are known before a run.
struct Known;

impl KnownNames for Known {
    fn names(&self, kind: NameKind, _: &Path) -> Option<BTreeSet<String>> {
        let names = match kind {
            NameKind::Posture => ["home", "wipe"],
            NameKind::Arm => ["left_arm", "right_arm"],
            _ => return None,
        };
        Some(names.map(str::to_owned).into())
    }
}

fn registry() -> Registry {
    let newton = Type::quantity(Unit::N);
    let act =
        SkillManifest::new("Act", "Acts.").optional("force", newton, 1.0, "Any force.").outcome("blocked");
    let arm = SkillManifest::new("Arm", "Moves the arm.").limb("right_arm");
    let needs = SkillManifest::new("Needs", "Needs something.").input("what", Type::String, "Anything.");
    let says = SkillManifest::new("Says", "Says something.").output("said", Type::String, "What it said.");
    let stand = SkillManifest::new("Stand", "Stands in a posture.")
        .optional("posture", Type::String, "", "A posture; none: as it is.")
        .names(NameKind::Posture);
    let reach = SkillManifest::new("Reach", "Moves an arm.")
        .optional("arm", Type::String, "", "The arm; empty: the right one.")
        .names(NameKind::Arm)
        .limb_by_input("arm", "", "right_arm")
        .limb_by_input("arm", "right_arm", "right_arm")
        .limb_by_input("arm", "left_arm", "left_arm");
    let skills =
        [act, arm, needs, reach, says, stand].into_iter().map(|m| Arc::new(Declared(m)) as Arc<dyn Skill>);
    let mut registry = skills.collect::<Registry>().with_names(Arc::new(Known));
    // The offers of the agent bob, and a query that it refused.
    let dance = SkillManifest::new("bob/Dance", "Dances.").input("steps", Type::Int, "How many.");
    registry.add_remote(Arc::new(Declared(dance)));
    let reason = "`bob` does not offer `Dnce`".to_owned();
    registry.refuse_remote("bob/Dnce", Refused { reason, help: Some("did you mean `Dance`?".into()) });
    registry
}

fn channels() -> ChannelSchema {
    let wrist = Type::record([("push", Type::list(Type::quantity(Unit::N)))]);
    let attributes = [("class", Type::String), ("pose", Type::Pose)];
    let attributes = attributes.map(|(name, ty)| Parameter::new(name, ty, "Something.")).into();
    let (name, description) = ("ObjectInstances".into(), "Things.".into());
    ChannelSchema::new().with("wrist", wrist).with_segment(MemorySegment { name, description, attributes })
}

fn folder() -> PathBuf {
    repository::root().join("tests/golden")
}

/// The findings of a file, one per line, with paths relative to the folder.
fn findings(file: &Path) -> Vec<String> {
    let channels = channels();
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

/// A bad chart's findings, and its text with the remedies of one of them done.
fn put_right(file: &Path) -> Vec<(Finding, Vec<Finding>)> {
    let channels = channels();
    let check = |path: &Path| {
        let library = chart::load(path, &[folder().join("charts")]);
        chart::check(&library, &registry(), &channels).findings
    };
    let fixed = tempfile::tempdir().expect("a temporary folder");
    let path = fixed.path().join("fixed.yaml");
    let found =
        check(file).into_iter().filter(|finding| finding.source.path == file && !finding.edits().is_empty());
    let one = |finding: Finding| {
        std::fs::write(&path, applied(&finding.source.text, &finding.edits())).expect("it can be written");
        let after = check(&path);
        (finding, after)
    };
    found.map(one).collect()
}

#[test]
fn a_remedy_removes_its_finding_and_brings_no_new_error() {
    let (mut tried, mut wrong) = (BTreeSet::new(), Vec::new());
    for bad in files(".bad.yaml") {
        for (finding, after) in put_right(&bad) {
            tried.insert(finding.code);
            let same = |f: &&Finding| f.code == finding.code && f.message == finding.message;
            let count = after.iter().filter(same).count();
            let others = findings(&bad);
            let new =
                after.iter().filter(|f| f.is_error() && !others.iter().any(|line| line.contains(&f.message)));
            let new: Vec<String> = new.map(ToString::to_string).collect();
            // What a file that was no YAML says is not known before.
            if count > 0 || !new.is_empty() && finding.code != "E002" {
                wrong.push(format!("{finding}\n{:?}\n{new:?}", finding.edits()));
            }
        }
    }
    assert_eq!(wrong, Vec::<String>::new());
    let expected = [
        "E002", "E003", "E004", "E005", "E006", "E007", "E010", "E012", "E014", "E015", "E016", "E017",
        "E018", "E019", "E020", "E021", "E022", "E024", "E028", "E029", "E030", "W101", "W102", "W103",
        "W104", "W106", "W107", "W109",
    ];
    assert_eq!(
        expected.iter().filter(|code| !tried.contains(*code)).collect::<Vec<_>>(),
        Vec::<&&str>::new()
    );
}

/// Codes without a golden case, each with where it is tested.
const ELSEWHERE: [&str; 5] = [
    "E001", // a file that cannot be read: the loader's tests
    "E009", // too many levels or states: the loader's tests build them
    "E028", // values out of their range: no part of charts; the worlds' tests
    "W110", // values that a robot's files leave out: the robots' tests
    "E025", // forms that a build does not run: `remote` without its feature
];

#[test]
fn every_code_has_its_case() {
    let codes = armarium_source::code::TABLE.iter().map(|(code, _)| *code);
    let have: BTreeSet<String> = files(".bad.yaml").iter().map(|f| code(f)).collect();
    let missing: Vec<&str> = codes.filter(|c| !have.contains(*c) && !ELSEWHERE.contains(c)).collect();
    assert_eq!(missing, Vec::<&str>::new());
}
