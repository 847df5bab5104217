//! Forms, units, and that no text panics.

use std::sync::Arc;

use super::{Finding, Layout, Rule, Source, code, form, read, schema};

form! {
    /// A shelf.
    struct Shelf: "a shelf", check Self::stands {
        /// Its name.
        name: String, Rule::NAME;
        /// How high it is, m.
        height: f64 = 1.0, Rule::number("m", 0.0, 3.0);
        /// How it leans, degrees.
        lean_deg: f64 = 0.0, Rule::degrees(10.0, "lean");
        /// How its books lie.
        books: Vec<Book> = Vec::new(), Rule::most(3);
        /// Whose it is.
        owner as "for": Option<String> = None, Rule::OR_NONE;
    }
}

form! {
    struct Book: "a book" {
        pages: u32 = 100, Rule::number("", 1.0, 2000.0);
    }
}

impl Shelf {
    fn stands(&self, node: &super::yaml::Node, findings: &mut super::Findings) {
        if self.height > 2.0 && self.lean_deg > 5.0 {
            findings.error(code::VALUE, node.place("lean_deg"), "it falls");
        }
    }
}

fn shelf(text: &str) -> Result<Shelf, Vec<Finding>> {
    read(Arc::new(Source::new("shelf.yaml", text)))
}

#[test]
fn units_are_those_of_charts() {
    for (text, height) in
        [("0.5", 0.5), ("15 mm", 0.015), ("0.002 km", 2.0), ("50cm", 0.5), ("2", 2.0), ("1e0 m", 1.0)]
    {
        let read = shelf(&format!("name: a\nheight: {text}\n")).unwrap();
        assert!((read.height - height).abs() < 1e-12, "{text}: {}", read.height);
    }
    for text in [
        "lean_deg: 5",
        "lean_deg: 5 deg",
        "lean: 5 deg",
        "lean: 0.08726646259971647",
        "lean_deg: 0.08726646259971647 rad",
    ] {
        let read = shelf(&format!("name: a\n{text}\n")).unwrap();
        assert!((read.lean_deg - 5.0).abs() < 1e-12, "{text}: {}", read.lean_deg);
    }
    assert_eq!(shelf("name: a\nlean: 7 deg").unwrap().lean_deg, 7.0);
    assert_eq!(shelf("name: a\nfor: none").unwrap().owner, None);
}

#[test]
fn everything_that_is_wrong_is_found_with_its_code_and_place() {
    for (text, found) in [
        ("name: a\nheigth: 1\n", "2:1 E003 did you mean `height`?"),
        ("height: 1\n", "1:1 E005 "),
        ("name: a\nheight: 4 m\n", "2:9 E028 it lies between 0 and 3 m"),
        ("name: a\nheight: 4 kg\n", "2:9 E017 it is a number in m, or in another unit of that kind"),
        ("name: a\nheight: tall\n", "2:9 E004 "),
        ("name: a\nheight: [1]\n", "2:9 E004 "),
        ("name: ''\n", "1:7 E028 "),
        ("name: a\nbooks: [{}, {pages: 1.5}]\n", "2:21 E028 "),
        ("name: a\nbooks: [{}, {}, {}, {}]\n", "2:8 E009 "),
        ("name: a\nheight: 2.5\nlean_deg: 6\n", "3:11 E028 "),
        ("name: [\n", "1:7 E002 add the missing `]`"),
        ("[1]\n", "1:1 E004 "),
    ] {
        let findings = shelf(text).unwrap_err();
        let finding = findings.first().unwrap();
        let (line, column) = finding.position();
        let help = finding.help.as_deref().unwrap_or("");
        assert_eq!(format!("{line}:{column} {} {help}", finding.code), found, "{text}: {finding}");
    }
}

#[test]
fn the_schema_is_made_of_the_same_table() {
    let schema = schema::<Shelf>();
    assert_eq!(schema["required"], serde_json::json!(["name"]));
    assert_eq!(schema["properties"]["height"]["description"], "How high it is, m.");
    assert_eq!(schema["properties"]["height"]["default"], 1.0);
    assert_eq!(schema["properties"]["height"]["maximum"], 3.0);
    assert_eq!(schema["properties"]["books"]["items"]["properties"]["pages"]["type"], "integer");
    assert!(schema["properties"]["lean"].is_object());
}

