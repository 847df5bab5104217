//! The arrival time until which the stream of changes was received without a gap. Knows positions and times, no
//! snapshots.

use armarium_bus::stream::{Arrival, StreamPosition, StreamReader};

use crate::wire::Changes;

/// How far the stream of changes was received.
#[derive(Debug, Default)]
pub(super) struct ReceivedStream {
    reader: StreamReader,
    /// Everything that arrived in the other memory before this time was received, ns.
    complete_until: u64,
    /// The same, if gaps are ignored.
    received_until: u64,
    /// Gaps so far, and how many of them were closed.
    gaps: u64,
    closed: u64,
}

impl ReceivedStream {
    /// Everything that arrived until then is known, ns.
    pub(super) fn begin(&mut self, until: u64) {
        self.complete_until = self.complete_until.max(until);
        self.received_until = self.received_until.max(until);
    }

    /// Records a message of changes, which may be empty. Returns whether a gap precedes it.
    pub(super) fn receive(&mut self, changes: &Changes) -> bool {
        let position = StreamPosition { epoch: changes.epoch, number: changes.first };
        let follows = match self.reader.arrive(position, changes.snapshots.len()) {
            Arrival::InOrder | Arrival::Again => true,
            // Changes before the first message may have been published when there was no subscriber.
            Arrival::First => changes.first == 0,
            Arrival::After(_) | Arrival::NewEpoch => false,
        };
        if !follows {
            self.gaps += 1;
        }
        self.received_until = self.received_until.max(changes.until_ns);
        if self.gaps == self.closed {
            self.complete_until = self.received_until;
        }
        !follows
    }

    /// Something may have been lost.
    pub(super) fn note_loss(&mut self) {
        self.gaps += 1;
    }

    /// Everything that arrived in the other memory before this time was received, ns.
    pub(super) fn complete_until(&self) -> u64 {
        self.complete_until
    }

    /// Gaps so far. A read closes the gaps that existed when it began.
    pub(super) fn gaps(&self) -> u64 {
        self.gaps
    }

    /// Records that all changes lost up to this number of gaps have been read.
    pub(super) fn close_gap(&mut self, gaps: u64) {
        self.closed = gaps;
        if self.gaps == gaps {
            self.complete_until = self.received_until;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::entity::Snapshot;

    fn message(epoch: u64, first: u64, until_ns: u64, arrived_ns: &[u64]) -> Changes {
        let snapshot = |arrived_ns: &u64| {
            let id = "S/p/e".parse().unwrap();
            let (version, instances) = (*arrived_ns, Vec::new());
            Arc::new(Snapshot {
                id,
                version,
                referenced_ns: 0,
                sent_ns: 0,
                arrived_ns: *arrived_ns,
                instances,
            })
        };
        Changes { epoch, first, until_ns, snapshots: arrived_ns.iter().map(snapshot).collect() }
    }

    #[test]
    fn every_gap_is_noticed_and_read_from_where_it_was_whole() {
        let mut stream = ReceivedStream::default();
        stream.begin(10);
        for (told, is_missing, complete_until) in [
            (message(1, 0, 12, &[12, 11]), false, 12),
            (message(1, 2, 12, &[]), false, 12),
            (message(1, 2, 13, &[15]), false, 13),
            // The last changes were lost, and only their number came after them.
            (message(1, 5, 15, &[]), true, 13),
            (message(1, 5, 16, &[16]), false, 13),
            // The memory was restarted.
            (message(2, 0, 17, &[17]), true, 13),
        ] {
            assert_eq!(stream.receive(&told), is_missing, "{told:?}");
            assert_eq!(stream.complete_until(), complete_until, "{told:?}");
        }
        let gaps = stream.gaps();
        stream.close_gap(gaps);
        assert_eq!(stream.complete_until(), 17);
        stream.receive(&message(2, 1, 18, &[18]));
        assert_eq!(stream.complete_until(), 18);
    }

    #[test]
    fn what_was_told_before_the_first_message_is_missing() {
        for (first, is_missing) in [(0, false), (3, true)] {
            let mut stream = ReceivedStream::default();
            stream.begin(10);
            assert_eq!(stream.receive(&message(1, first, 20, &[20])), is_missing);
            assert_eq!(stream.complete_until(), if is_missing { 10 } else { 20 });
        }
    }
}
