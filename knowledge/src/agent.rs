//! The memory of one agent, put together: working memory on a long-term file, shared over Zenoh, following others.
//!
//! Every program opens, shares and follows memories here, also a run in virtual time. This file reads no command line and
//! opens no session.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Access, Session};
use armarium_memoryx::{
    Backing, Clock, Consolidator, Dropped, Loading, LongTermMemory, MemoryError, MemoryLimits, MemoryServer,
    Pattern, Policies, Policy, Retention, ServerOptions, WorkingMemory,
};
use tokio::runtime::Handle;
use tokio::task::JoinSet;

use crate::core_segments::working_memory;
use crate::infer::{Inference, RunningInference};
use crate::prior::PriorKnowledge;
use crate::share::{FollowedAgent, Followee, FollowingAgent};

/// How often snapshots are stored that a policy has held back for long enough.
const FLUSH_INTERVAL: Duration = Duration::from_secs(5);
/// How often what expires is looked for.
const EXPIRY_INTERVAL: Duration = Duration::from_millis(500);
/// How often long-term memory forgets what is old or too much.
const RETENTION_INTERVAL: Duration = Duration::from_secs(60);

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
    /// The agents that it follows, as soon as they are there.
    pub follow: Vec<Followee>,
    /// The provider segment of `ObjectInstances` into which followed objects are fused, too.
    pub fuse_into: Option<String>,
    /// Prior knowledge.
    pub prior: PriorKnowledge,
    /// The inferences that run on its memory.
    pub infer: Vec<Arc<dyn Inference>>,
    /// The access rules of its session, if it has any: then only named writers may write, each only into their own provider
    /// segments, and whom it follows has to be named.
    pub access: Option<Access>,
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
            fuse_into: None,
            prior: PriorKnowledge::new(),
            infer: Vec::new(),
            access: None,
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

/// An agent's memory.
pub struct AgentMemory {
    config: MemoryConfig,
    memory: Arc<WorkingMemory>,
    kept: Option<Arc<Consolidator>>,
    clock: Clock,
    _loading: Option<Loading>,
    _expiry: JoinSet<()>,
}

/// What makes an agent's memory known to others and others' memories known to it, and runs its inferences and upkeep, until
/// it is dropped.
pub struct ServedMemory {
    _server: MemoryServer,
    _inferences: Vec<RunningInference>,
    _tasks: JoinSet<()>,
}

impl fmt::Debug for AgentMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AgentMemory").field("config", &self.config).finish_non_exhaustive()
    }
}

impl AgentMemory {
    /// Opens the file and restores its content. Where everything is restored and the runtime has several threads, that goes on
    /// after this returns: until then, what was not read yet is looked up in the file. What expires is removed, inside a tokio
    /// runtime. Nothing is shared yet.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the file cannot be used; as [`WorkingMemory::commit_now`] for prior knowledge.
    pub fn open(config: MemoryConfig, clock: Clock) -> Result<Self, MemoryError> {
        let mut memory = working_memory(Arc::clone(&clock)).with_limits(config.limits);
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
        let mut expiry = JoinSet::new();
        if let Ok(runtime) = Handle::try_current() {
            expiry.spawn_on(remove_expired(Arc::clone(&memory)), &runtime);
        }
        Ok(Self { config, memory, kept, clock, _loading: loading, _expiry: expiry })
    }

    /// Serves the memory over `session`, follows other agents, runs inferences and retention, as the configuration
    /// says.
    ///
    /// # Errors
    /// [`MemoryError::Remote`] when it is to follow an agent that its own access rules keep out; as [`MemoryServer::start`].
    pub async fn share(&self, session: &Session) -> Result<ServedMemory, MemoryError> {
        let (config, memory) = (&self.config, || Arc::clone(&self.memory));
        for Followee { agent, .. } in &config.follow {
            if config.access.as_ref().is_some_and(|access| !access.admits(agent)) {
                let what = format!(
                    "the access rules of `{}` do not name it, so that nothing comes from it: name it, as a reader for instance",
                    config.name
                );
                return Err(MemoryError::Remote { agent: agent.clone(), what });
            }
        }
        let options = ServerOptions { store: self.store().cloned(), guarded: config.access.is_some() };
        let server = MemoryServer::start(session, &config.name, memory(), options).await?;
        let infer = |inference: &Arc<dyn Inference>| {
            RunningInference::start(memory(), Arc::clone(inference), Arc::clone(&self.clock))
        };
        let inferences = config.infer.iter().map(infer).collect();
        let mut tasks = JoinSet::new();
        for other in config.follow.clone() {
            let following = self.following(session);
            tasks.spawn(async move { following.keep_following(&other).await });
        }
        if let Some(kept) = &self.kept {
            tasks.spawn(flush_now_and_then(Arc::clone(kept), memory()));
        }
        if let Some(store) = self.store().filter(|_| config.retention != Retention::default()) {
            tasks.spawn(keep_within(Arc::clone(store), memory(), config.retention));
        }
        Ok(ServedMemory { _server: server, _inferences: inferences, _tasks: tasks })
    }

    /// Follows an agent that is there, from now on.
    ///
    /// # Errors
    /// [`MemoryError::Remote`] when no memory answers under that name, or the agent does not publish its pose.
    pub async fn follow(&self, session: &Session, other: &Followee) -> Result<FollowedAgent, MemoryError> {
        self.following(session).follow(other).await
    }

    fn following(&self, session: &Session) -> FollowingAgent {
        FollowingAgent {
            session: session.clone(),
            memory: Arc::clone(&self.memory),
            own: self.config.name.clone(),
            fuse_into: self.config.fuse_into.clone(),
        }
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
            AgentMemory::open(config.with_store(path), Arc::new(|| 1)).unwrap()
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

    #[test]
    fn its_core_segments_are_checked() {
        let agent = AgentMemory::open(MemoryConfig::new("a"), Arc::new(|| 1)).unwrap();
        let nameless = Commit::new("ObjectInstances/p/cup".parse().unwrap(), 1, []);
        let refused = agent.memory().commit_now(vec![nameless]);
        let is_class = |attribute: &str| attribute == "class";
        assert!(matches!(refused, Err(MemoryError::Schema { attribute, .. }) if is_class(&attribute)));
    }

    #[tokio::test(start_paused = true)]
    async fn what_expires_is_removed_also_where_nothing_is_shared() {
        let agent = AgentMemory::open(MemoryConfig::new("a"), armarium_memoryx::tokio_clock()).unwrap();
        let id: armarium_memoryx::EntityId = "S/p/e".parse().unwrap();
        let until = ("expires_ns", armarium_values::Value::Int(2_000_000_000));
        agent.memory().commit_now(vec![Commit::new(id.clone(), 0, [until])]).unwrap();
        tokio::time::sleep(Duration::from_millis(1900)).await;
        assert!(agent.memory().latest_now(&id).is_ok());
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert!(agent.memory().latest_now(&id).is_err());
    }
}
