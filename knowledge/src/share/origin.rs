//! Where a copy is from: the attribute `origin` of what an agent has copied of another one's memory.

use armarium_memoryx::{EntityId, Snapshot, fields};
use armarium_values::Value;

/// The snapshot of which this is a copy.
#[derive(Clone, Debug, PartialEq)]
pub struct Origin {
    /// Whose memory it is in.
    pub agent: String,
    /// Its address there.
    pub id: EntityId,
    /// Its version there.
    pub version: u64,
    /// When it arrived there, ns; 0 where that is not known.
    pub arrived_ns: u64,
}

impl Origin {
    /// Whether a snapshot is a copy, also of something that is not told as a program of this kind tells it.
    pub fn has(snapshot: &Snapshot) -> bool {
        snapshot.attribute("origin").is_some()
    }

    /// Of what a snapshot is a copy, if it says so.
    pub fn of(snapshot: &Snapshot) -> Option<Self> {
        let origin = snapshot.attribute("origin")?;
        let text = |name: &str| origin.get(name)?.as_str();
        let number = |name: &str| u64::try_from(origin.get(name)?.as_int()?).ok();
        Some(Self {
            agent: text("agent")?.to_owned(),
            id: EntityId::new(snapshot.id.segment(), text("provider")?, snapshot.id.entity()).ok()?,
            version: number("version")?,
            arrived_ns: number("arrived_ns").unwrap_or(0),
        })
    }

    /// The attribute; `missed` versions before this one were not copied.
    pub(super) fn attribute(&self, missed: u64) -> Value {
        let number = |n: u64| Value::Int(i64::try_from(n).unwrap_or(i64::MAX));
        Value::Map(fields([
            ("agent", Some(self.agent.as_str().into())),
            ("provider", Some(self.id.provider().into())),
            ("version", Some(number(self.version))),
            ("arrived_ns", Some(number(self.arrived_ns))),
            ("missed", (missed > 0).then(|| number(missed))),
        ]))
    }
}
