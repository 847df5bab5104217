//! What can be asked of a memory, and the functions that answer it from entities' histories.
//!
//! Every memory selects with [`Asked`], so that in process, on disk and over Zenoh a query means the same.

use std::cmp::Ordering;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::filter::Filter;
use crate::place::{Region, distance, place_of};

/// Which entities: each part is a name, a name with `*` for any characters, or any where none is given.
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
    /// From the first place to the second in what the memory still has, both included: 0 is the oldest, -1 the newest.
    Index(i64, i64),
    /// From the first version to the second, both included; also that the entity was gone.
    Versions(u64, u64),
}

/// A place in the order of an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cursor {
    /// The entity.
    pub id: EntityId,
    /// The version.
    pub version: u64,
}

/// A question to a memory. What it asks for besides the pattern and the times is applied in the order of the fields.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Query {
    /// Which entities.
    pub pattern: Pattern,
    /// Which of their snapshots.
    pub times: Times,
    /// Only what arrived in this memory at this time or later, ns.
    pub arrived_since: Option<u64>,
    /// Only what a CEL expression is true for; see [`Filter`].
    pub filter: Option<String>,
    /// Only what is there.
    pub region: Option<Region>,
    /// At most this many of each entity, the newest versions.
    pub limit: Option<usize>,
    /// Only what comes after this in the answer.
    pub after: Option<Cursor>,
    /// At most this many snapshots in all, the first ones.
    pub most: Option<usize>,
    /// Whether to look into long-term memory too, where working memory has forgotten.
    pub long_term: bool,
}

/// A question that was checked.
#[derive(Clone, Debug)]
pub struct Asked<'q> {
    query: &'q Query,
    filter: Option<Filter>,
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

    /// The one entity that it can fit, if it names one.
    #[must_use]
    pub fn exact(&self) -> Option<EntityId> {
        let (Some(s), Some(p), Some(e)) = (self.exact_segment(), &self.provider, &self.entity) else {
            return None;
        };
        EntityId::new(s, p, e).ok()
    }

    /// The one core segment that it can fit, if it names one.
    #[must_use]
    pub fn exact_segment(&self) -> Option<&str> {
        self.segment.as_deref().filter(|name| !name.contains('*'))
    }

    /// Whether an address fits.
    #[must_use]
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
    /// The newest snapshots of what a pattern fits.
    #[must_use]
    pub fn latest(pattern: Pattern) -> Self {
        Self { pattern, ..Self::default() }
    }

    /// Everything the memory has of what a pattern fits.
    #[must_use]
    pub fn history(pattern: Pattern) -> Self {
        Self { pattern, times: Times::All, ..Self::default() }
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

    /// The same question, for what a CEL expression is true for.
    #[must_use]
    pub fn filter(mut self, expression: &str) -> Self {
        self.filter = Some(expression.into());
        self
    }

    /// The same question, for what is in a region.
    #[must_use]
    pub fn region(mut self, region: Region) -> Self {
        self.region = Some(region);
        self
    }

    /// The same question, to working memory and long-term memory together.
    #[must_use]
    pub fn with_long_term(mut self) -> Self {
        self.long_term = true;
        self
    }

    /// Whether it asks for the nearest ones, which are ordered by distance.
    #[must_use]
    pub fn is_nearest(&self) -> bool {
        matches!(self.region, Some(Region::Nearest { .. }))
    }

    /// Checks the question.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when its expression or region is none.
    pub fn ask(&self) -> Result<Asked<'_>, MemoryError> {
        self.region.as_ref().map_or(Ok(()), Region::check)?;
        let filter = self.filter.as_deref().map(Filter::compile).transpose()?;
        Ok(Asked { query: self, filter })
    }
}

