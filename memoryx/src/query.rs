//! Queries to a memory. This file does not answer them: every memory selects with [`CheckedQuery`], so that a query
//! means the same in process, on disk and over Zenoh.

use std::sync::Arc;

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::place::SpatialRegion;
use crate::time_of::TimeOf;

/// Which entities: each part is a name, a name with `*` for any characters, or `None` for any.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pattern {
    /// The core segment.
    pub segment: Option<String>,
    /// The provider segment.
    pub provider: Option<String>,
    /// The entity's own name.
    pub entity: Option<String>,
}

/// Which of an entity's snapshots. Times are those that the data describe (`referenced_ns`), and of one clock ([`TimeOf`]):
/// where an entity that matches is of the other one, the query is refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Times {
    /// The newest version, unless it is a removal.
    #[default]
    Latest,
    /// All that the memory still has, removals included.
    All,
    /// From the first time to the second, both included, ns; removals included.
    Between(u64, u64),
    /// The state at this time, ns: the last snapshot at or before it, unless that is a removal.
    At(u64),
    /// The last snapshot strictly before this time, ns, unless that is a removal.
    Before(u64),
    /// From the first position to the second in the history that is left, both included: 0 is the oldest, -1 the
    /// newest.
    Index(i64, i64),
    /// From the first version to the second, both included; removals included.
    Versions(u64, u64),
}

impl Times {
    /// The clock of the times that it names, if it names any; refused when they are of two.
    pub(crate) fn clock(self) -> Result<Option<TimeOf>, MemoryError> {
        match self {
            Self::At(time) | Self::Before(time) => Ok(Some(TimeOf::of(time))),
            // An end that is open is of either.
            Self::Between(0, u64::MAX) => Ok(None),
            Self::Between(0, time) | Self::Between(time, u64::MAX) => Ok(Some(TimeOf::of(time))),
            Self::Between(from, to) if TimeOf::of(from) != TimeOf::of(to) => {
                let (one, other) = (TimeOf::of(from), TimeOf::of(to));
                let what = format!("{from} ns is {one}, {to} ns is {other}: name times of one clock");
                Err(MemoryError::Query { what })
            }
            Self::Between(from, _) => Ok(Some(TimeOf::of(from))),
            Self::Latest | Self::All | Self::Index(..) | Self::Versions(..) => Ok(None),
        }
    }
}

/// A position in the order of an answer.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Cursor {
    /// The entity.
    pub id: EntityId,
    /// The version.
    pub version: u64,
}

/// A query to a memory. The conditions after `pattern` and `times` are applied in the order of the fields.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Query {
    /// Which entities.
    pub pattern: Pattern,
    /// Which of their snapshots.
    pub times: Times,
    /// Only snapshots that arrived in this memory at this time or later, ns.
    pub arrived_since: Option<u64>,
    /// Only snapshots for which a CEL expression is true; see [`Filter`](crate::Filter).
    pub filter: Option<String>,
    /// Only snapshots in this region.
    pub region: Option<SpatialRegion>,
    /// At most this many snapshots of each entity, the newest versions.
    pub limit: Option<usize>,
    /// Only snapshots after this position in the answer.
    pub after: Option<Cursor>,
    /// At most this many snapshots in all, the first ones.
    pub most: Option<usize>,
    /// At most about this many bytes of snapshots in all; the snapshot that reaches the limit is the last.
    pub most_bytes: Option<u64>,
    /// Whether the times that select one snapshot (`Latest`, `At`, `Before`) may return a removal.
    pub removed: bool,
    /// Whether to include long-term memory, where working memory has forgotten.
    pub long_term: bool,
}

impl Cursor {
    /// The position of a snapshot.
    pub fn after(snapshot: &Snapshot) -> Self {
        Self { id: snapshot.id.clone(), version: snapshot.version }
    }

    /// The position behind all snapshots of an entity.
    pub fn behind(id: &EntityId) -> Self {
        Self { id: id.clone(), version: u64::MAX }
    }
}

impl Pattern {
    /// Every entity.
    pub fn any() -> Self {
        Self::default()
    }

    /// Every entity of a core segment.
    pub fn segment(segment: &str) -> Self {
        Self { segment: Some(segment.into()), ..Self::default() }
    }

    /// One entity.
    pub fn entity(id: &EntityId) -> Self {
        let part = |name: &str| Some(name.into());
        Self { segment: part(id.segment()), provider: part(id.provider()), entity: part(id.entity()) }
    }

    /// The same pattern in one provider segment.
    #[must_use]
    pub fn of_provider(mut self, provider: &str) -> Self {
        self.provider = Some(provider.into());
        self
    }

