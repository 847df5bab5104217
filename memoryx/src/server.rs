//! Shares a working memory over Zenoh: answers commits and queries, takes updates, and tells every change.
//!
//! What is told goes through a [`Follower`], so that a network that is slow for a while loses nothing that the
//! memory still holds. What others send is checked like any commit; what is not understood is refused or, where
//! nobody waits for an answer, logged with its sender.

use std::sync::Arc;

use armarium_bus::{
    AliveToken, KeyPattern, Message, Question, Questions, Session, SessionError, Subscription, keys,
};
use tokio::task::JoinSet;

use crate::entity::Commit;
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::query::{Pattern, Query};
use crate::wire::{self, CommitRequest, Snapshots, Versions};
use crate::working::WorkingMemory;

/// Questions and updates that wait to be looked at.
const QUEUE: usize = 1024;
/// Most bytes of snapshots in one answer.
const LARGEST_ANSWER: usize = 32 << 20;

/// A memory that is shared for as long as this lives.
#[derive(Debug)]
pub struct MemoryServer {
    _alive: AliveToken,
    _tasks: JoinSet<()>,
}

impl MemoryServer {
    /// Shares a memory as that of `agent`.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the agent's name cannot be part of a key; [`MemoryError::Remote`] when Zenoh fails.
    pub async fn start(
        session: &Session,
        agent: &str,
        memory: Arc<WorkingMemory>,
    ) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, &error.to_string());
        let named = |error: armarium_bus::KeyError| MemoryError::Name { name: error.name };
        let requests = keys::memory_commit(agent).map_err(named)?;
        let entities = wire::every_entity(agent).map_err(named)?;
        let service = keys::alive(agent, "memory").map_err(named)?;

        let (follower, _) = Follower::from_now(Arc::<WorkingMemory>::clone(&memory), Pattern::any()).await?;
        let shared = Shared { session: session.clone(), agent: agent.into(), memory };
        let mut tasks = JoinSet::new();
        let questions = session.answer(requests, QUEUE).await.map_err(failed)?;
        tasks.spawn(shared.clone().answer_requests(questions));
        let gets = session.answer(entities.clone(), QUEUE).await.map_err(failed)?;
        tasks.spawn(shared.clone().answer_gets(gets));
        let updates = subscribe(session, entities).await.map_err(failed)?;
        tasks.spawn(shared.clone().take_updates(updates));
        tasks.spawn(shared.tell(follower));
        let alive = session.alive(&service).await.map_err(failed)?;
        Ok(Self { _alive: alive, _tasks: tasks })
    }
}

async fn subscribe(session: &Session, entities: KeyPattern) -> Result<Subscription, SessionError> {
    session.subscribe(entities, QUEUE).await
}

pub(crate) fn unreachable_memory(agent: &str, what: &str) -> MemoryError {
    MemoryError::Remote { agent: agent.into(), what: what.into() }
}

#[derive(Clone)]
struct Shared {
    session: Session,
    agent: String,
    memory: Arc<WorkingMemory>,
}

impl Shared {
    async fn answer_requests(self, mut questions: Questions) {
        while let Some(question) = questions.next().await {
            let answer = self.answer(&question.encoding, &question.payload);
            let sent = match answer {
                Ok((encoding, payload)) => match keys::memory_commit(&self.agent) {
                    Ok(key) => question.reply(&key, &encoding, payload).await,
                    Err(error) => refuse(&question, &MemoryError::Name { name: error.name }).await,
                },
                Err(error) => refuse(&question, &error).await,
            };
            log_failure(sent);
        }
    }

