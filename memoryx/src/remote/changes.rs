//! The changes of another agent's memory as they arrive. Gaps are noticed by the numbers of each core segment's stream,
//! by the queue's count of what it dropped, and by the memory's liveliness; they are not closed here.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use armarium_bus::session::LivelinessSubscription;
use armarium_bus::stream::{Arrival, StreamPosition, StreamReader};
use armarium_bus::{Message, Session, Subscription};
use async_trait::async_trait;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};

use crate::changes::ChangeSource;
use crate::entity::Snapshot;
use crate::wire::{self, ChangesMessage};

/// The changes of one core segment, or of all.
pub(super) struct RemoteChanges {
    session: Session,
    messages: Subscription,
    services: LivelinessSubscription,
    received: Received,
}

/// What was received.
#[derive(Debug, Default)]
struct Received {
    /// Whether these are the changes of one core segment.
    is_one: bool,
    /// By key.
    streams: BTreeMap<String, StreamReader>,
    waiting: VecDeque<Arc<Snapshot>>,
    /// Of the last message: everything that arrived in the memory before this time was sent with it or before, ns.
    sent_until_ns: u64,
    until_ns: u64,
    is_lost: bool,
    began_anew: bool,
    was_away: bool,
    dropped: u64,
}

impl RemoteChanges {
    pub(super) fn new(
        session: Session,
        messages: Subscription,
        services: LivelinessSubscription,
        is_one: bool,
    ) -> Self {
        Self { session, messages, services, received: Received { is_one, ..Received::default() } }
    }

    async fn take(&mut self, message: Message) {
        match wire::open::<ChangesMessage>(&message.encoding, &message.payload) {
            Ok(changes) => self.received.take(&message.key, changes),
            Err(error) => {
                let sender = self.session.sender(message.sender.as_deref());
                tracing::warn!(%error, key = message.key, sender, "changes were not understood");
            }
        }
        self.received.note_dropped(self.messages.dropped());
    }
}

impl Received {
    fn take(&mut self, key: &str, changes: ChangesMessage) {
        let position = StreamPosition { epoch: changes.epoch, number: changes.first };
        let reader = self.streams.entry(key.to_owned()).or_default();
        match reader.arrive(position, changes.snapshots.len()) {
            Arrival::NewEpoch => self.lose(true),
            Arrival::After(_) => self.lose(false),
            // What was sent before the first message is in the heads that are read after the subscription.
            Arrival::First | Arrival::InOrder | Arrival::Again => {}
        }
        self.sent_until_ns = changes.until_ns;
        self.waiting.extend(changes.snapshots);
    }

    fn lose(&mut self, all: bool) {
        self.is_lost = true;
        // The times of several core segments do not say until when all is known.
        self.began_anew |= all || !self.is_one;
    }

    fn note_dropped(&mut self, dropped: u64) {
        if dropped > self.dropped {
            self.dropped = dropped;
            self.lose(false);
        }
    }

    fn note_alive(&mut self, is_alive: bool) {
        if is_alive && std::mem::take(&mut self.was_away) {
            self.lose(true);
        }
        self.was_away |= !is_alive;
    }

    /// A loss is reported before what comes after it.
    fn next(&mut self) -> Result<Arc<Snapshot>, TryRecvError> {
        if std::mem::take(&mut self.is_lost) {
            return Err(TryRecvError::Lagged(1));
        }
        let change = self.waiting.pop_front().ok_or(TryRecvError::Empty)?;
        self.began_anew = false;
        if self.waiting.is_empty() && self.is_one {
            self.until_ns = self.until_ns.max(self.sent_until_ns);
        }
        Ok(change)
    }
}

#[async_trait]
impl ChangeSource for RemoteChanges {
    async fn recv(&mut self) -> Result<Arc<Snapshot>, RecvError> {
        loop {
            match self.try_recv() {
                Ok(change) => return Ok(change),
                Err(TryRecvError::Lagged(count)) => return Err(RecvError::Lagged(count)),
                Err(TryRecvError::Empty | TryRecvError::Closed) => {}
            }
            tokio::select! {
                biased;
                service = self.services.next() => {
                    self.received.note_alive(service.ok_or(RecvError::Closed)?.alive);
                }
                message = self.messages.next() => self.take(message.ok_or(RecvError::Closed)?).await,
            }
        }
    }

    fn try_recv(&mut self) -> Result<Arc<Snapshot>, TryRecvError> {
        loop {
            match self.received.next() {
                Err(TryRecvError::Empty) => {}
                other => return other,
            }
            while let Some(service) = self.services.try_next() {
                self.received.note_alive(service.alive);
            }
            let Some(message) = self.messages.try_next() else {
                return if self.received.is_lost { self.received.next() } else { Err(TryRecvError::Empty) };
            };
            if let Ok(changes) = wire::open::<ChangesMessage>(&message.encoding, &message.payload) {
                self.received.take(&message.key, changes);
            }
            self.received.note_dropped(self.messages.dropped());
        }
    }

    fn until_ns(&self) -> u64 {
        self.received.until_ns
    }

    fn began_anew(&self) -> bool {
        self.received.began_anew
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(epoch: u64, first: u64, until_ns: u64, versions: &[u64]) -> ChangesMessage {
        let snapshot = |version: &u64| {
            let (id, instances) = ("S/p/e".parse().unwrap(), Vec::new());
            let (version, arrived_ns) = (*version, *version);
            Arc::new(Snapshot { id, version, referenced_ns: 0, sent_ns: 0, arrived_ns, instances })
        };
        ChangesMessage { epoch, first, until_ns, snapshots: versions.iter().map(snapshot).collect() }
    }

    /// What is received of some messages: versions, `lost` or `anew`, and until when all is known.
    #[test]
    fn every_gap_is_reported_before_what_comes_after_it() {
        let mut received = Received { is_one: true, ..Received::default() };
        let mut said = Vec::new();
        for (told, expected) in [
            (message(1, 3, 12, &[11, 12]), "11 12 until 12"),
            (message(1, 5, 13, &[13]), "13 until 13"),
            // The last changes were lost, and only their number came after them.
            (message(1, 9, 15, &[]), "lost until 13"),
            (message(1, 11, 17, &[17]), "lost 17 until 17"),
            // The memory was restarted, and its clock was set back.
            (message(2, 0, 2, &[1, 2]), "anew 1 2 until 17"),
        ] {
            received.take("key", told);
            loop {
                match received.next() {
                    Ok(snapshot) => said.push(snapshot.version.to_string()),
                    Err(TryRecvError::Empty) => break,
                    Err(_) => said.push(if received.began_anew { "anew" } else { "lost" }.into()),
                }
            }
            said.push(format!("until {}", received.until_ns));
            assert_eq!(std::mem::take(&mut said).join(" "), expected);
        }
        for (is_alive, is_lost) in [(true, false), (false, false), (true, true)] {
            received.note_alive(is_alive);
            assert_eq!(received.next().is_err_and(|error| error != TryRecvError::Empty), is_lost);
        }
    }
}
