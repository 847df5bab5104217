//! The queue from Zenoh's threads to the reader: bounded in items and in bytes. Writing never blocks; items that do
//! not fit are dropped and counted.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use tokio::sync::mpsc;

/// Most bytes in one queue; the item that exceeds them is still accepted.
const MAX_WAITING_BYTES: usize = 64 << 20;

#[derive(Debug, Default)]
struct Counts {
    waiting_bytes: AtomicUsize,
    dropped: AtomicU64,
}

/// The writing end.
#[derive(Debug)]
pub(crate) struct QueueSender<T> {
    sender: mpsc::Sender<(usize, T)>,
    counts: Arc<Counts>,
}

/// The reading end, with Zenoh's declaration that fills it. Its type is hidden: what a reader's future holds is proven
/// to be `Send` again in each function that awaits it, and Zenoh's types are deep.
#[derive(Debug)]
pub struct Receiver<T> {
    receiver: mpsc::Receiver<(usize, T)>,
    counts: Arc<Counts>,
    _declared: Option<Box<dyn Any + Send + Sync>>,
}

/// A queue for `capacity` items, at least one.
pub(crate) fn queue<T>(capacity: usize) -> (QueueSender<T>, Receiver<T>) {
    let (sender, receiver) = mpsc::channel(capacity.max(1));
    let counts = Arc::new(Counts::default());
    (QueueSender { sender, counts: Arc::clone(&counts) }, Receiver { receiver, counts, _declared: None })
}

impl<T> QueueSender<T> {
    /// Never blocks: this runs on Zenoh's link threads.
    pub(crate) fn send(&self, bytes: usize, item: T) {
        let before = self.counts.waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        if before > MAX_WAITING_BYTES || self.sender.try_send((bytes, item)).is_err() {
            self.counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            self.counts.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl<T> Receiver<T> {
    pub(crate) fn declared(self, declared: impl Any + Send + Sync) -> Self {
        Self { _declared: Some(Box::new(declared)), ..self }
    }

    /// The next item; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<T> {
        let item = self.receiver.recv().await;
        self.take(item)
    }

    /// The next item, if one is in the queue.
    pub fn try_next(&mut self) -> Option<T> {
        let item = self.receiver.try_recv().ok();
        self.take(item)
    }

    /// How many items were dropped so far, because of their number or their bytes. A dropped query gets no reply.
    pub fn dropped(&self) -> u64 {
        self.counts.dropped.load(Ordering::Relaxed)
    }

    fn take(&self, item: Option<(usize, T)>) -> Option<T> {
        let (bytes, item) = item?;
        self.counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
        Some(item)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_bounded_in_number_and_in_bytes() {
        let (sender, mut queue) = queue(3);
        let send = |bytes| sender.send(bytes, bytes);
        [1, 2, 3, 4].into_iter().for_each(send);
        assert_eq!((queue.try_next(), queue.dropped()), (Some(1), 1));
        send(MAX_WAITING_BYTES);
        send(5);
        assert_eq!(queue.dropped(), 2, "full in number");
        while queue.try_next().is_some() {}
        send(MAX_WAITING_BYTES + 1);
        send(1);
        assert_eq!(queue.dropped(), 3, "full in bytes");
        assert_eq!((queue.try_next(), queue.try_next()), (Some(MAX_WAITING_BYTES + 1), None));
        send(1);
        assert_eq!((queue.try_next(), queue.dropped()), (Some(1), 3), "and there is room again");
    }
}
