//! Conversion of documents: the written chart, and what is refused.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::Value;

use super::scxml;
use crate::chart::{ChannelSchema, Registry, check, load_text};
use crate::stepping::Stepper;

fn wrap(inside: &str) -> String {
    format!("<scxml xmlns='http://www.w3.org/2005/07/scxml' version='1.0'>\n{inside}\n</scxml>")
}

fn yaml(inside: &str) -> String {
    scxml(&wrap(inside), "c").unwrap_or_else(|e| panic!("{e:?}")).yaml
}

fn refused(inside: &str) -> Vec<String> {
    let errors = scxml(&wrap(inside), "c").err().unwrap_or_default();
    errors.iter().map(ToString::to_string).collect()
}

fn stepper(inside: &str) -> Stepper {
    let yaml = yaml(inside);
    let checked = check(&load_text("c.yaml", &yaml, &[]), &Registry::new(), &ChannelSchema::new());
    let program = checked.program.unwrap_or_else(|| panic!("{:?}\n{yaml}", checked.findings));
    let mut stepper = Stepper::new(program, &BTreeMap::new(), None).unwrap();
    stepper.start();
    stepper
}

/// The active leaves after the start, or after an event.
fn leaves(inside: &str, event: Option<&str>) -> String {
    let mut stepper = stepper(inside);
    event.into_iter().for_each(|event| stepper.event(event, Value::Null));
    stepper.snapshot().configuration.join(" ")
}

#[test]
fn documents_go_where_the_standard_says() {
    for case in include_str!("cases.txt").split("\n## ").skip(1) {
        let (name, text) = case.split_once('\n').unwrap();
        let (document, steps) = text.split_once("\n> ").unwrap();
        let mut stepper = stepper(document);
        for step in steps.lines().map(|line| line.trim_start_matches("> ")).filter(|line| !line.is_empty()) {
            let (step, expected) = step.split_once(" => ").unwrap_or((step, ""));
            match step.split_once(' ') {
                Some(("event", event)) => stepper.event(event, Value::Null),
                Some((_, seconds)) => stepper.advance(Duration::from_secs(seconds.parse().unwrap())),
                None if step == "restart" => {
                    stepper = self::stepper(document);
                    continue;
                }
                None => {}
            }
            assert_eq!(stepper.snapshot().configuration.join(" "), expected, "{name}: {step}");
        }
    }
}

#[test]
fn a_small_document_as_a_whole() {
    let text = yaml(
        "<state id='a'><onentry><raise event='e'/></onentry>\
         <transition event='e f.*' cond=\"In('b.1') || _event.name == 'e'\" target='b.1'>\
         <send event='late' delay='1.5s' id='l'/><log label='L' expr=\"'x' + 1\"/></transition></state>\
         <state id='b.1'><transition event='late' target='a'/></state>",
    );
    insta::assert_snapshot!(text);
}

#[test]
fn every_mistake_is_found_at_once_with_its_line() {
    let found = refused(
        "<datamodel><data id='x'/></datamodel>\n<state id='a'>\n<invoke/>\n<transition event='e' target='nowhere' cond='x == 1'/>\n\
         <onentry><script>1</script><send event='e' delay='soon'/></onentry></state>\n<state id='a'/>",
    );
    let expected = [
        "line 2: `<datamodel>` needs a data model: only the null data model and literals are carried over",
        "line 4: `<invoke>` cannot be carried over: write a `statechart:` or `remote:` state",
        "line 5: the expression `x == 1` cannot be carried over: `x` needs a data model",
        "line 5: there is no state with the id `nowhere`",
        "line 6: `<script>` cannot be carried over: charts hold no programs",
        "line 6: `soon` is not a delay: write `2s` or `100ms`",
        "line 7: two states have the id `a`",
    ];
    assert_eq!(found, expected);
}

#[test]
fn hostile_documents_are_refused() {
    let deep = format!("{}{}", "<state>".repeat(5000), "</state>".repeat(5000));
    assert!(refused(&deep)[0].contains("nested deeper"));
    let ifs = format!(
        "<state><onentry>{}{}</onentry></state>",
        "<if cond='true'>".repeat(100),
        "</if>".repeat(100)
    );
    assert!(refused(&ifs)[0].contains("nested deeper"));
    let bomb = "<!DOCTYPE x [<!ENTITY a 'aa'><!ENTITY b '&a;&a;'>]><scxml>&b;</scxml>";
    assert!(scxml(bomb, "c").unwrap_err()[0].message.contains("XML"));
    assert!(scxml("", "c").is_err() && scxml("<a/>", "c").is_err() && scxml("\u{0}", "c").is_err());
    let cond = format!("<state><transition cond=\"{}true\"/></state>", "!(".repeat(1000));
    assert!(refused(&cond)[0].contains("too deep"));
}

