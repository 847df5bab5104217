//! The memory of one agent, put together: working memory on a long-term file, shared over Zenoh, following others.
//!
//! This is what a program runs for an agent; it reads no command line and opens no session.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use tokio::task::JoinSet;

use crate::error::MemoryError;
use crate::infer::{Attached, Inference};
use crate::prior::PriorKnowledge;
use crate::query::Pattern;
use crate::remote::RemoteMemory;
use crate::server::MemoryServer;
use crate::share::{FollowSettings, Following};
use crate::store::{Consolidator, LongTermMemory, Policies, Policy, Retention};
use crate::working::{Limits, WorkingMemory};

/// How often long-term memory forgets what is old or too much.
const RETAIN_EVERY: Duration = Duration::from_secs(60);
/// How long to wait before an agent that is not there is looked for again.
const AGAIN: Duration = Duration::from_secs(1);

/// How an agent's memory is put together.
#[derive(Clone, Debug)]
pub struct AgentConfig {
    /// The agent.
    pub name: String,
    /// The file of long-term memory; none is kept where none is given.
    pub store: Option<PathBuf>,
    /// What of working memory is kept; it is durable when a commit is acknowledged.
    pub policies: Policies,
    /// How much is kept.
    pub retention: Retention,
    /// How much working memory holds.
    pub limits: Limits,
    /// Whom it follows.
    pub follow: Vec<FollowSettings>,
    /// What is known before anything is seen.
    pub prior: PriorKnowledge,
    /// What concludes something from its memory.
    pub infer: Vec<Arc<dyn Inference>>,
    /// Whether only named writers may write, each his own provider segments.
    pub guarded: bool,
}

impl AgentConfig {
    /// An agent that keeps nothing and follows nobody.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            store: None,
            policies: Policies::all(Policy::Everything),
            retention: Retention::default(),
            limits: Limits::of_agent(),
            follow: Vec::new(),
            prior: PriorKnowledge::new(),
            infer: Vec::new(),
            guarded: false,
        }
    }

    /// The same agent with long-term memory in a file.
    #[must_use]
    pub fn with_store(mut self, store: impl Into<PathBuf>) -> Self {
        self.store = Some(store.into());
        self
    }
}

/// An agent's memory, shared for as long as this lives.
#[derive(Debug)]
pub struct AgentMemory {
    memory: Arc<WorkingMemory>,
    store: Option<Arc<LongTermMemory>>,
    _server: MemoryServer,
    _inferences: Vec<Attached>,
    _tasks: JoinSet<()>,
}

impl AgentMemory {
    /// Opens the file, loads what was known last, and shares it. Times are those of the session: ns since 1970.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the file cannot be used; as [`MemoryServer::start`].
    pub async fn start(session: &Session, config: AgentConfig) -> Result<Self, MemoryError> {
        let clock = session.clone();
        let mut memory = WorkingMemory::new(Arc::new(move || clock.now_ns())).with_limits(config.limits);
        let store = config.store.as_deref().map(LongTermMemory::open).transpose()?.map(Arc::new);
        if let Some(store) = &store {
            memory =
                memory.with_backing(Arc::new(Consolidator::new(Arc::clone(store), config.policies.clone())));
            store.load_into(&memory, Pattern::any())?;
        }
        config.prior.put_into(&memory)?;
        let memory = Arc::new(memory);
        let (shared, kept) = (Arc::clone(&memory), store.clone());
        let server = MemoryServer::start_guarded(session, &config.name, shared, kept, config.guarded).await?;
        let attach = |inference| {
            let (clock, memory) = (session.clone(), Arc::<WorkingMemory>::clone(&memory));
            Attached::start(memory, inference, Arc::new(move || clock.now_ns()))
        };
        let inferences = config.infer.into_iter().map(attach).collect();
        let mut tasks = JoinSet::new();
        for settings in config.follow {
            tasks.spawn(follow(session.clone(), Arc::clone(&memory), settings));
        }
        if let Some(store) = store.clone().filter(|_| config.retention != Retention::default()) {
            tasks.spawn(keep_within(store, Arc::clone(&memory), config.retention));
        }
        Ok(Self { memory, store, _server: server, _inferences: inferences, _tasks: tasks })
    }

    /// What it knows now.
    #[must_use]
    pub fn memory(&self) -> &Arc<WorkingMemory> {
        &self.memory
    }

    /// What it keeps.
    #[must_use]
    pub fn store(&self) -> Option<&Arc<LongTermMemory>> {
        self.store.as_ref()
    }
}

/// Follows an agent, who may not be there yet.
async fn follow(session: Session, memory: Arc<WorkingMemory>, settings: FollowSettings) {
    loop {
        match RemoteMemory::connect(&session, &settings.agent).await {
            Ok(remote) => {
                let started = Following::start(Arc::new(remote), Arc::clone(&memory), settings.clone()).await;
                match started {
                    Ok(_following) => std::future::pending::<()>().await,
                    Err(error) => tracing::warn!(%error, agent = settings.agent, "cannot be followed"),
                }
            }
            Err(error) => tracing::info!(%error, agent = settings.agent, "waiting for a memory to follow"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

/// Has long-term memory forget what is too old or too much, every minute, for as long as it is waited for; the time is
/// `memory`'s.
pub async fn keep_within(store: Arc<LongTermMemory>, memory: Arc<WorkingMemory>, retention: Retention) {
    while retention != Retention::default() {
        tokio::time::sleep(RETAIN_EVERY).await;
        let (store, now_ns) = (Arc::clone(&store), memory.now_ns());
        match tokio::task::spawn_blocking(move || store.retain(retention, now_ns)).await {
            Ok(Ok(dropped)) if dropped.snapshots > 0 => {
                tracing::info!(
                    snapshots = dropped.snapshots,
                    bytes = dropped.bytes,
                    "long-term memory has forgotten"
                );
            }
            Ok(Err(error)) => tracing::warn!(%error, "long-term memory could not forget"),
            Ok(Ok(_)) | Err(_) => {}
        }
    }
}
