//! How far the stream of changes was heard, and what of it is missing. Knows counts and times, no snapshots.

use crate::wire::Changes;

/// How far the stream of changes was heard.
#[derive(Debug, Default)]
pub(super) struct Stream {
    epoch: u64,
    /// The count of the next change, once one was heard.
    next: Option<u64>,
    /// When the last change arrived in the other memory before anything was lost, ns.
    whole_until: u64,
    /// The same of the last change that was heard.
    heard_until: u64,
    /// Gaps so far, and how many of them were closed.
    gaps: u64,
    closed: u64,
}

impl Stream {
    /// What arrived until then is known, ns.
    pub(super) fn begin(&mut self, until: u64) {
        self.whole_until = self.whole_until.max(until);
        self.heard_until = self.heard_until.max(until);
    }

    /// Takes note of a message of changes. Returns whether something before it is missing.
    pub(super) fn hear(&mut self, changes: &Changes) -> bool {
        let follows = self.epoch == changes.epoch && self.next.is_none_or(|next| next == changes.first);
        let is_first = self.next.is_none();
        self.epoch = changes.epoch;
        self.next = Some(changes.first.saturating_add(changes.snapshots.len() as u64));
        if !follows && !is_first {
            self.gaps += 1;
        }
        let last = changes.snapshots.last().map_or(0, |s| s.arrived_ns);
        self.heard_until = self.heard_until.max(last);
        if self.gaps == self.closed {
            self.whole_until = self.heard_until;
        }
        !follows && !is_first
    }

    /// Something may have been lost.
    pub(super) fn lose(&mut self) {
        self.gaps += 1;
    }

    /// From when on what was lost has to be read again, ns, and which gaps that closes.
    pub(super) fn open_gap(&self) -> (u64, u64) {
        (self.whole_until, self.gaps)
    }

    /// What was lost up to these gaps has been read.
    pub(super) fn close_gap(&mut self, gaps: u64) {
        self.closed = gaps;
        if self.gaps == gaps {
            self.whole_until = self.heard_until;
        }
    }
}
