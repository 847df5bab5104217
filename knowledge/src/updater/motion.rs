//! Motion models: the expected position of an entity between two observations.
//!
//! Attributes of the entity: `motion_model` (`static`, `hand` or `object`), `attached_to` (the hand's name or the other
//! entity's address) and `offset` (its pose in the carrier's frame, m; a vector where the turn is not known).

use std::sync::Arc;

use armarium_memoryx::{Instance, Snapshot, place_of};
use armarium_values::{Frame, Pose, Value};
use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};

use super::Settings;
use super::kalman::Gaussian;

/// The variance of a position without covariance: 1 cm along each axis, squared, m².
const UNKNOWN_VARIANCE: f64 = 1e-4;
/// Longest chain of carriers that are carried themselves.
const MAX_CARRIERS: usize = 8;

/// How an entity moves between observations.
#[derive(Clone, Debug, PartialEq)]
pub enum MotionModel {
    /// It does not move.
    Static,
    /// It moves with a hand of the robot.
    Hand {
        /// The hand.
        name: String,
        /// Its pose in the hand's frame, m.
        offset: Isometry3<f64>,
    },
    /// It moves with another entity.
    Object {
        /// The entity's address.
        id: String,
        /// Its pose in the entity's frame, m.
        offset: Isometry3<f64>,
    },
}

/// Supplies the poses of hands.
pub trait Carriers: Send + Sync {
    /// The pose of a hand at a time, m; `None` when unknown.
    fn hand(&self, name: &str, at_ns: u64) -> Option<Pose>;
}

/// Knows no hands.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoCarriers;

impl Carriers for NoCarriers {
    fn hand(&self, _: &str, _: u64) -> Option<Pose> {
        None
    }
}

impl MotionModel {
    /// The model named in an instance; static when none is named, or when its attributes are incomplete.
    pub fn of(instance: &Instance) -> Self {
        let text = |name: &str| instance.attributes.get(name).and_then(Value::as_str).map(str::to_owned);
        let offset = match instance.attributes.get("offset") {
            Some(Value::Pose(pose)) => pose.isometry(),
            offset => Translation3::from(offset.and_then(Value::as_vector3).unwrap_or_default()).into(),
        };
        match (text("motion_model").as_deref(), text("attached_to")) {
            (Some("hand"), Some(name)) => Self::Hand { name, offset },
            (Some("object"), Some(id)) => Self::Object { id, offset },
            _ => Self::Static,
        }
    }

    /// The attributes that name the model.
    pub fn attributes(&self) -> Vec<(String, Value)> {
        let (kind, carrier) = match self {
            Self::Static => ("static", None),
            Self::Hand { name, offset } => ("hand", Some((name, offset))),
            Self::Object { id, offset } => ("object", Some((id, offset))),
        };
        let mut attributes = vec![("motion_model".to_owned(), kind.into())];
        if let Some((to, offset)) = carrier {
            attributes.push(("attached_to".into(), to.as_str().into()));
            attributes.push(("offset".into(), Value::Pose(Pose::new(Frame(to.clone()), offset))));
        }
        attributes
    }
}

/// The expected position of an entity at a time, with its frame, by its motion model. The variance grows with the
/// time since the last observation. `held`: the newest snapshots of the entities that may carry it. `None` when it has no position.
/// If the carrier's pose is unknown, the entity stays where it was seen.
pub fn predict(
    snapshot: &Snapshot,
    at_ns: u64,
    held: &[Arc<Snapshot>],
    carriers: &dyn Carriers,
    settings: &Settings,
) -> Option<(Frame, Gaussian)> {
    let instance = snapshot.instance()?;
    let (frame, position) = place_of(snapshot)?;
    let seconds = at_ns.saturating_sub(snapshot.referenced_ns) as f64 * 1e-9;
    let rows = instance.covariance.get("position").filter(|rows| rows.len() == 9);
    let covariance =
        rows.map_or_else(|| Matrix3::identity() * UNKNOWN_VARIANCE, |rows| Matrix3::from_row_slice(rows));
    let seen = |frame: &Frame, mean: Vector3<f64>, drift: f64| {
        let gaussian = Gaussian::new(mean, covariance)
            .or_else(|| Gaussian::new(mean, covariance + Matrix3::identity() * 1e-12))?;
        Some((frame.clone(), gaussian.spread(drift * seconds)))
    };
    match carried(snapshot, at_ns, held, carriers) {
        Some(pose) => seen(&pose.frame, Vector3::from(pose.position), settings.carried_drift),
        None => seen(frame, Vector3::from(position), settings.drift),
    }
}

/// The pose at a time of an entity that a hand or another entity carries; `None` of one that is not carried, and where the carrier's
/// pose is unknown. `held`: the newest snapshots of the entities that may carry it.
pub fn carried(
    snapshot: &Snapshot,
    at_ns: u64,
    held: &[Arc<Snapshot>],
    carriers: &dyn Carriers,
) -> Option<Pose> {
    carried_within(snapshot, at_ns, held, carriers, MAX_CARRIERS)
}

fn carried_within(
    snapshot: &Snapshot,
    at_ns: u64,
    held: &[Arc<Snapshot>],
    carriers: &dyn Carriers,
    left: usize,
) -> Option<Pose> {
    let (carrier, offset) = match MotionModel::of(snapshot.instance()?) {
        MotionModel::Static => return None,
        MotionModel::Hand { name, offset } => (carriers.hand(&name, at_ns)?, offset),
        MotionModel::Object { id, offset } => {
            let carrier = held.iter().find(|s| s.id.as_str() == id).filter(|_| left > 0)?;
            let pose = carried_within(carrier, at_ns, held, carriers, left - 1).or_else(|| pose_of(carrier));
            (pose?, offset)
        }
    };
    Some(Pose::new(carrier.frame.clone(), &(carrier.isometry() * offset)))
}

/// Where an entity was seen; not turned where nothing says how.
fn pose_of(snapshot: &Snapshot) -> Option<Pose> {
    let (frame, position) = place_of(snapshot)?;
    let orientation = match snapshot.attribute("pose") {
        Some(Value::Pose(pose)) => pose.orientation,
        _ => [0.0, 0.0, 0.0, 1.0],
    };
    Some(Pose { frame: frame.clone(), position, orientation })
}
