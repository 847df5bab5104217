//! The memory that a command works on: a running agent's, or a file.

use std::io;
use std::path::Path;
use std::sync::Arc;

use armarium_bus::Session;
use armarium_knowledge::{AgentMemory, MemoryConfig, working_memory};
use armarium_memoryx::wire::{Maintain, MaintenanceReport};
use armarium_memoryx::{
    Backing, Clock, EntityId, LongTermMemory, Memory, MemoryError, MemoryLimits, Query, RemoteMemory,
    Snapshot, StoreError, WorkingMemory, maintain, pages,
};

use super::{CommandFailure, LOCAL, MemoryArgs, MemoryCommand};

/// Default listening endpoint of an agent.
pub(super) const USUAL_ENDPOINT: &str = "tcp/127.0.0.1:7447";
const MAX_SNAPSHOTS_PER_QUERY: usize = 4096;

pub(super) enum OpenedMemory {
    Agent {
        remote: RemoteMemory,
        session: Session,
    },
    /// The memory of an agent that nobody reaches, on a file.
    File(Box<AgentMemory>),
    /// A file as it is, also a damaged one: only what is asked for is read. Working memory is empty.
    Store {
        store: Arc<LongTermMemory>,
        memory: WorkingMemory,
    },
}

impl OpenedMemory {
    /// Opens the memory that the arguments name.
    pub(super) async fn open(args: &MemoryArgs) -> Result<Self, CommandFailure> {
        if let Some(file) = &args.store {
            args.only_a_file()?;
            let makes = matches!(args.command, MemoryCommand::Import { .. });
            if !makes {
                check_file(file)?;
            }
            let clock: Clock = Arc::new(wall_clock_ns);
            return if args.command.needs_working_memory() { held(file, clock) } else { stored(file, clock) };
        }
        Self::of_agent(args, &args.agent, None).await
    }

    /// Opens another memory to be read, too: a file's, or a running agent's, on this session if there is one.
    pub(super) async fn beside(
        args: &MemoryArgs,
        name: &str,
        session: Option<Session>,
    ) -> Result<Self, CommandFailure> {
        if let Some(file) = file_named(name) {
            check_file(file)?;
            return stored(file, Arc::new(wall_clock_ns));
        }
        Self::of_agent(args, name, session).await
    }

    async fn of_agent(
        args: &MemoryArgs,
        agent: &str,
        session: Option<Session>,
    ) -> Result<Self, CommandFailure> {
        let mut connection = args.connection.clone();
        if connection.connect.is_empty() {
            connection.connect = vec![USUAL_ENDPOINT.into()];
        }
        let session = match session {
            Some(session) => session,
            None => connection.session(None).await?,
        };
        let remote = match &args.writer {
            Some(writer) => RemoteMemory::connect_as(&session, agent, writer).await,
            None => RemoteMemory::connect(&session, agent).await,
        };
        let remote = remote.map_err(|error| match error {
            MemoryError::Remote { .. } => {
                let connect = connection.connect.join(" ");
                let whom = args.writer.as_ref().map_or("", |_| " under that name");
                CommandFailure::Refused(format!(
                    "{error}; is the agent running, does it listen at {connect}, and does it let you in{whom}?"
                ))
            }
            error => error.into(),
        })?;
        Ok(Self::Agent { remote, session })
    }

    pub(super) fn memory(&self) -> &dyn Memory {
        match self {
            Self::Agent { remote, .. } => remote,
            Self::File(agent) => &**agent.memory(),
            Self::Store { memory, .. } => memory,
        }
    }

    /// The running agent's memory, and the session on which it is reached.
    pub(super) fn agent(&self) -> Result<(&RemoteMemory, &Session), CommandFailure> {
        match self {
            Self::Agent { remote, session } => Ok((remote, session)),
            Self::File(_) | Self::Store { .. } => Err(CommandFailure::Argument(
                "only an agent that runs writes and follows others: give --agent instead of --store".into(),
            )),
        }
    }

