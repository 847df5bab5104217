//! Answers to one asker are sent one at a time.
//!
//! A link that takes nothing holds its sender up until Zenoh gives the link up, 5 s later. Each sender that waits for
//! the same link by then waits as long again, because Zenoh tells only those who come after. So they wait here: when
//! the first has failed, the others fail at once. Knows nothing of keys and payloads.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::block_in_place;

/// Askers that are kept before those that wait for nothing are forgotten.
const KEPT: usize = 64;

/// The turns of a session's askers; clones are the same.
#[derive(Clone, Debug, Default)]
pub(crate) struct Turns(Arc<Mutex<BTreeMap<String, Weak<tokio::sync::Mutex<()>>>>>);

/// The turns of one asker.
#[derive(Clone, Debug, Default)]
pub(crate) struct AskerTurn(Arc<tokio::sync::Mutex<()>>);

/// Does what may hold up the thread, while the thread's other tasks go on elsewhere, where there is an elsewhere.
pub(crate) fn aside<T>(act: impl FnOnce() -> T) -> T {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => block_in_place(act),
        _ => act(),
    }
}

impl Turns {
    /// The turns of an asker. Those who do not say who they are share theirs.
    pub(crate) fn of(&self, asker: Option<&str>) -> AskerTurn {
        let mut askers = self.0.lock();
        let asker = asker.unwrap_or_default();
        if let Some(turn) = askers.get(asker).and_then(Weak::upgrade) {
            return AskerTurn(turn);
        }
        if askers.len() >= KEPT {
            askers.retain(|_, turn| turn.strong_count() > 0);
        }
        let turn = AskerTurn::default();
        askers.insert(asker.into(), Arc::downgrade(&turn.0));
        turn
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_asker_has_one_turn_and_who_is_gone_is_forgotten() {
        let turns = Turns::default();
        let (alice, nameless) = (turns.of(Some("alice")), turns.of(None));
        assert!(Arc::ptr_eq(&alice.0, &turns.of(Some("alice")).0));
        assert!(Arc::ptr_eq(&nameless.0, &turns.of(None).0));
        assert!(!Arc::ptr_eq(&alice.0, &nameless.0));
        for asker in 0..1000 {
            let _ = turns.of(Some(&asker.to_string()));
        }
        assert!(turns.0.lock().len() <= KEPT + 1);
        assert!(Arc::ptr_eq(&alice.0, &turns.of(Some("alice")).0));
    }
}
