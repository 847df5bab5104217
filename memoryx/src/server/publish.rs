//! Publishes a memory's changes by core segment and, when there are no more, their number: so a reader that missed the
//! last ones soon notices. Answers no queries.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::stream::{StreamPosition, StreamWriter};
use armarium_bus::{Interest, Key, Session, SessionError, keys};
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::time::Instant;

use super::{log_failure, unreachable_memory};
use crate::changes::Changes;
use crate::entity::Snapshot;
use crate::error::MemoryError;
use crate::query::{Pattern, Query};
use crate::wire::{self, ChangesMessage};
use crate::working::WorkingMemory;

/// Most changes in one round.
const MAX_BATCH: usize = 2048;
/// Most core segments whose streams are continued; another one's begins anew.
const MAX_STREAMS: usize = 1024;
/// Time without changes after which their number is published; then again after twice the time, and so on. So a
/// paused connection only delays it, and an idle memory publishes ever more rarely.
const QUIET_INTERVAL: Duration = Duration::from_millis(80);

/// Publishes the changes of a memory.
pub(super) struct ChangePublisher {
    session: Session,
    agent: String,
    memory: Arc<WorkingMemory>,
    changes: Changes,
    /// The arrival time of the last published change, and of the last that was read after a lag, ns.
    until_ns: u64,
    read_until_ns: u64,
    /// By core segment; `None` has all changes.
    streams: BTreeMap<Option<String>, SegmentStream>,
    /// Followers of single core segments, of all of them on one key, and subscribers to single entities. While these are
    /// declared, Zenoh sends nothing to a router without followers behind it.
    followers: Interest,
    followers_of_all: Interest,
    each: Interest,
}

/// A numbered stream of changes.
struct SegmentStream {
    key: Key,
    writer: StreamWriter,
    quiet: Duration,
    /// When its number is published, if nothing changes.
    due: Instant,
}

