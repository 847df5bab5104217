//! The updater: turns observations of perception into entities. It matches observations to known entities, fuses
//! them, and commits the result together.
//!
//! 1. Each known entity of the class is predicted to the time of the observation ([`MotionModel`]).
//! 2. Observations and entities are assigned to each other with the least sum of squared Mahalanobis distances; an
//!    observation without an entity inside the gate becomes a new entity.
//! 3. A Kalman filter fuses the position; a new entity gets the prior knowledge of its class.
//!
//! An observation is addressed to a core segment. One without a place says only what else is observed. People's hands and bodies
//! move by themselves, and each picture shows another part of a table: of these segments the last observation counts alone. It
//! is of the nearest known entity of its class, however far that is, and one without a place (no hand is there) is of all.
//! An observer who follows its entities himself names them: such an observation is of that entity, as it says, and one of less
//! confidence than counts removes it.
//! Where a [`Search`] says what was looked for and where it would have been seen, what is known to be there and was not found has moved
//! to where one was found that nobody knew; or it loses confidence, and is removed in the end. What is carried is not doubted: a hand hides it.
//! It sees no image and no robot: a [`Carriers`] supplies the poses of hands.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{
    Commit, EntityId, Instance, Memory, MemoryError, Pattern, Query, Snapshot, check_name, fields,
};
use armarium_values::{Frame, Observation, ObservedPlace, Search, Shown, Value, Vector};
use indexmap::IndexSet;
use nalgebra::{Matrix3, Point3, Vector3};

use crate::prior::OBJECT_CLASSES;

mod assignment;
mod kalman;
mod motion;

pub use assignment::assign;
pub use kalman::{Gaussian, fuse_absence, fuse_confidence};
pub use motion::{Carriers, MotionModel, NoCarriers, carried, predict};

/// The core segment of observed objects.
pub const OBJECT_INSTANCES: &str = "ObjectInstances";
/// How often an update tries again after a conflict with another writer.
const MAX_TRIES: u32 = 8;
/// How far a hand moves a thing that it hides, m.
const IN_REACH: f64 = 0.5;
/// A thing whose place is just out of view and that is seen so near to it, m, has moved; it is no second one.
const BESIDE: f64 = 0.15;

/// Settings of the updater.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Gate: the largest squared Mahalanobis distance of an observation from its entity. 11.34 accepts 99 % of the
    /// true pairs (chi-squared with 3 degrees of freedom).
    pub gate: f64,
    /// Variance along each axis by which all that is seen from one place may be off from what is seen from another, m²: where the camera is
    /// is known no better. It tells what belongs together; it is not noise that a mean of many looks reduces.
    pub placement: f64,
    /// Growth of the position's variance of an object at rest, m²/s along each axis.
    pub drift: f64,
    /// The same for a carried object, because grasps slip.
    pub carried_drift: f64,
    /// Probability of finding what is looked for, in view and not hidden.
    pub detection: f64,
    /// What has less confidence after looks that did not find it is removed.
    pub gone: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { gate: 11.34, placement: 6.4e-5, drift: 1e-6, carried_drift: 1e-5, detection: 0.7, gone: 0.05 }
    }
}

/// Core segments of which the last observation counts alone.
const LAST_COUNTS: [&str; 4] = ["HumanHands", "HumanPoses", "EnvironmentModels", "Slips"];

/// What an observation says that is not known yet.
#[derive(Clone, Copy)]
enum Evidence {
    /// It was made now, apart from all others.
    New,
    /// It may hold what is known here already.
    FusedElsewhere,
    /// The thing is no longer where it was known to be.
    Moved,
}

/// The entity of an observation.
struct Match<'h> {
    /// The index of the observation.
    observation: usize,
    /// The entity; `None` when it is new.
    entity: Option<&'h Arc<Snapshot>>,
    /// The predicted position of that entity, with its frame.
    predicted: Option<(Frame, Gaussian)>,
    /// It is not where it should have been seen, but here.
    moved: bool,
}

/// An entity that was not found, where it is known to be, and how that place was seen.
type Missed<'h> = (&'h Arc<Snapshot>, (Vector3<f64>, Shown));

