//! Executes the commands.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use armarium_knowledge::infer;
use armarium_memoryx::wire::{Maintain, MaintenanceReport};
use armarium_memoryx::{
    Commit, EntityId, Filter, Instance, MemoryError, Pattern, Query, Snapshot, SpatialRegion, Times,
};
use armarium_values::{Frame, Value};
use tokio::sync::broadcast::error::RecvError;

use super::reach::{OpenedMemory, file_named, id, unusable};
use super::recording;
use super::show::Printer;
use super::{
    CommandFailure, ExportArgs, GetArgs, LOCAL, MemoryArgs, MemoryCommand, PutArgs, QueryArgs,
    SnapshotCommand, WatchArgs, keep, serve,
};
use crate::stopped::stopped;

/// Snapshots per import request.
const BATCH: usize = 1000;

pub(super) async fn carry_out(args: &MemoryArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    if let MemoryCommand::Serve(command) = &args.command {
        return serve::serve(args, command, out).await;
    }
    let reached = OpenedMemory::open(args).await?;
    let mut shown = Printer::new(args.json);
    match &args.command {
        MemoryCommand::Ls(of) => {
            let query = Query::latest(pattern(&of.pattern.pattern)?);
            let memories = Memories::open(reached, args).await?;
            let count = memories.each(&query, &mut shown, |shown, s| shown.row(s, out)).await?;
            shown.end(count, "entities", out)?;
        }
        MemoryCommand::Get(get) => return self::get(reached, args, get, &mut shown, out).await,
        MemoryCommand::Put(put) => {
            let version = self::put(&reached, put, args).await?;
            shown.counts(&[("version".to_owned(), version)].into(), out)?;
        }
        MemoryCommand::Observe(observe) => return super::observe::observe(reached, observe, out).await,
        MemoryCommand::Watch(watch) => self::watch(&reached, watch, &mut shown, out).await?,
        MemoryCommand::Top { once } => super::top::top(&reached, args, *once, &shown, out).await?,
        MemoryCommand::Metrics => {
            let report = reached.maintain(Maintain::Stats).await?;
            shown.metrics(&args.agent, &report.counts, out)?;
        }
        MemoryCommand::Health => {
            let took = health(&reached, args).await?;
            shown.counts(&[("answered_in_us".to_owned(), took)].into(), out)?;
        }
        MemoryCommand::Query(query) => {
            let memories = Memories::open(reached, args).await?;
            let count = memories.each(&self::query(query)?, &mut shown, |shown, s| shown.row(s, out)).await?;
            shown.end(count, "snapshots", out)?;
        }
        MemoryCommand::Export(export) => self::export(&reached, export, &shown, out).await?,
        MemoryCommand::Import { file } => {
            let counts = import(&reached, file).await?;
            shown.counts(&counts, out)?;
        }
        MemoryCommand::Infer { what } => {
            let inference = what.inference();
            let round = infer::conclude_once(reached.memory(), &*inference, reached.now_ns()).await?;
            let counts =
                [("concluded", round.concluded), ("written", round.written), ("removed", round.removed)];
            shown.counts(&counts.map(|(name, count)| (name.to_owned(), count)).into(), out)?;
        }
        MemoryCommand::Lag => return Ok(u8::from(!super::lag::lag(&reached, args, &shown, out).await?)),
        MemoryCommand::Plot(plot) => super::plot::plot(&reached, plot, out).await?,
        MemoryCommand::Diff { .. } | MemoryCommand::Backup { .. } => {
            let report = reached.maintain(request(&args.command)?).await?;
            shown.words(&report, out)?;
        }
        MemoryCommand::Snapshot(_)
        | MemoryCommand::Compact
        | MemoryCommand::Verify
        | MemoryCommand::Stats
        | MemoryCommand::Retain(_)
        | MemoryCommand::Serve(_) => {
            let report = reached.maintain(request(&args.command)?).await?;
            return report_of(&report, &shown, out);
        }
    }
    Ok(0)
}

fn request(command: &MemoryCommand) -> Result<Maintain, CommandFailure> {
    Ok(match command {
        MemoryCommand::Snapshot(snapshot) => match &snapshot.command {
            SnapshotCommand::Save { name } => Maintain::Save { name: name.clone() },
            SnapshotCommand::Load { name } => Maintain::Load { name: name.clone() },
            SnapshotCommand::Rm { name } => Maintain::Forget { name: name.clone() },
            SnapshotCommand::Ls => Maintain::Names,
        },
        MemoryCommand::Compact => Maintain::Compact,
        MemoryCommand::Diff { from, to } => Maintain::Compare { name: from.clone(), to: to.clone() },
        MemoryCommand::Backup { name } => Maintain::BackUp { name: name.clone() },
        MemoryCommand::Verify => Maintain::Verify,
        MemoryCommand::Retain(retain) => {
            let retention =
                keep::retention(retain.days, retain.megabytes).map_err(CommandFailure::Argument)?;
            Maintain::Retain { age_ns: retention.age_ns, bytes: retention.bytes }
        }
        _ => Maintain::Stats,
    })
}

