//! Queries, gets by key and maintenance of a shared memory: answered in parallel, beside commits, in parts, and
//! within a memory budget.

use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{IncomingQuery, Queryable, SessionError};
use parking_lot::FairMutexGuard;
use tokio::sync::OwnedSemaphorePermit;
use tokio::task::{JoinSet, block_in_place};
use tokio::time::Instant;

use super::{BUDGET_KB, Response, ServedMemory, forbid, log_failure};
use crate::checked_query::Answer;
use crate::entity::Snapshot;
use crate::error::MemoryError;
use crate::maintain;

use crate::query::{Cursor, Query};
use crate::wire::{
    self, HeadsPart, HeadsRequest, MAX_BYTES, MAX_SNAPSHOTS, Maintain, QueryRequest, Snapshots,
};

/// Least budget of a query, kB. It bounds the number of queries that wait.
const MIN_QUERY_KB: u32 = 256;
/// Most entities in one list of heads.
const MAX_HEADS: usize = 1 << 16;
/// How long one part of an answer may take, where the asker reads it in parts, and where he does not. An asker that is
/// gone costs no more than this.
const PART_TIME: Duration = Duration::from_millis(250);
const WHOLE_TIME: Duration = Duration::from_secs(10);
/// How long a query computes before the next one does.
const TURN_TIME: Duration = Duration::from_millis(2);

impl ServedMemory {
    /// Reserves budget for a query to wait beside the others, so that commits never wait for queries. When none is
    /// left, the caller gets an error.
    pub(super) async fn reserve_budget(&self, question: &IncomingQuery) -> Option<OwnedSemaphorePermit> {
        let kb = u32::try_from(question.payload.len() / 1024).unwrap_or(BUDGET_KB);
        let wanted = kb.saturating_add(MIN_QUERY_KB).min(BUDGET_KB);
        let room = Arc::clone(&self.room).try_acquire_many_owned(wanted).ok();
        if room.is_none() {
            let what = "too many questions wait for their answers: ask again later".into();
            self.send(question, Err(MemoryError::Query { what })).await;
        }
        room
    }

    /// Answers a query or maintenance when a slot is free. The slot is freed before the answer is sent, because the
    /// caller decides how long that takes.
    pub(super) async fn answer_aside(self, question: IncomingQuery) {
        let Some(_room) = self.reserve_budget(&question).await else { return };
        let slot = self.queries.acquire().await;
        let answer = block_in_place(|| self.answer(&question));
        drop(slot);
        self.send(&question, answer).await;
    }

    /// Answers a query or maintenance, depending on its encoding.
    fn answer(&self, question: &IncomingQuery) -> Response {
        let (encoding, payload) = (question.encoding.as_str(), question.payload.as_slice());
        if encoding.starts_with("application/cbor;memoryx/maintain;") {
            let request: Maintain = self.opened(encoding, payload)?;
            let writer = self.writer(question);
            if self.options.guarded && writer != Some(self.agent.as_str()) {
                return Err(forbid("long-term memory".into(), writer));
            }
            return self.sealed(&maintain::carry_out(request, self.options.store.as_deref(), &self.memory)?);
        }
        if encoding.starts_with("application/cbor;memoryx/list;") {
            return self.sealed(&self.heads(self.opened(encoding, payload)?)?);
        }
        self.sealed(&self.page(self.opened(encoding, payload)?)?)
    }

    /// As much of an answer as fits into one message and into the time of one part.
    fn page(&self, request: QueryRequest) -> Result<Snapshots, MemoryError> {
        let QueryRequest { mut query, parts } = request;
        query.most = Some(query.most.unwrap_or(usize::MAX).min(MAX_SNAPSHOTS));
        query.most_bytes = Some(query.most_bytes.unwrap_or(u64::MAX).min(MAX_BYTES));
        let Answer { mut snapshots, mut next } =
            self.ask(&query, if parts { PART_TIME } else { WHOLE_TIME })?;
        if let Some(end) = next.as_ref().filter(|end| !parts && end.version == u64::MAX) {
            return Err(end.too_slow());
        }
        let fits = wire::in_one_answer(&snapshots);
        if fits < snapshots.len() {
            snapshots.truncate(fits);
            // The nearest are ordered by distance, so a cursor cannot continue such an answer.
            next = snapshots.last().filter(|_| !query.is_nearest()).map(|last| Cursor::after(last));
        }
        Ok(Snapshots { snapshots, more: next.is_some(), next })
    }

    /// The newest versions of entities, as many as fit into one message and into the time of one part.
    fn heads(&self, request: HeadsRequest) -> Result<HeadsPart, MemoryError> {
        let newest = Query { removed: true, most: Some(MAX_HEADS), ..Query::latest(request.pattern) };
        let after = request.after.as_ref().map(Cursor::behind);
        let answer = self.ask(&Query { after, ..newest }, PART_TIME)?;
        let head = |s: &Arc<Snapshot>| (s.id.clone(), s.version, s.arrived_ns, s.is_removed());
        let entities = answer.snapshots.iter().map(head).collect();
        let now_ns = Some(self.memory.now_ns());
        Ok(HeadsPart { entities, next: answer.next.map(|next| next.id), now_ns })
    }

    /// Asks the memory for as long as `time`. Queries that look at many entities take turns, so that together they use
    /// one processor at most.
    fn ask(&self, query: &Query, time: Duration) -> Result<Answer, MemoryError> {
        let is_quick = query.pattern.exact().is_some() && !query.long_term;
        if is_quick || query.most == Some(0) {
            return self.memory.query_while(query, &|| true);
        }
        let turn = RefCell::new(self.turn.lock());
        let start = Instant::now();
        let since = Cell::new(start);
        self.memory.query_while(query, &|| {
            if since.get().elapsed() > TURN_TIME {
                FairMutexGuard::bump(&mut turn.borrow_mut());
                since.set(Instant::now());
            }
            start.elapsed() < time
        })
    }

    pub(super) async fn answer_gets(self, mut questions: Queryable) {
        let mut answers = JoinSet::new();
        while let Some(question) = questions.next().await {
            let shared = self.clone();
            answers.spawn(async move {
                if let Some(_room) = shared.reserve_budget(&question).await {
                    log_failure(shared.answer_get(&question).await);
                }
            });
            while answers.try_join_next().is_some() {}
        }
    }

    /// Answers in parts, so that only one part of a long answer is in memory.
    async fn answer_get(&self, question: &IncomingQuery) -> Result<(), SessionError> {
        let mut query = match wire::query_of_get(&question.key, &question.parameters) {
            Ok(query) => Query { most: Some(MAX_SNAPSHOTS), most_bytes: Some(MAX_BYTES), ..query },
            Err(error) => return self.refuse(question, &error).await,
        };
        loop {
            let slot = self.queries.acquire().await;
            let answer = match block_in_place(|| self.ask(&query, WHOLE_TIME)) {
                Ok(answer) => answer,
                Err(error) => return self.refuse(question, &error).await,
            };
            drop(slot);
            for snapshot in answer.snapshots {
                let Some((key, encoding, payload)) = wire::of_entity(&self.agent, &snapshot) else {
                    continue;
                };
                question.reply(&key, &encoding, payload).await?;
            }
            match answer.next {
                // Stopped before the end of the answer's bounds, by time.
                Some(next) if next.version == u64::MAX => {
                    return self.refuse(question, &next.too_slow()).await;
                }
                Some(next) => query.after = Some(next),
                None => return Ok(()),
            }
        }
    }
}
