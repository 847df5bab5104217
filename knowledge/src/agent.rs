//! The memory of one agent, put together: working memory on a long-term file, shared over Zenoh, following others.
//!
//! Every program opens an agent's memory here, also a run in virtual time. This file reads no command line and opens
//! no session.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{
    Backing, Clock, Consolidator, Dropped, Loading, LongTermMemory, MemoryError, MemoryLimits, MemoryServer,
    Pattern, Policies, Policy, RemoteMemory, Retention, ServerOptions, WorkingMemory,
};
use tokio::task::JoinSet;

use crate::infer::{Inference, RunningInference};
use crate::prior::PriorKnowledge;
use crate::share::{FollowSettings, Following};

/// How often snapshots are stored that a policy has held back for long enough.
const FLUSH_INTERVAL: Duration = Duration::from_secs(5);
/// How often what expires is looked for.
const EXPIRY_INTERVAL: Duration = Duration::from_millis(500);
/// How often long-term memory forgets what is old or too much.
const RETENTION_INTERVAL: Duration = Duration::from_secs(60);
/// How long to wait before connecting again to an agent that is absent.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// How an agent's memory is put together.
#[derive(Clone, Debug)]
pub struct MemoryConfig {
    /// The agent.
    pub name: String,
    /// The file of long-term memory; `None` keeps nothing.
    pub store: Option<PathBuf>,
    /// Whether other processes use the file at the same time; otherwise it is locked for as long as the agent lives.
    pub shared: bool,
    /// What long-term memory keeps of working memory; it is on disk when a commit is acknowledged.
    pub policies: Policies,
    /// Which part of long-term memory is loaded into working memory at the start; queries reach all of it.
    pub restored: Restored,
    /// How much is kept.
    pub retention: Retention,
    /// How much working memory holds.
    pub limits: MemoryLimits,
    /// The agents that it follows.
    pub follow: Vec<FollowSettings>,
    /// Prior knowledge.
    pub prior: PriorKnowledge,
    /// The inferences that run on its memory.
    pub infer: Vec<Arc<dyn Inference>>,
    /// Whether only named writers may write, each only into their own provider segments.
    pub guarded: bool,
}

impl MemoryConfig {
    /// An agent without long-term memory that follows no one.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            store: None,
            shared: false,
            policies: Policies::all(Policy::Everything),
            restored: Restored::All,
            retention: Retention::default(),
            limits: MemoryLimits::of_agent(),
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

/// Which core segments of the file are loaded into working memory at the start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Restored {
    /// All of them.
    All,
    /// Only these.
    Only(Vec<String>),
    /// All but these.
    AllBut(Vec<String>),
}

impl Restored {
    fn has(&self, segment: &str) -> bool {
        let names = |list: &[String]| list.iter().any(|name| name == segment);
        match self {
            Self::All => true,
            Self::Only(list) => names(list),
            Self::AllBut(list) => !names(list),
        }
    }
}

/// An agent's memory. After [`Self::share`] others can use it, until this is dropped.
pub struct AgentMemory {
    memory: Arc<WorkingMemory>,
    kept: Option<Arc<Consolidator>>,
    clock: Clock,
    server: Option<MemoryServer>,
    inferences: Vec<RunningInference>,
    tasks: JoinSet<()>,
    _loading: Option<Loading>,
}

impl fmt::Debug for AgentMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AgentMemory").field("memory", &self.memory).field("server", &self.server).finish()
    }
}

