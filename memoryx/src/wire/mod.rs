//! The messages of memories over Zenoh: payloads, their schemas, and the parameters of a get.
//!
//! | where | payload | answer |
//! |---|---|---|
//! | get `{agent}/memory` | `memoryx/commit;v1`: [`CommitRequest`] | `memoryx/versions;v1`: list of versions |
//! | get `{agent}/memory` | `memoryx/query;v1`: [`QueryRequest`] | `memoryx/snapshots;v2`: [`Snapshots`], a part where there is more |
//! | get `{agent}/memory` | `memoryx/list;v1`: [`HeadsRequest`] | `memoryx/heads;v1`: [`HeadsPart`] |
//! | get `{agent}/memory` | `memoryx/maintain;v1`: [`Maintain`] | `memoryx/report;v1`: [`MaintenanceReport`] |
//! | get `{agent}/memory/{segment}/{provider}/{entity}`, `*` allowed | - | `memoryx/entity;v1` each, on its own key |
//! | put `{agent}/memory/{segment}/{provider}/{entity}` by others | `memoryx/update;v1`: [`Commit`] | - |
//! | put `{agent}/memory/{segment}/{provider}/{entity}` by the memory, while anybody subscribes | `memoryx/entity;v1`: [`Snapshot`] | - |
//! | put `{agent}/memory/changes/{segment}` by the memory | `memoryx/changes;v1`: [`ChangesMessage`] | - |
//! | put `{agent}/memory/changes` by the memory, while anybody subscribes | the same, of all core segments | - |
//!
//! A refusal is an error reply with `memoryx/error;v1`: [`MemoryError`]. Parameters of a get on entities, times in ns:
//! none (the newest), `history`, `at=T`, `before=T`, `from=T;to=T`, `index=I,J`, and with each `limit=N`, `filter=CEL` (without `;` and
//! `=`), `long_term`.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_bus::{Bounds, CodecError, Key, KeyPattern, Payload, keys};
use serde::{Deserialize, Serialize};

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Pattern, Query, Times};

mod forms;

/// Most snapshots in one answer.
pub(crate) const MAX_SNAPSHOTS: usize = 8192;
/// Most bytes of snapshots in one message, about; a single larger one is sent alone.
pub(crate) const MAX_BYTES: u64 = 4 << 20;

/// Updates that are committed all or none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommitRequest {
    /// The updates.
    pub updates: Vec<Commit>,
    /// When they were sent, ns since 1970 by the sender's clock; 0 from programs that do not say.
    #[serde(default, deserialize_with = "forms::or_default")]
    pub sent_ns: u64,
}

/// The versions that a commit has created, in order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Versions(pub Vec<u64>);

/// A query to a memory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct QueryRequest {
    /// The query.
    #[serde(flatten)]
    pub query: Query,
    /// Whether the asker goes on at [`Snapshots::next`]. Then each part takes a short time, and may be empty.
    #[serde(deserialize_with = "forms::or_default")]
    pub parts: bool,
}

/// The snapshots that answer a query, or the first part of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Snapshots {
    /// The snapshots.
    pub snapshots: Vec<Arc<Snapshot>>,
    /// Whether there are more.
    pub more: bool,
    /// If there are more: a query with `after` this position returns them. The memory has not looked at them.
    pub next: Option<Cursor>,
}

/// Asks for the newest versions of entities, without their content.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeadsRequest {
    /// Which entities.
    pub pattern: Pattern,
    /// Only entities after this one.
    pub after: Option<EntityId>,
}

/// The newest versions of entities in order of address, or the first part of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeadsPart {
    /// Entity, version, arrival time, ns, and whether it is a removal.
    pub entities: Vec<(EntityId, u64, u64, bool)>,
    /// If there are more: those after this entity.
    pub next: Option<EntityId>,
    /// The memory's clock, ns; `None` from programs that do not say.
    pub now_ns: Option<u64>,
}

/// Changes of a memory, in order. An idle memory sends an empty list, with the number of changes so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ChangesMessage {
    /// When the publisher started, ns; the count begins at 0 with it.
    pub epoch: u64,
    /// How many changes were published before these.
    pub first: u64,
    /// Everything that arrived in the memory before this time was published with these changes or before, ns; 0 when
    /// unknown.
    #[serde(default)]
    pub until_ns: u64,
    /// The changes; may be empty.
    pub snapshots: Vec<Arc<Snapshot>>,
}