fn report_of(report: &MaintenanceReport, shown: &Printer, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    shown.counts(&report.counts, out)?;
    let damaged = report.counts.get("damaged").is_some_and(|count| *count > 0);
    if damaged {
        for what in &report.words {
            writeln!(out, "damaged: {what}")?;
        }
    }
    Ok(u8::from(damaged))
}

fn pattern(text: &str) -> Result<Pattern, CommandFailure> {
    let parts: Vec<&str> = text.split('/').collect();
    if parts.len() > 3 || parts.iter().any(|part| part.is_empty()) {
        return Err(CommandFailure::Argument(format!("`{text}` is not SEGMENT/PROVIDER/ENTITY")));
    }
    let part = |i: usize| parts.get(i).filter(|p| **p != "*").map(|p| (*p).to_owned());
    Ok(Pattern { segment: part(0), provider: part(1), entity: part(2) })
}

/// The memories that a question is asked of, one after the other, by their names if there are several.
struct Memories {
    named: Vec<(String, OpenedMemory)>,
}

impl Memories {
    async fn open(first: OpenedMemory, args: &MemoryArgs) -> Result<Self, CommandFailure> {
        let file = args.store.as_ref().map(|file| file.display().to_string());
        let mut named = vec![(file.unwrap_or_else(|| args.agent.clone()), first)];
        for name in args.command.others() {
            let is_same = |other: &str| match [name, other].map(file_named) {
                [Some(one), Some(other)] => one.canonicalize().ok() == other.canonicalize().ok(),
                _ => name == other,
            };
            if named.iter().any(|(other, _)| is_same(other)) {
                return Err(CommandFailure::Argument(format!("--beside {name}: it is asked already")));
            }
            let session = named.iter().find_map(|(_, memory)| Some(memory.agent().ok()?.1.clone()));
            named.push((name.clone(), OpenedMemory::beside(args, name, session).await?));
        }
        Ok(Self { named })
    }

    /// Asks all of them. Where there are several, one that refuses does not keep the others from answering; refusals are said at the end.
    async fn each(
        &self,
        query: &Query,
        shown: &mut Printer,
        mut act: impl FnMut(&mut Printer, &Snapshot) -> Result<(), CommandFailure>,
    ) -> Result<u64, CommandFailure> {
        let (mut count, mut refused) = (0, Vec::new());
        let width = self.named.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        for (name, memory) in &self.named {
            shown.memory = (self.named.len() > 1).then(|| (name.clone(), width));
            match memory.each(query.clone(), |snapshot| act(shown, snapshot)).await {
                Ok(told) => count += told,
                Err(CommandFailure::Refused(why) | CommandFailure::Argument(why))
                    if shown.memory.is_some() =>
                {
                    refused.push(format!("{name}: {why}"));
                }
                Err(failure) => return Err(failure),
            }
        }
        if refused.is_empty() { Ok(count) } else { Err(CommandFailure::Refused(refused.join("\n"))) }
    }
}

async fn get(
    reached: OpenedMemory,
    args: &MemoryArgs,
    get: &GetArgs,
    shown: &mut Printer,
    out: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    let id = id(&get.id)?;
    let times = match (get.at, get.before) {
        (Some(at), _) => Times::At(at),
        (None, Some(before)) => Times::Before(before),
        (None, None) if get.history => Times::All,
        (None, None) => Times::Latest,
    };
    let query = Query::latest(Pattern::entity(&id)).times(times);
    let mut query = if times == Times::Latest { query } else { query.with_long_term() };
    query.limit = get.limit;
    let memories = Memories::open(reached, args).await?;
    let count = memories.each(&query, shown, |shown, s| shown.whole(s, out)).await?;
    if count == 0 {
        return Err(CommandFailure::Refused(format!("there is no entity `{id}` in memory")));
    }
    Ok(0)
}

