//! What fuzzing feeds with hostile input, one function a kind of file. The fuzz targets call these, and a test replays what
//! fuzzing has found.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_editor::lsp_types::{Position, Range, TextDocumentContentChangeEvent, Uri};
use armarium_editor::{Catalog, FileKind, Workspace};
use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Effect, Engine, Input, NoSensors};
use armarium_runtime::import;
use armarium_source::{Files, Finding, Source};
use armarium_values::expr::{Environment, EvalContext, Expr, Slot, Unknown, Unresolved, Variable};
use armarium_values::{Type, Value};
use armarium_visionx::providers::PixelOwner;
use armarium_visionx::providers::convert::{depth_of, rgb_of};
use armarium_visionx::providers::wire::{Header, pack, unpack};

/// Any text as a chart: it is refused, or it runs.
///
/// # Panics
/// Where the code under test is wrong.
pub fn chart(text: &str) {
    let checked = check(&load_text("fuzz.yaml", text, &[]), &Registry::new(), &ChannelSchema::new());
    checked.findings.iter().for_each(|finding| drop(finding.to_string()));
    let Some(program) = checked.program else { return };
    let Ok(mut engine) = Engine::new(program, &BTreeMap::new(), None) else { return };
    let mut out = Vec::new();
    engine.start(&NoSensors, &mut out);
    for name in ["a", "b", "go", "t", "next", "a"] {
        engine.handle(Input::Event { name: name.into(), data: Value::Int(1) }, &NoSensors, &mut out);
        let timers: Vec<u64> = out
            .drain(..)
            .filter_map(|e| if let Effect::StartTimer { timer, .. } = e { Some(timer) } else { None })
            .collect();
        for timer in timers.into_iter().take(8) {
            engine.handle(Input::Timer { timer }, &NoSensors, &mut out);
        }
    }
}

/// Any text as an SCXML document: it is refused with its errors, or becomes a chart that loads and runs.
///
/// # Panics
/// Where the code under test is wrong.
pub fn document(text: &str) {
    let Ok(imported) = import::scxml(text, "fuzz") else { return };
    let checked =
        check(&load_text("fuzz.yaml", &imported.yaml, &[]), &Registry::new(), &ChannelSchema::new());
    // What the importer writes is YAML in any case, whatever names and texts the document has.
    let broken = checked.findings.iter().find(|f| ["E002", "E003", "E004", "E005"].contains(&f.code));
    assert!(broken.is_none(), "{broken:?}\n{}", imported.yaml);
    let Some(program) = checked.program else { return };
    let Ok(mut engine) = Engine::new(program, &BTreeMap::new(), None) else { return };
    let mut out = Vec::new();
    engine.start(&NoSensors, &mut out);
    for name in ["e1", "t", "go", "done", "error.x"] {
        engine.handle(Input::Event { name: name.into(), data: Value::Null }, &NoSensors, &mut out);
    }
}

/// Any text as an expression: it is refused, or the quick way and the long way agree.
///
/// # Panics
/// Where the code under test is wrong.
pub fn expression(source: &str) {
    let list = Value::List((1..=4).map(Value::Int).collect());
    let fixture = Fixture(vec![
        ("n", Type::Int, Some(Value::Int(7))),
        ("x", Type::FLOAT, Some(Value::Float(2.5))),
        ("flag", Type::Bool, Some(Value::Bool(true))),
        ("word", Type::String, Some("fist".into())),
        ("items", Type::list(Type::Int), Some(list)),
        ("anything", Type::Any, Some(Value::record([("a", Value::Null)]))),
        ("later", Type::FLOAT, None),
    ]);
    let Ok(expr) = Expr::compile(source, &fixture) else { return };
    let (quick, long) = (expr.evaluate(&fixture), expr.interpret(&fixture));
    // By their text, as NaN is not equal to itself.
    assert_eq!(format!("{quick:?}"), format!("{long:?}"), "{source}");
    let _ = expr.observe(&fixture);
}

