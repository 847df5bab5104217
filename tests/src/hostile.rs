//! What fuzzing feeds with hostile input, one function a kind of file. The fuzz targets call these, and a test replays what
//! fuzzing has found.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Effect, Engine, Input, NoSensors};
use armarium_runtime::import;
use armarium_values::expr::{Environment, Expr, Slot, Unknown, Unresolved, Variable, World};
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
        let unknown =
            || Unresolved { kind: Unknown::Name, message: "there is no such name".into(), help: None };
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

impl World for Fixture {
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
