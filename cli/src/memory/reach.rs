//! The memory that a command works on: a running agent's, or a file.

use std::io;
use std::path::Path;
use std::sync::Arc;

use armarium_bus::Session;
use armarium_memoryx::wire::{Maintain, MaintenanceReport};
use armarium_memoryx::{
    EntityId, LongTermMemory, Memory, MemoryError, Pattern, Query, RemoteMemory, Snapshot, WorkingMemory,
    maintain, pages,
};

use super::{CommandFailure, MemoryArgs, MemoryCommand};

/// Default listening endpoint of an agent.
pub(super) const USUAL_ENDPOINT: &str = "tcp/127.0.0.1:7447";
const MAX_SNAPSHOTS_PER_QUERY: usize = 4096;

pub(super) enum OpenedMemory {
    Agent { remote: RemoteMemory, session: Session },
    File { store: Arc<LongTermMemory>, memory: Arc<WorkingMemory> },
}

impl OpenedMemory {
    /// Opens the memory that the arguments name.
    pub(super) async fn open(args: &MemoryArgs) -> Result<Self, CommandFailure> {
        if let Some(file) = &args.store {
            args.only_a_file()?;
            let makes = matches!(args.command, MemoryCommand::Import { .. });
            if !makes && !file.exists() {
                return Err(CommandFailure::Argument(format!("there is no file `{}`", file.display())));
            }
            let store = Arc::new(LongTermMemory::open(file)?);
            let memory = Arc::new(opened(&store)?);
            return Ok(Self::File { store, memory });
        }
        let mut connection = args.connection.clone();
        if connection.connect.is_empty() {
            connection.connect = vec![USUAL_ENDPOINT.into()];
        }
        let session = connection.session(None).await?;
        let remote = match &args.writer {
            Some(writer) => RemoteMemory::connect_as(&session, &args.agent, writer).await,
            None => RemoteMemory::connect(&session, &args.agent).await,
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
            Self::File { memory, .. } => &**memory,
        }
    }

    /// The time now, ns since 1970.
    pub(super) fn now_ns(&self) -> u64 {
        match self {
            Self::Agent { session, .. } => session.now_ns(),
            Self::File { memory, .. } => memory.now_ns(),
        }
    }

    /// Reads all snapshots of a query, piece by piece.
    pub(super) async fn each(
        &self,
        query: Query,
        mut act: impl FnMut(&Snapshot) -> Result<(), CommandFailure>,
    ) -> Result<u64, CommandFailure> {
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
            Self::File { store, memory } => Ok(maintain::carry_out(request, Some(store), memory)?),
        }
    }
}

/// A working memory on a file, with its newest snapshots. Its clock is the machine's.
fn opened(store: &Arc<LongTermMemory>) -> Result<WorkingMemory, CommandFailure> {
    let backing = Arc::clone(store) as Arc<dyn armarium_memoryx::Backing>;
    let memory = WorkingMemory::new(Arc::new(wall_clock_ns)).with_backing(backing);
    store.load_into(&memory, Pattern::any())?;
    Ok(memory)
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