#[test]
fn the_page_of_findings_is_the_table_of_codes() {
    let page = include_str!("../../docs/findings.md");
    let rows: Vec<String> = page.lines().filter(|l| l.starts_with("| `")).map(str::to_owned).collect();
    let table: Vec<String> =
        code::TABLE.iter().map(|(code, what)| format!("| `{code}` | {} |", what.trim())).collect();
    assert_eq!(rows, table);
}

proptest::proptest! {
    #[test]
    fn no_text_panics(text in "\\PC{0,80}") {
        let _ = shelf(&text);
    }

    #[test]
    fn no_value_panics(key in "[a-z_]{1,12}", value in "[-a-z0-9.,\\[\\]{}: ]{0,24}") {
        let _ = shelf(&format!("name: {{{key}: {value}}}\nbooks: [{{{key}: {value}}}]\n{key}: {value}\n"));
    }
}

/// With a search for the line's beginning from each item, this would take minutes.
#[test]
fn very_long_lines_have_their_columns() {
    let items = 300_000;
    for (open, item, close) in [("[", "1, ", "]"), ("[", "\"a\", ", "]"), ("[", "[", "]")] {
        let text = format!("a: 1\nb: {open}{}{close}\n", item.repeat(items));
        let layout = Layout::of(&text);
        let last = layout.entries.last().expect("it has items");
        assert_eq!(layout.entries.len(), items + 2);
        assert_eq!(last.column, last.key.start - "a: 1\n".len(), "{item}");
    }
}

mod edited {
    use std::sync::Arc;

    use proptest::prelude::*;

    use crate::yaml::{self, Node};
    use crate::{Findings, Source};

    const TEXT: &str = "# A chart.\nstatechart: C # named\ninputs: {f: {type: float}}\nstates:\n  A:\n    skill: Look\n    with:\n      a: [1,\n        2]\n      'b': |\n        text\n\n    transitions: {success: B,\n      failure: D}\n  # Between.\n  B:\n  é: {final: success}\n  D:\n    enter:\n    - log: x\n    - {raise: y}\nlast: ~\n";

    fn tree(source: Source) -> (Arc<Source>, Option<Arc<Node>>) {
        let source = Arc::new(source);
        let tree = yaml::parse(&mut Findings::new(Arc::clone(&source)));
        (source, tree)
    }

    #[test]
    fn what_is_not_edited_is_not_read_again() {
        let before = tree(Source::new("", TEXT)).1.expect("it is YAML");
        let edit = |from, to| yaml::after_edit(TEXT, &before, &TEXT.replacen(from, to, 1));
        for (from, to) in [
            ("Look", "Loook"),
            ("[1,", "[1, 7,"),
            ("success: B", "success: D"),
            ("text", "text\n        more"),
            ("~", "7"),
        ] {
            assert!(edit(from, to).is_some(), "{from}");
        }
        for (from, to) in [
            ("statechart", "chart"),
            ("Look", "&a Look"),
            ("  D:\n", "D:\n"),
            ("Look", "[Look"),
            ("x\n", "x\n  E: 1\n  "),
        ] {
            assert!(edit(from, to).is_none(), "{from}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn an_edited_text_has_the_tree_of_its_text(
            edits in prop::collection::vec((0..300_usize, 0..6_usize, "[a: \\n{}',&#|~-]{0,5}"), 1..4),
        ) {
            let mut text = TEXT.to_owned();
            let (mut before, _) = tree(yaml::edited("", TEXT, None));
            for (at, length, typed) in edits {
                let boundary = |at: usize| (0..=at.min(text.len())).rfind(|at| text.is_char_boundary(*at)).unwrap_or(0);
                let (start, end) = (boundary(at), boundary(at + length));
                text.replace_range(start..end, &typed);
                let (now, edited) = tree(yaml::edited("", text.as_str(), Some(&before)));
                prop_assert_eq!(&edited, &tree(Source::new("", text.as_str())).1, "{}", text);
                if edited.is_some() {
                    before = now;
                }
            }
        }
    }
}
