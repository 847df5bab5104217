//! The byte format of keys and records, which the page of [`super`] describes.

use std::collections::BTreeMap;

use armarium_values::{Frame, Pose, Reference, Value, Vector, Wrench};
use sha2::{Digest, Sha256};

use crate::attributes::Attributes;
use crate::entity::{EntityId, Instance, Snapshot};
use crate::query::Pattern;

/// Bytes before a record's content: length, checksum, entity, version.
pub(super) const HEAD: usize = 24;
/// Values of at least this many bytes are stored once, by their content.
pub(super) const BLOB_FROM: usize = 16 << 10;
/// Deepest nesting that can be read; more than memory accepts.
const MAX_DEPTH: usize = 32;

/// What is wrong with the bytes of a key or a record.
#[derive(Debug, thiserror::Error)]
pub(super) enum RecordError {
    #[error("a key is no address: {key}")]
    Key { key: String },
    #[error("it ends too early")]
    Short,
    #[error("{0}")]
    Malformed(&'static str),
    #[error("version {version} of entity number {number} does not have its checksum")]
    Checksum { version: u64, number: u64 },
    #[error("entity number {number} has no address")]
    NoAddress { number: u64 },
    #[error("a value is of the unknown kind {kind}")]
    Kind { kind: u8 },
    #[error("a commit in the log, at byte {at} of it, is not whole, and those after it are not read")]
    Log { at: usize },
    #[error("a large value of it is missing")]
    NoBlob,
    #[error(transparent)]
    Storage(#[from] redb::StorageError),
    #[error("version {version} of `{id}`: {what}")]
    Content { version: u64, id: EntityId, what: Box<RecordError> },
    #[error("version {version} of `{id}` is too long")]
    Trailing { version: u64, id: EntityId },
}

/// The name of a blob: SHA-256 of its bytes.
pub(super) type Hash = [u8; 32];

pub(super) fn entity_key(id: &EntityId) -> Vec<u8> {
    let mut key = Vec::with_capacity(id.as_str().len() + 1);
    for name in [id.segment(), id.provider(), id.entity()] {
        key.extend_from_slice(name.as_bytes());
        key.push(0);
    }
    key
}

/// The range of keys of the entities that a pattern can match: the start is included, the end excluded.
pub(super) fn entity_range(pattern: &Pattern) -> (Vec<u8>, Option<Vec<u8>>) {
    let mut from = Vec::new();
    for name in [&pattern.segment, &pattern.provider, &pattern.entity] {
        let Some(name) = name.as_ref().filter(|name| !name.contains('*')) else { break };
        from.extend_from_slice(name.as_bytes());
        from.push(0);
    }
    let mut to = from.clone();
    let end = to.last_mut().map(|last| *last = 1);
    (from, end.map(|()| to))
}

/// The entity of a key in the table `entities`.
pub(super) fn entity_of(key: &[u8]) -> Result<EntityId, RecordError> {
    let unreadable = || RecordError::Key { key: key.escape_ascii().to_string() };
    let key = key.strip_suffix(&[0]).ok_or_else(unreadable)?;
    let text = std::str::from_utf8(key).map_err(|_| unreadable())?;
    match text.split('\0').collect::<Vec<_>>()[..] {
        [segment, provider, entity] => EntityId::new(segment, provider, entity).map_err(|_| unreadable()),
        _ => Err(unreadable()),
    }
}

/// Appends the record of a snapshot; the large values that it refers to go to `blobs`.
pub(super) fn append<'s>(
    to: &mut Vec<u8>,
    number: u64,
    snapshot: &'s Snapshot,
    blobs: &mut Vec<(Hash, &'s [u8])>,
) {
    let start = to.len();
    to.extend_from_slice(&[0; 8]);
    to.extend_from_slice(&number.to_le_bytes());
    to.extend_from_slice(&snapshot.version.to_le_bytes());
    for time in [snapshot.referenced_ns, snapshot.sent_ns, snapshot.arrived_ns] {
        to.extend_from_slice(&time.to_le_bytes());
    }
    append_instances(to, &snapshot.instances, blobs);
    seal(&mut to[start..]);
}

/// Appends the instances of a snapshot; the large values that they refer to go to `blobs`.
pub(super) fn append_instances<'s>(
    to: &mut Vec<u8>,
    instances: &'s [Instance],
    blobs: &mut Vec<(Hash, &'s [u8])>,
) {
    put_count(to, instances.len());
    for instance in instances {
        to.extend_from_slice(&instance.confidence.to_le_bytes());
        put_count(to, instance.attributes.len());
        for (name, value) in instance.attributes.iter() {
            put_bytes(to, name.as_bytes());
            put_value(to, value, blobs);
        }
        put_count(to, instance.covariance.len());
        for (name, rows) in &instance.covariance {
            put_bytes(to, name.as_bytes());
            put_count(to, rows.len());
            put_numbers(to, rows);
        }
    }
}

fn seal(record: &mut [u8]) {
    let length = u32::try_from(record.len()).unwrap_or(u32::MAX);
    let sum = crc32fast::hash(&record[8..]);
    record[..4].copy_from_slice(&length.to_le_bytes());
    record[4..8].copy_from_slice(&sum.to_le_bytes());
}

fn put_count(to: &mut Vec<u8>, count: usize) {
    let mut rest = count as u64;
    while rest >= 0x80 {
        to.push((rest as u8 & 0x7f) | 0x80);
        rest >>= 7;
    }
    to.push(rest as u8);
}

fn put_bytes(to: &mut Vec<u8>, bytes: &[u8]) {
    put_count(to, bytes.len());
    to.extend_from_slice(bytes);
}

fn put_numbers(to: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|n| to.extend_from_slice(&n.to_le_bytes()));
}

/// Appends the byte for a value's kind, after which its content comes.
fn kind(to: &mut Vec<u8>, kind: u8) -> &mut Vec<u8> {
    to.push(kind);
    to
}

fn put_value<'s>(to: &mut Vec<u8>, value: &'s Value, blobs: &mut Vec<(Hash, &'s [u8])>) {
    match value {
        Value::Null => to.push(0),
        Value::Bool(b) => to.push(1 + u8::from(*b)),
        Value::Int(i) => kind(to, 3).extend_from_slice(&i.to_le_bytes()),
        Value::Float(f) => put_numbers(kind(to, 4), &[*f]),
        Value::String(text) => put_bytes(kind(to, 5), text.as_bytes()),
        Value::Duration(s) => put_numbers(kind(to, 6), &[*s]),
        Value::Bytes(bytes) if bytes.len() >= BLOB_FROM => {
            let hash: Hash = Sha256::digest(bytes).into();
            kind(to, 7).extend_from_slice(&hash);
            blobs.push((hash, bytes));
        }
        Value::Bytes(bytes) => put_bytes(kind(to, 8), bytes),
        Value::List(items) => {
            put_count(kind(to, 9), items.len());
            items.iter().for_each(|item| put_value(to, item, blobs));
        }
        Value::Map(fields) => {
            put_count(kind(to, 10), fields.len());
            for (name, field) in fields {
                put_bytes(to, name.as_bytes());
                put_value(to, field, blobs);
            }
        }
        Value::Vector(v) => {
            put_bytes(kind(to, 11), v.frame.0.as_bytes());
            put_numbers(to, &v.components);
        }
        Value::Pose(p) => {
            put_bytes(kind(to, 12), p.frame.0.as_bytes());
            put_numbers(to, &p.position);
            put_numbers(to, &p.orientation);
        }
        Value::Wrench(w) => {
            put_bytes(kind(to, 13), w.frame.0.as_bytes());
            put_numbers(to, &w.force);
            put_numbers(to, &w.torque);
        }
        Value::Reference(r) => {
            put_bytes(kind(to, 14), r.kind.as_bytes());
            put_bytes(to, r.id.as_bytes());
        }
    }
}

/// The header before a record's content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RecordHeader {
    pub(super) length: usize,
    pub(super) number: u64,
    pub(super) version: u64,
}

