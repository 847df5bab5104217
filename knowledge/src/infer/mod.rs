//! Inference: processes that read a memory, present and past, and write conclusions into it, with confidence and
//! provenance.
//!
//! - [`Inference`]: the trait of such a process. It sees a [`Memory`], in this process or another agent's; queries
//!   with `long_term` also reach what working memory has forgotten.
//! - [`RunningInference`]: runs an inference whenever something that it watches has changed. [`conclude_once`]: one round.
//! - [`SpatialRelations`], [`UsualPlaces`]: the two built-in ones.
//!
//! Conclusions are in the provider segment with the inference's name. No one else should write there: a conclusion
//! that no longer holds is removed. Every conclusion has the attributes `concluded_by` and `because`: the addresses
//! and versions of its evidence. Other languages attach over Zenoh; `docs/wire-memory.md` has an example.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_memoryx::{
    Clock, Commit, EntityId, Instance, Memory, MemoryError, Pattern, Query, Snapshot, check_name,
};
use armarium_values::Value;
use async_trait::async_trait;
use sha2::{Digest, Sha256};
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinSet;

mod places;
mod relations;
mod solid;

pub use places::{USUAL_PLACES, UsualPlaces};
pub use relations::{OBJECT_RELATIONS, SpatialRelations};

/// Conclusions per commit.
const MAX_BATCH: usize = 1000;
/// Most pieces of evidence that a conclusion names.
const MAX_EVIDENCE: usize = 16;
/// A conclusion whose confidence changes by less is not written again.
const SAME_CONFIDENCE: f64 = 0.02;
/// Longest name that [`joined`] makes, bytes.
const MAX_NAME_BYTES: usize = 160;

/// A process that draws conclusions from memory.
#[async_trait]
pub trait Inference: fmt::Debug + Send + Sync {
    /// Its name: the provider segment of its conclusions.
    fn name(&self) -> &str;
    /// Changes of these entities start a new round.
    fn watches(&self) -> Vec<Pattern>;
    /// The shortest time between two rounds.
    fn pause(&self) -> Duration;
    /// All present conclusions. `now_ns`: the memory's time.
    ///
    /// # Errors
    /// As [`Memory::query`].
    async fn conclude(&self, memory: &dyn Memory, now_ns: u64) -> Result<Vec<Conclusion>, MemoryError>;
}

/// A conclusion.
#[derive(Clone, Debug, PartialEq)]
pub struct Conclusion {
    /// Its core segment.
    pub segment: String,
    /// The name of its entity; [`joined`] makes one of several names.
    pub entity: String,
    /// Its attributes.
    pub attributes: BTreeMap<String, Value>,
    /// Covariances of attributes, as in an [`Instance`].
    pub covariance: BTreeMap<String, Vec<f64>>,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// The time that it describes, ns.
    pub referenced_ns: u64,
    /// The entities and versions of its evidence.
    pub because: Vec<(EntityId, u64)>,
}

/// What one round has changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Round {
    /// Conclusions that hold now.
    pub concluded: u64,
    /// Conclusions among them that are new or have changed.
    pub written: u64,
    /// Conclusions that no longer hold.
    pub removed: u64,
}

/// An inference that runs until this is dropped.
#[derive(Debug)]
pub struct RunningInference {
    rounds: Arc<AtomicU64>,
    _tasks: JoinSet<()>,
}

/// Joins names to one name; a name that would be too long is cut, and a hash makes it unique.
pub fn joined(names: &[&str]) -> String {
    let whole = names.join("-");
    let is_forbidden = |c: char| c.is_control() || matches!(c, '/' | '*' | '#' | '?' | '$' | '@');
    let name: String = whole.chars().map(|c| if is_forbidden(c) { '_' } else { c }).collect();
    if name == whole && name.len() <= MAX_NAME_BYTES {
        return name;
    }
    let hash = Sha256::digest(whole.as_bytes());
    let cut = name.floor_char_boundary(MAX_NAME_BYTES);
    let hash: String = hash.iter().take(6).map(|byte| format!("{byte:02x}")).collect();
    format!("{}-{hash}", &name[..cut])
}

