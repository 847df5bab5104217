//! A checked query, applied to the snapshots of one entity at a time: the one selection that every memory uses. It
//! does not find the entities; each memory does that itself.

use std::cmp::Ordering;
use std::sync::{Arc, OnceLock};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::filter::Filter;
use crate::place::{SpatialRegion, distance, place_of};
use crate::query::{Cursor, Query, Times};
use crate::time_of::TimeOf;

/// Limits of a nearest-first selection: after so many snapshots, or bytes of them, only the nearest are kept.
const MIN_NEAREST: usize = 1024;
const MIN_NEAREST_BYTES: u64 = 16 << 20;
/// So many entities are looked at between two questions whether to go on.
const PAUSE: usize = 16;

/// A checked query.
#[derive(Clone, Debug)]
pub struct CheckedQuery<'q> {
    pub(crate) query: &'q Query,
    pub(crate) filter: Option<Filter>,
    /// The clock of the times that it names.
    pub(crate) clock: Option<TimeOf>,
    /// Why it is not known of a snapshot whether it fits; shared with the queries that this one is divided into.
    unknown: Arc<OnceLock<MemoryError>>,
}

impl Query {
    /// Checks the query.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when its filter or region is invalid, or its times are of two clocks.
    pub fn check(&self) -> Result<CheckedQuery<'_>, MemoryError> {
        self.region.as_ref().map_or(Ok(()), SpatialRegion::check)?;
        let filter = self.filter.as_deref().map(Filter::compile).transpose()?;
        Ok(CheckedQuery { query: self, filter, clock: self.times.clock()?, unknown: Arc::default() })
    }
}