    /// The same pattern with one entity name.
    #[must_use]
    pub fn named(mut self, entity: &str) -> Self {
        self.entity = Some(entity.into());
        self
    }

    /// The one entity that it can match, if it names one.
    pub fn exact(&self) -> Option<EntityId> {
        EntityId::new(self.exact_segment()?, self.provider.as_ref()?, self.entity.as_ref()?).ok()
    }

    /// The one core segment that it can match, if it names one.
    pub fn exact_segment(&self) -> Option<&str> {
        self.segment.as_deref().filter(|name| !name.contains('*'))
    }

    /// Whether an address matches.
    pub fn matches(&self, id: &EntityId) -> bool {
        let fits = |wanted: &Option<String>, name: &str| {
            wanted.as_ref().is_none_or(|w| if w.contains('*') { fits_stars(w, name) } else { w == name })
        };
        fits(&self.segment, id.segment())
            && fits(&self.provider, id.provider())
            && fits(&self.entity, id.entity())
    }
}

impl Query {
    /// The newest snapshots of the entities that match.
    pub fn latest(pattern: Pattern) -> Self {
        Self { pattern, ..Self::default() }
    }

    /// All snapshots that the memory has of the entities that match.
    pub fn history(pattern: Pattern) -> Self {
        Self { pattern, times: Times::All, ..Self::default() }
    }

    /// The same query for other times.
    #[must_use]
    pub fn times(mut self, times: Times) -> Self {
        self.times = times;
        self
    }

    /// The same query, for at most `n` snapshots of each entity.
    #[must_use]
    pub fn limit(mut self, n: usize) -> Self {
        self.limit = Some(n);
        self
    }

    /// The same query, for snapshots for which a CEL expression is true.
    #[must_use]
    pub fn filter(mut self, expression: &str) -> Self {
        self.filter = Some(expression.into());
        self
    }

    /// The same query, for snapshots in a region.
    #[must_use]
    pub fn region(mut self, region: SpatialRegion) -> Self {
        self.region = Some(region);
        self
    }

    /// The same query, to working memory and long-term memory together.
    #[must_use]
    pub fn with_long_term(mut self) -> Self {
        self.long_term = true;
        self
    }

    /// Whether it asks for the nearest entities; its answer is ordered by distance.
    pub fn is_nearest(&self) -> bool {
        matches!(self.region, Some(SpatialRegion::Nearest { .. }))
    }

    /// Whether an answer has reached the query's bounds, so that there may be more: a query with [`Self::after`] its
    /// last snapshot returns the rest.
    pub fn is_filled_by(&self, answer: &[Arc<Snapshot>]) -> bool {
        let bytes = || answer.iter().map(|snapshot| snapshot.bytes()).sum::<u64>();
        !self.is_nearest()
            && (self.most.is_some_and(|most| answer.len() >= most)
                || self.most_bytes.is_some_and(|most| !answer.is_empty() && bytes() >= most))
    }
}

/// Whether a name matches a pattern with `*` for any characters. Time is linear in both.
fn fits_stars(pattern: &str, name: &str) -> bool {
    let mut pieces = pattern.split('*');
    let Some(mut rest) = name.strip_prefix(pieces.next().unwrap_or_default()) else { return false };
    let mut pieces: Vec<&str> = pieces.collect();
    let last = pieces.pop().unwrap_or_default();
    for piece in pieces {
        match rest.split_once(piece) {
            Some((_, after)) => rest = after,
            None => return false,
        }
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_stand_for_any_characters() {
        let fits = |pattern: &str, name: &str| {
            Pattern::any().named(pattern).matches(&EntityId::new("S", "p", name).unwrap())
        };
        for (pattern, name, expected) in [
            ("cup", "cup", true),
            ("cup", "cup1", false),
            ("cup*", "cup1", true),
            ("*1", "cup1", true),
            ("c*p*", "cup1", true),
            ("c*p", "cup1", false),
            ("*", "x", true),
            ("*ab*ab", "ab", false),
            ("a*a", "a", false),
        ] {
            assert_eq!(fits(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn questions_that_are_none_are_refused() {
        let region = |radius: f64| SpatialRegion::Within { frame: "root".into(), of: [0.0; 3], radius };
        for bad in [
            Query::default().filter("1 +"),
            Query::default().region(region(f64::NAN)),
            Query::default().region(region(-1.0)),
        ] {
            assert!(matches!(bad.check(), Err(MemoryError::Query { .. })), "{bad:?}");
        }
    }
}