async fn put(reached: &OpenedMemory, put: &PutArgs, args: &MemoryArgs) -> Result<u64, CommandFailure> {
    let id = id(&put.id)?;
    let mut attributes = BTreeMap::new();
    for set in &put.set {
        let (name, text) = set
            .split_once('=')
            .ok_or_else(|| CommandFailure::Argument(format!("`{set}` is not NAME=VALUE")))?;
        if name.is_empty() || attributes.insert(name.to_owned(), value(name, text)?).is_some() {
            return Err(CommandFailure::Argument(format!(
                "--set {set}: each attribute has a name, and one value"
            )));
        }
    }
    if let Some(ttl) = put.ttl {
        let expires_ns = u128::from(reached.now_ns()) + ttl.as_nanos();
        attributes.insert("expires_ns".into(), Value::Int(i64::try_from(expires_ns).unwrap_or(i64::MAX)));
    }
    let instances =
        if put.remove { Vec::new() } else { vec![Instance::new(attributes).with_confidence(put.confidence)] };
    let referenced_ns = put.time.unwrap_or_else(|| reached.now_ns());
    let commit = Commit { id, referenced_ns, instances, expected_version: put.expect };
    match reached.memory().commit(vec![commit]).await {
        Ok(versions) => Ok(versions.first().copied().unwrap_or(0)),
        Err(error @ MemoryError::Forbidden { .. }) if args.writer.is_none() => {
            Err(CommandFailure::Refused(format!("{error}: say who you are with --as NAME")))
        }
        Err(error) => Err(error.into()),
    }
}

/// Kinds of values that are recognised as an object with one field.
const KINDS: &str = "bool int float string duration bytes list map vector pose wrench reference";

/// A value from the command line: with its kind, as plain JSON, or else as text.
fn value(name: &str, text: &str) -> Result<Value, CommandFailure> {
    let json = match serde_json::from_str::<serde_json::Value>(text) {
        Ok(json) => json,
        Err(_) => return Ok(Value::String(text.to_owned())),
    };
    let kind = json.as_object().filter(|object| object.len() == 1).and_then(|object| object.keys().next());
    match kind.filter(|kind| KINDS.split(' ').any(|known| known == kind.as_str())) {
        Some(kind) => serde_json::from_value(json.clone())
            .map_err(|error| CommandFailure::Argument(format!("--set {name}: this is no {kind}: {error}"))),
        None => Ok(Value::from_json(&json)),
    }
}

async fn watch(
    reached: &OpenedMemory,
    watch: &WatchArgs,
    shown: &mut Printer,
    out: &mut dyn Write,
) -> Result<(), CommandFailure> {
    let pattern = pattern(&watch.pattern.pattern)?;
    let filter = watch.filter.as_deref().map(Filter::compile).transpose()?;
    let mut changes = reached.memory().subscribe(&pattern).await?;
    let mut left = watch.count.unwrap_or(usize::MAX);
    for snapshot in changed_last(reached, &pattern, watch.last).await? {
        if filter.as_ref().map_or(Ok(true), |filter| filter.fits(&snapshot))? {
            shown.row(&snapshot, out)?;
        }
    }
    out.flush()?;
    if !matches!(reached, OpenedMemory::Agent { .. }) {
        return Ok(());
    }
    while left > 0 {
        let change = tokio::select! {
            biased;
            () = stopped() => return Ok(()),
            change = changes.recv() => change,
        };
        match change {
            Ok(snapshot) => {
                let fits = filter.as_ref().map_or(Ok(true), |filter| filter.fits(&snapshot))?;
                if fits {
                    shown.row(&snapshot, out)?;
                    out.flush()?;
                    left -= 1;
                }
            }
            Err(RecvError::Lagged(count)) => shown.lagged(count, out)?,
            Err(RecvError::Closed) => return Ok(()),
        }
    }
    Ok(())
}

/// The newest snapshots of the entities that have changed last, in the order of their arrival.
async fn changed_last(
    reached: &OpenedMemory,
    pattern: &Pattern,
    count: usize,
) -> Result<Vec<Arc<Snapshot>>, CommandFailure> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let mut heads = reached.memory().heads(pattern).await?.entities;
    heads.sort_by_key(|head| head.arrived_ns);
    let mut last = Vec::new();
    for head in heads.iter().rev().take(count).rev() {
        let newest = Query { removed: true, ..Query::latest(Pattern::entity(&head.id)) };
        last.extend(reached.memory().query(&newest).await?);
    }
    Ok(last)
}

/// Commits and removes an entity of this command's own. Returns how long that took, us.
async fn health(reached: &OpenedMemory, args: &MemoryArgs) -> Result<u64, CommandFailure> {
    let provider = args.writer.as_deref().unwrap_or(LOCAL);
    let id = EntityId::new("Health", provider, "check")?;
    let start = tokio::time::Instant::now();
    let now = reached.now_ns();
    let there = Commit::new(id.clone(), now, [("ok", Value::Bool(true))]);
    reached.memory().commit(vec![there, Commit::removal(id, now)]).await?;
    Ok(u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX))
}

