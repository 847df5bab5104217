//! Queries, gets by key and maintenance of a shared memory: answered in parallel, beside commits, in parts, and
//! within a memory budget.

use std::sync::Arc;

use armarium_bus::{IncomingQuery, Queryable, SessionError};
use tokio::sync::OwnedSemaphorePermit;
use tokio::task::{JoinSet, block_in_place};

use super::{BUDGET_KB, ServedMemory, forbid, log_failure};
use crate::error::MemoryError;
use crate::maintain;
use crate::query::{Cursor, Query};
use crate::wire::{self, MAX_BYTES, MAX_SNAPSHOTS, Maintain, Snapshots};

/// Least budget of a query, kB. It bounds the number of queries that wait.
const MIN_QUERY_KB: u32 = 256;

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

    /// Waits for one of the slots in which queries are answered.
    async fn turn(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.queries).acquire_owned().await.ok()
    }

    /// Answers a query or maintenance when a slot is free. The slot is freed before the answer is sent, because the
    /// caller decides how long that takes.
    pub(super) async fn answer_aside(self, question: IncomingQuery) {
        let Some(_room) = self.reserve_budget(&question).await else { return };
        let turn = self.turn().await;
        let answer = block_in_place(|| self.answer(&question));
        drop(turn);
        self.send(&question, answer).await;
    }

    /// Answers a query or maintenance, depending on its encoding.
    fn answer(&self, question: &IncomingQuery) -> Result<(String, Vec<u8>), MemoryError> {
        let (encoding, payload) = (question.encoding.as_str(), question.payload.as_slice());
        let sealed = if encoding.starts_with("application/cbor;memoryx/maintain;") {
            let request: Maintain = wire::open(encoding, payload).map_err(|e| self.not_understood(&e))?;
            let writer = self.writer(question);
            if self.options.guarded && writer != Some(self.agent.as_str()) {
                return Err(forbid("long-term memory".into(), writer));
            }
            wire::seal(&maintain::carry_out(request, self.options.store.as_deref(), &self.memory)?)
        } else {
            let query: Query = wire::open(encoding, payload).map_err(|e| self.not_understood(&e))?;
            wire::seal(&self.page(query)?)
        };
        sealed.map_err(|e| self.not_understood(&e))
    }

    /// As much of an answer as fits into one message.
    fn page(&self, mut query: Query) -> Result<Snapshots, MemoryError> {
        query.most = Some(query.most.unwrap_or(usize::MAX).min(MAX_SNAPSHOTS));
        query.most_bytes = Some(query.most_bytes.unwrap_or(u64::MAX).min(MAX_BYTES));
        let mut snapshots = self.memory.query_now(&query)?;
        let full = query.is_filled_by(&snapshots) && !snapshots.is_empty();
        let fits = wire::in_one_answer(&snapshots);
        let cut = fits < snapshots.len();
        snapshots.truncate(fits);
        // The nearest are ordered by distance, so a cursor cannot continue such an answer.
        Ok(Snapshots { snapshots, more: (full || cut) && !query.is_nearest() })
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
            let turn = self.turn().await;
            let found = match block_in_place(|| self.memory.query_now(&query)) {
                Ok(found) => found,
                Err(error) => return self.refuse(question, &error).await,
            };
            drop(turn);
            let more = query.is_filled_by(&found);
            query.after = found.last().map(|s| Cursor { id: s.id.clone(), version: s.version });
            for snapshot in found {
                let (Ok(key), Ok((encoding, payload))) =
                    (wire::entity_key(&self.agent, &snapshot), wire::seal(&*snapshot))
                else {
                    continue;
                };
                question.reply(&key, &encoding, payload).await?;
            }
            if !more {
                return Ok(());
            }
        }
    }
}
