//! One agent's memory follows another's: where the other stands, then what it sees and how things stand to each other.
//!
//! Where it stands comes first, so that all the rest arrives in one's own frame.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::share::{WORLD, own_from_other};
use armarium_memoryx::{
    Commit, EntityId, FollowSettings, Following, Memory, MemoryError, Pattern, RemoteMemory, WorkingMemory,
    check_name,
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

/// Whose memory is followed, and which core segment of it; what is told of the world where none is named.
#[derive(Clone, Debug)]
pub(crate) struct Followee {
    pub(crate) agent: String,
    pub(crate) segment: Option<String>,
}

impl FromStr for Followee {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (agent, segment) = match text.split_once(':') {
            Some((agent, segment)) => (agent, Some(segment)),
            None => (text, None),
        };
        for name in [Some(agent), segment].into_iter().flatten() {
            check_name(name).map_err(|error| error.to_string())?;
        }
        Ok(Self { agent: agent.into(), segment: segment.map(Into::into) })
    }
}

/// Follows for as long as it lives.
pub(crate) struct Followed {
    /// The other's own memory.
    pub(crate) remote: Arc<RemoteMemory>,
    /// They end with this.
    followings: Vec<Following>,
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
    let mut followed = begin(session, memory, own, other).await?;
    if !stands_somewhere(memory, own, other).await {
        return Err(format!("`{other}` does not say where it stands: {}", stand_is_said_by(other)));
    }
    followed.go_on(memory, own, other, &TOLD).await?;
    Ok(followed)
}

/// As [`follow`], of an agent who may not be there yet, and what of it: a core segment, or what is told of the world. Of
/// who does not say where he stands, things are known in his own frame.
pub(crate) async fn follow_when_there(
    session: &Session,
    memory: &Arc<WorkingMemory>,
    own: &str,
    (other, segment): (&str, Option<&str>),
) -> Followed {
    let segments = segment.map_or(TOLD.to_vec(), |segment| vec![segment]);
    loop {
        let begun = begin(session, memory, own, other).await;
        match begun {
            Ok(mut followed) => {
                if !stands_somewhere(memory, own, other).await {
                    tracing::warn!(
                        "`{other}` or `{own}` does not say where it stands, so what comes is in the frame `{other}/root`: {}",
                        stand_is_said_by(other)
                    );
                }
                match followed.go_on(memory, own, other, &segments).await {
                    Ok(()) => return followed,
                    Err(error) => tracing::info!("{error}; looking for `{other}` again"),
                }
            }
            Err(error) => tracing::info!("{error}; looking for `{other}` again"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

fn stand_is_said_by(agent: &str) -> String {
    format!("its memory has no `{AGENTS}/{agent}/{agent}` with a `pose` in `{WORLD}`")
}

/// Follows where agents stand.
async fn begin(
    session: &Session,
    memory: &Arc<WorkingMemory>,
    own: &str,
    other: &str,
) -> Result<Followed, String> {
    let remote = Arc::new(RemoteMemory::connect(session, other).await.map_err(|e| failed(other, &e))?);
    let mut followed = Followed { remote, followings: Vec::new() };
    followed.go_on(memory, own, other, &[AGENTS]).await?;
    Ok(followed)
}

/// Whether it is known, or soon is, where the other stands.
async fn stands_somewhere(memory: &Arc<WorkingMemory>, own: &str, other: &str) -> bool {
    let mut changes = memory.subscribe();
    let known = async {
        while own_from_other(memory, own, other).is_none() {
            // A reader that lags looks again as well.
            let _ = changes.recv().await.is_ok();
        }
    };
    tokio::time::timeout(PATIENCE, known).await.is_ok()
}

fn failed(other: &str, error: &MemoryError) -> String {
    format!("the memory of `{other}` cannot be followed: {error}")
}

impl Followed {
    /// Follows core segments.
    async fn go_on(
        &mut self,
        memory: &Arc<WorkingMemory>,
        own: &str,
        other: &str,
        segments: &[&str],
    ) -> Result<(), String> {
        // Where agents stand is followed from the beginning.
        let already = !self.followings.is_empty();
        for segment in segments.iter().filter(|segment| !already || **segment != AGENTS) {
            let pattern = Pattern::segment(segment);
            let settings = FollowSettings { own: own.into(), agent: other.into(), pattern, fuse_into: None };
            let shared: Arc<dyn Memory> = Arc::<RemoteMemory>::clone(&self.remote);
            let following = Following::start(shared, Arc::clone(memory), settings).await;
            self.followings.push(following.map_err(|e| failed(other, &e))?);
        }
        Ok(())
    }
}