    /// The time now, ns since 1970.
    pub(super) fn now_ns(&self) -> u64 {
        match self {
            Self::Agent { session, .. } => session.now_ns(),
            Self::File(agent) => agent.memory().now_ns(),
            Self::Store { memory, .. } => memory.now_ns(),
        }
    }

    /// Reads all snapshots of a query, piece by piece.
    pub(super) async fn each(
        &self,
        mut query: Query,
        mut act: impl FnMut(&Snapshot) -> Result<(), CommandFailure>,
    ) -> Result<u64, CommandFailure> {
        query.long_term |= matches!(self, Self::Store { .. });
        let mut count = 0;
        // The nearest are ordered by distance, and a bounded answer is one piece.
        if query.is_nearest() || query.most.is_some() {
            for snapshot in self.memory().query(&query).await? {
                act(&snapshot)?;
                count += 1;
            }
            return Ok(count);
        }
        let mut pieces = pages(query, MAX_SNAPSHOTS_PER_QUERY);
        while let Some(piece) = pieces.next(self.memory()).await? {
            for snapshot in piece {
                act(&snapshot)?;
                count += 1;
            }
        }
        Ok(count)
    }

    pub(super) async fn maintain(&self, request: Maintain) -> Result<MaintenanceReport, CommandFailure> {
        match self {
            Self::Agent { remote, .. } => Ok(remote.maintain(&request).await?),
            Self::File(agent) => {
                Ok(maintain::carry_out(request, agent.store().map(Arc::as_ref), agent.memory())?)
            }
            Self::Store { store, memory } => {
                let mut report = maintain::carry_out(request, Some(store), memory)?;
                report.counts.retain(|name, _| !name.starts_with("working_"));
                Ok(report)
            }
        }
    }
}

/// The file that a name beside others means; other names are agents'.
pub(super) fn file_named(name: &str) -> Option<&Path> {
    (name.contains('/') || name.ends_with(".redb")).then(|| Path::new(name))
}

fn check_file(file: &Path) -> Result<(), CommandFailure> {
    let absent = || CommandFailure::Argument(format!("there is no file `{}`", file.display()));
    if file.exists() { Ok(()) } else { Err(absent()) }
}

fn held(file: &Path, clock: Clock) -> Result<OpenedMemory, CommandFailure> {
    let config = MemoryConfig { limits: MemoryLimits::default(), ..MemoryConfig::new(LOCAL) };
    let opened = AgentMemory::open(config.with_store(file), clock);
    let agent = opened.map_err(|error| match LongTermMemory::open(file) {
        Err(locked @ StoreError::Locked { .. }) => locked.into(),
        _ => CommandFailure::from(error),
    })?;
    Ok(OpenedMemory::File(Box::new(agent)))
}

fn stored(file: &Path, clock: Clock) -> Result<OpenedMemory, CommandFailure> {
    let store = Arc::new(LongTermMemory::open(file)?);
    let memory = working_memory(clock).with_backing(Arc::clone(&store) as Arc<dyn Backing>);
    Ok(OpenedMemory::Store { store, memory })
}

/// The wall clock, ns since 1970.
#[allow(clippy::disallowed_methods, reason = "commands are the edge at which it is read")]
pub(super) fn wall_clock_ns() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

/// An address from the command line.
pub(super) fn id(text: &str) -> Result<EntityId, CommandFailure> {
    match text.split('/').collect::<Vec<_>>()[..] {
        [segment, provider, entity] => Ok(EntityId::new(segment, provider, entity)?),
        _ => Err(CommandFailure::Argument(format!("`{text}` is not SEGMENT/PROVIDER/ENTITY"))),
    }
}

/// A file that cannot be read or written.
pub(super) fn unusable(path: &Path, error: &io::Error) -> CommandFailure {
    CommandFailure::Argument(format!("`{}` cannot be used: {error}", path.display()))
}
