//! What an editor is told: completion, hover, definitions, references, renames, fixes, symbols.

use armarium_editor::RenameError;
use armarium_editor::lsp_types::{
    CompletionTextEdit, DocumentChanges, HoverContents, OneOf, Range, WorkspaceEdit,
};

use crate::fixture::{self, OpenProject};

const PARTS: &str = "\
statechart: Parts
inputs:
  depth: {type: float, unit: m, default: 0.1, description: How deep.}
outputs:
  done: {type: bool}
initial: Go
states:
  Go:
    skill: Press
    with: {force: 3 N}
    transitions: {success: Good, blocked: Stuck, failure: Bad}
  Good:  {enter: [{assign: {outputs.done: true}}], always: End}
  End:   {final: success}
  Stuck: {final: stuck}
  Bad:   {final: failure}
";

const WHOLE: &str = "\
statechart: Whole
types:
  Mood: {enum: [calm, hasty]}
inputs:
  force: {type: float, unit: N, default: 5.0}
  mood:  {type: Mood, default: calm}
locals:
  n: {type: int, default: 0}
events:
  stop: {data: {why: string}}
initial: Use
states:
  Use:
    statechart: Parts
    with: {depth: 20 mm}
    transitions: {success: Wait, stuck: Wait, failure: Bad}
  Wait:
    watch: {pushed: {if: \"norm(channels.wrist.push) > 6.0\"}}
    transitions:
      pushed: {target: Work, do: [{assign: {locals.n: \"${locals.n + 1}\"}}]}
      stop: Bad
  Work:
    initial: Inner
    states:
      Inner: {skill: Press, with: {force: \"${inputs.force}\"}, transitions: {success: Ended, blocked: Ended, failure: Bad}}
      Ended: {final: success}
    transitions: {success: {target: Good, if: \"Use.done && active('Work.Ended')\"}}
  Good: {final: success}
  Bad:  {final: failure}
";

const CASES: &str = "\
test: whole.yaml
skills: {Press: success}
cases:
  - case: it works
    given: {force: 6 N}
    steps:
      - {channel: wrist, value: {push: [7.0, 0.0, 0.0]}, expect: {active: [Good], locals: {n: 1}}}
      - {event: stop, data: {why: x}}
      - {event: pushed, from: Wait, expect: {active: [Inner]}}
";

fn project() -> OpenProject {
    OpenProject::new(&[("parts.yaml", PARTS), ("whole.yaml", WHOLE), ("whole.test.yaml", CASES)])
}

/// The labels that are offered at the mark.
fn offered(text: &str) -> Vec<String> {
    offers(text).into_iter().map(|(label, _)| label).collect()
}

fn offers(text: &str) -> Vec<(String, String)> {
    let mut project = project();
    let name = if text.starts_with("test:") { "x.test.yaml" } else { "x.yaml" };
    // The last text that could be read is known, as it is while somebody writes.
    let good =
        text.lines().filter(|line| !line.contains('|')).map(|line| format!("{line}\n")).collect::<String>();
    let (uri, _) = project.open(name, &good);
    let _ = project.workspace.findings(&uri);
    let (uri, position) = project.open(name, text);
    let mut items = project.workspace.completion(&uri, position, true);
    items.sort_by(|a, b| a.sort_text.cmp(&b.sort_text));
    let insert = |edit: Option<CompletionTextEdit>| match edit {
        Some(CompletionTextEdit::Edit(edit)) => edit.new_text,
        _ => String::new(),
    };
    items.into_iter().map(|item| (item.label, insert(item.text_edit))).collect()
}

fn has(text: &str, wanted: &[&str], unwanted: &[&str]) {
    let offered = offered(text);
    let is = |word: &&&str| offered.iter().any(|label| label == **word);
    assert!(wanted.iter().all(|word| is(&word)), "{text}\n{offered:?}");
    assert!(!unwanted.iter().any(|word| is(&word)), "{text}\n{offered:?}");
}

fn chart(states: &str) -> String {
    format!(
        "statechart: X\ninputs:\n  f: {{type: float, unit: N, default: 1.0}}\n  d: {{type: float, unit: m, default: 1.0}}\nlocals:\n  n: {{type: int, default: 0}}\ninitial: A\nstates:\n{states}"
    )
}

#[test]
fn keys_are_those_of_the_form() {
    has(&chart("  A:\n    |\n"), &["skill", "transitions", "after", "with"], &["statecharts", "inputs"]);
    has("statechart: X\n|", &["inputs", "states", "events"], &["statechart", "skill"]);
    has(&chart("  A: {retry: {|}}\n"), &["times", "wait"], &["skill"]);
    has("world: w\ntable:\n  |\n", &["height", "friction"], &["objects"]);
    has("world: w\nobjects:\n  - |\n", &["name", "size"], &["table"]);
    has("object: o\n|", &["grasps", "mass"], &["objects"]);
}

#[test]
fn values_are_names_that_are_known_here() {
    has(
        &chart("  A: {after: {1s: |}}\n  B: {}\n  C: {states: {D: {}}, initial: D}\n"),
        &["A", "B", "C"],
        &["D"],
    );
    has(&chart("  A:\n    initial: |\n    states:\n      In: {}\n      Out: {}\n"), &["In", "Out"], &["A"]);
    has(&chart("  A:\n    skill: |\n"), &["Press", "Look"], &["A"]);
    has(&chart("  A:\n    statechart: |\n"), &["Parts", "Whole"], &[]);
    has("statechart: X\ninputs:\n  a: {type: |}\n", &["float", "Pose"], &[]);
    has("statechart: X\ninputs:\n  a: {type: float, unit: |}\n", &["N", "mm"], &[]);
    has(&chart("  A: {history: |}\n"), &["shallow", "deep"], &[]);
    has(&chart("  A: {unbreakable: |}\n"), &["true", "false"], &[]);
    has("test: |\n", &["Whole", "Parts"], &[]);
}

#[test]
fn words_are_those_of_what_they_are_for() {
    has("|", &["statechart", "world", "test", "scene", "object"], &["states"]);
    has("sta|", &["statechart"], &["states"]);
    let moody = |line: &str| {
        format!(
            "statechart: X\ntypes:\n  Mood: {{enum: [calm, hasty]}}\nlocals:\n  mood: {{type: Mood, default: calm}}\n\
            initial: A\nstates:\n  A:\n{line}  B: {{}}\n"
        )
    };
    let watched = moody("    watch: {w: {if: \"locals.mood == '|'\"}}\n");
    has(&watched, &["calm", "hasty"], &["locals", "true"]);
    has(&moody("    enter: [{assign: {locals.mood: |}}]\n"), &["calm", "hasty"], &["A"]);
    let second = moody("    watch: {w: {if: \"locals.mood == 'calm' && |\"}}\n");
    has(&second, &["locals"], &["calm"]);
}

#[test]
fn outcomes_that_are_not_handled_come_first() {
    let text = chart("  A:\n    skill: Press\n    transitions:\n      success: A\n      |\n");
    let offered = offered(&text);
    assert_eq!(&offered[..2], ["blocked", "failure"], "{offered:?}");
    assert!(!offered.contains(&"success".to_owned()));
    has(
        &chart("  A:\n    statechart: Parts\n    transitions: {|}\n"),
        &["stuck", "success", "failure"],
        &["blocked"],
    );
}

#[test]
fn a_skill_comes_with_the_inputs_that_it_must_have() {
    let offers = offers(&chart("  A:\n    skill: |\n"));
    let press = offers.iter().find(|(label, _)| label == "Press").map(|(_, insert)| insert.as_str());
    assert_eq!(press, Some("Press\n    with: {force: ${1:0 N}}"));
    has(&chart("  A:\n    skill: Press\n    with: {|}\n"), &["force", "mode"], &["depth"]);
    has(&chart("  A:\n    skill: Press\n    with: {mode: |}\n"), &["soft", "hard"], &[]);
    has(&chart("  A:\n    skill: Press\n    with: {force: |}\n"), &["${inputs.f}"], &["${inputs.d}"]);
}

#[test]
fn expressions_know_their_names_and_fields() {
    has(
        &chart("  A:\n    watch:\n      w: {if: \"|\"}\n"),
        &["inputs", "channels", "norm", "active"],
        &["A"],
    );
    has(&chart("  A:\n    watch:\n      w: {if: \"channels.|\"}\n"), &["wrist", "hand"], &["inputs"]);
    has(&chart("  A:\n    watch:\n      w: {if: \"channels.wrist.|\"}\n"), &["push", "settled"], &["wrist"]);
    has(&chart("  A:\n    watch:\n      w: {if: \"age('|\"}\n"), &["wrist"], &["norm"]);
    has(
        &chart("  A: {skill: Press, with: {force: 1 N}}\n  B: {enter: [{log: \"${A.|}\"}]}\n"),
        &["depth"],
        &["inputs"],
    );
    has(&chart("  A: {enter: [{log: \"${inputs.|}\"}]}\n"), &["f", "d"], &["n"]);
    has(&chart("  A: {enter: [{assign: {|}}]}\n"), &["locals.n"], &["inputs.f"]);
}

#[test]
fn test_cases_know_their_chart() {
    let text = |step: &str| format!("test: whole.yaml\ncases:\n  - case: a\n    steps:\n      - {step}\n");
    has(&text("{expect: {active: [|]}}"), &["Inner", "Wait", "Go"], &[]);
    has(&text("{event: |}"), &["stop"], &[]);
    has(&text("{channel: |}"), &["wrist"], &[]);
    has("test: whole.yaml\ncases:\n  - case: a\n    given: {|}\n", &["force", "mood"], &["n"]);
}

#[test]
fn hover_says_what_is_known() {
    let at = |mark: &str| {
        let mut project = project();
        let text = WHOLE.replacen(mark, &format!("{}|{}", &mark[..1], &mark[1..]), 1);
        let (uri, position) = project.open("whole.yaml", &text);
        match project.workspace.hover(&uri, position).map(|hover| hover.contents) {
            Some(HoverContents::Markup(content)) => content.value,
            _ => String::new(),
        }
    };
    for (mark, wanted) in [
        ("Press, with", "Presses on something."),
        ("force}\"", "float in N = 5.0"),
        ("Parts", "How deep."),
        ("depth: 20", "input `depth: float in m = 0.1`"),
        ("transitions: {success: Wait", "Transitions by event"),
        ("wrist.push", "channel `wrist`"),
        ("push) >", "list<float in N>"),
        ("norm(", "The length of a vector"),
        ("pushed: {target", "watch `pushed` of `Wait`"),
        ("stuck: Wait", "outcome `stuck` of the chart `Parts`"),
        ("Good, if", "final: success"),
        ("Ended')", "state `Work.Ended`"),
        ("done &&", "output `done: bool`"),
        ("stop: Bad", "{why: string}"),
    ] {
        assert!(at(mark).contains(wanted), "{mark}: {}", at(mark));
    }
}

/// Where the name at the mark is defined, and everywhere it is used.
fn places(file: &str, text: &str) -> (Vec<String>, Vec<String>) {
    let mut project = project();
    let (uri, position) = project.open(file, text);
    let definition = project.workspace.definition(&uri, position);
    let uses = project.workspace.find_references(&uri, position, true);
    let shown = |l: armarium_editor::lsp_types::Location| project.shown(&l.uri, l.range);
    (definition.into_iter().map(shown).collect(), uses.into_iter().map(shown).collect())
}

#[test]
fn names_lead_to_their_definitions_and_uses() {
    for (from, to, definition, uses) in [
        (
            "target: Work",
            "target: W|ork",
            "whole.yaml:21:2",
            vec!["whole.yaml:19:23", "whole.yaml:21:2", "whole.yaml:26:67"],
        ),
        (
            "statechart: Parts",
            "statechart: P|arts",
            "parts.yaml:0:12",
            vec!["parts.yaml:0:12", "whole.yaml:13:16"],
        ),
        ("{depth:", "{d|epth:", "parts.yaml:2:2", vec!["parts.yaml:2:2", "whole.yaml:14:11"]),
        ("stuck: Wait", "st|uck: Wait", "parts.yaml:13:17", vec!["parts.yaml:13:17", "whole.yaml:15:33"]),
        (
            "Use.done",
            "Use.d|one",
            "parts.yaml:4:2",
            vec!["parts.yaml:11:36", "parts.yaml:4:2", "whole.yaml:26:51"],
        ),
        ("type: Mood", "type: M|ood", "whole.yaml:2:2", vec!["whole.yaml:2:2", "whole.yaml:5:16"]),
        (
            "pushed: {target",
            "p|ushed: {target",
            "whole.yaml:17:12",
            vec!["whole.test.yaml:8:16", "whole.yaml:17:12", "whole.yaml:19:6"],
        ),
        (
            "stop: Bad",
            "s|top: Bad",
            "whole.yaml:9:2",
            vec!["whole.test.yaml:7:16", "whole.yaml:20:6", "whole.yaml:9:2"],
        ),
    ] {
        let (found, mut used) = places("whole.yaml", &WHOLE.replacen(from, to, 1));
        used.sort();
        assert_eq!(
            (found, used),
            (vec![definition.to_owned()], uses.into_iter().map(str::to_owned).collect()),
            "{from}"
        );
    }
}

/// The files after a rename.
fn renamed(file: &str, text: &str, name: &str) -> Result<Vec<(String, String)>, RenameError> {
    let mut project = project();
    let (uri, position) = project.open(file, text);
    let edit = project.workspace.rename(&uri, position, name)?;
    Ok(done(&project, edit))
}

fn done(project: &OpenProject, edit: WorkspaceEdit) -> Vec<(String, String)> {
    let Some(DocumentChanges::Edits(changes)) = edit.document_changes else { return Vec::new() };
    let mut files = Vec::new();
    for change in changes {
        let name = change.text_document.uri.as_str().rsplit('/').next().unwrap_or("").to_owned();
        let text = project.workspace.text(&change.text_document.uri).map(str::to_owned);
        let text = text.unwrap_or_else(|| {
            std::fs::read_to_string(project.folder.path().join(&name)).expect("it is there")
        });
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for edit in change.edits.into_iter().rev() {
            let OneOf::Left(edit) = edit else { continue };
            let Range { start, end } = edit.range;
            assert_eq!(start.line, end.line);
            let line = &mut lines[start.line as usize];
            line.replace_range(start.character as usize..end.character as usize, &edit.new_text);
        }
        files.push((name, lines.join("\n") + "\n"));
    }
    files
}

#[test]
fn a_rename_changes_every_use_and_nothing_else() {
    for (from, to, old, new) in [
        ("  Wait:", "  W|ait:", "Wait", "Idle"),
        ("  force: {type", "  f|orce: {type", "force", "push"),
        ("  n: {type", "  |n: {type", "n", "count"),
        ("pushed: {if", "p|ushed: {if", "pushed", "touched"),
        ("  stop: {data", "  s|top: {data", "stop", "halt"),
        ("  Mood:", "  M|ood:", "Mood", "Temper"),
    ] {
        let files = renamed("whole.yaml", &WHOLE.replacen(from, to, 1), new).expect(old);
        let mut after = OpenProject::new(&[("parts.yaml", PARTS)]);
        for (name, text) in &files {
            after.open(name, text);
        }
        let (uri, _) = after.open(
            "whole.yaml",
            &files.iter().find(|(name, _)| name == "whole.yaml").expect("it is changed").1,
        );
        let errors: Vec<String> =
            after.workspace.findings(&uri).iter().filter(|f| f.is_error()).map(ToString::to_string).collect();
        assert_eq!(errors, Vec::<String>::new(), "{old}");
        let test = files.iter().find(|(name, _)| name == "whole.test.yaml");
        assert_eq!(test.is_some_and(|(_, text)| text.contains(new)), old != "Mood", "{old}: {files:?}");
    }
    let files =
        renamed("whole.yaml", &WHOLE.replacen("  Use:", "  U|se:", 1), "First").expect("a chart's state");
    assert!(files.iter().any(|(_, text)| text.contains("initial: First") && text.contains("First.done")));
    let files = renamed("parts.yaml", &PARTS.replacen("final: stuck", "final: st|uck", 1), "jammed")
        .expect("an outcome");
    assert_eq!(files.len(), 2, "{files:?}");
    assert!(files.iter().any(|(name, text)| name == "whole.yaml" && text.contains("jammed: Wait")));
}

#[test]
fn a_rename_is_refused_with_its_reason() {
    let refused = |from: &str, to: &str, name: &str| {
        renamed("whole.yaml", &WHOLE.replacen(from, to, 1), name).expect_err(from).to_string()
    };
    for (from, to, name, reason) in [
        ("skill: Press", "skill: P|ress", "Push", "is a skill"),
        ("channels.wrist", "channels.w|rist", "hand", "is a channel"),
        ("norm(", "n|orm(", "abs", "is a function"),
        ("  Wait:", "  W|ait:", "1st", "is not a name"),
        ("  Wait:", "  W|ait:", "inputs", "is a word of the language"),
        ("  Wait:", "  W|ait:", "Good", "stands for something else already"),
        ("  force: {type", "  f|orce: {type", "mood", "stands for something else already"),
        // Seen from inside, the new name would hide another state.
        ("      Inner:", "      I|nner:", "Bad", "stands for something else already"),
        ("blocked: Ended", "bl|ocked: Ended", "other", "an outcome of a skill"),
        ("success: Wait", "succ|ess: Wait", "other", "a word of the language"),
        ("type: int", "ty|pe: int", "other", "there is no name here"),
    ] {
        let found = refused(from, to, name);
        assert!(found.contains(reason), "{from}: {found}");
    }
    let line = WHOLE.lines().position(|line| line.starts_with("  Good:")).expect("it is there") + 1;
    let found = refused("  Wait:", "  W|ait:", "Good");
    assert!(found.ends_with(&format!("whole.yaml:{line}:3")), "{found}");
}

#[test]
fn a_broken_text_is_served_by_the_last_that_was_whole() {
    let mut project = project();
    let (uri, _) = project.open("whole.yaml", WHOLE);
    assert!(project.workspace.findings(&uri).is_empty());
    let (uri, position) =
        project.open("whole.yaml", &WHOLE.replacen("  Good: {final", "  : [\n  G|ood: {final", 1));
    assert!(project.workspace.findings(&uri).iter().any(|f| f.code == "E002"));
    assert!(project.workspace.hover(&uri, position).is_some());
    let uses = project.workspace.find_references(&uri, position, true);
    assert!(uses.len() >= 2, "{uses:?}");
}

#[test]
fn files_that_do_not_say_what_they_are_are_told_by_their_name_or_their_beginning() {
    for (name, text, code) in [
        ("a.world.yaml", "world W\n", "E004"),
        ("b.test.yaml", "cases: []\n", "E005"),
        ("c.yaml", "statechart C8\ninitial: A\n", "E002"),
        ("d.yaml", "id: door\ninitial: A\nstates: {A: {}}\n", "E005"),
    ] {
        let mut project = project();
        let (uri, _) = project.open(name, text);
        let codes: Vec<&str> = project.workspace.findings(&uri).iter().map(|finding| finding.code).collect();
        assert!(codes.contains(&code), "{name}: {codes:?}");
    }
}

#[test]
fn other_files_and_lost_files_are_no_errors() {
    let mut project = project();
    let (uri, position) = project.open("compose.yaml", "services:\n  web: {image: x}\n|");
    assert_eq!(project.workspace.findings(&uri), []);
    assert!(project.workspace.completion(&uri, position, true).is_empty());
    let (uri, _) = project.open("whole.yaml", WHOLE);
    assert_eq!(project.workspace.findings(&uri), []);
    std::fs::remove_file(project.folder.path().join("parts.yaml")).expect("it was there");
    project.workspace.close(&fixture::uri(&project.folder.path().join("parts.yaml")));
    assert_eq!(project.workspace.findings(&uri).iter().map(|f| f.code).collect::<Vec<_>>(), ["E011"]);
    // A text that was never saved stands for the file.
    project.open("parts.yaml", PARTS);
    assert_eq!(project.workspace.findings(&uri), []);
    project.workspace.close(&uri);
    assert_eq!(project.workspace.findings(&uri), []);
}

#[test]
fn symbols_folds_lenses_and_hints() {
    let mut project = project();
    let (uri, _) = project.open("whole.yaml", WHOLE);
    let symbols = project.workspace.symbols(&uri);
    let states = symbols
        .iter()
        .find(|s| s.name == "states")
        .and_then(|s| s.children.as_ref())
        .expect("there are states");
    let names: Vec<&str> = states.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["Use", "Wait", "Work", "Good", "Bad"]);
    assert_eq!(states[0].detail.as_deref(), Some("chart Parts"));
    assert_eq!(states[2].children.as_ref().map(Vec::len), Some(2));
    let folds = project.workspace.folding(&uri);
    assert!(folds.iter().any(|fold| (fold.start_line, fold.end_line) == (12, 15)), "{folds:?}");
    let lenses = project.workspace.lenses(&uri);
    let commands: Vec<&str> =
        lenses.iter().filter_map(|l| l.command.as_ref()).map(|c| c.command.as_str()).collect();
    assert_eq!(commands, ["armarium.run", "armarium.test", "armarium.graph"]);
    let all = Range::new(Default::default(), armarium_editor::lsp_types::Position::new(99, 0));
    let hints = project.workspace.hints(&uri, all);
    assert_eq!(hints.len(), 2, "{hints:?}");
}