/// Writes observations into the provider segments of one process.
pub struct Updater {
    memory: Arc<dyn Memory>,
    carriers: Arc<dyn Carriers>,
    provider: String,
    settings: Settings,
}

impl Updater {
    /// An updater of `{segment}/{provider}`, where the segment is that of each observation.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the provider's name is not valid in an address.
    pub fn new(memory: Arc<dyn Memory>, provider: &str) -> Result<Self, MemoryError> {
        check_name(provider)?;
        let carriers = Arc::new(NoCarriers);
        Ok(Self { memory, carriers, provider: provider.into(), settings: Settings::default() })
    }

    /// The same updater with other settings.
    #[must_use]
    pub fn with_settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// The same updater, which gets the poses of hands from `carriers`.
    #[must_use]
    pub fn with_carriers(mut self, carriers: Arc<dyn Carriers>) -> Self {
        self.carriers = carriers;
        self
    }

    /// Writes observations made together, all or none. Returns the entity and its version for each observation.
    ///
    /// # Errors
    /// [`MemoryError::Schema`] when an observation's covariance is invalid; as [`Memory::commit`].
    pub async fn update(&self, observations: &[Observation]) -> Result<Vec<(EntityId, u64)>, MemoryError> {
        self.write(observations, None, Evidence::New).await
    }

