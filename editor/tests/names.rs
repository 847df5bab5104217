//! Names that are known before a run are offered and checked where skills take them, and so are channels that charts declare.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_editor::lsp_types::{Position, Uri};
use armarium_editor::{Catalog, Workspace};
use armarium_runtime::chart::{ChannelSchema, KnownNames, Registry};
use armarium_runtime::skill::{NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::Type;
use futures::future::BoxFuture;

/// A skill that has only a manifest.
struct Stand;

impl Skill for Stand {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Stand", "Stands.")
            .input("posture", Type::String, "A posture.")
            .names(NameKind::Posture)
    }
    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        Box::pin(async { Ok(Outcome::success()) })
    }
}

struct Postures;

impl KnownNames for Postures {
    fn names(&self, _: NameKind, _: &Path) -> Option<BTreeSet<String>> {
        Some(["home", "wipe"].map(str::to_owned).into())
    }
}

const CHART: &str = "statechart: T
channels: {battery: {type: {volts: {type: float, unit: V}}}}
initial: A
states:
  A:
    skill: Stand
    with: {posture: hom}
    watch: {low: \"channels.battery.volts < 11.0\"}
    transitions: {success: B, failure: B, low: B}
  B: {final: success}
";

/// The labels that are offered behind a text of the chart.
fn offered(workspace: &mut Workspace, uri: &Uri, behind: &str) -> Vec<String> {
    let before = &CHART[..CHART.find(behind).expect("it is in the chart") + behind.len()];
    let line = before.matches('\n').count();
    let column = before.rsplit('\n').next().map_or(0, str::len);
    let at = Position::new(u32::try_from(line).expect("few"), u32::try_from(column).expect("few"));
    workspace.completion(uri, at, false).into_iter().map(|item| item.label).collect()
}

#[test]
fn known_names_and_declared_channels_are_offered() {
    let skills = [Arc::new(Stand) as Arc<dyn Skill>];
    let registry = skills.into_iter().collect::<Registry>().with_names(Arc::new(Postures));
    let mut workspace =
        Workspace::new(Catalog { registry, channels: ChannelSchema::new() }, &[] as &[PathBuf]);
    let uri: Uri = "file:///nowhere/t.yaml".parse().expect("it is an address");
    workspace.open(uri.clone(), 1, CHART.to_owned());
    let found: Vec<String> = workspace.findings(&uri).iter().map(ToString::to_string).collect();
    assert!(found.len() == 1 && found[0].contains("there is no posture `hom`"), "{found:?}");
    let names = offered(&mut workspace, &uri, "posture: ho");
    assert!(names.contains(&"home".to_owned()) && names.contains(&"wipe".to_owned()), "{names:?}");
    assert_eq!(offered(&mut workspace, &uri, "\"channels.b"), ["battery"]);
    assert_eq!(offered(&mut workspace, &uri, "channels.battery.v"), ["volts"]);
}