impl Asked<'_> {
    /// The question.
    #[must_use]
    pub fn query(&self) -> &Query {
        self.query
    }

    /// Whether an entity can be in the answer.
    #[must_use]
    pub fn wants(&self, id: &EntityId) -> bool {
        self.query.pattern.matches(id) && self.query.after.as_ref().is_none_or(|after| after.id <= *id)
    }

    /// Whether which snapshots it takes follows from the times alone.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.filter.is_none()
            && self.query.region.is_none()
            && self.query.arrived_since.is_none()
            && self.query.after.is_none()
    }

    /// What the question takes of one wanted entity's snapshots, given and returned in order of version.
    #[must_use]
    pub fn select(&self, history: impl DoubleEndedIterator<Item = Arc<Snapshot>>) -> Vec<Arc<Snapshot>> {
        let query = self.query;
        let limit = query.limit.unwrap_or(usize::MAX);
        let mut history = history;
        let newest = |history: &mut dyn Iterator<Item = Arc<Snapshot>>| {
            let mut kept: Vec<_> = history.filter(|s| self.fits(s)).take(limit).collect();
            kept.reverse();
            kept
        };
        match query.times {
            _ if limit == 0 => Vec::new(),
            Times::Latest => {
                let newest = history.next_back().filter(|s| !s.is_removed() && self.fits(s));
                newest.into_iter().collect()
            }
            Times::All => newest(&mut history.rev()),
            Times::Between(from, to) => {
                newest(&mut history.rev().filter(|s| (from..=to).contains(&s.referenced_ns)))
            }
            Times::Versions(from, to) => {
                newest(&mut history.rev().filter(|s| (from..=to).contains(&s.version)))
            }
            Times::Index(from, to) => {
                let held: Vec<_> = history.collect();
                newest(&mut held.get(places(from, to, held.len())).unwrap_or_default().iter().rev().cloned())
            }
            Times::At(time) => self.held(history, |s| s.referenced_ns <= time),
            Times::Before(time) => self.held(history, |s| s.referenced_ns < time),
        }
    }

    /// [`Self::select`] of snapshots whose times were chosen before.
    pub(crate) fn select_of(&self, chosen: Vec<Arc<Snapshot>>, times: Times) -> Vec<Arc<Snapshot>> {
        let query = Query { times, ..self.query.clone() };
        Asked { query: &query, filter: self.filter.clone() }.select(chosen.into_iter())
    }

    /// Whether as much was found as is asked for, so that later entities need not be looked at.
    #[must_use]
    pub fn is_full(&self, found: usize) -> bool {
        !self.query.is_nearest() && self.query.most.is_some_and(|most| found >= most)
    }

    /// Makes the answer of what was taken of all entities, in order of address.
    #[must_use]
    pub fn finish(&self, mut found: Vec<Arc<Snapshot>>) -> Vec<Arc<Snapshot>> {
        if let Some(Region::Nearest { to, count, .. }) = &self.query.region {
            let far = |s: &Snapshot| place_of(s).map_or(f64::INFINITY, |(_, place)| distance(to, &place));
            let mut placed: Vec<(f64, Arc<Snapshot>)> = found.into_iter().map(|s| (far(&s), s)).collect();
            // Those equally far keep the order of their addresses.
            placed.sort_by(|a, b| a.0.total_cmp(&b.0));
            placed.truncate(*count);
            found = placed.into_iter().map(|(_, s)| s).collect();
        }
        found.truncate(self.query.most.unwrap_or(usize::MAX));
        found
    }

    fn fits(&self, snapshot: &Snapshot) -> bool {
        let query = self.query;
        query.arrived_since.is_none_or(|since| snapshot.arrived_ns >= since)
            && query.after.as_ref().is_none_or(|after| {
                (snapshot.id.cmp(&after.id)).then(snapshot.version.cmp(&after.version)) == Ordering::Greater
            })
            && query.region.as_ref().is_none_or(|region| region.holds(snapshot))
            && self.filter.as_ref().is_none_or(|filter| filter.fits(snapshot))
    }

    /// The snapshot with the latest referenced time among those that count, unless it says that the entity is gone.
    fn held(
        &self,
        history: impl Iterator<Item = Arc<Snapshot>>,
        counts: impl Fn(&Snapshot) -> bool,
    ) -> Vec<Arc<Snapshot>> {
        let held = history.filter(|s| counts(s)).max_by_key(|s| (s.referenced_ns, s.version));
        held.filter(|s| !s.is_removed() && self.fits(s)).into_iter().collect()
    }
}

/// The places from one to another among `count`, negative ones counted from the end.
pub(crate) fn places(from: i64, to: i64, count: usize) -> std::ops::Range<usize> {
    let count = i64::try_from(count).unwrap_or(i64::MAX);
    let place = |i: i64| if i < 0 { count.saturating_add(i) } else { i };
    let (from, to) = (place(from).max(0), place(to).min(count - 1));
    if from > to {
        return 0..0;
    }
    let index = |i: i64| usize::try_from(i).unwrap_or(0);
    index(from)..index(to) + 1
}

/// Whether a name fits a pattern with `*` for any characters, in time linear in both.
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
            (&[10, 20, 30], Query::default().times(Times::Index(0, 0)), &[1]),
            (&[10, 20, 30], Query::default().times(Times::Index(-2, -1)), &[2, 3]),
            (&[10, 20, 30], Query::default().times(Times::Index(1, 99)).limit(1), &[3]),
            (&[10, 20, 30], Query::default().times(Times::Index(5, 9)), &[]),
            (&[10, 20, 30], Query::default().times(Times::Versions(2, 9)), &[2, 3]),
            (&[10, 20, 30], Query::history(Pattern::any()).filter("version != 2"), &[1, 3]),
            (&[10, 20, 30], Query::history(Pattern::any()).filter("version < 3").limit(1), &[2]),
        ];
        for (times, query, expected) in cases {
            let taken: Vec<u64> =
                query.ask().unwrap().select(history(times).into_iter()).iter().map(|s| s.version).collect();
            assert_eq!(&taken, expected, "{query:?} of {times:?}");
        }
    }

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
        let region = |radius: f64| Region::Within { frame: "root".into(), of: [0.0; 3], radius };
        for bad in [
            Query::default().filter("1 +"),
            Query::default().region(region(f64::NAN)),
            Query::default().region(region(-1.0)),
        ] {
            assert!(matches!(bad.ask(), Err(MemoryError::Query { .. })), "{bad:?}");
        }
    }
}