impl CheckedQuery<'_> {
    /// A query that is a part of this one: it has its filter.
    pub(crate) fn part<'q>(&self, query: &'q Query) -> CheckedQuery<'q> {
        let (filter, unknown) = (self.filter.clone(), Arc::clone(&self.unknown));
        CheckedQuery { query, filter, clock: self.clock, unknown }
    }

    /// Whether it is known of each snapshot so far whether it fits.
    ///
    /// # Errors
    /// [`MemoryError::Query`], naming the entity, when the filter exceeds a limit.
    pub(crate) fn is_known(&self) -> Result<(), MemoryError> {
        self.unknown.get().map_or(Ok(()), |why| Err(why.clone()))
    }

    /// Whether an entity can be in the answer.
    pub fn wants(&self, id: &EntityId) -> bool {
        self.query.pattern.matches(id) && self.query.after.as_ref().is_none_or(|after| after.id <= *id)
    }

    /// The class that all in the answer have, if the filter asks for one.
    pub(crate) fn wanted_class(&self) -> Option<&str> {
        self.filter.as_ref()?.wanted_class()
    }

    /// Whether the selection depends only on versions and referenced times.
    pub fn is_plain(&self) -> bool {
        self.filter.is_none() && self.query.region.is_none() && self.query.arrived_since.is_none()
    }

    /// Selects from the snapshots of one entity that [`Self::wants`]. Input and output are in order of version.
    pub fn select(&self, mut history: impl DoubleEndedIterator<Item = Arc<Snapshot>>) -> Vec<Arc<Snapshot>> {
        let query = self.query;
        let limit = query.limit.unwrap_or(usize::MAX);
        let newest = |history: &mut dyn Iterator<Item = Arc<Snapshot>>| {
            let mut kept: Vec<_> = history.filter(|s| self.fits(s)).take(limit).collect();
            kept.reverse();
            kept
        };
        match query.times {
            _ if limit == 0 => Vec::new(),
            Times::Latest => history.next_back().filter(|s| self.answers(s)).into_iter().collect(),
            Times::All => newest(&mut history.rev()),
            Times::Between(from, to) => {
                newest(&mut history.rev().filter(|s| (from..=to).contains(&s.referenced_ns)))
            }
            Times::Versions(from, to) => {
                newest(&mut history.rev().filter(|s| (from..=to).contains(&s.version)))
            }
            Times::Index(from, to) => {
                let held: Vec<_> = history.collect();
                let range = index_range(from, to, held.len());
                newest(&mut held.get(range).unwrap_or_default().iter().rev().cloned())
            }
            Times::At(time) => self.state_at(history, |s| s.referenced_ns <= time),
            Times::Before(time) => self.state_at(history, |s| s.referenced_ns < time),
        }
    }

    /// An empty answer, which ends early when `goes_on` says so; `goes_on` is called every few entities.
    pub(crate) fn answer<'a>(&'a self, goes_on: &'a dyn Fn() -> bool) -> Selection<'a> {
        Selection {
            asked: self,
            goes_on,
            looked_at: 0,
            stopped: None,
            other_clock: None,
            found: Vec::new(),
            bytes: 0,
            left: MIN_NEAREST,
            left_bytes: MIN_NEAREST_BYTES,
        }
    }

    /// Completes the answer: sorts the nearest by distance and applies the bounds. `found`: in order of address.
    pub fn finish(&self, mut found: Vec<Arc<Snapshot>>) -> Vec<Arc<Snapshot>> {
        if let Some(SpatialRegion::Nearest { to, count, .. }) = &self.query.region {
            let far = |s: &Snapshot| place_of(s).map_or(f64::INFINITY, |(_, place)| distance(to, &place));
            let mut placed: Vec<(f64, Arc<Snapshot>)> = found.into_iter().map(|s| (far(&s), s)).collect();
            // The sort is stable: equal distances keep the order of addresses.
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

    /// Whether a snapshot is the answer where the query takes one per entity.
    fn answers(&self, snapshot: &Snapshot) -> bool {
        (self.query.removed || !snapshot.is_removed()) && self.fits(snapshot)
    }

    /// Whether a snapshot that `times` selects passes all other conditions.
    pub(crate) fn fits(&self, snapshot: &Snapshot) -> bool {
        let query = self.query;
        query.arrived_since.is_none_or(|since| snapshot.arrived_ns >= since)
            && query.after.as_ref().is_none_or(|after| {
                (snapshot.id.cmp(&after.id)).then(snapshot.version.cmp(&after.version)) == Ordering::Greater
            })
            && query.region.as_ref().is_none_or(|region| region.holds(snapshot))
            && self.filter.as_ref().is_none_or(|filter| match filter.fits(snapshot) {
                Ok(fits) => fits,
                Err(why) => {
                    self.unknown.get_or_init(|| why);
                    false
                }
            })
    }

    /// The snapshot with the latest referenced time among those for which `counts` is true, unless it is a removal.
    fn state_at(
        &self,
        history: impl Iterator<Item = Arc<Snapshot>>,
        counts: impl Fn(&Snapshot) -> bool,
    ) -> Vec<Arc<Snapshot>> {
        let held = history.filter(|s| counts(s)).max_by_key(|s| (s.referenced_ns, s.version));
        held.filter(|s| self.answers(s)).into_iter().collect()
    }
}

/// The answer to a query.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// The snapshots.
    pub snapshots: Vec<Arc<Snapshot>>,
    /// Where it was cut off: a query with `after` this position returns the rest, which was not looked at. `None` when
    /// it is whole.
    pub next: Option<Cursor>,
}

impl Cursor {
    /// The refusal of a query that has taken too long to get further.
    pub(crate) fn too_slow(&self) -> MemoryError {
        let what = format!("it takes too long, and nothing after `{}` was looked at: ask for less", self.id);
        MemoryError::Query { what }
    }
}