    /// As [`Self::update`], of what was already fused elsewhere, such as the entities of another agent's memory: places are joined by
    /// covariance intersection, and neither place nor confidence become surer for being told again.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub async fn adopt(&self, observations: &[Observation]) -> Result<Vec<(EntityId, u64)>, MemoryError> {
        self.write(observations, None, Evidence::FusedElsewhere).await
    }

    /// As [`Self::update`], of all observations of a search. What it did not find loses confidence, in the same commit.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub async fn update_from(
        &self,
        observations: &[Observation],
        search: Option<&Search>,
    ) -> Result<Vec<(EntityId, u64)>, MemoryError> {
        self.write(observations, search, Evidence::New).await
    }

    async fn write(
        &self,
        observations: &[Observation],
        search: Option<&Search>,
        evidence: Evidence,
    ) -> Result<Vec<(EntityId, u64)>, MemoryError> {
        let mut tries = 0;
        loop {
            let mut updates = self.updates(observations, search, evidence).await?;
            let ids: Vec<EntityId> = updates.iter().map(|update| update.id.clone()).collect();
            if let Some(search) = search {
                updates.extend(self.missed(search, &ids).await?);
            }
            if updates.is_empty() {
                return Ok(Vec::new());
            }
            tries += 1;
            match self.memory.commit(updates).await {
                Ok(versions) => return Ok(ids.into_iter().zip(versions).collect()),
                Err(MemoryError::Conflict { .. }) if tries < MAX_TRIES => {}
                Err(error) => return Err(error),
            }
        }
    }

    async fn updates(
        &self,
        observations: &[Observation],
        search: Option<&Search>,
        evidence: Evidence,
    ) -> Result<Vec<Commit>, MemoryError> {
        let classes = self.memory.segment(OBJECT_CLASSES).await?;
        let mut updates = Vec::new();
        for segment in observations.iter().map(|o| o.segment.as_str()).collect::<IndexSet<_>>() {
            let pattern = Pattern::segment(segment).of_provider(&self.provider);
            let held = self.memory.query(&Query::latest(pattern)).await?;
            let mut names: Vec<String> = held.iter().map(|s| s.id.entity().to_owned()).collect();
            let of_segment = || observations.iter().enumerate().filter(|(_, o)| o.segment == segment);
            for class in of_segment().map(|(_, o)| o.class.as_str()).collect::<IndexSet<_>>() {
                let seen = of_segment().filter(|(_, o)| o.class == class).map(|(i, _)| i).collect::<Vec<_>>();
                let is_of_class =
                    |s: &&Arc<Snapshot>| s.attribute("class").and_then(Value::as_str) == Some(class);
                let known: Vec<&Arc<Snapshot>> = held.iter().filter(is_of_class).collect();
                let mut matches = self.match_class(observations, &seen, &known, &held)?;
                if let Some(search) = search {
                    self.find_moved(search, observations, (&known, &held), &mut matches)?;
                }
                for matched in matches {
                    let evidence = if matched.moved { Evidence::Moved } else { evidence };
                    let observation = &observations[matched.observation];
                    let update = match matched.entity {
                        Some(entity) => self.fused(observation, entity, (matched.predicted, evidence))?,
                        None if self.is_gone(observation) => continue,
                        None => {
                            let own = observation.entity.clone();
                            let name = own.unwrap_or_else(|| free_name(class, &names));
                            names.push(name.clone());
                            self.created(observation, &name, &classes)?
                        }
                    };
                    updates.push((matched.observation, update));
                }
            }
        }
        updates.sort_by_key(|(observation, _)| *observation);
        Ok(updates.into_iter().map(|(_, update)| update).collect())
    }

    /// Where an entity is in the view of a search, and how that place was seen; `None` where it is carried, or was not looked for.
    fn sought_at(
        &self,
        search: &Search,
        entity: &Snapshot,
        held: &[Arc<Snapshot>],
    ) -> Option<(Vector3<f64>, Shown)> {
        let class = entity.attribute("class").and_then(Value::as_str)?;
        let is_sought = |(segment, of): &(String, String)| segment == entity.id.segment() && of == class;
        let stands = MotionModel::of(entity.instance()?) == MotionModel::Static;
        if !stands || !search.classes.iter().any(is_sought) {
            return None;
        }
        let (frame, place) = predict(entity, search.stamp_ns, held, &*self.carriers, &self.settings)?;
        let place = place.mean();
        (frame == search.frame).then(|| (place, search.shows(&Point3::from(place))))
    }

    /// A thing that is not where it should have been seen, while another place has one that nobody knew, has moved there. So has one
    /// whose place is hidden, if it is near: what hides it is most likely the hand that moves it; and one whose place is just out of view.
    fn find_moved<'h>(
        &self,
        search: &Search,
        observations: &[Observation],
        (known, held): (&[&'h Arc<Snapshot>], &[Arc<Snapshot>]),
        matches: &mut [Match<'h>],
    ) -> Result<(), MemoryError> {
        let found =
            |entity: &Arc<Snapshot>| matches.iter().any(|m| m.entity.is_some_and(|e| e.id == entity.id));
        let missed = known.iter().filter(|entity| !found(entity));
        let mut missed: Vec<Missed<'h>> =
            missed.filter_map(|entity| Some((*entity, self.sought_at(search, entity, held)?))).collect();
        let may_be = |(was, shown): &(Vector3<f64>, Shown), is: &Vector3<f64>| match shown {
            Shown::Open => true,
            Shown::Hidden => (was - is).norm() < IN_REACH,
            Shown::Outside => (was - is).norm() < BESIDE,
        };
        for matched in matches.iter_mut().filter(|matched| matched.entity.is_none()) {
            let Some((frame, place)) = self.measured(&observations[matched.observation])? else { continue };
            if frame != search.frame {
                continue;
            }
            let place = place.mean();
            let away = |(_, (was, _)): &Missed<'_>| (was - place).norm();
            let candidates = (0..missed.len()).filter(|&at| may_be(&missed[at].1, &place));
            let nearest = candidates.min_by(|&a, &b| away(&missed[a]).total_cmp(&away(&missed[b])));
            if let Some(nearest) = nearest {
                (matched.entity, matched.moved) = (Some(missed.remove(nearest).0), true);
            }
        }
        Ok(())
    }

    /// What a search should have found and did not.
    async fn missed(&self, search: &Search, found: &[EntityId]) -> Result<Vec<Commit>, MemoryError> {
        let mut updates = Vec::new();
        for segment in search.classes.iter().map(|(segment, _)| segment.as_str()).collect::<IndexSet<_>>() {
            let pattern = Pattern::segment(segment).of_provider(&self.provider);
            let held = self.memory.query(&Query::latest(pattern)).await?;
            for entity in held.iter().filter(|entity| !found.contains(&entity.id)) {
                let sought = self.sought_at(search, entity, &held);
                let missed =
                    sought.filter(|(_, shown)| *shown == Shown::Open).and_then(|_| entity.instance());
                let Some(instance) = missed else { continue };
                let confidence = fuse_absence(instance.confidence, self.settings.detection);
                let left = Instance { confidence, ..instance.clone() };
                let instances = if confidence < self.settings.gone { Vec::new() } else { vec![left] };
                // The time of what it says stays that at which it was seen last.
                let (id, referenced_ns) = (entity.id.clone(), entity.referenced_ns);
                updates.push(Commit::of(id, referenced_ns, instances).expecting(entity.version));
            }
        }
        Ok(updates)
    }

    /// Matches the observations of one class to entities, with the entities' predicted positions.
    fn match_class<'h>(
        &self,
        observations: &[Observation],
        seen: &[usize],
        known: &[&'h Arc<Snapshot>],
        held: &[Arc<Snapshot>],
    ) -> Result<Vec<Match<'h>>, MemoryError> {
        let matched = |observation, entity: Option<&'h Arc<Snapshot>>, predicted| Match {
            observation,
            entity,
            predicted,
            moved: false,
        };
        if let [at] = seen
            && let observation = &observations[*at]
            && last_counts(observation)
            && observation.place.is_none()
            && !known.is_empty()
        {
            return Ok(known.iter().map(|entity| matched(*at, Some(entity), None)).collect());
        }
        let (named, seen): (Vec<usize>, Vec<usize>) =
            seen.iter().partition(|at| observations[**at].entity.is_some());
        let of_name = |at: usize| {
            let name = observations[at].entity.as_deref();
            matched(at, known.iter().find(|entity| Some(entity.id.entity()) == name).copied(), None)
        };
        let named = named.into_iter().map(of_name);
        let mut predicted = Vec::new();
        let mut costs = Vec::new();
        for at in &seen {
            let observation = &observations[*at];
            let measured = self.measured(observation)?;
            let last_counts = last_counts(observation);
            // A new entity costs as much as a distance equal to the gate. What has no place in the same frame may be the entity, if
            // nothing fits better.
            let fresh = if last_counts { f64::MAX.sqrt() } else { self.settings.gate };
            let unplaced = if last_counts { fresh / 2.0 } else { 0.999 * fresh };
            let mut row = Vec::new();
            for entity in known {
                let prior = predict(entity, observation.stamp_ns, held, &*self.carriers, &self.settings);
                let cost = match (&prior, &measured) {
                    (Some((known, prior)), Some((frame, measured))) if known == frame => prior
                        .spread(self.settings.placement)
                        .distance_squared(measured)
                        .map_or(f64::INFINITY, |d| if last_counts { d.min(unplaced) } else { d }),
                    (Some(_), Some(_)) if !last_counts => f64::INFINITY,
                    _ => unplaced,
                };
                row.push(if cost <= fresh { cost } else { f64::INFINITY });
                predicted.push(prior);
            }
            row.extend((0..seen.len()).map(|_| fresh));
            costs.push(row);
        }
        let assigned = assign(&costs);
        let others = seen.iter().enumerate().map(|(row, at)| {
            let column = assigned.get(row).copied().filter(|column| *column < known.len());
            let predicted = column.and_then(|column| predicted[row * known.len() + column].clone());
            matched(*at, column.map(|column| known[column]), predicted)
        });
        Ok(named.chain(others).collect())
    }

    fn fused(
        &self,
        observation: &Observation,
        entity: &Snapshot,
        (prior, evidence): (Option<(Frame, Gaussian)>, Evidence),
    ) -> Result<Commit, MemoryError> {
        let measured = self.measured(observation)?;
        let id = entity.id.clone();
        if self.is_gone(observation) {
            return Ok(Commit::removal(id, observation.stamp_ns).expecting(entity.version));
        }
        let before = entity.instance().filter(|_| !last_counts(observation));
        let before = before.map(|i| (i.attributes.to_map(), i.confidence));
        let (mut attributes, known) = before.unwrap_or_default();
        attributes.extend(observation.attributes.clone());
        let seen = observation.confidence;
        let (place, confidence) = match (measured, evidence) {
            (measured, _) if last_counts(observation) => (measured, seen),
            // What was observed without a place stays where it was, and is no surer for that.
            (None, _) => (prior, known),
            (Some((frame, at)), Evidence::New) => {
                let joined = prior.and_then(|(_, prior)| prior.fuse(&at));
                (Some((frame, joined.unwrap_or(at))), fuse_confidence(known, seen))
            }
            (Some((frame, at)), Evidence::FusedElsewhere) => {
                let joined = prior.and_then(|(_, prior)| prior.intersect(&at));
                (Some((frame, joined.unwrap_or(at))), known.max(seen))
            }
            (moved, Evidence::Moved) => (moved, seen),
        };
        Ok(commit_of(observation, id, attributes, place, confidence).expecting(entity.version))
    }

    /// Whether an observation says that the entity which it names is no longer there.
    fn is_gone(&self, observation: &Observation) -> bool {
        observation.entity.is_some() && observation.confidence < self.settings.gone
    }

    fn created(
        &self,
        observation: &Observation,
        name: &str,
        classes: &[Arc<Snapshot>],
    ) -> Result<Commit, MemoryError> {
        let id = EntityId::new(&observation.segment, &self.provider, name)?;
        let classes = if last_counts(observation) { &[] } else { classes };
        let mut attributes = enrichment(&observation.class, classes);
        attributes.extend(observation.attributes.clone());
        let measured = self.measured(observation)?;
        Ok(commit_of(observation, id, attributes, measured, observation.confidence))
    }

    /// The observed position with its frame; `None` of an observation without a place.
    fn measured(&self, observation: &Observation) -> Result<Option<(Frame, Gaussian)>, MemoryError> {
        let Some(ObservedPlace { position, covariance }) = &observation.place else { return Ok(None) };
        let gaussian = Gaussian::new(position.vector(), Matrix3::from_row_slice(covariance));
        let gaussian = gaussian.ok_or_else(|| MemoryError::Schema {
            id: format!("{}/{}/{}", observation.segment, self.provider, observation.class),
            attribute: "position".into(),
            what: "needs finite numbers and a symmetric positive definite covariance, m²".into(),
        })?;
        Ok(Some((position.frame.clone(), gaussian)))
    }
}

