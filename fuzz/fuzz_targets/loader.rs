//! Any text as a chart: it is refused, or it runs; it never panics.
#![no_main]

use std::collections::BTreeMap;

use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::engine::{Effect, Engine, Input, NoSensors};
use armarium_values::Value;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
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
});
