//! A question that was checked, put to the snapshots of one entity after the other: the one function by which every
//! memory answers. Finds no entities; those are each memory's own.

use std::cmp::Ordering;
use std::sync::Arc;

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::filter::Filter;
use crate::place::{Region, distance, place_of};
use crate::query::{Query, Times};

/// Snapshots, and bytes of them, among which the nearest are looked for before the others are forgotten.
const LEFT: usize = 1024;
const LEFT_BYTES: u64 = 16 << 20;

/// A question that was checked.
#[derive(Clone, Debug)]
pub struct CheckedQuery<'q> {
    pub(crate) query: &'q Query,
    pub(crate) filter: Option<Filter>,
}

impl Query {
    /// Checks the question.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when its expression or region is none.
    pub fn check(&self) -> Result<CheckedQuery<'_>, MemoryError> {
        self.region.as_ref().map_or(Ok(()), Region::check)?;
        let filter = self.filter.as_deref().map(Filter::compile).transpose()?;
        Ok(CheckedQuery { query: self, filter })
    }
}

impl CheckedQuery<'_> {
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

    /// Whether which snapshots it takes follows from their versions and the times that they speak of.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.filter.is_none() && self.query.region.is_none() && self.query.arrived_since.is_none()
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
                let newest = history.next_back().filter(|s| self.is_told(s) && self.fits(s));
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

    /// An answer with nothing in it yet.
    pub(crate) fn answer(&self) -> Selection<'_> {
        Selection { asked: self, found: Vec::new(), bytes: 0, left: LEFT, left_bytes: LEFT_BYTES }
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
        if let Some(most) = self.query.most_bytes {
            let mut bytes = 0;
            let before_last = found.iter().take_while(|snapshot| {
                bytes += snapshot.bytes();
                bytes < most
            });
            found.truncate(before_last.count() + 1);
        }
        found
    }

    /// Whether a snapshot may be told where one of an entity is asked for.
    fn is_told(&self, snapshot: &Snapshot) -> bool {
        self.query.removed || !snapshot.is_removed()
    }

    /// Whether a snapshot that the times have chosen is asked for.
    pub(crate) fn fits(&self, snapshot: &Snapshot) -> bool {
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
        held.filter(|s| self.is_told(s) && self.fits(s)).into_iter().collect()
    }
}

/// What was found so far, in the order of the answer.
pub(crate) struct Selection<'a> {
    asked: &'a CheckedQuery<'a>,
    found: Vec<Arc<Snapshot>>,
    /// Of `found`, where the question bounds them.
    bytes: u64,
    /// How many more may be found, and how many bytes of them, before those that are not among the nearest are forgotten.
    left: usize,
    left_bytes: u64,
}

impl Selection<'_> {
    pub(crate) fn push(&mut self, snapshot: Arc<Snapshot>) {
        let query = self.asked.query;
        if query.is_nearest() {
            self.left = self.left.saturating_sub(1);
            self.left_bytes = self.left_bytes.saturating_sub(snapshot.bytes());
        } else if query.most_bytes.is_some() {
            self.bytes += snapshot.bytes();
        }
        self.found.push(snapshot);
        if self.left == 0 || self.left_bytes == 0 {
            self.found = self.asked.finish(std::mem::take(&mut self.found));
            // As many again, so that sorting costs little of each.
            self.left = self.found.len().max(LEFT);
            self.left_bytes = self.found.iter().map(|s| s.bytes()).sum::<u64>().max(LEFT_BYTES);
        }
    }

    pub(crate) fn extend(&mut self, snapshots: Vec<Arc<Snapshot>>) {
        snapshots.into_iter().for_each(|snapshot| self.push(snapshot));
    }

    /// Whether as much was found as is asked for, so that nothing that comes later need be looked at.
    pub(crate) fn is_full(&self) -> bool {
        let query = self.asked.query;
        !query.is_nearest()
            && (query.most.is_some_and(|most| self.found.len() >= most)
                || query.most_bytes.is_some_and(|most| self.bytes >= most && !self.found.is_empty()))
    }

    pub(crate) fn finish(self) -> Vec<Arc<Snapshot>> {
        self.asked.finish(self.found)
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

/// The first and the last version from one place in a history to another, negative ones counted from the end, where `at`
/// gives the version in a place; `None` where there is none between them.
pub(crate) fn versions_between<E>(
    from: i64,
    to: i64,
    at: impl Fn(i64) -> Result<Option<u64>, E>,
) -> Result<Option<(u64, u64)>, E> {
    // What is before the beginning is the beginning for the first place, and nothing for the last one.
    let first = at(from)?.or((from < 0).then_some(0));
    let last = at(to)?.or((to >= 0).then_some(u64::MAX));
    Ok(first.zip(last))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::entity::Instance;
    use crate::query::Pattern;

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
                query.check().unwrap().select(history(times).into_iter()).iter().map(|s| s.version).collect();
            assert_eq!(&taken, expected, "{query:?} of {times:?}");
        }
    }
}