/// The answer so far, in its order.
pub(crate) struct Selection<'a> {
    asked: &'a CheckedQuery<'a>,
    goes_on: &'a dyn Fn() -> bool,
    looked_at: usize,
    /// The position up to which everything was looked at, when the answer ended early.
    stopped: Option<Cursor>,
    /// An entity that is of another clock than the query's times.
    other_clock: Option<EntityId>,
    found: Vec<Arc<Snapshot>>,
    /// Bytes of `found`; counted only when the query bounds them.
    bytes: u64,
    /// How many more snapshots, and bytes of them, may be added before only the nearest are kept.
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
            // As many again, so that the cost of sorting per snapshot stays small.
            self.left = self.found.len().max(MIN_NEAREST);
            self.left_bytes = self.found.iter().map(|s| s.bytes()).sum::<u64>().max(MIN_NEAREST_BYTES);
        }
    }

    pub(crate) fn extend(&mut self, snapshots: Vec<Arc<Snapshot>>) {
        snapshots.into_iter().for_each(|snapshot| self.push(snapshot));
    }

    /// Adds the selection from one entity's snapshots. Entities come in order of address. Returns whether further ones
    /// are to be looked at.
    pub(crate) fn consider<H>(&mut self, id: &EntityId, history: impl Fn() -> H) -> bool
    where
        H: DoubleEndedIterator<Item = Arc<Snapshot>>,
    {
        if !self.is_full() && self.asked.wants(id) {
            self.note_clock(id, || history().next_back().map(|newest| newest.referenced_ns));
            self.extend(self.asked.select(history()));
        }
        self.looked_at += 1;
        let may_pause = self.looked_at.is_multiple_of(PAUSE);
        if may_pause { self.looks_on(|| Cursor::behind(id)) } else { !self.is_full() }
    }

    /// Compares the clock of an entity's newest snapshot with that of the query's times.
    pub(crate) fn note_clock(&mut self, id: &EntityId, newest_ns: impl FnOnce() -> Option<u64>) {
        if let Some(clock) = self.asked.clock
            && self.other_clock.is_none()
            && newest_ns().is_some_and(|time| TimeOf::of(time) != clock)
        {
            self.other_clock = Some(id.clone());
        }
    }

    /// Whether what follows a position, up to which everything was looked at, is to be looked at.
    pub(crate) fn looks_on(&mut self, position: impl FnOnce() -> Cursor) -> bool {
        if self.stopped.is_none() && !(self.goes_on)() {
            self.stopped = Some(position());
        }
        self.stopped.is_none() && !self.is_full()
    }

    /// Whether the answer has reached the query's bounds, so that later snapshots need not be read.
    pub(crate) fn is_full(&self) -> bool {
        let query = self.asked.query;
        !query.is_nearest()
            && (query.most.is_some_and(|most| self.found.len() >= most)
                || query.most_bytes.is_some_and(|most| self.bytes >= most && !self.found.is_empty()))
    }

    /// The whole answer. [`MemoryError::Query`] when it ended early and cannot be continued, because the nearest may be
    /// among what was not looked at; when an entity is of another clock than the query's times.
    pub(crate) fn finish(self) -> Result<Answer, MemoryError> {
        self.asked.is_known()?;
        let query = self.asked.query;
        if let (Some(id), Some(clock)) = (&self.other_clock, self.asked.clock) {
            let other = if clock == TimeOf::Run { TimeOf::Day } else { TimeOf::Run };
            let what =
                format!("it asks by {clock}, and `{id}` is of {other}: ask for the entities of one clock");
            return Err(MemoryError::Query { what });
        }
        if let Some(end) = self.stopped.as_ref().filter(|_| query.is_nearest()) {
            return Err(end.too_slow());
        }
        let (was_full, stopped) = (self.is_full(), self.stopped);
        let snapshots = self.asked.finish(self.found);
        let last = snapshots.last().filter(|_| was_full).map(|s| Cursor::after(s));
        Ok(Answer { snapshots, next: last.or(stopped) })
    }
}

/// Converts two positions, both included, to a range in a list of `count`; negative ones count from the end.
pub(crate) fn index_range(from: i64, to: i64, count: usize) -> std::ops::Range<usize> {
    let count = i64::try_from(count).unwrap_or(i64::MAX);
    let place = |i: i64| if i < 0 { count.saturating_add(i) } else { i };
    let (from, to) = (place(from).max(0), place(to).min(count - 1));
    if from > to {
        return 0..0;
    }
    let index = |i: i64| usize::try_from(i).unwrap_or(0);
    index(from)..index(to) + 1
}

/// The first and the last version between two positions in a history; negative positions count from the end. `at`
/// gives the version at a position. `None` when the range is empty.
pub(crate) fn versions_between<E>(
    from: i64,
    to: i64,
    at: impl Fn(i64) -> Result<Option<u64>, E>,
) -> Result<Option<(u64, u64)>, E> {
    // A first position before the oldest means the oldest; a last position before the oldest means an empty range.
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

    /// Versions from 1 with these referenced times; a negative time is a removal at that time.
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
