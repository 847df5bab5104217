//! A channel for the newest value, which wakes its receivers at each change.
//!
//! Receivers are woken in the order in which they began to wait. `tokio::sync::watch` does the same but wakes its
//! receivers in a random order; under virtual time, this alone would make two runs differ.

use std::pin::pin;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::Notify;

#[derive(Debug)]
struct Channel<T> {
    state: Mutex<Newest<T>>,
    changed: Notify,
}

#[derive(Debug)]
struct Newest<T> {
    value: T,
    version: u64,
    closed: bool,
}

/// Sets the value; there is only one sender.
#[derive(Debug)]
pub struct Sender<T> {
    shared: Arc<Channel<T>>,
}

/// Reads the newest value; clones read the same value.
#[derive(Debug)]
pub struct NewestReceiver<T> {
    shared: Arc<Channel<T>>,
    seen: u64,
}

/// The sender is gone: the value will not change any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the sender is gone: the value will not change any more")]
pub struct Closed;

impl<T: Clone> Sender<T> {
    /// A channel with its first value.
    pub fn new(value: T) -> Self {
        let state = Mutex::new(Newest { value, version: 0, closed: false });
        Self { shared: Arc::new(Channel { state, changed: Notify::new() }) }
    }

    /// Replaces the value and wakes the waiting receivers.
    pub fn send(&self, value: T) {
        let mut state = self.shared.state.lock();
        state.value = value;
        state.version += 1;
        drop(state);
        self.shared.changed.notify_waiters();
    }

    /// Tells the receivers that the value will not change any more, as a dropped sender does.
    pub fn close(&self) {
        self.shared.close();
    }

    /// The present value.
    pub fn borrow(&self) -> T {
        self.shared.state.lock().value.clone()
    }

    /// A receiver that counts the present value as seen.
    pub fn subscribe(&self) -> NewestReceiver<T> {
        let seen = self.shared.state.lock().version;
        NewestReceiver { shared: Arc::clone(&self.shared), seen }
    }
}

impl<T> Drop for Sender<T> {
    fn drop(&mut self) {
        self.shared.close();
    }
}

impl<T> Channel<T> {
    fn close(&self) {
        self.state.lock().closed = true;
        self.changed.notify_waiters();
    }
}

impl<T> Clone for NewestReceiver<T> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared), seen: self.seen }
    }
}

impl<T: Clone> NewestReceiver<T> {
    /// The present value, without marking it as seen.
    pub fn borrow(&self) -> T {
        self.shared.state.lock().value.clone()
    }

    /// The present value, marked as seen.
    pub fn borrow_and_update(&mut self) -> T {
        let state = self.shared.state.lock();
        self.seen = state.version;
        state.value.clone()
    }

    /// Waits until there is a value that was not seen.
    ///
    /// # Errors
    /// [`Closed`] when the sender is gone.
    pub async fn changed(&mut self) -> Result<(), Closed> {
        loop {
            let mut woken = pin!(self.shared.changed.notified());
            // Registered before the check, so that no change is missed in between.
            woken.as_mut().enable();
            let (version, closed) = {
                let state = self.shared.state.lock();
                (state.version, state.closed)
            };
            if version != self.seen {
                self.seen = version;
                return Ok(());
            }
            if closed {
                return Err(Closed);
            }
            woken.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn waiters_wake_in_the_order_in_which_they_began_to_wait() {
        let sender = Sender::new(0);
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut tasks = Vec::new();
        for name in 0..20 {
            let (mut receiver, order) = (sender.subscribe(), Arc::clone(&order));
            tasks.push(tokio::spawn(async move {
                while receiver.changed().await.is_ok() {
                    order.lock().push(name);
                }
            }));
        }
        for value in 1..=50 {
            tokio::task::yield_now().await;
            sender.send(value);
            tokio::task::yield_now().await;
        }
        drop(sender);
        for task in tasks {
            task.await.expect("no waiter panics");
        }
        let order = order.lock();
        let expected: Vec<i32> = (0..50).flat_map(|_| 0..20).collect();
        assert_eq!(*order, expected);
    }

    #[tokio::test]
    async fn a_change_before_the_wait_is_not_missed_and_the_end_is_told() {
        let sender = Sender::new("a");
        let mut receiver = sender.subscribe();
        sender.send("b");
        assert_eq!(receiver.changed().await, Ok(()));
        assert_eq!(receiver.borrow(), "b");
        drop(sender);
        assert_eq!(receiver.changed().await, Err(Closed));
        assert_eq!(receiver.borrow_and_update(), "b");
    }
}
