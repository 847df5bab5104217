//! What the live page costs a run, and how quick it is: `cargo bench -p armarium-cli --bench live`.
//!
//! Processor time of the same run without, with one and with ten readers of its news, in turn; and in Debian's Chromium (with
//! `ARMARIUM_NODE_MODULES`, as the tests of the page): first paint, the time from an event to what the page shows, images of the world a
//! second, and how much a tab grows. With `-- --hour` only the growth is measured, in an hour of run.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a benchmark may fail, prints, and measures the machine"
)]

use std::io::{BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Swings for as long as it is let; `flip` goes back and forth between two states beside it.
const CHART: &str = "
statechart: Measured
events: {flip: {description: Somebody wants the other state.}}
initial: Both
states:
  Both:
    parallel:
      Swing:
        initial: There
        states:
          There: {skill: MoveJoints, with: {posture: wipe}, transitions: {success: Back}}
          Back: {skill: MoveJoints, with: {posture: home}, transitions: {success: There}}
      Flip:
        initial: One
        states:
          One: {transitions: {flip: Two}}
          Two: {transitions: {flip: One}}
";
/// Rounds of paired runs.
const ROUNDS: usize = 20;

/// Processor time of all children that have ended, s.
fn children_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    // Fields 16 and 17 of `man 5 proc`, in ticks of 10 ms.
    fields[13..15].iter().map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
}

/// Runs the chart with so many readers of its page. Returns the processor time of the run, s.
fn run(folder: &Path, readers: Option<usize>) -> f64 {
    let before = children_s();
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.args(["run", "chart.yaml", "--for", "60s", "--force"]).current_dir(folder);
    if readers.is_some() {
        command.arg("--live");
    }
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    if let Some(readers) = readers {
        let url = address(&mut said);
        for _ in 0..readers {
            let url = url.clone();
            std::thread::spawn(move || {
                let mut stream = TcpStream::connect(&url).unwrap();
                write!(stream, "GET /news HTTP/1.1\r\nHost: {url}\r\n\r\n").unwrap();
                // It ends with the run.
                let _ = stream.read_to_end(&mut Vec::new());
            });
        }
    }
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    child.wait().unwrap();
    children_s() - before
}

/// Where the page is: `127.0.0.1:PORT`.
fn address(said: &mut impl std::io::BufRead) -> String {
    let mut line = String::new();
    while !line.starts_with("http://") {
        line.clear();
        assert_ne!(said.read_line(&mut line).unwrap(), 0, "it has printed no address");
    }
    line.trim().trim_start_matches("http://").trim_end_matches('/').to_owned()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("chart.yaml"), CHART).unwrap();
    let hour = std::env::args().any(|argument| argument == "--hour");
    if !hour {
        paired(folder.path());
    }
    match std::env::var_os("ARMARIUM_NODE_MODULES").map(PathBuf::from) {
        // As fast as the machine allows.
        Some(modules) if hour => browser((folder.path(), &modules), "hour", &["--for", "4000s"]),
        Some(modules) => browser((folder.path(), &modules), "measure", &["--speed", "1"]),
        None => {
            println!("ARMARIUM_NODE_MODULES names no folder with playwright-core: no browser was measured")
        }
    }
}

/// Runs with and without readers, in turn.
fn paired(folder: &Path) {
    let mut times = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
    for _ in 0..ROUNDS {
        for (times, readers) in times.iter_mut().zip([None, Some(0), Some(1), Some(10)]) {
            times.push(run(folder, readers));
        }
    }
    let [bare, rest @ ..] = times;
    println!(
        "a run of 60 s without a page: {:.2} s of processor time (median of {ROUNDS})",
        median(bare.clone())
    );
    for (times, what) in rest.iter().zip(["a page that nobody reads", "one reader", "ten readers"]) {
        let ratios = times.iter().zip(&bare).map(|(with, without)| with / without).collect();
        println!("with {what}: {:.3} of that", median(ratios));
    }
}

/// What a browser measures.
fn browser((folder, modules): (&Path, &Path), scenario: &str, options: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.args(["run", "chart.yaml", "--force", "--live-control"]).args(options).current_dir(folder);
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let url = format!("http://{}/", address(&mut said));
    std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/page.mjs");
    let mut node = Command::new("node");
    node.arg(script).arg(modules).arg("/usr/bin/chromium").arg(scenario).arg(url).arg(folder);
    let found = node.output().unwrap();
    print!("{}{}", String::from_utf8_lossy(&found.stdout), String::from_utf8_lossy(&found.stderr));
    child.kill().unwrap();
    child.wait().unwrap();
}
