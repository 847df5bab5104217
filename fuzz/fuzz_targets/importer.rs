//! Any text as an SCXML document: it is refused with its errors, or becomes a chart that loads and runs; it never
//! panics.
#![no_main]

use std::collections::BTreeMap;

use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Engine, Input, NoSensors};
use armarium_runtime::import;
use armarium_values::Value;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
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
});