impl AgentMemory {
    /// Opens the file and restores its content. Where everything is restored and the runtime has several threads, that goes on
    /// after this returns: until then, what was not read yet is looked up in the file. Nothing is shared yet.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the file cannot be used; as [`WorkingMemory::commit_now`] for prior knowledge.
    pub fn open(config: &MemoryConfig, clock: Clock) -> Result<Self, MemoryError> {
        let mut memory = WorkingMemory::new(Arc::clone(&clock)).with_limits(config.limits);
        let mut kept = None;
        if let Some(file) = &config.store {
            let open = if config.shared { LongTermMemory::open_shared } else { LongTermMemory::open };
            let store = Arc::new(open(file)?);
            let consolidator = Arc::new(Consolidator::new(Arc::clone(&store), config.policies.clone())?);
            memory = memory.with_backing(Arc::clone(&consolidator) as Arc<dyn Backing>);
            kept = Some(consolidator);
        }
        let memory = Arc::new(memory);
        let loading = match kept.as_ref().map(|kept| kept.store()) {
            Some(store) if config.restored == Restored::All => Some(store.load_beside(&memory)?),
            Some(store) => {
                for segment in store.segments()?.iter().filter(|segment| config.restored.has(segment)) {
                    store.load_into(&memory, Pattern::segment(segment))?;
                }
                None
            }
            None => None,
        };
        config.prior.put_into(&memory)?;
        let tasks = JoinSet::new();
        Ok(Self { memory, kept, clock, server: None, inferences: Vec::new(), tasks, _loading: loading })
    }

    /// Serves the memory over `session`, follows other agents, runs inferences and retention, as the configuration
    /// says.
    ///
    /// # Errors
    /// As [`MemoryServer::start`].
    pub async fn share(&mut self, session: &Session, config: &MemoryConfig) -> Result<(), MemoryError> {
        let (shared, store) = (Arc::clone(&self.memory), self.store().cloned());
        let options = ServerOptions { store: store.clone(), guarded: config.guarded };
        self.server = Some(MemoryServer::start(session, &config.name, shared, options).await?);
        for inference in &config.infer {
            let memory = Arc::<WorkingMemory>::clone(&self.memory);
            let attached = RunningInference::start(memory, Arc::clone(inference), Arc::clone(&self.clock));
            self.inferences.push(attached);
        }
        for settings in &config.follow {
            self.tasks.spawn(follow(session.clone(), Arc::clone(&self.memory), settings.clone()));
        }
        self.tasks.spawn(remove_expired(Arc::clone(&self.memory)));
        if let Some(kept) = &self.kept {
            self.tasks.spawn(flush_now_and_then(Arc::clone(kept), Arc::clone(&self.memory)));
        }
        if let Some(store) = store.filter(|_| config.retention != Retention::default()) {
            self.tasks.spawn(keep_within(store, Arc::clone(&self.memory), config.retention));
        }
        Ok(())
    }

    /// [`Self::open`], then [`Self::share`]. Times are the session's: ns since 1970.
    ///
    /// # Errors
    /// As [`Self::open`] and [`Self::share`].
    pub async fn start(session: &Session, config: MemoryConfig) -> Result<Self, MemoryError> {
        let clock = session.clone();
        let mut agent = Self::open(&config, Arc::new(move || clock.now_ns()))?;
        agent.share(session, &config).await?;
        Ok(agent)
    }

    /// The working memory.
    pub fn memory(&self) -> &Arc<WorkingMemory> {
        &self.memory
    }

    /// The long-term memory, if the agent has one.
    pub fn store(&self) -> Option<&Arc<LongTermMemory>> {
        self.kept.as_ref().map(|kept| kept.store())
    }

    /// Writes the snapshots that policies have held back so far; so does dropping this.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the file cannot be written.
    pub fn flush(&self) -> Result<(), MemoryError> {
        self.kept.as_ref().map_or(Ok(()), |kept| Ok(kept.flush().map(|_| ())?))
    }
}

/// Follows an agent that may not be there yet.
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
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

impl Drop for AgentMemory {
    fn drop(&mut self) {
        if let Err(error) = self.flush() {
            tracing::warn!(%error, "what was held back is not in long-term memory");
        }
    }
}