/// The header of the record at the start of `bytes`, checked with its checksum.
pub(super) fn head(bytes: &[u8]) -> Result<RecordHeader, RecordError> {
    let mut cursor = ByteReader { rest: bytes };
    let (length, sum) = (cursor.u32()? as usize, cursor.u32()?);
    let (number, version) = (cursor.u64()?, cursor.u64()?);
    let content = bytes.get(8..length).ok_or(RecordError::Malformed("a record is longer than its place"))?;
    if crc32fast::hash(content) != sum {
        return Err(RecordError::Checksum { version, number });
    }
    if length < HEAD {
        Err(RecordError::Malformed("a chunk has an empty record"))
    } else {
        Ok(RecordHeader { length, number, version })
    }
}

/// The length that a record states, if another record can follow at that place.
fn length(bytes: &[u8]) -> Option<usize> {
    let length = ByteReader { rest: bytes }.u32().ok()? as usize;
    (HEAD..=bytes.len()).contains(&length).then_some(length)
}

/// The records of a chunk from a place on, one after the other: where each begins, its header, and its bytes. If the length of
/// a damaged record is damaged too, those after it cannot be found.
pub(super) struct Records<'c> {
    pub(super) chunk: &'c [u8],
    /// Where the next one begins.
    pub(super) at: usize,
}

