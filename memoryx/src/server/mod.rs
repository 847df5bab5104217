//! Shares a working memory over Zenoh: answers commits and queries, takes updates, and publishes every change.
//!
//! A publisher that lags reads the memory: a network that is slow for a while loses nothing that the memory still has.
//! Changes that wait together are sent together, by core segment. A slow reader does not block the others: Zenoh drops what its link
//! does not take. The reader sees the gap in the next message or, when nothing more changes, in the number of changes
//! that an idle memory publishes, and queries the rest. Commits that wait together are made durable together. What
//! others send is checked like any commit. What cannot be decoded is refused or, where the sender expects no answer,
//! logged with its sender.

use std::sync::Arc;

use armarium_bus::{
    AliveToken, IncomingQuery, Key, Message, Payload, Queryable, Session, SessionError, Subscription, keys,
};
use parking_lot::FairMutex;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::entity::Commit;
use crate::error::MemoryError;
use crate::store::LongTermMemory;
use crate::wire::{self, CommitRequest, Versions};
use crate::working::WorkingMemory;

mod askers;
mod asking;
mod publish;
mod refusals;

use askers::Askers;
use publish::ChangePublisher;
use refusals::{Refusals, is_senders_fault};

/// Queries and updates that wait to be decoded.
const QUEUE: usize = 1024;
/// Updates without an answer that are committed together.
const MAX_GROUP: usize = 256;
/// Budget for queries that wait or are being answered, and for commits that wait, kB each.
const BUDGET_KB: u32 = 64 << 10;

/// A memory that is shared until this is dropped.
#[derive(Debug)]
pub struct MemoryServer {
    _alive: AliveToken,
    _tasks: JoinSet<()>,
}

/// What a shared memory allows.
#[derive(Clone, Debug, Default)]
pub struct ServerOptions {
    /// The long-term memory whose maintenance others may request.
    pub store: Option<Arc<LongTermMemory>>,
    /// Whether only named writers may write, each only into their own provider segments, and only the agent itself may
    /// request maintenance. The session's rules ([`armarium_bus::Access`]) guarantee the writer's name.
    pub guarded: bool,
}

impl MemoryServer {
    /// Shares a memory as the memory of `agent`.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the agent's name cannot be part of a key; [`MemoryError::Remote`] when Zenoh fails.
    pub async fn start(
        session: &Session,
        agent: &str,
        memory: Arc<WorkingMemory>,
        options: ServerOptions,
    ) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, error);
        let entities = wire::every_entity(agent)?;
        let publisher = ChangePublisher::new(session, agent, Arc::clone(&memory)).await?;
        let shared = ServedMemory {
            session: session.clone(),
            agent: agent.into(),
            memory,
            options,
            askers: Arc::new(Askers::new()),
            waiting: Arc::new(Semaphore::new(BUDGET_KB as usize)),
            turn: Arc::default(),
            refusals: Arc::default(),
        };
        let mut tasks = JoinSet::new();
        for key in [keys::memory_by_pattern(agent)?, keys::memory_commit(agent)?.into()] {
            let questions = session.declare_queryable(key, QUEUE).await.map_err(failed)?;
            tasks.spawn(shared.clone().answer_requests(questions));
        }
        let gets = session.declare_queryable(entities.clone(), QUEUE).await.map_err(failed)?;
        tasks.spawn(shared.clone().answer_gets(gets));
        let updates = session.subscribe_others(entities.clone(), QUEUE).await.map_err(failed)?;
        tasks.spawn(shared.take_updates(updates));
        tasks.spawn(publisher.publish());
        let alive = session.alive(&keys::alive(agent, "memory")?).await.map_err(failed)?;
        Ok(Self { _alive: alive, _tasks: tasks })
    }
}

pub(crate) fn unreachable_memory(agent: &str, what: impl ToString) -> MemoryError {
    MemoryError::Remote { agent: agent.into(), what: what.to_string() }
}

/// The encoding and the bytes of an answer, or the refusal.
type Response = Result<(String, Vec<u8>), MemoryError>;

#[derive(Clone)]
struct ServedMemory {
    session: Session,
    agent: String,
    memory: Arc<WorkingMemory>,
    options: ServerOptions,
    askers: Arc<Askers>,
    /// Budget for commits that wait, kB.
    waiting: Arc<Semaphore>,
    /// Held by the query that computes.
    turn: Arc<FairMutex<()>>,
    refusals: Arc<Refusals>,
}

impl ServedMemory {
    /// Takes requests in the order of their arrival, and answers each in a task of its own: an asker that takes nothing
    /// holds nobody else up.
    async fn answer_requests(self, mut questions: Queryable) {
        let mut answers = JoinSet::new();
        while let Some(mut question) = questions.next().await {
            let shared = self.clone();
            if question.encoding.starts_with("application/cbor;memoryx/commit;") {
                // Further requests wait in Zenoh's queue while so many commits wait for the disk.
                let kb = u32::try_from(question.payload.len() / 1024 + 1).unwrap_or(BUDGET_KB).min(BUDGET_KB);
                let waiting = Arc::clone(&self.waiting).acquire_many_owned(kb).await;
                let versions = self.begin_commit(&question);
                question.payload = Vec::new();
                answers.spawn(async move {
                    let versions = async { versions?.await }.await;
                    drop(waiting);
                    let sealed = versions.and_then(|versions| shared.sealed(&Versions(versions)));
                    shared.send(&question, sealed).await;
                });
            } else {
                answers.spawn(shared.answer_aside(question));
            }
            while answers.try_join_next().is_some() {}
        }
    }