/// A maintenance request for an agent's long-term memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Maintain {
    /// Count what is there.
    Stats,
    /// Count what each owner of provider segments takes of each core segment, and has written.
    Usage,
    /// Read and check everything.
    Verify,
    /// Return free space to the file system.
    Compact,
    /// Store working memory under a name.
    Save {
        /// The name.
        name: String,
    },
    /// Restore the named content in working memory.
    Load {
        /// The name.
        name: String,
    },
    /// Forget a named snapshot.
    Forget {
        /// The name.
        name: String,
    },
    /// List the names.
    Names,
    /// Say what has changed since a named snapshot was taken.
    Compare {
        /// The name.
        name: String,
        /// Until another one was taken; until now if not given.
        #[serde(default)]
        to: Option<String>,
    },
    /// Copy the whole file.
    BackUp {
        /// The name of the copy, beside the file.
        name: String,
    },
    /// Apply retention.
    Retain {
        /// How long snapshots are kept, ns.
        age_ns: Option<u64>,
        /// Most bytes.
        bytes: Option<u64>,
    },
    /// Store snapshots with their versions, as an import does.
    Keep {
        /// The snapshots.
        snapshots: Vec<Arc<Snapshot>>,
    },
}

/// The result of maintenance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaintenanceReport {
    /// Numbers by name.
    pub counts: BTreeMap<String, u64>,
    /// Messages: damages, names.
    pub words: Vec<String>,
}

armarium_bus::payloads! {
    CommitRequest: "memoryx/commit", 1;
    Versions: "memoryx/versions", 1;
    QueryRequest: "memoryx/query", 1;
    Snapshots: "memoryx/snapshots", 2;
    ChangesMessage: "memoryx/changes", 1;
    HeadsRequest: "memoryx/list", 1;
    HeadsPart: "memoryx/heads", 1;
    Maintain: "memoryx/maintain", 1;
    MaintenanceReport: "memoryx/report", 1;
    Snapshot: "memoryx/entity", 1;
    Commit: "memoryx/update", 1;
    MemoryError: "memoryx/error", 1;
}

/// How many snapshots from the start fit into one message; at least one.
pub(crate) fn in_one_answer(snapshots: &[Arc<Snapshot>]) -> usize {
    let mut bytes = 0;
    let fits = snapshots.iter().take(MAX_SNAPSHOTS).take_while(|snapshot| {
        bytes += snapshot.bytes();
        bytes <= MAX_BYTES
    });
    fits.count().max(1).min(snapshots.len())
}

/// Decodes a payload of the type that its encoding names.
pub(crate) fn open<T: Payload>(encoding: &str, payload: &[u8]) -> Result<T, CodecError> {
    T::SCHEMA.check(encoding)?;
    armarium_bus::decode(payload)
}

/// A payload of whatever kind, for people: a refusal of a later program, or of one that is no memory.
pub(crate) fn of_any_kind(payload: &[u8]) -> String {
    // A map in CBOR is no UTF-8.
    if let Ok(text) = std::str::from_utf8(payload) {
        return text.to_owned();
    }
    let known = armarium_bus::decode::<serde_json::Value>(payload);
    known.map_or_else(|_| String::from_utf8_lossy(payload).into_owned(), |known| known.to_string())
}

/// The encoding and the bytes of a payload. A size that the receiver would refuse is refused here, where the sender can react.
pub(crate) fn seal<T: Payload>(content: &T) -> Result<(String, Vec<u8>), CodecError> {
    let (bytes, most) = (armarium_bus::encode(content)?, Bounds::default().bytes);
    if bytes.len() > most {
        return Err(CodecError::TooLong { bytes: bytes.len(), most });
    }
    Ok((T::SCHEMA.encoding(), bytes))
}

/// A snapshot as a message on the key of its entity; `None` where it cannot be one.
pub(crate) fn of_entity(agent: &str, snapshot: &Snapshot) -> Option<(Key, String, Vec<u8>)> {
    let (segment, provider) = (snapshot.id.segment(), snapshot.id.provider());
    let key = keys::memory(agent, segment, provider, snapshot.id.entity()).ok()?;
    let (encoding, payload) = seal(snapshot).ok()?;
    Some((key, encoding, payload))
}