impl<'c> Iterator for Records<'c> {
    type Item = (usize, Result<(RecordHeader, &'c [u8]), RecordError>);

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.chunk.get(self.at..).filter(|rest| !rest.is_empty())?;
        let (at, head) = (self.at, head(rest));
        let length = head.as_ref().map_or(length(rest).unwrap_or(rest.len()), |head| head.length);
        self.at += length;
        Some((at, head.map(|head| (head, &rest[..length]))))
    }
}

/// Looks up blobs.
pub(super) type Blobs<'b> = &'b dyn Fn(&Hash) -> Result<Vec<u8>, RecordError>;

/// The snapshot of a record whose [`head`] was read.
pub(super) fn decode(
    id: &EntityId,
    head: RecordHeader,
    bytes: &[u8],
    blobs: Blobs<'_>,
) -> Result<Snapshot, RecordError> {
    let content = bytes.get(HEAD..head.length).ok_or(RecordError::Short)?;
    let mut cursor = ByteReader { rest: content };
    let snapshot = cursor.snapshot(id, head.version, blobs);
    let (version, id) = (head.version, id.clone());
    match snapshot {
        Ok(snapshot) if cursor.rest.is_empty() => Ok(snapshot),
        Ok(_) => Err(RecordError::Trailing { version, id }),
        Err(what) => Err(RecordError::Content { version, id, what: Box::new(what) }),
    }
}

/// The referenced time and the arrival time of a record, ns.
pub(super) fn times(bytes: &[u8]) -> Result<(u64, u64), RecordError> {
    let mut cursor = ByteReader { rest: bytes.get(HEAD..).ok_or(RecordError::Short)? };
    let (referenced, _, arrived) = (cursor.u64()?, cursor.u64()?, cursor.u64()?);
    Ok((referenced, arrived))
}

/// Whether a record is a removal: it has no instances.
pub(super) fn is_removal(bytes: &[u8]) -> bool {
    bytes.get(HEAD + 24) == Some(&0)
}

/// The blobs that a record refers to.
pub(super) fn blobs_of(bytes: &[u8], head: RecordHeader) -> Result<Vec<Hash>, RecordError> {
    let found = std::cell::RefCell::new(Vec::new());
    let note = |hash: &Hash| {
        found.borrow_mut().push(*hash);
        Ok(Vec::new())
    };
    let nobody = EntityId::new("none", "none", "none").expect("three names");
    decode(&nobody, head, bytes, &note)?;
    Ok(found.into_inner())
}

pub(super) struct ByteReader<'b> {
    pub(super) rest: &'b [u8],
}

