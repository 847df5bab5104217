//! Names that are known before a run are offered and checked where skills take them, and so are channels that charts declare, and
//! what they observe of memory.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_editor::lsp_types::{DocumentChanges, HoverContents, OneOf, Position, Range, Uri};
use armarium_editor::{Catalog, Workspace};
use armarium_runtime::chart::{ChannelSchema, KnownNames, MemorySegment, Registry};
use armarium_runtime::skill::{
    NameKind, Outcome, Parameter, Skill, SkillContext, SkillManifest, SkillResult,
};
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

/// The place behind a text of a chart.
fn behind(chart: &str, text: &str) -> Position {
    let before = &chart[..chart.find(text).expect("it is in the chart") + text.len()];
    let line = before.matches('\n').count();
    let column = before.rsplit('\n').next().map_or(0, str::len);
    Position::new(u32::try_from(line).expect("few"), u32::try_from(column).expect("few"))
}

/// The labels that are offered behind a text of the chart.
fn offered(workspace: &mut Workspace, uri: &Uri, text: &str) -> Vec<String> {
    workspace.completion(uri, behind(CHART, text), false).into_iter().map(|item| item.label).collect()
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

const OBSERVES: &str = "statechart: T
observe: {cup: \"ObjectInstances/*/cup*\"}
initial: A
states:
  A:
    watch:
      near: \"channels.cup.pose.z > 1.0\"
      gone: \"age('cup') > 2.0 || size(channels.cup_all) == 0\"
    transitions: {near: B, gone: B}
  B: {final: success}
";

/// A workspace with the chart as an open document, and a memory that knows of objects.
fn observing(chart: &str) -> (Workspace, Uri) {
    let attributes = [("class", Type::String), ("pose", Type::Pose)];
    let attributes = attributes.map(|(name, ty)| Parameter::new(name, ty, "In the root frame.")).into();
    let objects = MemorySegment {
        name: "ObjectInstances".into(),
        description: "Things that were seen.".into(),
        attributes,
    };
    let channels = ChannelSchema::new().with("wrist", Type::FLOAT).with_segment(objects);
    let mut workspace = Workspace::new(Catalog { registry: Registry::new(), channels }, &[] as &[PathBuf]);
    let uri: Uri = "file:///nowhere/t.yaml".parse().expect("it is an address");
    workspace.open(uri.clone(), 1, chart.to_owned());
    (workspace, uri)
}

#[test]
fn what_a_chart_observes_is_offered_and_explained() {
    let (mut workspace, uri) = observing(OBSERVES);
    assert_eq!(workspace.findings(&uri).len(), 0);
    let mut offered = |text: &str| -> Vec<String> {
        let items = workspace.completion(&uri, behind(OBSERVES, text), false);
        items.into_iter().map(|item| item.label).collect()
    };
    assert_eq!(offered("near: \"channels."), ["cup", "cup_all", "wrist"]);
    assert_eq!(offered("near: \"channels.cup."), ["class", "confidence", "id", "pose", "position"]);
    assert_eq!(offered("age('c"), ["cup", "cup_all", "wrist"]);
    assert_eq!(offered("cup: \"Obj"), ["ObjectInstances/*/*"]);
    let mut said =
        |text: &str| match workspace.hover(&uri, behind(OBSERVES, text)).map(|hover| hover.contents) {
            Some(HoverContents::Markup(markup)) => markup.value,
            other => panic!("{other:?}"),
        };
    let cup = said("near: \"channels.cu");
    assert!(cup.contains("channel `cup`: ObjectInstances/*/cup*") && cup.contains("`pose: Pose`"), "{cup}");
    assert_eq!(said("age('cu"), cup);
    assert!(said("channels.cup.po").contains("attribute of ObjectInstances: `pose: Pose`"));
}

#[test]
fn what_a_chart_observes_is_renamed_wherever_it_is_read() {
    let (mut workspace, uri) = observing(OBSERVES);
    let edit = workspace.rename(&uri, behind(OBSERVES, "near: \"channels.c"), "mug").expect("it is ours");
    let Some(DocumentChanges::Edits(changes)) = edit.document_changes else { panic!("no edits") };
    let mut text: Vec<String> = OBSERVES.lines().map(str::to_owned).collect();
    let mut edits: Vec<_> = changes.into_iter().flat_map(|change| change.edits).collect();
    edits.reverse();
    for edit in edits {
        let OneOf::Left(edit) = edit else { panic!("an annotated edit") };
        let Range { start, end } = edit.range;
        let line = &mut text[start.line as usize];
        line.replace_range(start.character as usize..end.character as usize, &edit.new_text);
    }
    let expected = OBSERVES
        .replace("{cup:", "{mug:")
        .replace("channels.cup", "channels.mug")
        .replace("age('cup')", "age('mug')");
    assert_eq!(text.join("\n"), expected.trim_end());
    assert!(workspace.rename(&uri, behind(OBSERVES, "channels.cup.po"), "place").is_err(), "memory names it");
}

#[test]
fn a_misspelt_name_and_attribute_are_put_right() {
    for (wrong, right) in [("channels.cup.pose", "channels.cpu.pose"), ("cup.pose", "cup.poze")] {
        let chart = OBSERVES.replace(wrong, right);
        let (mut workspace, uri) = observing(&chart);
        let at = behind(&chart, right);
        let at = Position::new(at.line, at.character - 1);
        let fixes = workspace.fixes(&uri, Range::new(at, at));
        assert_eq!(fixes.len(), 1, "{:?}", workspace.findings(&uri));
    }
}
