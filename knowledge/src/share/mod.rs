//! Following another agent's memory: copies its knowledge into the provider segment `{agent}.{provider}`, in this
//! agent's frame, with the attribute `origin` that names the source.
//!
//! Every version is copied once and in order. After a disconnection the other memory is queried for the changes
//! since, from its long-term memory where its working memory has forgotten. Versions that are gone become a gap: the
//! next snapshot's `origin.missed` counts them. Copies of a third agent's knowledge are not copied again.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{
    Change, Commit, EntityId, Follower, Instance, LastSeen, Memory, MemoryError, Pattern, Query, Snapshot,
    WorkingMemory, pages,
};
use armarium_values::{Observation, ObservedPlace, Vector};
use tokio::task::JoinSet;

use crate::updater::{OBJECT_INSTANCES, Updater};

mod agents;
mod frames;
mod origin;
mod record;

pub(crate) use agents::FollowingAgent;
pub use agents::{FollowedAgent, Followee, agent_pose_update};
pub use frames::WORLD;
use frames::{AGENTS, own_from_other, transformed};
pub use origin::Origin;
use record::FollowingRecord;
pub use record::{FOLLOWING, Following};

/// Changes that are committed together.
const MAX_BATCH: usize = 256;
/// Snapshots of the own memory per query.
const PAGE_SIZE: usize = 4096;
/// How long to wait before a memory that refuses for the moment is tried again.
const RETRY_INTERVAL: std::time::Duration = std::time::Duration::from_millis(500);

/// Which agent is followed, and how.
#[derive(Clone, Debug)]
pub(crate) struct FollowSettings {
    /// This agent.
    pub(crate) own: String,
    /// The agent whose memory is followed.
    pub(crate) agent: String,
    /// The entities that are followed.
    pub(crate) pattern: Pattern,
    /// If given, objects with a position are also fused into this provider segment of `ObjectInstances`, as
    /// observations.
    pub(crate) fuse_into: Option<String>,
    /// Where it is told what was missed.
    pub(crate) record: Option<Arc<FollowingRecord>>,
}

/// Copies until this is dropped.
#[derive(Debug)]
pub(crate) struct Copying {
    _tasks: JoinSet<()>,
}

impl Copying {
    /// Continues to follow `other` from what `memory` already has of it.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when an agent's name is invalid; as [`Memory::query`].
    pub(crate) async fn start(
        other: Arc<dyn Memory>,
        memory: Arc<WorkingMemory>,
        settings: FollowSettings,
    ) -> Result<Self, MemoryError> {
        armarium_memoryx::check_name(&settings.agent)?;
        let told = last_taken(&memory, &settings).await?;
        let follower = Follower::resume(other, settings.pattern.clone(), told).await?;
        let fuses = |provider: &String| Updater::new(Arc::<WorkingMemory>::clone(&memory), provider);
        let updater = settings.fuse_into.as_ref().map(fuses).transpose()?;
        let mut tasks = JoinSet::new();
        tasks.spawn(FollowTask { memory, settings, updater }.run(follower));
        Ok(Self { _tasks: tasks })
    }
}

/// The address of another agent's entity in this memory.
///
/// # Errors
/// [`MemoryError::Name`] when the combined names are too long.
pub(crate) fn followed_id(agent: &str, id: &EntityId) -> Result<EntityId, MemoryError> {
    EntityId::new(id.segment(), &format!("{agent}.{}", id.provider()), id.entity())
}

/// What this memory has of another: the last copied snapshot of each entity.
async fn last_taken(
    memory: &WorkingMemory,
    settings: &FollowSettings,
) -> Result<BTreeMap<EntityId, LastSeen>, MemoryError> {
    let prefix = format!("{}.", settings.agent);
    let segment = settings.pattern.segment.clone();
    let pattern = Pattern { segment, ..Pattern::any() }.of_provider(&format!("{prefix}*"));
    let mut told: BTreeMap<EntityId, LastSeen> = BTreeMap::new();
    // A removal has no attributes. It is the version after its predecessor; when it arrived there is unknown.
    let mut pieces = pages(Query::history(pattern).limit(2).with_long_term(), PAGE_SIZE);
    while let Some(piece) = pieces.next(memory).await? {
        for snapshot in piece {
            let provider = snapshot.id.provider().strip_prefix(&prefix).unwrap_or_default();
            let id = EntityId::new(snapshot.id.segment(), provider, snapshot.id.entity())?;
            // The name `alice.b` begins with `alice.`, too.
            let origin = Origin::of(&snapshot).filter(|origin| origin.agent == settings.agent);
            if let Some(Origin { version, arrived_ns, .. }) = origin {
                told.insert(id, LastSeen { version, arrived_ns });
            } else if let Some(last) = told.get_mut(&id).filter(|_| snapshot.is_removed()) {
                *last = LastSeen { version: last.version + 1, arrived_ns: 0 };
            }
        }
    }
    Ok(told)
}

