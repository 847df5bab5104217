//! Following an agent: first the agents' poses, so that the rest can be converted to one's own frame; then what the
//! agent sees.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{
    Commit, EntityId, Memory, MemoryError, Pattern, RemoteMemory, WorkingMemory, check_name,
};
use armarium_values::{Pose, Value};
use nalgebra::Isometry3;

use super::frames::AGENTS;
use super::record::FollowingRecord;
use super::{Copying, FollowSettings, WORLD, own_from_other};

/// Core segments that are followed by default.
const DEFAULT_SEGMENTS: [&str; 2] = ["ObjectInstances", "ObjectRelations"];
/// How long to wait for the pose of the other agent.
const POSE_TIMEOUT: Duration = Duration::from_secs(5);
/// How long to wait before connecting again to an agent that is absent.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);
/// How often the clock of a followed agent is compared with one's own. It may be another one after a restart.
const CLOCK_INTERVAL: Duration = Duration::from_secs(5);
/// Clocks that are further apart than this are warned of, s.
pub(super) const CLOCKS_APART_S: f64 = 0.1;

/// Which agent is followed, and which core segments; by default objects and their relations. Written as `AGENT` or
/// `AGENT:SEGMENT`, where `*` stands for any characters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Followee {
    /// The agent.
    pub agent: String,
    /// The core segment, or a pattern of core segments.
    pub segment: Option<String>,
}

impl FromStr for Followee {
    type Err = MemoryError;

    fn from_str(text: &str) -> Result<Self, MemoryError> {
        let (agent, segment) = text.split_once(':').map_or((text, None), |(agent, of)| (agent, Some(of)));
        check_name(agent)?;
        segment.map_or(Ok(()), |segment| check_name(&segment.replace('*', "any")))?;
        Ok(Self { agent: agent.into(), segment: segment.map(Into::into) })
    }
}

// No `From<&str>`: the command line would take it instead of `FromStr`, and a segment for a part of the name.
impl Followee {
    /// The default core segments of an agent.
    pub fn of(agent: &str) -> Self {
        Self { agent: agent.into(), segment: None }
    }

    /// The core segments, without the agents' poses, which are followed before all others.
    fn segments(&self) -> Vec<&str> {
        let segments = self.segment.as_deref().map_or(DEFAULT_SEGMENTS.to_vec(), |segment| vec![segment]);
        segments.into_iter().filter(|segment| *segment != AGENTS).collect()
    }
}

/// Follows an agent until this is dropped.
#[derive(Debug)]
pub struct FollowedAgent {
    /// The other agent's own memory.
    pub remote: Arc<RemoteMemory>,
    followings: Vec<Copying>,
}

/// The update that states the pose of an agent's root frame in the world frame.
///
/// # Errors
/// [`MemoryError::Name`] when the name cannot be part of an address.
pub fn agent_pose_update(agent: &str, world_from_root: &Isometry3<f64>) -> Result<Commit, MemoryError> {
    let pose = Value::Pose(Pose::new(WORLD.into(), world_from_root));
    Ok(Commit::new(EntityId::new(AGENTS, agent, agent)?, 0, [("pose", pose)]))
}

/// The agent `own`, whose memory follows others.
pub(crate) struct FollowingAgent {
    /// The session on which the others are reached.
    pub(crate) session: Session,
    /// The memory that the followed knowledge is written to.
    pub(crate) memory: Arc<WorkingMemory>,
    /// The agent's name.
    pub(crate) own: String,
    /// As [`FollowSettings::fuse_into`].
    pub(crate) fuse_into: Option<String>,
}

impl FollowingAgent {
    /// Follows an agent from now on.
    ///
    /// # Errors
    /// [`MemoryError::Remote`] when no memory answers under that name, or the agent does not publish its pose.
    pub(crate) async fn follow(&self, other: &Followee) -> Result<FollowedAgent, MemoryError> {
        let remote = Arc::new(RemoteMemory::connect(&self.session, &other.agent).await?);
        self.compare_clocks(&remote, &other.agent).await?;
        self.follow_remote(remote, other, true, None).await
    }

