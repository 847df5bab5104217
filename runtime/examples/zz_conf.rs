#![allow(clippy::all, clippy::pedantic, clippy::print_stdout, clippy::unwrap_used, clippy::disallowed_types)]
//! scratch
use std::collections::BTreeMap;
use armarium_runtime::chart::*;
use armarium_runtime::engine::*;
fn main() {
    let mut pass = 0; let mut fail = 0;
    let mut paths: Vec<_> = std::fs::read_dir("/tmp/conf").unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "yaml")).collect();
    paths.sort();
    for p in paths {
        let name = p.file_stem().unwrap().to_string_lossy().into_owned();
        let lib = load(&p, &[]);
        let c = check(&lib, &Registry::new(), &ChannelSchema::new());
        let Some(program) = c.program else { println!("LOAD {name}"); for f in c.findings.iter().filter(|f| f.is_error()) { println!("   {f}"); } fail += 1; continue };
        let j: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(p.with_extension("json")).unwrap()).unwrap();
        let ids = j["ids"].as_object().unwrap();
        let mut e = Engine::new(program.clone(), &BTreeMap::new(), None).unwrap();
        let mut now = 0.0f64; let mut timers: Vec<(f64, u64, u64)> = vec![]; let mut finished = None; let mut last = vec![];
        let mut apply = |out: &mut Vec<Effect>, now: f64, timers: &mut Vec<(f64,u64,u64)>| {
            for x in out.drain(..) { match x {
                Effect::StartTimer { timer, after, order } => timers.push((now + after.as_secs_f64(), order, timer)),
                Effect::CancelTimer { timer } => timers.retain(|t| t.2 != timer),
                Effect::Trace(armarium_runtime::trace::TraceItem::Configuration { leaves }) => if !leaves.is_empty() { last = leaves; },
                Effect::Finished(_r) => finished = Some(last.clone()),
                _ => {} } }
            (finished.clone(), last.clone())
        };
        let mut out = vec![];
        e.start(&NoSensors, &mut out); let mut st = apply(&mut out, now, &mut timers);
        let want = |v: &serde_json::Value| { let mut w: Vec<String> = v.as_array().unwrap().iter().map(|s| ids.get(s.as_str().unwrap()).map_or("?".into(), |x| x.as_str().unwrap().to_owned())).collect(); w.sort(); w };
        let mut run_until = |e: &mut Engine, t: f64, now: &mut f64, timers: &mut Vec<(f64,u64,u64)>, st: &mut (Option<Vec<String>>, Vec<String>), apply: &mut dyn FnMut(&mut Vec<Effect>, f64, &mut Vec<(f64,u64,u64)>) -> (Option<Vec<String>>, Vec<String>)| {
            loop { timers.sort_by(|a, b| a.partial_cmp(b).unwrap()); let Some(&(at, _, id)) = timers.first() else { break }; if at > t { break } timers.remove(0); *now = at; let mut o = vec![]; e.handle(Input::Timer { timer: id }, &NoSensors, &mut o); *st = apply(&mut o, *now, timers); }
            *now = t;
        };
        let mut good = true;
        let w3c = name.starts_with("w3c-ecma");
        let got = |st: &(Option<Vec<String>>, Vec<String>)| { let mut g = st.1.clone(); g.sort(); g };
        if w3c { run_until(&mut e, 60.0, &mut now, &mut timers, &mut st, &mut apply); good = got(&st) == vec!["pass".to_string()]; if !good { println!("FAIL {name}: {:?}", got(&st)); } }
        else {
            if got(&st) != want(&j["initialConfiguration"]) { good = false; println!("FAIL {name}: start {:?} want {:?}", got(&st), want(&j["initialConfiguration"])); }
            for ev in j["events"].as_array().unwrap() {
                let after = ev.get("after").and_then(|a| a.as_f64()).unwrap_or(0.0) / 1000.0;
                let t = now + after; run_until(&mut e, t, &mut now, &mut timers, &mut st, &mut apply);
                let mut o = vec![]; e.handle(Input::Event { name: ev["event"]["name"].as_str().unwrap().into(), data: armarium_values::Value::Null }, &NoSensors, &mut o); st = apply(&mut o, now, &mut timers);
                if got(&st) != want(&ev["nextConfiguration"]) { good = false; println!("FAIL {name}: after {} {:?} want {:?}", ev["event"]["name"], got(&st), want(&ev["nextConfiguration"])); break; }
            }
        }
        if good { pass += 1 } else { fail += 1 }
    }
    println!("pass {pass} fail {fail}");
    bench();
}
fn bench() {
    let text = |g: bool| { let t = |to: &str| if g { format!("{{target: {to}, if: \"locals.n < 1000000000\", do: [{{assign: {{locals.n: \"${{locals.n + 1}}\"}}}}]}}") } else { to.to_string() }; format!("statechart: B\nlocals: {{n: {{type: int, default: 0}}}}\nevents: {{next: {{}}, switch: {{}}}}\ninitial: A\nstates:\n  A: {{initial: a1, states: {{a1: {{transitions: {{next: {}}}}}, a2: {{transitions: {{next: {}}}}}}}, transitions: {{switch: B}}}}\n  B: {{initial: b1, states: {{b1: {{transitions: {{next: {}}}}}, b2: {{transitions: {{next: {}}}}}}}, transitions: {{switch: A}}}}\n", t("a2"), t("a1"), t("b2"), t("b1")) };
    for g in [true, false] {
        let c = check(&load_text("b", &text(g), &[]), &Registry::new(), &ChannelSchema::new());
        for f in &c.findings { println!("{f}"); }
        let mut e = Engine::new(c.program.unwrap(), &BTreeMap::new(), None).unwrap();
        let mut out = vec![]; e.start(&NoSensors, &mut out);
        let n = 200_000; let t = std::time::Instant::now();
        for i in 0..n { out.clear(); e.handle(Input::Event { name: if i % 10 == 9 { "switch".into() } else { "next".into() }, data: armarium_values::Value::Null }, &NoSensors, &mut out); }
        println!("guards {g}: {:.0} events/s {:?}", n as f64 / t.elapsed().as_secs_f64(), e.locals());
    }
    for n in [1000usize, 20_000, 100_000] {
        let mut s = String::from("statechart: L\ninitial: s0\nevents: {t: {}}\nstates:\n");
        for i in 0..n { s += &format!("  s{i}: {{transitions: {{t: s{}}}}}\n", (i + 1) % n); }
        let t = std::time::Instant::now();
        let c = check(&load_text("l", &s, &[]), &Registry::new(), &ChannelSchema::new());
        println!("{n} states: {:?} findings {} ok {}", t.elapsed(), c.findings.len(), c.program.is_some());
    }
}
