//! Questions to working memory and long-term memory together: both are asked for all that could decide the answer, in
//! parts, so that no more is in memory at once than a part and the answer.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Backing, WorkingMemory};
use crate::asked::Asked;
use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Query, Times};

/// Most snapshots of a part.
pub(super) const PART: usize = 8192;
/// Most bytes of a part, about.
const PART_BYTES: u64 = 16 << 20;

impl WorkingMemory {
    /// What a question asks for of what is held and of what was ever kept.
    pub(super) fn ask_both(
        &self,
        asked: &Asked<'_>,
        backing: &dyn Backing,
    ) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let query = asked.query();
        let mut answer = asked.answer();
        let mut wide = wider(query, self.part);
        loop {
            let recalled = backing.recall(&wide)?;
            let held = self.read().select(&wide.ask()?);
            let cut = [&recalled, &held].into_iter().filter(|part| wide.is_filled_by(part));
            // Beyond the end of a part that was cut not everything is known: that is asked for again.
            let end = cut.filter_map(|part| part.last()).map(|last| place(last, query)).min();
            let mut known: BTreeMap<EntityId, BTreeMap<u64, Arc<Snapshot>>> = BTreeMap::new();
            for snapshot in recalled.into_iter().chain(held) {
                if end.as_ref().is_none_or(|end| place(&snapshot, query) <= *end) {
                    known.entry(snapshot.id.clone()).or_default().insert(snapshot.version, snapshot);
                }
            }
            for (_, history) in known.into_iter().filter(|(id, _)| asked.wants(id)) {
                answer.extend(asked.select(history.into_values()));
            }
            match end {
                Some((id, version)) if !answer.is_full() => wide.after = Some(Cursor { id, version }),
                _ => return Ok(answer.finish()),
            }
        }
    }
}

/// Where a snapshot stands among the parts: where one of an entity is asked for, entities are not divided.
fn place(snapshot: &Snapshot, query: &Query) -> (EntityId, u64) {
    (snapshot.id.clone(), if is_one(query.times) { u64::MAX } else { snapshot.version })
}

/// Whether at most one snapshot of each entity is asked for.
fn is_one(times: Times) -> bool {
    matches!(times, Times::Latest | Times::At(_) | Times::Before(_))
}

/// What two memories are asked for when the answer is taken of what they know together: all that could decide it.
fn wider(query: &Query, part: usize) -> Query {
    let is_one = is_one(query.times);
    let by_time = matches!(query.times, Times::All | Times::Between(..) | Times::Versions(..));
    // Whether each snapshot is asked for or not, whatever others there are.
    let is_each = by_time && query.limit.is_none();
    let in_parts = is_one || (is_each && !query.is_nearest());
    let most = if is_each { query.most.map_or(part, |most| most.min(part)) } else { part };
    let after = query.after.clone().filter(|_| is_one || by_time);
    Query {
        pattern: query.pattern.clone(),
        times: if matches!(query.times, Times::Index(..)) { Times::All } else { query.times },
        arrived_since: query.arrived_since.filter(|_| by_time),
        filter: query.filter.clone().filter(|_| by_time),
        region: query.region.clone().filter(|_| is_each || (by_time && !query.is_nearest())),
        limit: query.limit.filter(|limit| by_time || *limit == 0),
        after: after.map(|after| Cursor { version: if is_one { 0 } else { after.version }, ..after }),
        most: in_parts.then_some(most),
        most_bytes: in_parts.then_some(PART_BYTES),
        removed: is_one,
        long_term: false,
    }
}
