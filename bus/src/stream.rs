//! Numbered streams: a sender counts what it sends, and a reader notices what did not come.
//!
//! Zenoh drops what a congested link does not take. A sender therefore gives each item a number, which begins anew with each
//! of its epochs, and a reader holds the numbers against each other ([`StreamReader`]). What is missing is asked for again
//! where the sender still has it: of the sender itself ([`Lost`] is the question), or, as with a memory, of what lies behind
//! it. This file sends nothing and knows no payload.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Where an item, or the first of several in one message, stands in its stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamPosition {
    /// Tells one life of the sender from the next: numbers begin at 0 in each. The sender's time at its start, ns.
    pub epoch: u64,
    /// The item's number.
    pub number: u64,
}

/// Numbers what a sender sends.
#[derive(Clone, Copy, Debug)]
pub struct StreamWriter {
    next: StreamPosition,
}

impl StreamWriter {
    /// A stream that begins now.
    #[must_use]
    pub fn new(now_ns: u64) -> Self {
        Self { next: StreamPosition { epoch: now_ns, number: 0 } }
    }

    /// The position of a message with `count` items; the next one follows them.
    pub fn advance(&mut self, count: usize) -> StreamPosition {
        let position = self.next;
        self.next.number = self.next.number.saturating_add(count as u64);
        position
    }

    /// How many items were sent.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.next.number
    }
}

/// Items of a stream that did not come: a question to their sender. Written as `lost=EPOCH:FROM:TO`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    /// The sender's epoch.
    pub epoch: u64,
    /// The first of them.
    pub from: u64,
    /// The last of them.
    pub to: u64,
}

impl Lost {
    /// How many they are.
    #[must_use]
    pub fn count(&self) -> u64 {
        (self.to - self.from).saturating_add(1)
    }

    /// Whether an item is one of them.
    #[must_use]
    pub fn contains(&self, position: StreamPosition) -> bool {
        position.epoch == self.epoch && (self.from..=self.to).contains(&position.number)
    }
}

impl fmt::Display for Lost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "lost={}:{}:{}", self.epoch, self.from, self.to)
    }
}

/// Text that is no question for lost items.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a question for lost items is written as lost=EPOCH:FROM:TO")]
pub struct LostError;

impl FromStr for Lost {
    type Err = LostError;

    fn from_str(text: &str) -> Result<Self, LostError> {
        let mut numbers = text.strip_prefix("lost=").ok_or(LostError)?.split(':').map(str::parse);
        let mut next = || numbers.next().and_then(Result::ok).ok_or(LostError);
        let lost = Self { epoch: next()?, from: next()?, to: next()? };
        if numbers.next().is_some() || lost.from > lost.to { Err(LostError) } else { Ok(lost) }
    }
}

/// What a reader learns from the position of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// It is the first that is heard. What the sender sent before may have been sent to nobody.
    First,
    /// Nothing is missing before it.
    InOrder,
    /// These are missing before it.
    After(Lost),
    /// It was heard before, or comes late.
    Again,
    /// The sender has begun anew. What it sent last before that may be missing.
    NewEpoch,
}

/// Holds the numbers of a stream against each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct StreamReader {
    next: Option<StreamPosition>,
}

impl StreamReader {
    /// Takes note of a message with `count` items.
    pub fn arrive(&mut self, position: StreamPosition, count: usize) -> Arrival {
        let StreamPosition { epoch, number } = position;
        let arrival = match self.next {
            None => Arrival::First,
            Some(next) if next.epoch != epoch => Arrival::NewEpoch,
            Some(next) if next.number == number => Arrival::InOrder,
            Some(next) if next.number > number => Arrival::Again,
            Some(next) => Arrival::After(Lost { epoch, from: next.number, to: number - 1 }),
        };
        let after = StreamPosition { epoch, number: number.saturating_add(count as u64) };
        if arrival != Arrival::Again {
            self.next = Some(after);
        }
        arrival
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(epoch: u64, number: u64) -> StreamPosition {
        StreamPosition { epoch, number }
    }

    #[test]
    fn a_reader_notices_what_did_not_come() {
        let mut writer = StreamWriter::new(7);
        assert_eq!((writer.advance(2), writer.advance(0), writer.sent()), (at(7, 0), at(7, 2), 2));
        let mut reader = StreamReader::default();
        assert_eq!(reader.arrive(at(7, 3), 2), Arrival::First);
        assert_eq!(reader.arrive(at(7, 5), 0), Arrival::InOrder);
        assert_eq!(reader.arrive(at(7, 5), 1), Arrival::InOrder);
        let lost = Lost { epoch: 7, from: 6, to: 8 };
        assert_eq!((reader.arrive(at(7, 9), 1), lost.count()), (Arrival::After(lost), 3));
        assert_eq!(reader.arrive(at(7, 6), 1), Arrival::Again);
        assert_eq!(reader.arrive(at(7, 10), 1), Arrival::InOrder, "what came late changes nothing");
        assert_eq!(reader.arrive(at(8, 4), 1), Arrival::NewEpoch);
        assert_eq!(
            reader.arrive(at(8, u64::MAX), 9),
            Arrival::After(Lost { epoch: 8, from: 5, to: u64::MAX - 1 })
        );
        assert!(lost.contains(at(7, 8)) && !lost.contains(at(7, 9)) && !lost.contains(at(8, 8)));
    }

    #[test]
    fn a_question_for_lost_items_is_written_and_read() {
        let lost = Lost { epoch: 7, from: 1, to: 3 };
        assert_eq!(lost.to_string().parse(), Ok(lost));
        for wrong in
            ["", "lost=", "lost=1:2", "lost=1:2:x", "lost=1:2:3:4", "1:2:3", "lost=-1:2:3", "lost=1:3:2"]
        {
            assert_eq!(wrong.parse::<Lost>(), Err(LostError), "{wrong}");
        }
    }
}
