//! Numbered streams: a sender numbers its items, and a reader notices gaps.
//!
//! Zenoh drops messages on a congested link. So a sender numbers its items, from 0 in each of its epochs, and a
//! reader compares the numbers ([`StreamReader`]). Missing items are queried where they still exist: at the sender
//! ([`LostItems`] is the query's parameter) or, for a memory, in its store. This file sends nothing and knows no payload.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The position of an item, or of the first of several in one message, in its stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamPosition {
    /// The sender's time at its start, ns: distinguishes its runs. Numbers begin at 0 in each epoch.
    pub epoch: u64,
    /// The item's number.
    pub number: u64,
}

/// Numbers the items of a sender.
#[derive(Clone, Copy, Debug)]
pub struct StreamWriter {
    next: StreamPosition,
}

impl StreamWriter {
    /// A stream that begins now.
    pub fn new(now_ns: u64) -> Self {
        Self { next: StreamPosition { epoch: now_ns, number: 0 } }
    }

    /// The position of a message with `count` items. Advances by `count`.
    pub fn advance(&mut self, count: usize) -> StreamPosition {
        let position = self.next;
        self.next.number = self.next.number.saturating_add(count as u64);
        position
    }

    /// How many items were sent.
    pub fn sent(&self) -> u64 {
        self.next.number
    }
}

/// Missing items of a stream, as a query to their sender. Written as `lost=EPOCH:FROM:TO`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LostItems {
    /// The sender's epoch.
    pub epoch: u64,
    /// The first missing number.
    pub from: u64,
    /// The last missing number.
    pub to: u64,
}

impl LostItems {
    /// The number of missing items.
    pub fn count(&self) -> u64 {
        (self.to - self.from).saturating_add(1)
    }

    /// Whether an item is among them.
    pub fn contains(&self, position: StreamPosition) -> bool {
        position.epoch == self.epoch && (self.from..=self.to).contains(&position.number)
    }
}

impl fmt::Display for LostItems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "lost={}:{}:{}", self.epoch, self.from, self.to)
    }
}

/// Text that is not a query for missing items.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a question for lost items is written as lost=EPOCH:FROM:TO")]
pub struct LostItemsError;

impl FromStr for LostItems {
    type Err = LostItemsError;

    fn from_str(text: &str) -> Result<Self, LostItemsError> {
        let mut numbers = text.strip_prefix("lost=").ok_or(LostItemsError)?.split(':').map(str::parse);
        let mut next = || numbers.next().and_then(Result::ok).ok_or(LostItemsError);
        let lost = Self { epoch: next()?, from: next()?, to: next()? };
        if numbers.next().is_some() || lost.from > lost.to { Err(LostItemsError) } else { Ok(lost) }
    }
}

/// What the position of a message means to a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// The first message received. Earlier ones may have been sent when there was no subscriber.
    First,
    /// Nothing is missing before it.
    InOrder,
    /// These items are missing before it.
    After(LostItems),
    /// A repeated or late message.
    Again,
    /// The sender has restarted. The last items of its previous epoch may be missing.
    NewEpoch,
}

/// Compares the numbers of a stream.
#[derive(Clone, Copy, Debug, Default)]
pub struct StreamReader {
    next: Option<StreamPosition>,
}

impl StreamReader {
    /// Records a message with `count` items.
    pub fn arrive(&mut self, position: StreamPosition, count: usize) -> Arrival {
        let StreamPosition { epoch, number } = position;
        let arrival = match self.next {
            None => Arrival::First,
            Some(next) if next.epoch != epoch => Arrival::NewEpoch,
            Some(next) if next.number == number => Arrival::InOrder,
            Some(next) if next.number > number => Arrival::Again,
            Some(next) => Arrival::After(LostItems { epoch, from: next.number, to: number - 1 }),
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
        let lost = LostItems { epoch: 7, from: 6, to: 8 };
        assert_eq!((reader.arrive(at(7, 9), 1), lost.count()), (Arrival::After(lost), 3));
        assert_eq!(reader.arrive(at(7, 6), 1), Arrival::Again);
        assert_eq!(reader.arrive(at(7, 10), 1), Arrival::InOrder, "what came late changes nothing");
        assert_eq!(reader.arrive(at(8, 4), 1), Arrival::NewEpoch);
        assert_eq!(
            reader.arrive(at(8, u64::MAX), 9),
            Arrival::After(LostItems { epoch: 8, from: 5, to: u64::MAX - 1 })
        );
        assert!(lost.contains(at(7, 8)) && !lost.contains(at(7, 9)) && !lost.contains(at(8, 8)));
    }

    #[test]
    fn a_question_for_lost_items_is_written_and_read() {
        let lost = LostItems { epoch: 7, from: 1, to: 3 };
        assert_eq!(lost.to_string().parse(), Ok(lost));
        for wrong in
            ["", "lost=", "lost=1:2", "lost=1:2:x", "lost=1:2:3:4", "1:2:3", "lost=-1:2:3", "lost=1:3:2"]
        {
            assert_eq!(wrong.parse::<LostItems>(), Err(LostItemsError), "{wrong}");
        }
    }
}