fn last_counts(observation: &Observation) -> bool {
    LAST_COUNTS.contains(&observation.segment.as_str())
}

/// The prior knowledge of a class: size, colour, mass, and its source.
pub fn enrichment(class: &str, classes: &[Arc<Snapshot>]) -> BTreeMap<String, Value> {
    let Some(known) = classes.iter().find(|s| s.id.entity() == class) else { return BTreeMap::new() };
    let taken = ["size", "color", "mass", "recognition"].map(|name| (name, known.attribute(name).cloned()));
    let mut attributes = fields(taken);
    attributes.insert("prior".into(), Value::Reference(known.id.reference("ObjectClass")));
    attributes
}

/// The commit of an observation whose entity is now at `place`, if it has a place.
fn commit_of(
    observation: &Observation,
    id: EntityId,
    mut attributes: BTreeMap<String, Value>,
    place: Option<(Frame, Gaussian)>,
    confidence: f64,
) -> Commit {
    attributes.insert("class".into(), observation.class.clone().into());
    let mut instance = Instance::new(BTreeMap::new()).with_confidence(confidence);
    if let Some((frame, place)) = place {
        let position = Vector::new(frame, &place.mean());
        attributes.insert("position".into(), position.into());
        // A known pose moves with the position.
        if let Some(Value::Pose(pose)) = attributes.get_mut("pose").filter(|_| observation.place.is_some()) {
            pose.position = place.mean().into();
        }
        let rows = place.covariance().transpose().as_slice().to_vec();
        instance = instance.with_covariance("position", rows);
    }
    instance.attributes = attributes.into();
    Commit::of(id, observation.stamp_ns, vec![instance])
}

/// `class`, or `class_2`, `class_3` ... if that name is taken.
fn free_name(class: &str, taken: &[String]) -> String {
    let is_free = |name: &String| !taken.contains(name);
    let numbered = (2..).map(|n: u64| format!("{class}_{n}"));
    std::iter::once(class.to_owned()).chain(numbered).find(is_free).unwrap_or_else(|| class.to_owned())
}

#[cfg(test)]
mod tests;