impl Conclusion {
    fn instance(&self, by: &str) -> Instance {
        let evidence = |(id, version): &(EntityId, u64)| {
            let version = Value::Int(i64::try_from(*version).unwrap_or(i64::MAX));
            Value::record([("id", id.as_str().into()), ("version", version)])
        };
        let mut attributes = self.attributes.clone();
        attributes.insert("concluded_by".into(), by.into());
        let because = self.because.iter().take(MAX_EVIDENCE).map(evidence).collect();
        attributes.insert("because".into(), Value::List(because));
        let (attributes, covariance) = (attributes.into(), self.covariance.clone());
        Instance { attributes, confidence: self.confidence, covariance }
    }
}

/// Whether two instances are equal, apart from their evidence.
fn equal_apart_from_evidence(a: &Instance, b: &Instance) -> bool {
    let (a_says, b_says) = (a.attributes.iter(), b.attributes.iter());
    let is_no_evidence = |(name, _): &(&str, &Value)| *name != "because";
    (a.confidence - b.confidence).abs() < SAME_CONFIDENCE
        && a_says.filter(is_no_evidence).eq(b_says.filter(is_no_evidence))
        && a.covariance == b.covariance
}

/// Runs one round of an inference, and makes memory hold exactly its conclusions.
///
/// # Errors
/// As [`Memory::query`] and [`Memory::commit`]; [`MemoryError::Name`] when a name of the inference is not valid in an
/// address.
pub async fn conclude_once(
    memory: &dyn Memory,
    inference: &dyn Inference,
    now_ns: u64,
) -> Result<Round, MemoryError> {
    let name = inference.name();
    check_name(name)?;
    let conclusions = inference.conclude(memory, now_ns).await?;
    let held = memory.query(&Query::latest(Pattern::any().of_provider(name))).await?;
    let mut held: BTreeMap<EntityId, Arc<Snapshot>> = held.into_iter().map(|s| (s.id.clone(), s)).collect();
    let mut round = Round { concluded: conclusions.len() as u64, ..Round::default() };
    let mut updates = Vec::new();
    for conclusion in conclusions {
        let id = EntityId::new(&conclusion.segment, name, &conclusion.entity)?;
        let instance = conclusion.instance(name);
        let known = held.remove(&id);
        let same = |known: &Instance| equal_apart_from_evidence(known, &instance);
        if known.as_ref().and_then(|s| s.instance()).is_some_and(same) {
            continue;
        }
        round.written += 1;
        updates.push(Commit::of(id, conclusion.referenced_ns, vec![instance]));
    }
    round.removed = held.len() as u64;
    updates.extend(held.into_keys().map(|id| Commit::removal(id, now_ns)));
    while !updates.is_empty() {
        let rest = updates.split_off(updates.len().min(MAX_BATCH));
        memory.commit(std::mem::replace(&mut updates, rest)).await?;
    }
    Ok(round)
}

impl RunningInference {
    /// Runs a round now, and another when something that the inference watches has changed. `clock` is the memory's.
    pub fn start(memory: Arc<dyn Memory>, inference: Arc<dyn Inference>, clock: Clock) -> Self {
        let rounds = Arc::new(AtomicU64::new(0));
        let mut tasks = JoinSet::new();
        tasks.spawn(run(memory, inference, clock, Arc::clone(&rounds)));
        Self { rounds, _tasks: tasks }
    }

    /// How many rounds have ended, with or without an error.
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }
}

async fn run(memory: Arc<dyn Memory>, inference: Arc<dyn Inference>, clock: Clock, rounds: Arc<AtomicU64>) {
    let patterns = inference.watches();
    let watched = |s: &Snapshot| {
        s.id.provider() != inference.name() && patterns.iter().any(|pattern| pattern.matches(&s.id))
    };
    loop {
        // Subscribe before reading: a change during this round starts another.
        let mut changes = match memory.subscribe(&Pattern::any()).await {
            Ok(changes) => changes,
            Err(error) => {
                return tracing::warn!(%error, inference = inference.name(), "memory cannot be followed");
            }
        };
        if let Err(error) = conclude_once(&*memory, &*inference, clock()).await {
            tracing::warn!(%error, inference = inference.name(), "nothing could be concluded");
        }
        rounds.fetch_add(1, Ordering::Relaxed);
        loop {
            match changes.recv().await {
                Ok(snapshot) if watched(&snapshot) => break,
                Ok(_) => {}
                Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
        drop(changes);
        tokio::time::sleep(inference.pause()).await;
    }
}

#[cfg(test)]
mod tests;
