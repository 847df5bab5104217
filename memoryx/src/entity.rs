//! The memory model after MemoryX and its successor ArMem: memory / core segment / provider segment / entity /
//! snapshot / instance. This file says what is stored and how it is committed, not where it is stored.
//!
//! A snapshot without instances is a removal: histories and subscribers see it, `latest` and `segment` do not. A
//! later commit brings the entity back with the next version.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::str::FromStr;
use std::sync::Arc;

use armarium_values::{Reference, Value};

use crate::attributes::Attributes;
use crate::error::MemoryError;
use crate::time_of::TimeOf;

/// Longest name in an address, bytes.
const MAX_NAME_BYTES: usize = 200;

/// The address of an entity: `core segment / provider / entity`, each a name without `/`, `*`, `#`, `?`, `$`.
/// Ordered by core segment, then provider, then entity. Cheap to clone.
#[derive(Clone, PartialEq, Eq)]
pub struct EntityId {
    path: Arc<str>,
    provider_at: u16,
    entity_at: u16,
}

/// One hypothesis about an entity at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    /// Attributes by name.
    pub attributes: Attributes,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Covariances of the attributes that have one, row by row, in the attribute's unit squared: one number for a
    /// number, 3x3 for a vector or a point, 6x6 for a pose (position, then rotation vector, rad).
    pub covariance: BTreeMap<String, Vec<f64>>,
}

/// The state of an entity at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The entity.
    pub id: EntityId,
    /// Counts the entity's snapshots from 1.
    pub version: u64,
    /// The time that the data describe, ns, of the clock that [`Self::clock`] names.
    pub referenced_ns: u64,
    /// When it was sent, ns.
    pub sent_ns: u64,
    /// When this memory received it, ns.
    pub arrived_ns: u64,
    /// One or more hypotheses, the highest confidence first; empty when the entity was removed.
    pub instances: Vec<Instance>,
}

/// An update of one entity.
#[derive(Clone, Debug, PartialEq)]
pub struct Commit {
    /// The entity.
    pub id: EntityId,
    /// The time that the data describe, ns.
    pub referenced_ns: u64,
    /// The new state; empty removes the entity.
    pub instances: Vec<Instance>,
    /// When given, the commit is refused unless this is the entity's newest version (0: the entity must not exist).
    pub expected_version: Option<u64>,
}

impl EntityId {
    /// An address.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when a part is not a valid name.
    pub fn new(segment: &str, provider: &str, entity: &str) -> Result<Self, MemoryError> {
        [segment, provider, entity].into_iter().try_for_each(check_name)?;
        Ok(Self::of_path(format!("{segment}/{provider}/{entity}").into(), segment.len(), provider.len()))
    }

    /// The address of a path of checked names, given the lengths of the first two.
    fn of_path(path: Arc<str>, segment: usize, provider: usize) -> Self {
        let position = |n: usize| u16::try_from(n).expect("three names of at most 200 bytes");
        Self { path, provider_at: position(segment + 1), entity_at: position(segment + provider + 2) }
    }

    /// The core segment.
    pub fn segment(&self) -> &str {
        &self.path[..usize::from(self.provider_at) - 1]
    }

    /// The provider segment.
    pub fn provider(&self) -> &str {
        &self.path[usize::from(self.provider_at)..usize::from(self.entity_at) - 1]
    }

    /// The entity's own name.
    pub fn entity(&self) -> &str {
        &self.path[usize::from(self.entity_at)..]
    }

    /// The whole address, `segment/provider/entity`.
    pub fn as_str(&self) -> &str {
        &self.path
    }

    /// A reference to the entity for charts; `kind` is for instance `Motion` or `Object`.
    pub fn reference(&self, kind: &str) -> Reference {
        Reference { kind: kind.into(), id: self.as_str().into() }
    }
}

/// Checks that `name` can be one part of an address.
///
/// # Errors
/// [`MemoryError::Name`] when it cannot.
pub fn check_name(name: &str) -> Result<(), MemoryError> {
    Ok(armarium_bus::keys::check_name(name)?)
}

impl Hash for EntityId {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.path.hash(state);
    }
}

impl Ord for EntityId {
    fn cmp(&self, other: &Self) -> Ordering {
        // When the parts have equal lengths, the slashes are at the same positions and need no comparison.
        if (self.provider_at, self.entity_at) == (other.provider_at, other.entity_at) {
            return self.path.cmp(&other.path);
        }
        (self.segment(), self.provider(), self.entity()).cmp(&(
            other.segment(),
            other.provider(),
            other.entity(),
        ))
    }
}

impl PartialOrd for EntityId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl FromStr for EntityId {
    type Err = MemoryError;

