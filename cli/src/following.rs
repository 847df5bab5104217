//! One agent's memory follows another's: where the other stands, then what it sees and how things stand to each other.
//!
//! Where it stands comes first, so that all the rest arrives in one's own frame.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::share::{WORLD, own_from_other};
use armarium_memoryx::{
    Commit, EntityId, FollowSettings, Following, Memory, MemoryError, Pattern, RemoteMemory, WorkingMemory,
};
use armarium_values::{Pose, Value};
use nalgebra::Isometry3;

/// Where agents stand.
const AGENTS: &str = "AgentInstances";
/// What is told of the world.
const TOLD: [&str; 2] = ["ObjectInstances", "ObjectRelations"];
/// How long it may take until the other says where it stands.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long to wait before an agent that is not there is looked for again.
const AGAIN: Duration = Duration::from_millis(500);

/// Follows for as long as it lives.
pub(crate) struct Followed {
    /// The other's own memory.
    pub(crate) remote: Arc<RemoteMemory>,
    _followings: Vec<Following>,
}

/// Says in memory where an agent's root frame is in the world frame.
///
/// # Errors
/// When the name cannot be part of an address.
pub(crate) fn stands(agent: &str, world_from_root: &Isometry3<f64>) -> Result<Commit, MemoryError> {
    let pose = Value::Pose(Pose::new(WORLD.into(), world_from_root));
    Ok(Commit::new(EntityId::new(AGENTS, agent, agent)?, 0, [("pose", pose)]))
}

/// Follows the memory of `other` from now on.
///
/// # Errors
/// When nobody answers under that name, or it does not say where it stands.
pub(crate) async fn follow(
    session: &Session,
    memory: &Arc<WorkingMemory>,
    own: &str,
    other: &str,
) -> Result<Followed, String> {
    let failed = |error: MemoryError| format!("the memory of `{other}` cannot be followed: {error}");
    let remote = Arc::new(RemoteMemory::connect(session, other).await.map_err(failed)?);
    let start = |segment: &str| {
        let pattern = Pattern::segment(segment);
        let settings = FollowSettings { own: own.into(), agent: other.into(), pattern, fuse_into: None };
        let shared: Arc<dyn Memory> = Arc::<RemoteMemory>::clone(&remote);
        Following::start(shared, Arc::clone(memory), settings)
    };
    let mut followings = vec![start(AGENTS).await.map_err(failed)?];
    let mut changes = memory.subscribe();
    let known = async {
        while own_from_other(memory, own, other).is_none() {
            // A reader that lags looks again as well.
            let _ = changes.recv().await.is_ok();
        }
    };
    tokio::time::timeout(PATIENCE, known).await.map_err(|_| {
        format!("`{other}` does not say where it stands: its memory has no `{AGENTS}/{other}/{other}` with a `pose` in `{WORLD}`")
    })?;
    for segment in TOLD {
        followings.push(start(segment).await.map_err(failed)?);
    }
    Ok(Followed { remote, _followings: followings })
}

/// As [`follow`], of an agent who may not be there yet.
pub(crate) async fn follow_when_there(
    session: &Session,
    memory: &Arc<WorkingMemory>,
    own: &str,
    other: &str,
) -> Followed {
    loop {
        match follow(session, memory, own, other).await {
            Ok(followed) => return followed,
            Err(error) => tracing::info!("{error}; looking for `{other}` again"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}
