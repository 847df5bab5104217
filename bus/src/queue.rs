//! The queue from Zenoh's threads to the reader: bounded in items and in bytes. Writing never blocks; items that do
//! not fit are dropped and counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use tokio::sync::mpsc;

/// Most bytes in one queue; the item that exceeds them is still accepted.
const MOST_BYTES: usize = 64 << 20;

/// An item with a size.
pub(crate) trait Weigh {
    /// Its size, bytes.
    fn bytes(&self) -> usize;
}

#[derive(Debug, Default)]
struct Counts {
    waiting_bytes: AtomicUsize,
    dropped: AtomicU64,
}

/// The writing end.
#[derive(Debug)]
pub(crate) struct Offer<T> {
    sender: mpsc::Sender<T>,
    counts: Arc<Counts>,
}

/// The reading end.
#[derive(Debug)]
pub(crate) struct Queue<T> {
    receiver: mpsc::Receiver<T>,
    counts: Arc<Counts>,
}

/// A queue for `capacity` items, at least one.
pub(crate) fn queue<T: Weigh>(capacity: usize) -> (Offer<T>, Queue<T>) {
    let (sender, receiver) = mpsc::channel(capacity.max(1));
    let counts = Arc::new(Counts::default());
    (Offer { sender, counts: Arc::clone(&counts) }, Queue { receiver, counts })
}

impl<T: Weigh> Offer<T> {
    /// Never blocks: this runs on Zenoh's link threads.
    pub(crate) fn offer(&self, item: T) {
        let bytes = item.bytes();
        let before = self.counts.waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        if before > MOST_BYTES || self.sender.try_send(item).is_err() {
            self.counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            self.counts.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl<T: Weigh> Queue<T> {
    /// The next item; `None` when the writer is gone.
    pub(crate) async fn next(&mut self) -> Option<T> {
        let item = self.receiver.recv().await;
        self.taken(item)
    }

    /// The next item, if there is one.
    pub(crate) fn try_next(&mut self) -> Option<T> {
        let item = self.receiver.try_recv().ok();
        self.taken(item)
    }

    /// How many items were dropped so far.
    pub(crate) fn dropped(&self) -> u64 {
        self.counts.dropped.load(Ordering::Relaxed)
    }

    fn taken(&self, item: Option<T>) -> Option<T> {
        let bytes = item.as_ref().map_or(0, Weigh::bytes);
        self.counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
        item
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Weigh for usize {
        fn bytes(&self) -> usize {
            *self
        }
    }

    #[test]
    fn it_is_bounded_in_number_and_in_bytes() {
        let (offer, mut queue) = queue(3);
        [1, 2, 3, 4].into_iter().for_each(|item| offer.offer(item));
        assert_eq!((queue.try_next(), queue.dropped()), (Some(1), 1));
        offer.offer(MOST_BYTES);
        offer.offer(5);
        assert_eq!(queue.dropped(), 2, "full in number");
        while queue.try_next().is_some() {}
        offer.offer(MOST_BYTES + 1);
        offer.offer(1);
        assert_eq!(queue.dropped(), 3, "full in bytes");
        assert_eq!((queue.try_next(), queue.try_next()), (Some(MOST_BYTES + 1), None));
        offer.offer(1);
        assert_eq!((queue.try_next(), queue.dropped()), (Some(1), 3), "and there is room again");
    }
}