impl ChangePublisher {
    pub(super) async fn new(
        session: &Session,
        agent: &str,
        memory: Arc<WorkingMemory>,
    ) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, error);
        let changes = memory.changes(&Pattern::any());
        let all_changes = keys::memory_all_changes(agent)?.into();
        Ok(Self {
            session: session.clone(),
            agent: agent.into(),
            changes,
            until_ns: memory.last_arrival_ns(),
            read_until_ns: 0,
            memory,
            streams: BTreeMap::new(),
            followers: session.interest(&keys::memory_changes(agent, None)?).await.map_err(failed)?,
            followers_of_all: session.interest(&all_changes).await.map_err(failed)?,
            each: session.interest(&wire::every_entity(agent)?).await.map_err(failed)?,
        })
    }

    /// Runs until the memory closes.
    pub(super) async fn publish(mut self) {
        loop {
            let due = self.streams.values().map(|stream| stream.due).min();
            let first = tokio::select! {
                biased;
                first = self.changes.recv() => first,
                () = tokio::time::sleep_until(due.unwrap_or_else(Instant::now)), if due.is_some() => {
                    self.publish_numbers().await;
                    continue;
                }
            };
            let (mut news, mut is_behind) = (Vec::new(), false);
            match first {
                Ok(snapshot) => news.push(snapshot),
                Err(RecvError::Lagged(_)) => is_behind = true,
                Err(RecvError::Closed) => return,
            }
            while news.len() < MAX_BATCH && !is_behind {
                match self.changes.try_recv() {
                    Ok(snapshot) => news.push(snapshot),
                    Err(TryRecvError::Lagged(_)) => is_behind = true,
                    Err(TryRecvError::Empty | TryRecvError::Closed) => break,
                }
            }
            // What was read after a lag comes once more.
            news.retain(|snapshot| snapshot.arrived_ns > self.read_until_ns);
            self.publish_all(news).await;
            if is_behind {
                self.catch_up().await;
            }
        }
    }

    /// Publishes what arrived since the last published change, as far as the memory still has it.
    async fn catch_up(&mut self) {
        let since = Query { arrived_since: Some(self.until_ns), ..Query::history(Pattern::any()) };
        match self.memory.query_now(&since) {
            Ok(mut news) => {
                news.sort_by_key(|snapshot| snapshot.arrived_ns);
                self.publish_all(news).await;
                self.read_until_ns = self.until_ns;
            }
            Err(error) => tracing::warn!(%error, "changes could not be read"),
        }
    }

    async fn publish_all(&mut self, news: Vec<Arc<Snapshot>>) {
        if self.each.has_subscribers() {
            self.publish_each(&news).await;
        }
        self.until_ns = news.last().map_or(self.until_ns, |last| last.arrived_ns);
        let mut by_segment: BTreeMap<String, Vec<Arc<Snapshot>>> = BTreeMap::new();
        for snapshot in &news {
            match by_segment.get_mut(snapshot.id.segment()) {
                Some(of_segment) => of_segment.push(Arc::clone(snapshot)),
                None => drop(by_segment.insert(snapshot.id.segment().into(), vec![Arc::clone(snapshot)])),
            }
        }
        let by_segment = by_segment.into_iter().map(|(segment, news)| (Some(segment), news));
        for (segment, news) in by_segment.chain([(None, news)]) {
            self.publish_together(segment, news).await;
        }
    }

    /// Publishes changes in as many messages as needed.
    async fn publish_together(&mut self, segment: Option<String>, mut news: Vec<Arc<Snapshot>>) {
        if !self.streams.contains_key(&segment) {
            let Ok(stream) = self.begin_stream(segment.as_deref()) else { return };
            self.streams.insert(segment.clone(), stream);
        }
        while !news.is_empty() {
            let rest = news.split_off(wire::in_one_answer(&news));
            // All that arrived before is published with the last message.
            let until_ns = if rest.is_empty() { self.until_ns } else { 0 };
            self.publish_message(&segment, news, until_ns, QUIET_INTERVAL).await;
            news = rest;
        }
    }

    /// A stream for a core segment, in place of the one that has been quiet for longest if there are too many.
    fn begin_stream(&mut self, segment: Option<&str>) -> Result<SegmentStream, MemoryError> {
        if self.streams.len() >= MAX_STREAMS {
            let by_quiet = self.streams.iter().filter(|(name, _)| name.is_some());
            let quietest = by_quiet.max_by_key(|(_, stream)| stream.due).map(|(name, _)| name.clone());
            quietest.map(|name| self.streams.remove(&name));
        }
        let key = match segment {
            Some(segment) => keys::memory_changes_of(&self.agent, segment)?,
            None => keys::memory_all_changes(&self.agent)?,
        };
        let writer = StreamWriter::new(self.session.now_ns());
        Ok(SegmentStream { key, writer, quiet: QUIET_INTERVAL, due: Instant::now() })
    }

    /// Publishes the numbers of changes of the streams that have been quiet.
    async fn publish_numbers(&mut self) {
        let now = Instant::now();
        let due = self.streams.iter().filter(|(_, stream)| stream.due <= now);
        let due: Vec<_> = due.map(|(segment, stream)| (segment.clone(), stream.quiet)).collect();
        for (segment, quiet) in due {
            self.publish_message(&segment, Vec::new(), self.until_ns, quiet.saturating_mul(2)).await;
        }
    }

    /// Publishes one message; the next one without changes follows after `quiet`.
    async fn publish_message(
        &mut self,
        segment: &Option<String>,
        snapshots: Vec<Arc<Snapshot>>,
        until_ns: u64,
        quiet: Duration,
    ) {
        let is_wanted =
            if segment.is_some() { &self.followers } else { &self.followers_of_all }.has_subscribers();
        let Some(stream) = self.streams.get_mut(segment) else { return };
        (stream.quiet, stream.due) = (quiet, Instant::now() + quiet);
        // Also counted when nobody subscribes, because a subscription may be on its way.
        let StreamPosition { epoch, number: first } = stream.writer.advance(snapshots.len());
        if !is_wanted {
            return;
        }
        match wire::seal(&ChangesMessage { epoch, first, until_ns, snapshots }) {
            Ok((encoding, payload)) => log_failure(self.session.put(&stream.key, &encoding, payload).await),
            Err(error) => tracing::warn!(%error, "changes could not be told"),
        }
    }

    /// Publishes changes on the keys of their entities.
    async fn publish_each(&self, news: &[Arc<Snapshot>]) {
        for snapshot in news {
            let Some((key, encoding, payload)) = wire::of_entity(&self.agent, snapshot) else { continue };
            log_failure(self.session.put(&key, &encoding, payload).await);
        }
    }
}
