//! The editor and `check` find the same, whatever is typed.

use std::path::Path;

use armarium_editor::lsp_types::{Position, Range, TextDocumentContentChangeEvent};
use armarium_editor::{FileKind, Workspace, check, format};
use armarium_source::{Disk, Layout, yaml};
use proptest::prelude::*;

use crate::fixture::{catalog, charts, shipped, uri};

/// Something that is typed at a place.
#[derive(Clone, Debug)]
struct Typed {
    line: u32,
    column: u32,
    lines: u32,
    columns: u32,
    text: String,
}

fn typed() -> impl Strategy<Value = Typed> {
    let words = prop_oneof![
        Just(String::new()),
        Just("\n".to_owned()),
        Just("  ".to_owned()),
        Just("\"${inputs.".to_owned()),
        Just("é😀".to_owned()),
        Just("    skill: MoveJoints\n".to_owned()),
        Just("transitions: {success: Done}".to_owned()),
        Just("{".to_owned()),
        Just("]".to_owned()),
        "[ -~]{1,12}",
    ];
    (0..110_u32, 0..60_u32, 0..3_u32, 0..20_u32, words)
        .prop_map(|(line, column, lines, columns, text)| Typed { line, column, lines, columns, text })
}

/// What is found in the file alone: with other files beside it, each has its own findings.
fn compared(workspace: &mut Workspace, file: &Path) {
    let address = uri(file);
    let text = workspace.text(&address).expect("it is open").to_owned();
    let found = workspace.findings(&address);
    if FileKind::of(file, &text).is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for other in shipped() {
        std::fs::copy(&other, folder.path().join(other.file_name().expect("it has a name")))
            .expect("it can be copied");
    }
    let copy = folder.path().join(file.file_name().expect("it has a name"));
    std::fs::write(&copy, &text).expect("it can be written");
    let checked = check(&copy, &[], &Disk, &catalog()).findings;
    let shown = |findings: &[armarium_source::Finding], folder: &Path| {
        let shown = findings.iter().map(|f| f.to_string().replace(&format!("{}/", folder.display()), ""));
        shown.collect::<Vec<String>>()
    };
    assert_eq!(shown(&found, &charts()), shown(&checked, folder.path()), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_edits_make_the_editor_disagree_with_check(
        file in 0..shipped().len(),
        edits in prop::collection::vec(typed(), 1..6),
    ) {
        let file = &shipped()[file];
        let address = uri(file);
        let mut workspace = Workspace::new(catalog(), &[]);
        workspace.open(address.clone(), 0, std::fs::read_to_string(file).expect("it is there"));
        for (version, edit) in (1..).zip(edits) {
            let start = Position::new(edit.line, edit.column);
            let end = Position::new(edit.line + edit.lines, edit.columns);
            let range = Some(Range::new(start, end));
            let change = TextDocumentContentChangeEvent { range, range_length: None, text: edit.text };
            workspace.change(&address, version, vec![change]);
            let _ = workspace.completion(&address, start, true);
            let _ = workspace.hover(&address, start);
            let _ = workspace.symbols(&address);
            let _ = workspace.hints(&address, Range::new(start, end));
        }
        compared(&mut workspace, file);
    }

    #[test]
    fn a_file_says_the_same_in_its_form(
        file in 0..shipped().len(),
        spaces in prop::collection::vec((0..200_usize, 0..6_usize), 0..8),
    ) {
        let mut lines: Vec<String> =
            std::fs::read_to_string(&shipped()[file]).expect("it is there").lines().map(str::to_owned).collect();
        for (line, count) in spaces {
            let at = line % lines.len();
            lines[at].push_str(&" ".repeat(count));
            lines.insert(at, String::new());
        }
        let text = lines.join("\n");
        let path = Path::new("f.yaml");
        let formatted = format(path, &text);
        if let Ok(formatted) = formatted {
            prop_assert_eq!(format(path, &formatted), Ok(formatted.clone()));
            // Inside of a text of several lines, spaces at the end of a line are text.
            let layout = Layout::of(&formatted);
            let mut start = 0;
            for line in formatted.split_inclusive('\n') {
                let bare = line.trim_end_matches('\n');
                let in_text = layout.texts.iter().any(|t| t.start < start + bare.len() && start <= t.end);
                prop_assert!(in_text || bare.trim_end() == bare, "{}", bare);
                start += line.len();
            }
            let literal = |text: &str| {
                let source = armarium_source::Source::new(path, text);
                yaml::parse(&mut armarium_source::Findings::new(source.into())).map(|node| node.literal())
            };
            prop_assert_eq!(literal(&text), literal(&formatted));
            let comments = |text: &str| text.lines().filter_map(|l| l.split_once("# ").map(|(_, c)| c.trim().to_owned())).collect::<Vec<_>>();
            prop_assert_eq!(comments(&text), comments(&formatted));
        }
    }
}

#[test]
fn what_ships_is_found_to_be_in_order() {
    let mut workspace = Workspace::new(catalog(), &[]);
    for file in shipped() {
        workspace.open(uri(&file), 0, std::fs::read_to_string(&file).expect("it is there"));
    }
    for file in shipped() {
        compared(&mut workspace, &file);
    }
}
