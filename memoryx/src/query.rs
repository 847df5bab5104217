//! What can be asked of a memory, and the one function that answers it from an entity's history.
//!
//! Every memory selects with [`Query::select`], so that in process, on disk and over Zenoh a query means the same.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::entity::{EntityId, Snapshot};

/// Which entities: each part is a name, or any where none is given.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(default)]
pub struct Pattern {
    /// The core segment.
    pub segment: Option<String>,
    /// The provider segment.
    pub provider: Option<String>,
    /// The entity's own name.
    pub entity: Option<String>,
}

/// Which of an entity's snapshots. Times are the ones that the data speak of (`referenced_ns`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Times {
    /// The newest version, unless the entity is gone.
    #[default]
    Latest,
    /// All that the memory still has, also that the entity was gone.
    All,
    /// From the first time to the second, both included, ns; also that the entity was gone.
    Between(u64, u64),
    /// What held at this time, ns: the last at or before it, unless the entity was gone then.
    At(u64),
    /// The last strictly before this time, ns, unless the entity was gone then.
    Before(u64),
}

/// A question to a memory.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Query {
    /// Which entities.
    pub pattern: Pattern,
    /// Which of their snapshots.
    pub times: Times,
    /// At most this many of each entity, the newest versions.
    pub limit: Option<usize>,
}

impl Pattern {
    /// Every entity.
    #[must_use]
    pub fn any() -> Self {
        Self::default()
    }

    /// Every entity of a core segment.
    #[must_use]
    pub fn segment(segment: &str) -> Self {
        Self { segment: Some(segment.into()), ..Self::default() }
    }

    /// One entity.
    #[must_use]
    pub fn entity(id: &EntityId) -> Self {
        Self {
            segment: Some(id.segment().into()),
            provider: Some(id.provider().into()),
            entity: Some(id.entity().into()),
        }
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

    /// Whether an address fits.
    #[must_use]
    pub fn matches(&self, id: &EntityId) -> bool {
        let fits = |wanted: &Option<String>, name: &str| wanted.as_ref().is_none_or(|w| w == name);
        fits(&self.segment, id.segment())
            && fits(&self.provider, id.provider())
            && fits(&self.entity, id.entity())
    }
}

impl Query {
    /// The newest snapshots of what a pattern fits.
    #[must_use]
    pub fn latest(pattern: Pattern) -> Self {
        Self { pattern, ..Self::default() }
    }

    /// Everything the memory has of what a pattern fits.
    #[must_use]
    pub fn history(pattern: Pattern) -> Self {
        Self { pattern, times: Times::All, limit: None }
    }

    /// The same question about other times.
    #[must_use]
    pub fn times(mut self, times: Times) -> Self {
        self.times = times;
        self
    }

    /// The same question, for at most `n` snapshots of each entity.
    #[must_use]
    pub fn limit(mut self, n: usize) -> Self {
        self.limit = Some(n);
        self
    }

    /// What the question takes of one entity's snapshots, given and returned in order of version. The pattern is
    /// the caller's to check.
    #[must_use]
    pub fn select(&self, history: impl DoubleEndedIterator<Item = Arc<Snapshot>>) -> Vec<Arc<Snapshot>> {
        let limit = self.limit.unwrap_or(usize::MAX);
        let newest = |history: &mut dyn Iterator<Item = Arc<Snapshot>>| {
            let mut kept: Vec<_> = history.take(limit).collect();
            kept.reverse();
            kept
        };
        let mut history = history;
        match self.times {
            _ if limit == 0 => Vec::new(),
            Times::Latest => history.next_back().filter(|s| !s.is_removed()).into_iter().collect(),
            Times::All => newest(&mut history.rev()),
            Times::Between(from, to) => {
                newest(&mut history.rev().filter(|s| (from..=to).contains(&s.referenced_ns)))
            }
            Times::At(time) => held(history, |s| s.referenced_ns <= time),
            Times::Before(time) => held(history, |s| s.referenced_ns < time),
        }
    }
}

/// The snapshot with the latest referenced time among those that count, unless it says that the entity is gone.
fn held(
    history: impl Iterator<Item = Arc<Snapshot>>,
    counts: impl Fn(&Snapshot) -> bool,
) -> Vec<Arc<Snapshot>> {
    history
        .filter(|s| counts(s))
        .max_by_key(|s| (s.referenced_ns, s.version))
        .filter(|s| !s.is_removed())
        .into_iter()
        .collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::entity::Instance;

    /// Versions 1.. with these referenced times; a negative time says gone at that time.
    fn history(times: &[i64]) -> Vec<Arc<Snapshot>> {
        let snapshot = |(i, t): (usize, &i64)| {
            Arc::new(Snapshot {
                id: "S/p/e".parse().unwrap(),
                version: i as u64 + 1,
                referenced_ns: t.unsigned_abs(),
                sent_ns: 0,
                arrived_ns: 0,
                instances: if *t < 0 { vec![] } else { vec![Instance::new(BTreeMap::new())] },
            })
        };
        times.iter().enumerate().map(snapshot).collect()
    }

    #[test]
    fn a_question_takes_the_versions_it_asks_for() {
        let cases: &[(&[i64], Query, &[u64])] = &[
            (&[10, 20, 30], Query::default(), &[3]),
            (&[10, 20, -30], Query::default(), &[]),
            (&[10, 20, -30], Query::default().times(Times::All), &[1, 2, 3]),
            (&[10, 20, 30], Query::default().times(Times::All).limit(2), &[2, 3]),
            (&[10, 20, 30], Query::default().times(Times::All).limit(0), &[]),
            (&[10, 20, 30, 40], Query::default().times(Times::Between(20, 30)), &[2, 3]),
            (&[10, 20, 30, 40], Query::default().times(Times::Between(10, 40)).limit(1), &[4]),
            (&[10, 20, 30], Query::default().times(Times::At(20)), &[2]),
            (&[10, 20, 30], Query::default().times(Times::At(9)), &[]),
            (&[10, 20, 30], Query::default().times(Times::Before(20)), &[1]),
            (&[10, -20, 30], Query::default().times(Times::At(25)), &[]),
            (&[10, 30, 20], Query::default().times(Times::At(100)), &[2]),
            (&[10, 10], Query::default().times(Times::At(10)), &[2]),
            (&[], Query::default(), &[]),
        ];
        for (times, query, expected) in cases {
            let taken: Vec<u64> =
                query.select(history(times).into_iter()).iter().map(|s| s.version).collect();
            assert_eq!(&taken, expected, "{query:?} of {times:?}");
        }
    }
}