impl<'b> ByteReader<'b> {
    pub(super) fn take(&mut self, count: usize) -> Result<&'b [u8], RecordError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(RecordError::Short)?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], RecordError> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or(RecordError::Short)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub(super) fn u32(&mut self) -> Result<u32, RecordError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(super) fn u64(&mut self) -> Result<u64, RecordError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, RecordError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], RecordError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    /// A count of items that take at least one byte each.
    fn count(&mut self) -> Result<usize, RecordError> {
        let mut count = 0_u64;
        for shift in (0..64).step_by(7) {
            let [byte] = self.array()?;
            count |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                let count = usize::try_from(count).unwrap_or(usize::MAX);
                return if count <= self.rest.len() { Ok(count) } else { Err(RecordError::Short) };
            }
        }
        Err(RecordError::Malformed("a count does not end"))
    }

    fn text(&mut self) -> Result<&'b str, RecordError> {
        let count = self.count()?;
        std::str::from_utf8(self.take(count)?).map_err(|_| RecordError::Malformed("a text is not UTF-8"))
    }

    fn frame(&mut self) -> Result<Frame, RecordError> {
        Ok(Frame(self.text()?.to_owned()))
    }

    fn snapshot(&mut self, id: &EntityId, version: u64, blobs: Blobs<'_>) -> Result<Snapshot, RecordError> {
        let (referenced_ns, sent_ns, arrived_ns) = (self.u64()?, self.u64()?, self.u64()?);
        let count = self.count()?;
        let instances = (0..count).map(|_| self.instance(blobs)).collect::<Result<_, _>>()?;
        Ok(Snapshot { id: id.clone(), version, referenced_ns, sent_ns, arrived_ns, instances })
    }

    fn instance(&mut self, blobs: Blobs<'_>) -> Result<Instance, RecordError> {
        let confidence = self.f64()?;
        let count = self.count()?;
        let mut pairs = Vec::with_capacity(count);
        for _ in 0..count {
            pairs.push((self.text()?.into(), self.value(blobs, MAX_DEPTH)?));
        }
        let mut covariance = BTreeMap::new();
        for _ in 0..self.count()? {
            let name = self.text()?.to_owned();
            let rows = self.count()?;
            covariance.insert(name, (0..rows).map(|_| self.f64()).collect::<Result<_, _>>()?);
        }
        Ok(Instance { attributes: Attributes::from_pairs(pairs), confidence, covariance })
    }

    fn value(&mut self, blobs: Blobs<'_>, left: usize) -> Result<Value, RecordError> {
        let left = left.checked_sub(1).ok_or(RecordError::Malformed("it is nested too deep"))?;
        let [tag] = self.array()?;
        Ok(match tag {
            0 => Value::Null,
            1 => Value::Bool(false),
            2 => Value::Bool(true),
            3 => Value::Int(i64::from_le_bytes(self.array()?)),
            4 => Value::Float(self.f64()?),
            5 => Value::String(self.text()?.to_owned()),
            6 => Value::Duration(self.f64()?),
            7 => Value::Bytes(blobs(&self.array()?)?),
            8 => {
                let count = self.count()?;
                Value::Bytes(self.take(count)?.to_vec())
            }
            9 => {
                let count = self.count()?;
                Value::List((0..count).map(|_| self.value(blobs, left)).collect::<Result<_, _>>()?)
            }
            10 => {
                let count = self.count()?;
                let field = |_| Ok((self.text()?.to_owned(), self.value(blobs, left)?));
                Value::Map((0..count).map(field).collect::<Result<_, RecordError>>()?)
            }
            11 => Value::Vector(Vector { frame: self.frame()?, components: self.f64s()? }),
            12 => {
                Value::Pose(Pose { frame: self.frame()?, position: self.f64s()?, orientation: self.f64s()? })
            }
            13 => Value::Wrench(Wrench { frame: self.frame()?, force: self.f64s()?, torque: self.f64s()? }),
            14 => Value::Reference(Reference { kind: self.text()?.to_owned(), id: self.text()?.to_owned() }),
            other => return Err(RecordError::Kind { kind: other }),
        })
    }
}