struct FollowTask {
    memory: Arc<WorkingMemory>,
    settings: FollowSettings,
    updater: Option<Updater>,
}

impl FollowTask {
    async fn run(self, mut follower: Follower) {
        let mut gaps: BTreeMap<EntityId, u64> = BTreeMap::new();
        loop {
            let first = match follower.next().await {
                Ok(Some(change)) => change,
                Ok(None) => return,
                Err(error) => {
                    tracing::warn!(%error, agent = self.settings.agent, "what was missed could not be asked for");
                    tokio::time::sleep(RETRY_INTERVAL).await;
                    continue;
                }
            };
            let mut changes = vec![first];
            changes.extend(follower.drain(MAX_BATCH - 1).await.unwrap_or_default());
            let mut news = Vec::with_capacity(changes.len());
            for change in changes {
                match change {
                    Change::Missed { id, from, to } => {
                        let (count, agent) = (to - from + 1, &self.settings.agent);
                        tracing::warn!(
                            "`{agent}` has forgotten {count} versions of `{id}` that were not copied"
                        );
                        *gaps.entry(id).or_insert(0) += count;
                        self.settings.record.iter().for_each(|record| record.has_missed(count));
                    }
                    Change::New(snapshot) if self.is_wanted(&snapshot) => {
                        let missed = gaps.remove(&snapshot.id).unwrap_or(0);
                        news.push((snapshot, missed));
                    }
                    Change::New(_) => {}
                }
            }
            self.take(news).await;
        }
    }

    /// Whether a snapshot is the agent's own knowledge. Agents' poses come by a following of their own, before all others.
    fn is_wanted(&self, snapshot: &Snapshot) -> bool {
        let comes_apart = self.settings.pattern.exact_segment().is_none() && snapshot.id.segment() == AGENTS;
        !comes_apart && !Origin::has(snapshot)
    }

    async fn take(&self, news: Vec<(Arc<Snapshot>, u64)>) {
        let translated = news.iter().map(|(snapshot, missed)| self.translated(snapshot, *missed));
        let updates: Vec<Commit> =
            translated.filter_map(|update| log_refusal(update, &self.settings.agent)).collect();
        if self.memory.commit(updates.clone()).await.is_err() {
            // A refused update does not affect the others; after a disk failure, wait and try again.
            for update in updates {
                while let Err(error) = self.memory.commit(vec![update.clone()]).await {
                    tracing::warn!(%error, agent = self.settings.agent, "what is followed was refused");
                    if !matches!(error, MemoryError::Store { .. }) {
                        break;
                    }
                    tokio::time::sleep(RETRY_INTERVAL).await;
                }
            }
        }
        if let Some(updater) = &self.updater {
            for observation in news.iter().filter_map(|(snapshot, _)| self.observation(snapshot)) {
                log_refusal(updater.adopt(&[observation]).await, &self.settings.agent);
            }
        }
    }

    /// The update of this memory for a followed snapshot, in this agent's frame.
    fn translated(&self, snapshot: &Snapshot, missed: u64) -> Result<Commit, MemoryError> {
        let Snapshot { version, arrived_ns, .. } = *snapshot;
        let (agent, id) = (self.settings.agent.clone(), snapshot.id.clone());
        let origin = Origin { agent, id, version, arrived_ns, missed }.attribute();
        let instances = snapshot.instances.iter().map(|instance| {
            let moved = self.moved(instance);
            Instance { attributes: moved.attributes.with("origin", origin.clone()), ..moved }
        });
        let id = followed_id(&self.settings.agent, &snapshot.id)?;
        Ok(Commit::of(id, snapshot.referenced_ns, instances.collect()))
    }

    fn moved(&self, instance: &Instance) -> Instance {
        let own_from_other = own_from_other(&self.memory, &self.settings.own, &self.settings.agent);
        transformed(instance, &self.settings.agent, own_from_other.as_ref())
    }

    fn observation(&self, snapshot: &Snapshot) -> Option<Observation> {
        let moved = self.moved(snapshot.instance()?);
        let confidence = moved.confidence;
        let rows = moved.covariance.get("position").and_then(|rows| rows.as_slice().try_into().ok());
        let moved = Snapshot { instances: vec![moved], ..snapshot.clone() };
        let (frame, components) = armarium_memoryx::place_of(&moved)?;
        let class = moved.attribute("class")?.as_str()?.to_owned();
        let place = ObservedPlace {
            position: Vector { frame: frame.clone(), components },
            covariance: rows.unwrap_or([1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]),
        };
        let observation = Observation::new(OBJECT_INSTANCES, &class, snapshot.referenced_ns);
        (snapshot.id.segment() == OBJECT_INSTANCES).then(|| observation.at(place).with_confidence(confidence))
    }
}

fn log_refusal<T>(result: Result<T, MemoryError>, agent: &str) -> Option<T> {
    result.inspect_err(|error| tracing::warn!(%error, agent, "what is followed was refused")).ok()
}

#[cfg(test)]
mod tests;