#[test]
fn names_that_are_not_allowed_are_changed_and_kept() {
    let imported =
        scxml(&wrap("<state id='b.1'/><state id='b_1'/><state id='in'/><state/><state id='c'/>"), "c");
    let imported = imported.unwrap();
    let changed: Vec<(&str, &str)> = imported.renamed.iter().map(|(n, i)| (n.as_str(), i.as_str())).collect();
    assert_eq!(changed, [("b_1_2", "b.1"), ("in_", "in")]);
    assert!(imported.yaml.contains("  b_1_2: {}  # `b.1` in SCXML\n"), "{}", imported.yaml);
    assert!(imported.yaml.contains("statechart: c_2\n"), "{}", imported.yaml);
}

#[test]
fn expressions_of_literals_are_computed() {
    for (text, expected) in [
        ("1 + 2 == 3", "b"),
        ("'a' === 'a' && !false", "b"),
        ("1 > 2 || ''", "a"),
        ("In('nowhere')", "a"),
        ("In('a') && !In('b')", "b"),
        ("!(In('a') || In('b'))", "a"),
        ("_event.name == 'e'", "b"),
        ("_name == 'c' && _event.name != 'f'", "b"),
        ("0", "a"),
    ] {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        let found = leaves(
            &format!(
                "<state id='a'><transition event='e' cond=\"{text}\" target='b'/></state><state id='b'/>"
            ),
            Some("e"),
        );
        assert_eq!(found, expected, "{text}");
    }
    for text in
        ["x", "1 +", "'a", "a(", "In(x)", "f('a')", "_event.origin", "1 = 1", "'\\q'", "-'a'", "'a' < 1"]
    {
        let text = text.replace('<', "&lt;");
        assert_eq!(refused(&format!("<state><transition cond=\"{text}\"/></state>")).len(), 1, "{text}");
    }
}

#[test]
fn what_cannot_be_sent_is_the_error_event_that_scxml_names() {
    for (attribute, error) in [
        ("target='baz'", "error.execution"),
        ("type='27'", "error.execution"),
        ("target='#_scxml_foo'", "error.communication"),
        ("target='#_parent'", "error.communication"),
    ] {
        let document = format!(
            "<state id='a'><onentry><send event='e' {attribute}/><send event='f'/></onentry>\
             <transition event='{error}' target='b'/><transition event='*' target='c'/></state><state id='b'/><state id='c'/>"
        );
        assert_eq!(leaves(&document, None), "b", "{attribute}");
    }
}

#[test]
fn an_event_carries_content() {
    for (content, condition) in [
        ("<content>123</content>", "_event.data == 123"),
        ("<content> some\n  text </content>", "_event.data == 'some text'"),
        ("<content>{\"a\": {\"b\": \"${c}\"}}</content>", "_event.data.a.b == '${c}'"),
        ("<content expr=\"'x' + 1\"/>", "_event.data == 'x1'"),
        ("<content/>", "_event.name == 'e'"),
        ("<param name='a' expr='2'/>", "_event.data.a == 2"),
    ] {
        let document = format!(
            "<state id='a'><onentry><send event='e' namelist=''>{content}</send></onentry>\
             <transition event='e' cond=\"{condition}\" target='b'/></state><state id='b'/>"
        );
        assert_eq!(leaves(&document, None), "b", "{content}");
    }
    let send =
        |inside: &str| refused(&format!("<state><onentry><send event='e'>{inside}</send></onentry></state>"));
    assert!(send("<content><p/></content>")[0].contains("XML is no value"));
    assert!(send("<content>1</content><param name='a' expr='2'/>")[0].contains("not both"));
    let deep = format!("<content>{}{}</content>", "[".repeat(60), "]".repeat(60));
    assert!(send(&deep)[0].contains("deeper than 20"));
    let done = "<state id='a'><final><donedata><content>1</content></donedata></final></state>";
    assert!(refused(done)[0].contains("as `<param>`"));
    assert!(
        refused("<state><onentry><send event='e' idlocation='x'/></onentry></state>")[0]
            .contains("idlocation")
    );
}

#[test]
fn what_tools_leave_beside_the_states_is_named_and_left_out() {
    let text = "\u{feff}<scxml xmlns='http://www.w3.org/2005/07/scxml' xmlns:q='http://www.qt.io/2015/02/scxml-ext' version='1.0'>\n\
        <q:editorinfo x='1'/><state id='a'>\n<q:editorinfo><q:part/></q:editorinfo></state></scxml>";
    let imported = scxml(text, "c").unwrap();
    assert!(
        imported.yaml.contains("# `<editorinfo>` (line 3) is not SCXML: it is left out."),
        "{}",
        imported.yaml
    );
    // Foreign content that would have to be executed, or read from elsewhere, is an error.
    let wrong = "<state xmlns:q='http://q'><onentry><q:do/></onentry></state>\
        <x:include xmlns:x='http://www.w3.org/2001/XInclude' href='b.scxml'/>";
    assert_eq!(refused(wrong).len(), 2);
}
