//! Queries, gets by key and maintenance of a shared memory: answered in parallel, beside commits, in parts, and
//! within a memory budget. What is found at once waits for nobody; what takes long ends when its asker is gone or has
//! given up.

use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{IncomingQuery, Queryable, SessionError};
use parking_lot::FairMutexGuard;
use tokio::task::{JoinSet, block_in_place};
use tokio::time::{Instant, timeout_at};

use super::askers::Waiting;
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
/// How long one part of an answer may take, where the asker reads it in parts, and where he does not. The latter is also
/// how long a query waits: after that its asker has given up, as far as he says nothing else.
const PART_TIME: Duration = Duration::from_millis(250);
const WHOLE_TIME: Duration = Duration::from_secs(10);
/// How long a query computes before the next one does, and how often it looks whether its asker is still there.
const TURN_TIME: Duration = Duration::from_millis(2);
const LOOK_TIME: Duration = Duration::from_millis(50);

/// A question that may wait.
struct Question<'q> {
    query: &'q IncomingQuery,
    since: Instant,
    waiting: Waiting,
    /// Its asker, if he is linked to this session: then he is gone when he no longer is.
    linked: Option<&'q str>,
}

/// Whether a query is answered without looking at other entities than its own.
fn is_quick(query: &Query) -> bool {
    query.most == Some(0) || query.pattern.exact().is_some() && !query.long_term
}

