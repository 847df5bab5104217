//! The bytes of keys and records; the page of [`super`] describes them.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::StoreError;
use crate::entity::{EntityId, Instance, Snapshot};
use crate::query::Pattern;

/// Bytes of the checksum before a record.
const CHECKSUM: usize = 4;

/// A snapshot without what its key says.
#[derive(Serialize, Deserialize)]
struct Record<'a> {
    referenced_ns: u64,
    sent_ns: u64,
    arrived_ns: u64,
    instances: Cow<'a, [Instance]>,
}

pub(super) fn entity_key(id: &EntityId) -> Vec<u8> {
    let mut key = Vec::with_capacity(id.as_str().len() + 17);
    for name in [id.segment(), id.provider(), id.entity()] {
        key.extend_from_slice(name.as_bytes());
        key.push(0);
    }
    key
}

pub(super) fn key(id: &EntityId, version: u64) -> Vec<u8> {
    let mut key = entity_key(id);
    key.extend_from_slice(&version.to_be_bytes());
    key
}

pub(super) fn time_key(id: &EntityId, referenced_ns: u64, version: u64) -> Vec<u8> {
    let mut key = entity_key(id);
    key.extend_from_slice(&referenced_ns.to_be_bytes());
    key.extend_from_slice(&version.to_be_bytes());
    key
}

/// Keys of entities that a pattern can fit: from the first, included, to the second, excluded.
pub(super) fn entity_range(pattern: &Pattern) -> (Vec<u8>, Option<Vec<u8>>) {
    let mut from = Vec::new();
    for name in [&pattern.segment, &pattern.provider, &pattern.entity] {
        let Some(name) = name else { break };
        from.extend_from_slice(name.as_bytes());
        from.push(0);
    }
    let mut to = from.clone();
    let end = to.last_mut().map(|last| *last = 1);
    (from, end.map(|()| to))
}

/// The entity of a key of the table of entities.
pub(super) fn entity_of(key: &[u8]) -> Result<EntityId, String> {
    let unreadable = || format!("a key is no address: {}", key.escape_ascii());
    let key = key.strip_suffix(&[0]).ok_or_else(unreadable)?;
    let text = std::str::from_utf8(key).map_err(|_| unreadable())?;
    match text.split('\0').collect::<Vec<_>>()[..] {
        [segment, provider, entity] => EntityId::new(segment, provider, entity).map_err(|_| unreadable()),
        _ => Err(unreadable()),
    }
}

/// The version at the end of a key.
pub(super) fn last_number(key: &[u8]) -> u64 {
    key.last_chunk().map_or(0, |bytes| u64::from_be_bytes(*bytes))
}

pub(super) fn encode(snapshot: &Snapshot) -> Result<Vec<u8>, StoreError> {
    let record = Record {
        referenced_ns: snapshot.referenced_ns,
        sent_ns: snapshot.sent_ns,
        arrived_ns: snapshot.arrived_ns,
        instances: Cow::Borrowed(&snapshot.instances),
    };
    let refused = |what: String| StoreError::Encode { id: snapshot.id.to_string(), what };
    let payload = armarium_bus::encode(&record).map_err(|e| refused(e.to_string()))?;
    // What could not be read back must not be acknowledged.
    armarium_bus::codec::check(&payload, armarium_bus::Bounds::default())
        .map_err(|e| refused(e.to_string()))?;
    let mut bytes = checksum(&key(&snapshot.id, snapshot.version), &payload).to_le_bytes().to_vec();
    bytes.extend_from_slice(&payload);
    Ok(bytes)
}

pub(super) fn decode(key: &[u8], bytes: &[u8]) -> Result<Snapshot, String> {
    let unreadable = |what: &str| format!("the record of {}: {what}", key.escape_ascii());
    let (entity, version) = key.split_last_chunk::<8>().ok_or_else(|| unreadable("its key is too short"))?;
    let id = entity_of(entity)?;
    let version = u64::from_be_bytes(*version);
    let (stored, payload) = bytes.split_at_checked(CHECKSUM).ok_or_else(|| unreadable("it is too short"))?;
    if stored != checksum(key, payload).to_le_bytes() {
        return Err(format!("version {version} of `{id}` does not have its checksum"));
    }
    let record: Record<'_> = armarium_bus::decode(payload).map_err(|e| unreadable(&e.to_string()))?;
    Ok(Snapshot {
        id,
        version,
        referenced_ns: record.referenced_ns,
        sent_ns: record.sent_ns,
        arrived_ns: record.arrived_ns,
        instances: record.instances.into_owned(),
    })
}

fn checksum(key: &[u8], payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(key);
    hasher.update(payload);
    hasher.finalize()
}