/// Stores what a policy has held back for long enough. It never returns.
async fn flush_now_and_then(kept: Arc<Consolidator>, memory: Arc<WorkingMemory>) {
    loop {
        tokio::time::sleep(FLUSH_INTERVAL).await;
        let (kept, now_ns) = (Arc::clone(&kept), memory.now_ns());
        if let Ok(Err(error)) = tokio::task::spawn_blocking(move || kept.flush_due(now_ns)).await {
            tracing::warn!(%error, "what was held back could not be stored");
        }
    }
}

/// Removes what expires. It never returns.
async fn remove_expired(memory: Arc<WorkingMemory>) {
    loop {
        tokio::time::sleep(EXPIRY_INTERVAL).await;
        if !memory.has_expired() {
            continue;
        }
        let memory = Arc::clone(&memory);
        if let Ok(Err(error)) = tokio::task::spawn_blocking(move || memory.remove_expired()).await {
            tracing::warn!(%error, "what has expired could not be removed");
        }
    }
}

/// Applies retention to long-term memory every minute, by `memory`'s clock. It never returns.
async fn keep_within(store: Arc<LongTermMemory>, memory: Arc<WorkingMemory>, retention: Retention) {
    loop {
        tokio::time::sleep(RETENTION_INTERVAL).await;
        let (store, now_ns) = (Arc::clone(&store), memory.now_ns());
        match tokio::task::spawn_blocking(move || store.keep_within(retention, now_ns)).await {
            Ok(Ok(dropped)) if dropped.over > 0 => {
                tracing::warn!(
                    bytes = dropped.over,
                    "long-term memory is larger than it is to be: the newest of each entity and named snapshots stay"
                );
            }
            Ok(Ok(Dropped { snapshots, bytes, .. })) if snapshots > 0 => {
                tracing::info!(snapshots, bytes, "long-term memory has forgotten");
            }
            Ok(Err(error)) => tracing::warn!(%error, "long-term memory could not forget"),
            Ok(Ok(_)) | Err(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use armarium_memoryx::Commit;

    use super::*;

    /// What policies do not store has versions, too. The copy of an open file stands for the file of a killed process.
    #[test]
    fn acknowledged_versions_are_never_given_again() {
        let folder = tempfile::tempdir().unwrap();
        let policies = Policies::all(Policy::AtMost { hz: 1.0 })
            .with("Kept", Policy::Everything)
            .with("Changed", Policy::OnChange)
            .with("Lost", Policy::Nothing);
        let open = |path: &Path| {
            let config = MemoryConfig { policies: policies.clone(), ..MemoryConfig::new("a") };
            AgentMemory::open(&config.with_store(path), Arc::new(|| 1)).unwrap()
        };
        let names = ["Kept/p/e", "Changed/p/e", "Lost/p/e", "Rated/p/e"];
        let commit = |agent: &AgentMemory, id: &str, expected: Option<u64>| {
            let update = Commit::new(id.parse().unwrap(), 7, []);
            agent.memory().commit_now(vec![Commit { expected_version: expected, ..update }])
        };
        let (path, killed) = (folder.path().join("ended.redb"), folder.path().join("killed.redb"));
        let mut last = 0;
        for _ in 0..2 {
            let agent = open(&path);
            for _ in 0..1500 {
                let versions = names.map(|id| commit(&agent, id, None).unwrap()[0]);
                assert_eq!(versions, [last + 1; 4], "an end in good order leaves no gap");
                last += 1;
            }
            std::fs::copy(&path, &killed).unwrap();
        }
        let agent = open(&killed);
        for id in names {
            assert!(id.starts_with("Kept") || commit(&agent, id, Some(last)).is_err(), "{id}");
            let version = commit(&agent, id, None).unwrap()[0];
            assert!(version > last && (version == last + 1 || !id.starts_with("Kept")), "{id} has {version}");
        }
        assert_eq!(commit(&agent, "Rated/p/new", None), Ok(vec![1]), "a new name begins at 1");
    }
}
