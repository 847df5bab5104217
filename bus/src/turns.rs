//! Answers to one asker are sent one at a time.
//!
//! A link that takes nothing holds its sender up until Zenoh gives the link up, 5 s later. Each sender that waits for
//! the same link by then waits as long again, because Zenoh tells only those who come after. So they wait here: when
//! the first has failed, the others fail at once. Knows nothing of keys and payloads.

use std::sync::Arc;

use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::block_in_place;

use crate::per_asker::PerAsker;

/// The turns of a session's askers; clones are the same.
#[derive(Clone, Debug, Default)]
pub(crate) struct Turns(Arc<PerAsker<tokio::sync::Mutex<()>>>);

/// The turns of one asker.
#[derive(Clone, Debug, Default)]
pub(crate) struct AskerTurn(Arc<tokio::sync::Mutex<()>>);

/// Does what may hold up the thread, while the thread's other tasks go on elsewhere, where there is an elsewhere.
pub fn aside<T>(act: impl FnOnce() -> T) -> T {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => block_in_place(act),
        _ => act(),
    }
}

impl Turns {
    /// The turns of an asker. Those who do not say who they are share theirs.
    pub(crate) fn of(&self, asker: Option<&str>) -> AskerTurn {
        AskerTurn(self.0.of(asker, tokio::sync::Mutex::default))
    }
}

impl AskerTurn {
    /// Sends when it is this one's turn.
    pub(crate) async fn take<T>(&self, send: impl FnOnce() -> T) -> T {
        let _taken = self.0.lock().await;
        aside(send)
    }

    /// As [`Self::take`], without waiting for it.
    pub(crate) fn take_later(&self, send: impl FnOnce() + Send + 'static) {
        if let Ok(_taken) = self.0.try_lock() {
            aside(send);
        } else if let Ok(runtime) = Handle::try_current() {
            let turn = self.clone();
            runtime.spawn(async move { turn.take(send).await });
        }
    }
}