/// A few variables of several types.
struct Fixture(Vec<(&'static str, Type, Option<Value>)>);

impl Environment for Fixture {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let at = self.0.iter().position(|(name, ..)| path.first() == Some(name));
        let unknown = || Unresolved::new(Unknown::Name, "there is no such name".into(), None, None);
        let at = at.ok_or_else(unknown)?;
        Ok(Variable { slot: Slot::Data(at as u32), ty: self.0[at].1.clone(), used: 1 })
    }
    fn channel(&self, _: &str) -> Result<u32, Unresolved> {
        Ok(0)
    }
    fn state(&self, _: &str) -> Result<u32, Unresolved> {
        Ok(0)
    }
}

impl EvalContext for Fixture {
    fn data(&self, slot: u32) -> Option<&Value> {
        self.0.get(slot as usize)?.2.as_ref()
    }
    fn channel(&self, _: u32, _: &[String]) -> Option<Value> {
        None
    }
    fn age(&self, _: u32) -> Option<f64> {
        Some(0.5)
    }
    fn event_name(&self) -> Option<&str> {
        Some("said")
    }
    fn event_data(&self) -> Option<&Value> {
        None
    }
    fn active(&self, _: u32) -> bool {
        true
    }
}

/// Any bytes as a frame: as one message, and as header and payload of their own. They are refused, or are a frame that
/// survives being packed again.
///
/// # Panics
/// Where the code under test is wrong.
pub fn frame(bytes: &[u8]) {
    if let Ok((header, frame)) = unpack(bytes.to_vec()) {
        for image in &frame.images {
            let _ = (rgb_of(image), depth_of(image));
        }
        if let Ok(packed) = pack(&frame, header.epoch, header.sent_ns) {
            let (_, again) = unpack(packed).expect("what was packed can be unpacked");
            assert_eq!(again.images.len(), frame.images.len());
        }
    }
    let middle = usize::from(bytes.first().copied().unwrap_or(0)).min(bytes.len());
    let (said, payload) = bytes.split_at(middle);
    if let Ok(header) = Header::decode(said) {
        let owner: Arc<dyn PixelOwner> = Arc::new(payload.to_vec());
        let _ = header.frame(&owner);
    }
}

/// A folder with one file.
struct OneFile(Arc<Source>);

impl Files for OneFile {
    fn read(&self, path: &Path) -> Result<Arc<Source>, Box<Finding>> {
        if *path == self.0.path { Ok(Arc::clone(&self.0)) } else { Source::read(path) }
    }
    fn head(&self, path: &Path) -> Option<String> {
        (*path == self.0.path).then(|| self.0.text.clone())
    }
    fn list(&self, _: &Path) -> Vec<PathBuf> {
        vec![self.0.path.clone()]
    }
}

/// Any text as a chart in an editor, and edits of it: after each the editor finds what a check of the same text finds, and
/// answers whatever it is asked. The first line of the input says where the edits are and what they put there.
///
/// # Panics
/// Where the code under test is wrong.
pub fn edits(text: &str) {
    let (script, text) = text.split_once('\n').unwrap_or(("", text));
    let Ok(uri) = "file:///fuzz/fuzz.yaml".parse::<Uri>() else { return };
    let nothing = || Catalog { registry: Registry::new(), channels: ChannelSchema::new() };
    let mut workspace = Workspace::new(nothing(), &[]);
    workspace.open(uri.clone(), 0, text.to_owned());
    let mut text = text.to_owned();
    let mut numbers = script.bytes().map(u32::from);
    let mut version = 0;
    while let (Some(line), Some(column), Some(length)) = (numbers.next(), numbers.next(), numbers.next()) {
        const PUT: [&str; 12] =
            ["", " ", "\n", "  ", "- ", ": ", "{", "}", "\"", "${inputs.", "😀é", "states:\n  A: {}\n"];
        version += 1;
        let start = Position::new(line % 40, column % 60);
        let end = Position::new(start.line + length % 3, column % 60 + length % 7);
        let put = PUT[(line + column + length) as usize % PUT.len()];
        let range = Some(Range::new(start, end));
        let change = TextDocumentContentChangeEvent { range, range_length: None, text: put.to_owned() };
        workspace.change(&uri, version, vec![change]);
        if let Some(now) = workspace.text(&uri) {
            text = now.to_owned();
        }
        let found = workspace.findings(&uri);
        if FileKind::of(Path::new("/fuzz/fuzz.yaml"), &text).is_some() {
            let file = OneFile(Arc::new(Source::new("/fuzz/fuzz.yaml", text.as_str())));
            let checked = armarium_editor::check(&file.0.path, &[], &file, &nothing()).findings;
            assert_eq!(found, checked, "{text}");
        }
        let _ = (workspace.completion(&uri, start, true), workspace.hover(&uri, start));
        let _ = (workspace.definition(&uri, start), workspace.find_references(&uri, start, true));
        let _ = (workspace.symbols(&uri), workspace.folding(&uri), workspace.lenses(&uri));
        let _ =
            (workspace.hints(&uri, Range::new(start, end)), workspace.fixes(&uri, Range::new(start, end)));
        let _ = workspace.rename(&uri, start, "other");
    }
    if let Ok(formatted) = armarium_editor::format(Path::new("fuzz.yaml"), &text) {
        let again = armarium_editor::format(Path::new("fuzz.yaml"), &formatted);
        assert_eq!(again.as_deref(), Ok(formatted.as_str()));
    }
}