    /// A commit or a query, by its encoding.
    fn answer(&self, encoding: &str, payload: &[u8]) -> Result<(String, Vec<u8>), MemoryError> {
        let not_understood =
            |error: armarium_bus::CodecError| unreachable_memory(&self.agent, &error.to_string());
        if encoding.starts_with("application/cbor;memoryx/commit;") {
            let request: CommitRequest = wire::open(encoding, payload).map_err(not_understood)?;
            let versions = self.memory.commit_sent(request.updates, request.sent_ns)?;
            return wire::seal(&Versions(versions)).map_err(not_understood);
        }
        let query: Query = wire::open(encoding, payload).map_err(not_understood)?;
        let found = self.memory.query_now(&query);
        let (encoding, payload) =
            wire::seal(&Snapshots(found.iter().map(|s| (**s).clone()).collect())).map_err(not_understood)?;
        if payload.len() > LARGEST_ANSWER {
            let what = format!("the answer of {} snapshots is too large; ask for less at once", found.len());
            return Err(unreachable_memory(&self.agent, &what));
        }
        Ok((encoding, payload))
    }

    async fn answer_gets(self, mut questions: Questions) {
        while let Some(question) = questions.next().await {
            match wire::query_of_get(&question.key, &question.parameters) {
                Ok(query) => log_failure(self.answer_get(&question, &query).await),
                Err(what) => log_failure(refuse(&question, &unreachable_memory(&self.agent, &what)).await),
            }
        }
    }

    async fn answer_get(&self, question: &Question, query: &Query) -> Result<(), SessionError> {
        for snapshot in self.memory.query_now(query) {
            let (Ok(key), Ok((encoding, payload))) =
                (wire::entity_key(&self.agent, &snapshot), wire::seal(&*snapshot))
            else {
                continue;
            };
            question.reply(&key, &encoding, payload).await?;
        }
        Ok(())
    }

    async fn take_updates(self, mut updates: Subscription) {
        let mut dropped = 0;
        while let Some(message) = updates.next().await {
            // The memory's own voice is on the same keys.
            let is_own = message.encoding.starts_with("application/cbor;memoryx/entity;");
            if let Some(error) = (!is_own).then(|| self.take_update(&message).err()).flatten() {
                let sender = message.sender.as_deref().unwrap_or("unknown");
                tracing::warn!(%error, key = message.key, sender, "an update was refused");
            }
            if updates.dropped() > dropped {
                dropped = updates.dropped();
                tracing::warn!(dropped, "updates came faster than they could be taken");
            }
        }
    }

    fn take_update(&self, message: &Message) -> Result<(), MemoryError> {
        let not_understood = |what: String| unreachable_memory(&self.agent, &what);
        let update: Commit =
            wire::open(&message.encoding, &message.payload).map_err(|e| not_understood(e.to_string()))?;
        if !message.key.ends_with(&format!("/memory/{}", update.id)) {
            return Err(not_understood(format!("the update is of `{}`, not of its key", update.id)));
        }
        let sent_ns = message.sent_ns.unwrap_or_else(|| self.memory.now_ns());
        self.memory.commit_sent(vec![update], sent_ns)?;
        Ok(())
    }

    async fn tell(self, mut follower: Follower) {
        loop {
            match follower.next().await {
                Ok(Some(Change::New(snapshot))) => {
                    let (Ok(key), Ok((encoding, payload))) =
                        (wire::entity_key(&self.agent, &snapshot), wire::seal(&*snapshot))
                    else {
                        continue;
                    };
                    log_failure(self.session.put_waiting(&key, &encoding, payload).await);
                }
                Ok(Some(Change::Missed { id, from, to })) => {
                    tracing::warn!(%id, from, to, "versions were overtaken before they could be told");
                }
                Ok(None) => return,
                Err(error) => tracing::warn!(%error, "changes could not be read"),
            }
        }
    }
}

async fn refuse(question: &Question, error: &MemoryError) -> Result<(), SessionError> {
    match wire::seal(error) {
        Ok((encoding, payload)) => question.refuse(&encoding, payload).await,
        Err(_) => question.refuse("text/plain", error.to_string().into_bytes()).await,
    }
}

fn log_failure(sent: Result<(), SessionError>) {
    if let Err(error) = sent {
        tracing::warn!(%error, "an answer could not be sent");
    }
}
