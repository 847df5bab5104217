//! Queries to working memory and long-term memory together. Both are asked for everything that can decide the answer,
//! in parts, so that only one part and the answer are in memory.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Archive, Core};
use crate::checked_query::{Answer, CheckedQuery, Selection, versions_between};
use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Pattern, Query, Times};

/// Most snapshots of a part.
pub(super) const MAX_PART: usize = 8192;
/// Most bytes of a part, about.
const MAX_PART_BYTES: u64 = 16 << 20;

/// Snapshots by entity and version.
type Histories = BTreeMap<EntityId, BTreeMap<u64, Arc<Snapshot>>>;

/// Working memory and everything that was ever stored.
pub(super) struct MergedView<'m> {
    /// Working memory, as it is when each part is read.
    pub(super) memory: &'m Core,
    pub(super) kept: &'m dyn Archive,
    /// Most snapshots of a part.
    pub(super) part: usize,
}

impl MergedView<'_> {
    /// Answers a query, or the part of it for which `goes_on` allows the time.
    pub(super) fn ask(
        &self,
        asked: &CheckedQuery<'_>,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<Answer, MemoryError> {
        let query = asked.query;
        let mut answer = asked.answer(goes_on);
        let is_counted = query.limit.is_some() || matches!(query.times, Times::Index(..));
        match query.limit {
            Some(0) => {}
            _ if is_counted && !is_one(query.times) => self.add_entities(asked, &mut answer)?,
            _ => self.add(asked, &mut answer)?,
        }
        answer.finish()
    }

    /// Adds the selection from each snapshot; for queries of one snapshot per entity, from the newest one of both
    /// memories.
    fn add(&self, asked: &CheckedQuery<'_>, answer: &mut Selection<'_>) -> Result<(), MemoryError> {
        let mut wide = wider(asked.query, self.part);
        loop {
            let (known, end) = self.part(&wide)?;
            for (_, history) in known.into_iter().filter(|(id, _)| asked.wants(id)) {
                answer.extend(asked.select(history.into_values()));
            }
            match end {
                Some(end) if answer.looks_on(|| end.clone()) => wide.after = Some(end),
                _ => return Ok(()),
            }
        }
    }

    /// A part of both memories' content, and its end if there is more.
    fn part(&self, wide: &Query) -> Result<(Histories, Option<Cursor>), MemoryError> {
        let recalled = self.kept.recall(wide)?;
        let wide_checked = wide.check()?;
        let mut held = wide_checked.answer(&|| true);
        self.memory.content().select(&wide_checked, &mut held);
        let held = held.finish()?.snapshots;
        let cut = [&recalled, &held].into_iter().filter(|part| wide.is_filled_by(part));
        // Past the end of a truncated part not everything is known: the next part begins there.
        let end = cut.filter_map(|part| part.last()).map(|last| place(last, wide)).min();
        let mut known = Histories::new();
        for snapshot in recalled.into_iter().chain(held) {
            if end.as_ref().is_none_or(|end| place(&snapshot, wide) <= *end) {
                known.entry(snapshot.id.clone()).or_default().insert(snapshot.version, snapshot);
            }
        }
        Ok((known, end))
    }

    /// Adds the selection entity by entity, for queries that count snapshots.
    fn add_entities(&self, asked: &CheckedQuery<'_>, answer: &mut Selection<'_>) -> Result<(), MemoryError> {
        let query = asked.query;
        if let Some(id) = query.pattern.exact() {
            return if asked.wants(&id) { self.add_entity(asked, &id, answer) } else { Ok(()) };
        }
        let newest = Query { after: query.after.clone(), ..Query::latest(query.pattern.clone()) };
        let mut newest = wider(&newest, self.part);
        loop {
            let (known, end) = self.part(&newest)?;
            for id in known.keys().filter(|id| asked.wants(id)) {
                self.add_entity(asked, id, answer)?;
                if !answer.looks_on(|| Cursor::behind(id)) {
                    return Ok(());
                }
            }
            match end {
                Some(end) => newest.after = Some(end),
                None => return Ok(()),
            }
        }
    }

    /// Finds the range of versions that contains the selection, and adds it.
    fn add_entity(
        &self,
        asked: &CheckedQuery<'_>,
        id: &EntityId,
        answer: &mut Selection<'_>,
    ) -> Result<(), MemoryError> {
        let mut query = Query { pattern: Pattern::entity(id), limit: None, ..asked.query.clone() };
        if let Times::Index(from, to) = query.times {
            let all = Query::history(query.pattern.clone());
            let all = all.check()?;
            let at = |place: i64| {
                let index = if place < 0 { -1 - place } else { place };
                self.nth(&all, id, usize::try_from(index).unwrap_or(usize::MAX), place < 0)
            };
            let Some((first, last)) = versions_between(from, to, at)? else { return Ok(()) };
            query.times = Times::Versions(first, last);
        }
        let one = asked.part(&query);
        let Some(limit) = asked.query.limit else { return self.add(&one, answer) };
        // If there are fewer, all are selected.
        let Some(first) = self.nth(&one, id, limit.saturating_sub(1), true)? else {
            return self.add(&one, answer);
        };
        let after = first.checked_sub(1).map(|version| Cursor { id: id.clone(), version });
        let query = Query { after: after.or(query.after.clone()), ..query };
        self.add(&asked.part(&query), answer)
    }

    /// The `n`th version of an entity that a query selects, from 0, counted from the first or backwards from the
    /// last.
    fn nth(
        &self,
        asked: &CheckedQuery<'_>,
        id: &EntityId,
        n: usize,
        backwards: bool,
    ) -> Result<Option<u64>, MemoryError> {
        let mut held = self.memory.content().versions(asked, id);
        if backwards {
            held.reverse();
        }
        let (mut held, mut left, mut found) = (held.into_iter().peekable(), n, None);
        let mut is_found = |version: u64| {
            match left {
                _ if found.is_some() => {}
                0 => found = Some(version),
                _ => left -= 1,
            }
            found.is_some()
        };
        self.kept.versions(asked.query, backwards, &mut |version| {
            let is_before = |held: &u64| if backwards { *held > version } else { *held < version };
            while let Some(earlier) = held.next_if(is_before) {
                is_found(earlier);
            }
            held.next_if_eq(&version);
            !is_found(version)
        })?;
        held.any(is_found);
        Ok(found)
    }
}

/// The position of a snapshot in the order of parts. For queries of one snapshot per entity, parts do not divide
/// entities.
fn place(snapshot: &Snapshot, query: &Query) -> Cursor {
    if is_one(query.times) { Cursor::behind(&snapshot.id) } else { Cursor::after(snapshot) }
}

/// Whether a query selects at most one snapshot per entity.
fn is_one(times: Times) -> bool {
    matches!(times, Times::Latest | Times::At(_) | Times::Before(_))
}

/// The query that both memories get, so that their answers together decide `query`.
fn wider(query: &Query, part: usize) -> Query {
    let is_one = is_one(query.times);
    let most = query.most.filter(|_| !is_one && !query.is_nearest());
    let after = query.after.clone();
    Query {
        pattern: query.pattern.clone(),
        times: query.times,
        arrived_since: query.arrived_since.filter(|_| !is_one),
        filter: query.filter.clone().filter(|_| !is_one),
        region: query.region.clone().filter(|_| !is_one && !query.is_nearest()),
        limit: None,
        after: after.map(|after| Cursor { version: if is_one { 0 } else { after.version }, ..after }),
        most: Some(most.map_or(part, |most| most.min(part))),
        most_bytes: Some(MAX_PART_BYTES),
        removed: is_one,
        long_term: false,
    }
}