/// The keys of all entities of an agent's memory.
pub(crate) fn every_entity(agent: &str) -> Result<KeyPattern, armarium_bus::KeyError> {
    keys::memory_pattern(Some(agent), None, None, None)
}

/// The query of a get on entities.
pub(crate) fn query_of_get(key: &str, parameters: &str) -> Result<Query, MemoryError> {
    let wrong = |what: String| MemoryError::Query { what };
    let parts: Vec<&str> = key.split('/').collect();
    let [_, "memory", segment, provider, entity] = parts[..] else {
        return Err(wrong(format!("`{key}` is no key of entities")));
    };
    let part = |name: &str| (name != "*" && name != "**").then(|| name.to_owned());
    let pattern = Pattern { segment: part(segment), provider: part(provider), entity: part(entity) };
    let mut query = Query::latest(pattern);
    let (mut from, mut to) = (None, None);
    for parameter in parameters.split(';').filter(|p| !p.is_empty()) {
        let (name, value) = parameter.split_once('=').unwrap_or((parameter, ""));
        let number =
            || value.parse::<u64>().map_err(|_| wrong(format!("`{parameter}` needs a whole number")));
        match name {
            "latest" => query.times = Times::Latest,
            "history" => query.times = Times::All,
            "at" => query.times = Times::At(number()?),
            "index" => {
                let (first, last) = value.split_once(',').unwrap_or((value, value));
                let place = |n: &str| {
                    n.parse::<i64>().map_err(|_| wrong(format!("`{parameter}` needs whole numbers")))
                };
                query.times = Times::Index(place(first)?, place(last)?);
            }
            "filter" => query.filter = Some(value.to_owned()),
            "long_term" => query.long_term = true,
            "before" => query.times = Times::Before(number()?),
            "from" => from = Some(number()?),
            "to" => to = Some(number()?),
            "limit" => query.limit = Some(usize::try_from(number()?).unwrap_or(usize::MAX)),
            _ => return Err(wrong(format!("`{name}` is no parameter of a get on memory"))),
        }
    }
    if from.is_some() || to.is_some() {
        query.times = Times::Between(from.unwrap_or(0), to.unwrap_or(u64::MAX));
    }
    Ok(query)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_get_is_a_query() {
        let all = Query::latest(Pattern::segment("Motions"));
        for (key, parameters, expected) in [
            ("a/memory/Motions/*/*", "", all.clone()),
            ("a/memory/Motions/*/*", "history;limit=3", all.clone().times(Times::All).limit(3)),
            ("a/memory/Motions/*/*", "from=5", all.clone().times(Times::Between(5, u64::MAX))),
            ("a/memory/Motions/*/*", "from=5;to=6", all.clone().times(Times::Between(5, 6))),
            ("a/memory/Motions/*/*", "at=7", all.times(Times::At(7))),
            ("a/memory/S/p/e", "", Query::latest(Pattern::entity(&"S/p/e".parse().unwrap()))),
        ] {
            assert_eq!(query_of_get(key, parameters), Ok(expected), "{key}?{parameters}");
        }
        for (key, parameters) in [
            ("a/memory/**", ""),
            ("a/robot/x/y/z", ""),
            ("a/memory/S/p/e", "at=x"),
            ("a/memory/S/p/e", "page=1"),
        ] {
            assert!(query_of_get(key, parameters).is_err(), "{key}?{parameters}");
        }
    }

    #[test]
    fn payloads_are_opened_by_their_schema_only() {
        let (encoding, bytes) = seal(&Versions(vec![1, 2])).unwrap();
        assert_eq!(open::<Versions>(&encoding, &bytes), Ok(Versions(vec![1, 2])));
        assert!(matches!(open::<QueryRequest>(&encoding, &bytes), Err(CodecError::OtherSchema { .. })));
        assert!(matches!(open::<Versions>(&encoding, b"\xff"), Err(CodecError::Malformed { .. })));
        let refusal = MemoryError::Conflict { id: "S/p/e".into(), expected: 1, actual: 2 };
        let (encoding, bytes) = seal(&refusal).unwrap();
        assert_eq!(open::<MemoryError>(&encoding, &bytes), Ok(refusal));
        let later = armarium_bus::encode(&serde_json::json!({"asleep": {"until_s": 7}})).unwrap();
        assert_eq!(of_any_kind(&later), r#"{"asleep":{"until_s":7}}"#);
        assert_eq!(of_any_kind(b"who are you?"), "who are you?");
    }
}
