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
    /// How many versions before it were not copied.
    pub missed: u64,
}

impl Origin {
    /// Whether a snapshot has the attribute, readable or not.
    pub fn has(snapshot: &Snapshot) -> bool {
        snapshot.attribute("origin").is_some()
    }

    /// Of whose memory a snapshot is a copy, if it says so.
    pub fn agent_of(snapshot: &Snapshot) -> Option<&str> {
        snapshot.attribute("origin")?.get("agent")?.as_str()
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
            missed: number("missed").unwrap_or(0),
        })
    }

    /// The attribute.
    pub(super) fn attribute(&self) -> Value {
        let number = |n: u64| Value::Int(i64::try_from(n).unwrap_or(i64::MAX));
        Value::Map(fields([
            ("agent", Some(self.agent.as_str().into())),
            ("provider", Some(self.id.provider().into())),
            ("version", Some(number(self.version))),
            ("arrived_ns", Some(number(self.arrived_ns))),
            ("missed", (self.missed > 0).then(|| number(self.missed))),
        ]))
    }
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::Instance;

    use super::*;

    #[test]
    fn it_is_read_as_it_is_written() {
        let id = EntityId::new("S", "eye", "cup").unwrap();
        for missed in [0, 4] {
            let origin = Origin { agent: "alice".into(), id: id.clone(), version: 3, arrived_ns: 7, missed };
            let copy = Snapshot {
                id: EntityId::new("S", "alice.eye", "cup").unwrap(),
                version: 1,
                referenced_ns: 1,
                sent_ns: 1,
                arrived_ns: 1,
                instances: vec![Instance::new([("origin", origin.attribute())])],
            };
            assert_eq!((Origin::agent_of(&copy), Origin::of(&copy)), (Some("alice"), Some(origin)));
        }
    }
}