impl ServedMemory {
    /// Takes a question to where it may wait; refuses it where there is no room.
    fn admitted<'q>(&self, query: &'q IncomingQuery) -> Result<Question<'q>, MemoryError> {
        let kb = u32::try_from(query.payload.len() / 1024).unwrap_or(BUDGET_KB).saturating_add(MIN_QUERY_KB);
        let Some(waiting) = self.askers.admit(query.sender.as_deref(), kb) else {
            let what = "too many questions wait for their answers: ask again later".into();
            return Err(MemoryError::Query { what });
        };
        let linked = query.sender.as_deref().filter(|asker| self.session.is_linked(asker));
        Ok(Question { query, since: Instant::now(), waiting, linked })
    }

    /// Computes when it is the question's turn.
    async fn in_turn<T>(
        &self,
        question: &Question<'_>,
        compute: impl FnOnce() -> Result<T, MemoryError>,
    ) -> Result<T, MemoryError> {
        let turn = timeout_at(question.since + WHOLE_TIME, self.askers.turn(&question.waiting)).await;
        if turn.is_err() || self.is_gone(question) {
            let what =
                format!("it has waited {} s for others: ask again later", question.since.elapsed().as_secs());
            return Err(MemoryError::Query { what });
        }
        block_in_place(compute)
    }

    /// Whether nobody waits for the answer any more, as far as that is known.
    fn is_gone(&self, question: &Question<'_>) -> bool {
        question.linked.is_some_and(|asker| !self.session.is_linked(asker))
    }

    /// Answers a query or maintenance. Its turn ends before the answer is sent, because the asker decides how long that
    /// takes; the room for it is taken until then.
    pub(super) async fn answer_aside(self, query: IncomingQuery) {
        let others = ["application/cbor;memoryx/maintain;", "application/cbor;memoryx/list;"];
        let is_query = !others.iter().any(|other| query.encoding.starts_with(other));
        let request = is_query.then(|| self.opened::<QueryRequest>(&query.encoding, &query.payload));
        // Whoever connects is not refused because others ask much.
        if let Some(Ok(request)) = &request
            && request.query.most == Some(0)
        {
            return self.send(&query, self.sealed(&Snapshots::default())).await;
        }
        let question = match self.admitted(&query) {
            Ok(question) => question,
            Err(error) => return self.send(&query, Err(error)).await,
        };
        let answer = match request {
            Some(Ok(request)) if is_quick(&request.query) => {
                block_in_place(|| self.sealed(&self.page(request, &question)?))
            }
            Some(Ok(request)) => {
                self.in_turn(&question, || self.sealed(&self.page(request, &question)?)).await
            }
            Some(Err(error)) => Err(error),
            None => self.in_turn(&question, || self.answer(&question)).await,
        };
        self.send(&query, answer).await;
    }

    /// Answers a list of heads or maintenance, depending on the encoding.
    fn answer(&self, question: &Question<'_>) -> Response {
        let (encoding, payload) = (question.query.encoding.as_str(), question.query.payload.as_slice());
        if encoding.starts_with("application/cbor;memoryx/maintain;") {
            let request: Maintain = self.opened(encoding, payload)?;
            let writer = self.writer(question.query);
            if self.options.guarded && writer != Some(self.agent.as_str()) {
                return Err(forbid("long-term memory".into(), writer));
            }
            return self.sealed(&maintain::carry_out(request, self.options.store.as_deref(), &self.memory)?);
        }
        self.sealed(&self.heads(self.opened(encoding, payload)?, question)?)
    }

    /// As much of an answer as fits into one message and into the time of one part.
    fn page(&self, request: QueryRequest, question: &Question<'_>) -> Result<Snapshots, MemoryError> {
        let QueryRequest { mut query, parts } = request;
        query.most = Some(query.most.unwrap_or(usize::MAX).min(MAX_SNAPSHOTS));
        query.most_bytes = Some(query.most_bytes.unwrap_or(u64::MAX).min(MAX_BYTES));
        let Answer { mut snapshots, mut next } =
            self.ask(&query, if parts { PART_TIME } else { WHOLE_TIME }, question)?;
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
    fn heads(&self, request: HeadsRequest, question: &Question<'_>) -> Result<HeadsPart, MemoryError> {
        let newest = Query { removed: true, most: Some(MAX_HEADS), ..Query::latest(request.pattern) };
        let after = request.after.as_ref().map(Cursor::behind);
        let answer = self.ask(&Query { after, ..newest }, PART_TIME, question)?;
        let head = |s: &Arc<Snapshot>| (s.id.clone(), s.version, s.arrived_ns, s.is_removed());
        let entities = answer.snapshots.iter().map(head).collect();
        let now_ns = Some(self.memory.now_ns());
        Ok(HeadsPart { entities, next: answer.next.map(|next| next.id), now_ns })
    }

    /// Asks the memory for as long as `time`, and as the asker is there. Queries that look at many entities take turns, so
    /// that together they use one processor at most.
    fn ask(&self, query: &Query, time: Duration, question: &Question<'_>) -> Result<Answer, MemoryError> {
        if is_quick(query) {
            return self.memory.query_while(query, &|| true);
        }
        let turn = RefCell::new(self.turn.lock());
        let start = Instant::now();
        let (since, looked) = (Cell::new(start), Cell::new(start));
        self.memory.query_while(query, &|| {
            if since.get().elapsed() > TURN_TIME {
                FairMutexGuard::bump(&mut turn.borrow_mut());
                since.set(Instant::now());
            }
            if looked.get().elapsed() > LOOK_TIME {
                looked.set(Instant::now());
                if self.is_gone(question) {
                    return false;
                }
            }
            start.elapsed() < time
        })
    }

    pub(super) async fn answer_gets(self, mut questions: Queryable) {
        let mut answers = JoinSet::new();
        while let Some(question) = questions.next().await {
            let shared = self.clone();
            answers.spawn(async move {
                log_failure(shared.answer_get(&question).await);
            });
            while answers.try_join_next().is_some() {}
        }
    }

    /// Answers in parts, so that only one part of a long answer is in memory.
    async fn answer_get(&self, get: &IncomingQuery) -> Result<(), SessionError> {
        let begun = wire::query_of_get(&get.key, &get.parameters).and_then(|query| {
            Ok((
                Query { most: Some(MAX_SNAPSHOTS), most_bytes: Some(MAX_BYTES), ..query },
                self.admitted(get)?,
            ))
        });
        let (mut query, mut question) = match begun {
            Ok(begun) => begun,
            Err(error) => return self.refuse(get, &error).await,
        };
        loop {
            let answer = if is_quick(&query) {
                block_in_place(|| self.ask(&query, WHOLE_TIME, &question))
            } else {
                self.in_turn(&question, || self.ask(&query, WHOLE_TIME, &question)).await
            };
            let answer = match answer {
                Ok(answer) => answer,
                Err(error) => return self.refuse(get, &error).await,
            };
            for snapshot in answer.snapshots {
                let Some((key, encoding, payload)) = wire::of_entity(&self.agent, &snapshot) else {
                    continue;
                };
                get.reply(&key, &encoding, payload).await?;
            }
            match answer.next {
                // Stopped before the end of the answer's bounds, by time.
                Some(next) if next.version == u64::MAX => return self.refuse(get, &next.too_slow()).await,
                Some(next) => query.after = Some(next),
                None => return Ok(()),
            }
            question.since = Instant::now();
        }
    }
}