fn query(args: &QueryArgs) -> Result<Query, CommandFailure> {
    let mut query = Query::latest(pattern(&args.pattern.pattern)?);
    query.times = match (args.at.or(args.before), args.from, args.to) {
        (Some(at), _, _) if args.at.is_some() => Times::At(at),
        (Some(before), _, _) => Times::Before(before),
        (None, None, None) if args.history => Times::All,
        (None, None, None) => Times::Latest,
        (None, from, to) => Times::Between(from.unwrap_or(0), to.unwrap_or(u64::MAX)),
    };
    query.filter.clone_from(&args.filter);
    (query.limit, query.most, query.long_term) = (args.limit, args.most, args.long_term);
    let frame = Frame(args.frame.clone());
    query.region = match (&args.near, args.radius, &args.in_box) {
        (Some(near), Some(radius), _) => Some(SpatialRegion::Within { frame, of: numbers(near)?, radius }),
        (Some(near), None, _) => {
            Some(SpatialRegion::Nearest { frame, to: numbers(near)?, count: args.count })
        }
        (None, _, Some(corners)) => {
            let [a, b, c, d, e, f] = numbers(corners)?;
            Some(SpatialRegion::Box { frame, min: [a, b, c], max: [d, e, f] })
        }
        _ => None,
    };
    Ok(query)
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], CommandFailure> {
    let wrong = || CommandFailure::Argument(format!("`{text}` is not {N} numbers with commas between them"));
    let numbers = text.split(',').map(|n| n.trim().parse::<f64>().map_err(|_| wrong()));
    numbers.collect::<Result<Vec<_>, _>>()?.try_into().map_err(|_| wrong())
}

async fn export(
    reached: &OpenedMemory,
    export: &ExportArgs,
    shown: &Printer,
    out: &mut dyn Write,
) -> Result<(), CommandFailure> {
    let pattern = pattern(&export.pattern.pattern)?;
    let Some(path) = &export.output else {
        return lines(reached, pattern, out).await.map(drop);
    };
    let count = if path.extension().is_some_and(|extension| extension == "mcap") {
        recording::record(reached, pattern, path).await?
    } else {
        let file = File::create(path).map_err(|error| unusable(path, &error))?;
        lines(reached, pattern, &mut BufWriter::new(file)).await?
    };
    shown.counts(&[("snapshots".to_owned(), count)].into(), out)
}

/// Writes all snapshots that match as lines of JSON. Returns how many.
async fn lines(
    reached: &OpenedMemory,
    pattern: Pattern,
    mut to: &mut dyn Write,
) -> Result<u64, CommandFailure> {
    if let OpenedMemory::Store { store, .. } = reached {
        // Continues past damaged parts.
        return Ok(store.export(&pattern, &mut to)?);
    }
    let each = |snapshot: &Snapshot| -> Result<(), CommandFailure> {
        let line = serde_json::to_string(snapshot).map_err(|e| CommandFailure::Refused(e.to_string()))?;
        Ok(writeln!(to, "{line}")?)
    };
    let count = reached.each(Query::history(pattern).with_long_term(), each).await?;
    to.flush()?;
    Ok(count)
}

async fn import(reached: &OpenedMemory, file: &Path) -> Result<BTreeMap<String, u64>, CommandFailure> {
    let mut lines: Box<dyn BufRead + Send> = if file == Path::new("-") {
        Box::new(BufReader::new(io::stdin()))
    } else {
        Box::new(BufReader::new(File::open(file).map_err(|e| unusable(file, &e))?))
    };
    let mut counts = BTreeMap::from([("kept".to_owned(), 0), ("lines".to_owned(), 0)]);
    let (mut batch, mut line, mut number) = (Vec::new(), String::new(), 0_u64);
    loop {
        line.clear();
        let read = lines.read_line(&mut line)?;
        if read > 0 && !line.trim().is_empty() {
            number += 1;
            let wrong =
                |e: serde_json::Error| CommandFailure::Argument(format!("line {number} is no snapshot: {e}"));
            batch.push(Arc::new(serde_json::from_str::<Snapshot>(&line).map_err(wrong)?));
        }
        if batch.len() == BATCH || (read == 0 && !batch.is_empty()) {
            let report = reached.maintain(Maintain::Keep { snapshots: std::mem::take(&mut batch) }).await?;
            *counts.entry("kept".into()).or_insert(0) += report.counts.get("kept").copied().unwrap_or(0);
        }
        if read == 0 {
            counts.insert("lines".into(), number);
            return Ok(counts);
        }
    }
}