    fn from_str(path: &str) -> Result<Self, MemoryError> {
        // A third slash would belong to the entity's name, where it is not allowed.
        let mut names = path.splitn(3, '/');
        let (Some(segment), Some(provider), Some(entity)) = (names.next(), names.next(), names.next()) else {
            return Err(MemoryError::Name { name: path.chars().take(MAX_NAME_BYTES).collect() });
        };
        [segment, provider, entity].into_iter().try_for_each(check_name)?;
        Ok(Self::of_path(path.into(), segment.len(), provider.len()))
    }
}

impl fmt::Display for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.path)
    }
}

impl fmt::Debug for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.path)
    }
}

impl Instance {
    /// An instance with confidence 1.
    pub fn new(attributes: impl Into<Attributes>) -> Self {
        Self { attributes: attributes.into(), confidence: 1.0, covariance: BTreeMap::new() }
    }

    /// The same instance with another confidence, 0 to 1.
    #[must_use]
    pub fn with_confidence(mut self, confidence: f64) -> Self {
        self.confidence = confidence;
        self
    }

    /// The same instance with the covariance of one of its attributes, row by row.
    #[must_use]
    pub fn with_covariance(mut self, attribute: &str, covariance: Vec<f64>) -> Self {
        self.covariance.insert(attribute.into(), covariance);
        self
    }
}

impl Commit {
    /// One hypothesis with confidence 1 and no expected version.
    pub fn new(id: EntityId, referenced_ns: u64, attributes: impl Into<Attributes>) -> Self {
        Self::of(id, referenced_ns, vec![Instance::new(attributes)])
    }

    /// These hypotheses and no expected version.
    pub fn of(id: EntityId, referenced_ns: u64, instances: Vec<Instance>) -> Self {
        Self { id, referenced_ns, instances, expected_version: None }
    }

    /// Removes the entity, as of `referenced_ns`.
    pub fn removal(id: EntityId, referenced_ns: u64) -> Self {
        Self::of(id, referenced_ns, Vec::new())
    }

    /// The same commit, refused unless `version` is the entity's newest (0: the entity must not exist).
    #[must_use]
    pub fn expecting(mut self, version: u64) -> Self {
        self.expected_version = Some(version);
        self
    }

    /// The same commit with another confidence, 0 to 1, for its first hypothesis.
    #[must_use]
    pub fn with_confidence(mut self, confidence: f64) -> Self {
        if let Some(instance) = self.instances.first_mut() {
            instance.confidence = confidence;
        }
        self
    }
}

impl Snapshot {
    /// The hypothesis with the highest confidence; `None` for a removal.
    pub fn instance(&self) -> Option<&Instance> {
        self.instances.first()
    }

    /// An attribute of the hypothesis with the highest confidence.
    pub fn attribute(&self, name: &str) -> Option<&Value> {
        self.instance()?.attributes.get(name)
    }

    /// When the memory removes the entity, ns by its own clock: the attribute `expires_ns`, an integer.
    pub fn expires_ns(&self) -> Option<u64> {
        u64::try_from(self.attribute("expires_ns")?.as_int()?).ok()
    }

    /// Of which clock the time is that its data describe.
    pub fn clock(&self) -> TimeOf {
        TimeOf::of(self.referenced_ns)
    }

    /// Whether this snapshot is a removal.
    pub fn is_removed(&self) -> bool {
        self.instances.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_made_of_three_checked_names() {
        let id = EntityId::new("Motions", "alice", "wipe-1").unwrap();
        assert_eq!((id.segment(), id.provider(), id.entity()), ("Motions", "alice", "wipe-1"));
        assert_eq!("Motions/alice/wipe-1".parse::<EntityId>().unwrap(), id);
        for bad in ["", "a/b", "a*", "#", "a?b", "$x", "@x", "line\nbreak", &"x".repeat(201)] {
            assert!(EntityId::new("Motions", bad, "e").is_err(), "{bad:?} is refused");
        }
        for bad in ["", "a/b", "a/b/c/d", "a//c"] {
            assert!(bad.parse::<EntityId>().is_err(), "{bad:?} is refused");
        }
    }

    #[test]
    fn addresses_are_ordered_by_their_parts() {
        let ids = ["a/z/z", "a-b/a/a", "a/b/c", "a/b!/c"].map(|p| p.parse::<EntityId>().unwrap());
        let mut sorted = ids.to_vec();
        sorted.sort();
        let sorted: Vec<&str> = sorted.iter().map(EntityId::as_str).collect();
        assert_eq!(sorted, ["a/b/c", "a/b!/c", "a/z/z", "a-b/a/a"]);
    }
}
