//! How long after an edit a chart of 5 000 states is diagnosed, held against `check` itself, how long references and a rename take, and
//! what memory the server has taken.
//!
//! `cargo bench -p armarium-editor`

#![expect(clippy::print_stdout, reason = "a bench measures and prints it")]

use std::path::Path;
use std::str::FromStr as _;
use std::time::{Duration, Instant};

use armarium_editor::{Catalog, Workspace, check};
use armarium_runtime::chart::{ChannelSchema, Registry};
use armarium_source::{Disk, is_yaml};
use lsp_types::{Position, Range, TextDocumentContentChangeEvent, Uri};

const STATES: usize = 5000;
const ROUNDS: usize = 20;

#[expect(clippy::disallowed_methods, reason = "a benchmark measures the machine itself")]
fn now() -> Instant {
    Instant::now()
}

/// A chart of composites with ten states each, with guards, inputs and watches.
fn chart() -> String {
    let mut text = String::from(
        "statechart: Large\ninputs:\n  n: {type: int, default: 3}\nlocals:\n  i: {type: int, default: 0}\n",
    );
    text += "events:\n  next: {}\ninitial: G0\nstates:\n";
    for group in 0..STATES / 11 {
        let next = (group + 1) % (STATES / 11);
        text +=
            &format!("  G{group}:\n    transitions: {{success: G{next}}}\n    initial: S0\n    states:\n");
        for state in 0..9 {
            text += &format!("      S{state}:\n        after: {{2s: S{}}}\n", state + 1);
            text += "        enter: [{assign: {locals.i: \"${locals.i + 1}\"}}]\n";
            text += &format!(
                "        transitions: {{next: {{target: S{}, if: \"locals.i > inputs.n\"}}}}\n",
                state + 1
            );
        }
        text += "      S9: {final: success}\n";
    }
    text
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times[times.len() / 2]
}

/// Most memory that this process has had, MB.
fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().split(' ').next()?.parse::<u64>().ok()).unwrap_or(0) / 1024
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("large.yaml");
    let text = chart();
    std::fs::write(&file, &text).expect("it can be written");
    assert!(is_yaml(Path::new(&file)));
    let catalog = Catalog { registry: Registry::new(), channels: ChannelSchema::new() };
    let time = |work: &mut dyn FnMut()| {
        let began = now();
        work();
        began.elapsed()
    };
    let mut found = 0;
    let plain = median(
        (0..ROUNDS)
            .map(|_| time(&mut || found = check(&file, &[], &Disk, &catalog).findings.len()))
            .collect(),
    );
    assert_eq!(found, 0, "the chart is in order");

    let uri = Uri::from_str(&format!("file://{}", file.display())).expect("it is an address");
    let mut workspace = Workspace::new(catalog, &[]);
    workspace.open(uri.clone(), 0, text.clone());
    assert!(workspace.findings(&uri).is_empty());
    let end = Position::new(u32::try_from(text.lines().count()).unwrap_or(0), 0);
    let mut edit = |version: i32| {
        let range = Some(Range::new(end, end));
        let change = TextDocumentContentChangeEvent { range, range_length: None, text: "# \n".into() };
        workspace.change(&uri, version, vec![change]);
        found = workspace.findings(&uri).len();
    };
    let served = median((0..ROUNDS).map(|n| time(&mut || edit(i32::try_from(n).unwrap_or(0)))).collect());
    let place = Position::new(20, 22);
    let first = time(&mut || drop(workspace.hover(&uri, place)));
    let hover = time(&mut || drop(workspace.hover(&uri, place)));
    let completion = time(&mut || drop(workspace.completion(&uri, place, true)));
    // The local that every state reads and sets.
    let local = Position::new(4, 3);
    let mut uses = 0;
    let references = time(&mut || uses = workspace.find_references(&uri, local, true).len());
    assert!(uses > STATES, "{uses}");
    let rename = time(&mut || assert!(workspace.rename(&uri, local, "counted").is_ok()));
    println!(
        "check: {plain:?}; edit to diagnostics: {served:?}, {:.2} of check",
        served.as_secs_f64() / plain.as_secs_f64()
    );
    println!("first hover after an edit: {first:?}; next: {hover:?}; completion: {completion:?}");
    println!("{uses} references: {references:?}; rename: {rename:?}");
    println!("memory: {} MB", memory());
}
