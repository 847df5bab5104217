//! What an agent says of those that it follows, in its own memory: an entity for each, which others and people read like all that it knows.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, MemoryError, Snapshot, WorkingMemory, fields};
use armarium_values::Value;
use parking_lot::Mutex;

use super::Followee;
use super::agents::CLOCKS_APART_S;

/// The core segment of these entities; the provider segment is the agent that follows.
pub const FOLLOWING: &str = "Following";

/// One whom an agent follows, as the entity says:
///
/// | attribute | content |
/// |---|---|
/// | `agent` | whom (text) |
/// | `segments` | which core segments of it, `*` stands for any characters (list of texts) |
/// | `state` | `followed`, or `looked for` |
/// | `why` | while it is looked for: what went wrong last (text) |
/// | `missed` | versions that it had forgotten before they were copied, in total |
/// | `clock_ahead_s` | how far its clock is ahead of the follower's, s, where it says so |
#[derive(Clone, Debug, PartialEq)]
pub struct Following {
    /// The agent that is followed.
    pub agent: String,
    /// The core segments of it that are followed, or patterns of these.
    pub segments: Vec<String>,
    /// While it is looked for: why it is not followed yet.
    pub looked_for: Option<String>,
    /// How many versions were lost.
    pub missed: u64,
    /// How far its clock is ahead of the follower's, s, if that is known.
    pub clock_ahead_s: Option<f64>,
}

impl Following {
    /// It is followed; nothing was missed, and nothing is known of its clock.
    pub fn new(agent: &str, segments: Vec<String>) -> Self {
        Self { agent: agent.into(), segments, looked_for: None, missed: 0, clock_ahead_s: None }
    }

    /// What an entity says, if it is one of these.
    pub fn of(snapshot: &Snapshot) -> Option<Self> {
        let text = |name: &str| snapshot.attribute(name).and_then(Value::as_str);
        let segments = match snapshot.attribute("segments") {
            Some(Value::List(names)) => names.iter().filter_map(Value::as_str).map(str::to_owned).collect(),
            _ => Vec::new(),
        };
        let missed = snapshot.attribute("missed").and_then(Value::as_int);
        Some(Self {
            looked_for: (text("state")? != "followed").then(|| text("why").unwrap_or_default().to_owned()),
            missed: missed.and_then(|count| u64::try_from(count).ok()).unwrap_or(0),
            clock_ahead_s: snapshot.attribute("clock_ahead_s").and_then(Value::as_f64),
            ..Self::new(text("agent")?, segments)
        })
    }

    /// `followed` or `looked for`.
    pub fn state(&self) -> &'static str {
        if self.looked_for.is_none() { "followed" } else { "looked for" }
    }

    fn attributes(&self) -> BTreeMap<String, Value> {
        let segments = self.segments.iter().map(|segment| segment.as_str().into()).collect();
        fields([
            ("agent", Some(self.agent.as_str().into())),
            ("segments", Some(Value::List(segments))),
            ("state", Some(self.state().into())),
            ("why", self.looked_for.as_deref().map(Into::into)),
            ("missed", Some(Value::Int(i64::try_from(self.missed).unwrap_or(i64::MAX)))),
            ("clock_ahead_s", self.clock_ahead_s.map(Value::Float)),
        ])
    }
}

/// Keeps the entity of one followed agent; it is written when it changes.
#[derive(Debug)]
pub(crate) struct FollowingRecord {
    memory: Arc<WorkingMemory>,
    id: EntityId,
    said: Mutex<Following>,
}

impl FollowingRecord {
    /// Nothing is written yet.
    pub(super) fn new(
        memory: Arc<WorkingMemory>,
        own: &str,
        followee: &Followee,
        segments: Vec<String>,
    ) -> Result<Self, MemoryError> {
        let agent = &followee.agent;
        let segment = followee.segment.as_ref().map(|segment| format!(":{}", segment.replace('*', "any")));
        let id = EntityId::new(FOLLOWING, own, &format!("{agent}{}", segment.unwrap_or_default()))?;
        let said = Mutex::new(Following::new(agent, segments));
        Ok(Self { memory, id, said })
    }

    /// Something is in the way. Returns whether it is something else than before.
    pub(super) fn is_looked_for(&self, why: &MemoryError) -> bool {
        let why = why.to_string();
        self.change(|said| said.looked_for = Some(why))
    }

    /// It is followed, with its clock so far ahead, where that is known. Returns whether that clock is to be warned of: it is wrong, and
    /// otherwise than before.
    pub(super) fn is_followed(&self, clock_ahead_s: Option<f64>) -> bool {
        let said = self.said.lock().clock_ahead_s;
        let is_other = match (said, clock_ahead_s) {
            (Some(said), Some(ahead_s)) => (said - ahead_s).abs() > CLOCKS_APART_S,
            (said, now) => said.is_some() != now.is_some(),
        };
        // A clock that is measured again a little otherwise is no news.
        let clock_ahead_s = if is_other { clock_ahead_s } else { said };
        self.change(|said| (said.looked_for, said.clock_ahead_s) = (None, clock_ahead_s));
        is_other && clock_ahead_s.is_some_and(|ahead_s| ahead_s.abs() > CLOCKS_APART_S)
    }

    pub(super) fn has_missed(&self, count: u64) {
        self.change(|said| said.missed += count);
    }

    fn change(&self, change: impl FnOnce(&mut Following)) -> bool {
        let mut said = self.said.lock();
        let before = said.clone();
        change(&mut said);
        if *said == before && self.memory.latest_now(&self.id).is_ok() {
            return false;
        }
        let update = Commit::new(self.id.clone(), self.memory.now_ns(), said.attributes());
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
        let memory = Arc::new(crate::working_memory(Arc::new(|| 7)));
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
        let entity = memory.latest_now(&"Following/bob/alice:Objectany".parse().unwrap()).unwrap();
        let segments = vec!["Agents".to_owned(), "Object*".to_owned()];
        let said = Following { missed: 5, clock_ahead_s: Some(-3.0), ..Following::new("alice", segments) };
        assert_eq!((entity.version, Following::of(&entity)), (5, Some(said)));
    }
}