    /// Takes a request that is valid and permitted into the order of commits.
    fn begin_commit(
        &self,
        question: &IncomingQuery,
    ) -> Result<impl Future<Output = Result<Vec<u64>, MemoryError>> + Send + use<>, MemoryError> {
        let request: CommitRequest = self.opened(&question.encoding, &question.payload)?;
        self.check_permitted(question, &request)?;
        Ok(self.memory.enqueue(request.updates, request.sent_ns))
    }

    fn opened<T: Payload>(&self, encoding: &str, payload: &[u8]) -> Result<T, MemoryError> {
        wire::open(encoding, payload).map_err(|error| unreachable_memory(&self.agent, error))
    }

    fn sealed<T: Payload>(&self, content: &T) -> Response {
        wire::seal(content).map_err(|error| unreachable_memory(&self.agent, error))
    }

    async fn send(&self, question: &IncomingQuery, answer: Response) {
        // A query to all memories at once is answered on this memory's own key.
        let key = Key::parse(&question.key).or_else(|_| keys::memory_commit(&self.agent));
        let sent = match answer.and_then(|answer| Ok((answer, key?))) {
            Ok(((encoding, payload), key)) => question.reply(&key, &encoding, payload).await,
            Err(error) => self.refuse(question, &error).await,
        };
        log_failure(sent);
    }

    /// The writer named in a query's key.
    fn writer<'q>(&self, question: &'q IncomingQuery) -> Option<&'q str> {
        match question.key.split('/').collect::<Vec<_>>()[..] {
            [_, "memory", "by", writer] => Some(writer),
            _ => None,
        }
    }

    /// Checks that a request's writer may write all of it.
    fn check_permitted(&self, question: &IncomingQuery, request: &CommitRequest) -> Result<(), MemoryError> {
        let is_own = |writer: &str, provider: &str| {
            writer == self.agent
                || provider.strip_prefix(writer).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        let writer = self.writer(question);
        let forbidden = request.updates.iter().find(|update| match writer {
            Some(writer) => !is_own(writer, update.id.provider()),
            None => self.options.guarded,
        });
        forbidden.map_or(Ok(()), |update| Err(forbid(update.id.to_string(), writer)))
    }

    /// Sends the refusal to the caller, and logs the sender.
    async fn refuse(&self, question: &IncomingQuery, error: &MemoryError) -> Result<(), SessionError> {
        if is_senders_fault(error) {
            let said = self.writer(question).or(question.sender.as_deref());
            self.refusals.note(&self.session.sender(said), &question.key, error);
        }
        match wire::seal(error) {
            Ok((encoding, payload)) => question.refuse(&encoding, payload).await,
            Err(_) => question.refuse("text/plain", error.to_string().into_bytes()).await,
        }
    }

    async fn take_updates(self, mut updates: Subscription) {
        let mut dropped = 0;
        while let Some(message) = updates.next().await {
            let waiting = std::iter::once(message).chain(std::iter::from_fn(|| updates.try_next()));
            let group = waiting.take(MAX_GROUP).map(|message| (self.begin_update(&message), message));
            for (begun, message) in group.collect::<Vec<_>>() {
                if let Err(error) = async { begun?.await }.await {
                    let sender = self.session.sender(message.sender.as_deref());
                    self.refusals.note(&sender, &message.key, &error);
                }
            }
            // Logged whenever the count has doubled, so that a flood gives few lines.
            if updates.dropped() > 2 * dropped {
                dropped = updates.dropped();
                tracing::warn!(dropped, "updates came faster than they could be taken");
            }
        }
    }

    fn begin_update(
        &self,
        message: &Message,
    ) -> Result<impl Future<Output = Result<Vec<u64>, MemoryError>> + Send + use<>, MemoryError> {
        let update: Commit = self.opened(&message.encoding, &message.payload)?;
        if !message.key.ends_with(&format!("/memory/{}", update.id)) {
            let what = format!("the update is of `{}`, not of its key", update.id);
            return Err(unreachable_memory(&self.agent, what));
        }
        let sent_ns = message.sent_ns.unwrap_or_else(|| self.memory.now_ns());
        Ok(self.memory.enqueue(vec![update], sent_ns))
    }
}

fn forbid(id: String, writer: Option<&str>) -> MemoryError {
    MemoryError::Forbidden { id, writer: writer.unwrap_or("somebody without a name").into() }
}

fn log_failure(sent: Result<(), SessionError>) {
    if let Err(error) = sent {
        tracing::warn!(%error, "an answer could not be sent");
    }
}