    /// Follows an agent as soon as it is there, and tells how that goes ([`super::FOLLOWING`]). If it does not publish its pose, its
    /// objects are kept in its own frame. It never returns.
    pub(crate) async fn keep_following(&self, other: &Followee) {
        let segments = std::iter::once(AGENTS).chain(other.segments()).map(str::to_owned).collect();
        let record = match FollowingRecord::new(Arc::clone(&self.memory), &self.own, other, segments) {
            Ok(record) => Arc::new(record),
            Err(error) => return tracing::error!(%error, "`{}` cannot be followed", other.agent),
        };
        let mut followed: Option<FollowedAgent> = None;
        loop {
            let tried = async {
                let remote = match &followed {
                    Some(followed) => Arc::clone(&followed.remote),
                    None => Arc::new(RemoteMemory::connect(&self.session, &other.agent).await?),
                };
                let clock_ahead_s = remote.clock_ahead_s(|| self.memory.now_ns()).await?;
                if record.is_followed(clock_ahead_s) {
                    self.warn_of_clock(&other.agent, clock_ahead_s);
                }
                if followed.is_none() {
                    let record = Some(Arc::clone(&record));
                    followed = Some(self.follow_remote(remote, other, false, record).await?);
                }
                Ok(())
            };
            let wait = match tried.await {
                Ok(()) => CLOCK_INTERVAL,
                Err(error) => {
                    if record.is_looked_for(&error) {
                        tracing::warn!(
                            "{error}; it may not run or not be connected, or its access rules do not name `{}`: looking for it again",
                            self.own
                        );
                    }
                    RETRY_INTERVAL
                }
            };
            tokio::time::sleep(wait).await;
        }
    }

    async fn compare_clocks(&self, remote: &RemoteMemory, agent: &str) -> Result<(), MemoryError> {
        let ahead_s = remote.clock_ahead_s(|| self.memory.now_ns()).await?;
        if ahead_s.is_some_and(|ahead_s| ahead_s.abs() > CLOCKS_APART_S) {
            self.warn_of_clock(agent, ahead_s);
        }
        Ok(())
    }

    fn warn_of_clock(&self, agent: &str, ahead_s: Option<f64>) {
        let (own, ahead_s) = (&self.own, ahead_s.unwrap_or_default());
        tracing::warn!("the clock of `{agent}` is {ahead_s:+.2} s from that of `{own}`: set both by NTP");
    }

    /// Follows the agents' poses, then the rest. If no pose comes, this is an error when it is needed.
    async fn follow_remote(
        &self,
        remote: Arc<RemoteMemory>,
        other: &Followee,
        needs_pose: bool,
        record: Option<Arc<FollowingRecord>>,
    ) -> Result<FollowedAgent, MemoryError> {
        let (own, agent) = (&self.own, other.agent.as_str());
        let mut followed = FollowedAgent { remote, followings: Vec::new() };
        self.follow_segment(&mut followed, agent, AGENTS, record.clone()).await?;
        if !self.place_is_known(agent).await {
            let missing = format!("its memory has no `{AGENTS}/{agent}/{agent}` with a `pose` in `{WORLD}`");
            if needs_pose {
                let what = format!("it does not say where it stands: {missing}");
                return Err(MemoryError::Remote { agent: agent.into(), what });
            }
            tracing::warn!(
                "`{agent}` or `{own}` does not say where it stands, so what comes is in the frame `{agent}/root`: {missing}"
            );
        }
        for segment in other.segments() {
            self.follow_segment(&mut followed, agent, segment, record.clone()).await?;
        }
        Ok(followed)
    }

    async fn follow_segment(
        &self,
        followed: &mut FollowedAgent,
        agent: &str,
        segment: &str,
        record: Option<Arc<FollowingRecord>>,
    ) -> Result<(), MemoryError> {
        let pattern = Pattern::segment(segment);
        let (own, fuse_into) = (self.own.clone(), self.fuse_into.clone());
        let settings = FollowSettings { own, agent: agent.into(), pattern, fuse_into, record };
        let remote: Arc<dyn Memory> = Arc::<RemoteMemory>::clone(&followed.remote);
        followed.followings.push(Copying::start(remote, Arc::clone(&self.memory), settings).await?);
        Ok(())
    }

    /// Waits for the other agent's pose; false when it does not come in time.
    async fn place_is_known(&self, other: &str) -> bool {
        let mut changes = self.memory.changes(&Pattern::segment(AGENTS));
        let known = async {
            while own_from_other(&self.memory, &self.own, other).is_none() {
                // A lagging receiver checks again as well.
                let _ = changes.recv().await.is_ok();
            }
        };
        tokio::time::timeout(POSE_TIMEOUT, known).await.is_ok()
    }
}
