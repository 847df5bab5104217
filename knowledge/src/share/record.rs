//! What an agent says of those that it follows, in its own memory: an entity for each, which others and people read like all that it knows.

use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, MemoryError, WorkingMemory, fields};
use armarium_values::Value;
use parking_lot::Mutex;

use super::Followee;
use super::agents::CLOCKS_APART_S;

/// The core segment of these entities; the provider segment is the agent that follows.
pub const FOLLOWING: &str = "Following";

/// The entity of one followed agent:
///
/// | attribute | content |
/// |---|---|
/// | `agent` | whom (text) |
/// | `segments` | which core segments of it, `*` stands for any characters (list of texts) |
/// | `state` | `followed`, or `looked for` |
/// | `why` | while it is looked for: what went wrong last (text) |
/// | `missed` | versions that it had forgotten before they were copied, in total |
/// | `clock_ahead_s` | how far its clock is ahead of the follower's, s, where it says so |
///
/// It is written when it changes.
#[derive(Debug)]
pub(crate) struct FollowingRecord {
    memory: Arc<WorkingMemory>,
    id: EntityId,
    agent: String,
    segments: Vec<String>,
    state: Mutex<FollowingState>,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct FollowingState {
    why: Option<String>,
    missed: u64,
    clock_ahead_s: Option<f64>,
}

impl FollowingRecord {
    /// Nothing is written yet.
    pub(super) fn new(
        memory: Arc<WorkingMemory>,
        own: &str,
        followee: &Followee,
        segments: Vec<String>,
    ) -> Result<Self, MemoryError> {
        let agent = followee.agent.clone();
        let segment = followee.segment.as_ref().map(|segment| format!(":{}", segment.replace('*', "any")));
        let id = EntityId::new(FOLLOWING, own, &format!("{agent}{}", segment.unwrap_or_default()))?;
        Ok(Self { memory, id, agent, segments, state: Mutex::default() })
    }

    /// Something is in the way. Returns whether it is something else than before.
    pub(super) fn is_looked_for(&self, why: &MemoryError) -> bool {
        let why = Some(why.to_string());
        self.change(|state| FollowingState { why, ..state })
    }

    /// It is followed, with its clock so far ahead, where that is known. Returns whether that clock is to be warned of: it is wrong, and
    /// otherwise than before.
    pub(super) fn is_followed(&self, clock_ahead_s: Option<f64>) -> bool {
        let said = self.state.lock().clock_ahead_s;
        let is_other = match (said, clock_ahead_s) {
            (Some(said), Some(ahead_s)) => (said - ahead_s).abs() > CLOCKS_APART_S,
            (said, now) => said.is_some() != now.is_some(),
        };
        // A clock that is measured again a little otherwise is no news.
        let clock_ahead_s = if is_other { clock_ahead_s } else { said };
        self.change(|state| FollowingState { why: None, clock_ahead_s, ..state });
        is_other && clock_ahead_s.is_some_and(|ahead_s| ahead_s.abs() > CLOCKS_APART_S)
    }

    pub(super) fn has_missed(&self, count: u64) {
        self.change(|state| FollowingState { missed: state.missed + count, ..state });
    }

    fn change(&self, change: impl FnOnce(FollowingState) -> FollowingState) -> bool {
        let mut state = self.state.lock();
        let next = change(state.clone());
        let is_written = self.memory.latest_now(&self.id).is_ok();
        if is_written && *state == next {
            return false;
        }
        *state = next;
        let segments = self.segments.iter().map(|segment| segment.as_str().into()).collect();
        let attributes = fields([
            ("agent", Some(self.agent.as_str().into())),
            ("segments", Some(Value::List(segments))),
            ("state", Some(if state.why.is_some() { "looked for" } else { "followed" }.into())),
            ("why", state.why.as_deref().map(Into::into)),
            ("missed", Some(Value::Int(i64::try_from(state.missed).unwrap_or(i64::MAX)))),
            ("clock_ahead_s", state.clock_ahead_s.map(Value::Float)),
        ]);
        let update = Commit::new(self.id.clone(), self.memory.now_ns(), attributes);
        if let Err(error) = self.memory.commit_now(vec![update]) {
            tracing::warn!(%error, "what is followed cannot be told");
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_says_what_changes() {
        let memory = Arc::new(WorkingMemory::new(Arc::new(|| 7)));
        let followee: Followee = "alice:Object*".parse().unwrap();
        let segments = vec!["Agents".to_owned(), "Object*".to_owned()];
        let record = FollowingRecord::new(Arc::clone(&memory), "bob", &followee, segments).unwrap();
        let read = |name: &str| {
            let entity = memory.latest_now(&"Following/bob/alice:Objectany".parse().unwrap()).unwrap();
            (entity.version, entity.attribute(name).cloned())
        };
        let absent = MemoryError::Remote { agent: "alice".into(), what: "she is away".into() };
        assert!(record.is_looked_for(&absent) && !record.is_looked_for(&absent));
        assert_eq!(read("state"), (1, Some("looked for".into())));
        assert!(!record.is_followed(Some(0.02)), "a good clock");
        assert!(!record.is_followed(Some(0.03)));
        assert_eq!(read("why"), (2, None));
        assert!(record.is_followed(Some(-3.0)), "it was set back");
        assert!(!record.is_followed(Some(-3.01)), "that was said");
        record.has_missed(4);
        record.has_missed(1);
        assert_eq!(read("missed"), (5, Some(Value::Int(5))));
        assert_eq!(read("clock_ahead_s"), (5, Some(Value::Float(-3.0))));
    }
}
