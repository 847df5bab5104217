//! Something for each asker of a session, as long as anybody holds it. Knows nothing of what that is.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;

/// Askers that are kept before those of whom nothing is held are forgotten.
const KEPT: usize = 64;

/// What each asker has. Those who do not say who they are have theirs together.
#[derive(Debug)]
pub struct PerAsker<T>(Mutex<BTreeMap<String, Weak<T>>>);

impl<T> Default for PerAsker<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> PerAsker<T> {
    /// What an asker has; if nobody holds that any more, it is made anew.
    pub fn of(&self, asker: Option<&str>, new: impl FnOnce() -> T) -> Arc<T> {
        let mut askers = self.0.lock();
        let asker = asker.unwrap_or_default();
        if let Some(held) = askers.get(asker).and_then(Weak::upgrade) {
            return held;
        }
        if askers.len() >= KEPT {
            askers.retain(|_, held| held.strong_count() > 0);
        }
        let made = Arc::new(new());
        askers.insert(asker.into(), Arc::downgrade(&made));
        made
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_has_one_and_who_is_gone_is_forgotten() {
        let askers = PerAsker::default();
        let of = |asker: Option<&str>| askers.of(asker, || ());
        let (alice, nameless) = (of(Some("alice")), of(None));
        assert!(Arc::ptr_eq(&alice, &of(Some("alice"))));
        assert!(Arc::ptr_eq(&nameless, &of(None)));
        assert_eq!(askers.0.lock().len(), 2);
        for asker in 0..1000 {
            let _ = of(Some(&asker.to_string()));
        }
        assert!(askers.0.lock().len() <= KEPT + 1);
        assert!(Arc::ptr_eq(&alice, &of(Some("alice"))));
    }
}
