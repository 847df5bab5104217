//! `armarium memory observe`: what other programs observe, joined with what memory knows.

use std::io::{BufRead as _, Read as _, Write};
use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_memoryx::{Memory, WorkingMemory};
use armarium_values::Observation;
use clap::Args;
use tokio::sync::mpsc;

use super::CommandFailure;
use super::reach::OpenedMemory;
use crate::stopped::stopped;

/// Longest line, bytes.
const LONGEST: u64 = 1 << 20;
/// Lines that may wait for the memory.
const WAITING: usize = 64;

#[derive(Clone, Debug, Args)]
pub(super) struct ObserveArgs {
    /// The provider segment that the entities are in: the name of what observes.
    #[arg(long, value_name = "NAME")]
    provider: String,
}

/// Reads observations from standard input until it ends, a line of JSON for each.
pub(super) async fn observe(
    reached: OpenedMemory,
    args: &ObserveArgs,
    out: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    let (memory, _session): (Arc<dyn Memory>, _) = match reached {
        OpenedMemory::Agent { remote, session } => (Arc::new(remote), Some(session)),
        OpenedMemory::File(ref agent) => (Arc::<WorkingMemory>::clone(agent.memory()), None),
        OpenedMemory::Store { memory, .. } => (Arc::new(memory), None),
    };
    let updater = Updater::new(memory, &args.provider)?;
    let (to, mut lines) = mpsc::channel(WAITING);
    // It may wait for the next line when the program ends.
    let _reading = tokio::task::spawn_blocking(move || {
        let mut input = std::io::stdin().lock();
        loop {
            let mut line = Vec::new();
            let read = input.by_ref().take(LONGEST).read_until(b'\n', &mut line);
            let ended = matches!(read, Ok(0));
            if ended || to.blocking_send(read.map(|_| line)).is_err() {
                return;
            }
        }
    });
    for number in 1_u64.. {
        let line = tokio::select! {
            biased;
            () = stopped() => return Ok(0),
            line = lines.recv() => line,
        };
        let Some(line) = line else { break };
        let line = line?;
        if line.trim_ascii().is_empty() {
            continue;
        }
        let wrong = |what: &dyn std::fmt::Display| CommandFailure::Argument(format!("line {number}: {what}"));
        let json = serde_json::from_slice(&line).map_err(|error| wrong(&error))?;
        let seen = Observation::from_json(&json).map_err(|error| wrong(&error))?;
        for (id, version) in updater.update(&[seen]).await? {
            writeln!(out, "{id} {version}")?;
        }
    }
    Ok(0)
}
