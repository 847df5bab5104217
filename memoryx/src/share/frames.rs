//! Transforms from another agent's frame into one's own, by the poses of the two agents.
//!
//! An agent's poses are in `root`, its own root frame, or in [`WORLD`], which all agents share. `AgentInstances` has
//! an entity with the agent's name, whose `pose` is in the world frame. If one of the two poses is unknown, the
//! agent's name is put before the frame (`alice/root`), so that no reader takes it for its own.

use std::collections::BTreeMap;

use armarium_values::{Frame, Pose, Value, Vector, Wrench};
use nalgebra::{DMatrix, Isometry3, Point3, UnitQuaternion, Vector3};

use crate::attributes::Attributes;
use crate::entity::Instance;
use crate::query::{Pattern, Query};
use crate::working::WorkingMemory;

/// The frame that all agents share.
pub const WORLD: &str = "world";
/// The core segment of agents.
pub(super) const AGENTS: &str = "AgentInstances";
/// Attributes whose vectors are directions: rotated, not translated.
const DIRECTIONS: [&str; 6] = ["velocity", "direction", "force", "axis", "normal", "acceleration"];

/// The pose of another agent's root frame in one's own, if memory has both agents' poses.
pub fn own_from_other(memory: &WorkingMemory, own: &str, other: &str) -> Option<Isometry3<f64>> {
    let world_from = |agent: &str| {
        let found = memory.query_now(&Query::latest(Pattern::segment(AGENTS).named(agent))).ok()?;
        let newest = found.into_iter().max_by_key(|s| s.referenced_ns)?;
        match newest.attribute("pose") {
            Some(Value::Pose(pose)) if pose.frame.0 == WORLD => Some(pose.isometry()),
            _ => None,
        }
    };
    if own == other {
        return Some(Isometry3::identity());
    }
    Some(world_from(own)?.inverse() * world_from(other)?)
}

/// The instance in one's own frame. Poses, points, directions and wrenches in `root` are transformed with their
/// covariances; those in the world frame stay; other frames get the agent's name as prefix.
pub fn transformed(instance: &Instance, agent: &str, own_from_other: Option<&Isometry3<f64>>) -> Instance {
    let change = FrameChange { agent, own_from_other };
    let mut covariance = BTreeMap::new();
    for (name, rows) in &instance.covariance {
        let frame = instance.attributes.get(name).and_then(frame_of);
        let turned = frame.and_then(|frame| change.of(frame)).map(|by| turned(rows, &by.rotation));
        covariance.insert(name.clone(), turned.unwrap_or_else(|| rows.clone()));
    }
    let pairs = instance.attributes.iter().map(|(name, value)| {
        let moved = change.value(value, DIRECTIONS.contains(&name));
        (name.to_owned(), moved)
    });
    let attributes = Attributes::from(pairs.collect::<BTreeMap<String, Value>>());
    Instance { attributes, confidence: instance.confidence, covariance }
}

fn frame_of(value: &Value) -> Option<&Frame> {
    match value {
        Value::Vector(v) => Some(&v.frame),
        Value::Pose(p) => Some(&p.frame),
        Value::Wrench(w) => Some(&w.frame),
        _ => None,
    }
}

/// Rotates covariances: `R P R'` for each block of three rows and columns.
fn turned(rows: &[f64], rotation: &UnitQuaternion<f64>) -> Vec<f64> {
    let size = match rows.len() {
        9 => 3,
        36 => 6,
        _ => return rows.to_vec(),
    };
    let covariance = DMatrix::from_row_slice(size, size, rows);
    let mut by = DMatrix::zeros(size, size);
    let matrix = rotation.to_rotation_matrix();
    for block in (0..size).step_by(3) {
        by.view_mut((block, block), (3, 3)).copy_from(matrix.matrix());
    }
    let turned = &by * covariance * by.transpose();
    // Remove the asymmetry that rounding causes.
    let turned = (&turned + turned.transpose()) * 0.5;
    turned.transpose().as_slice().to_vec()
}

struct FrameChange<'a> {
    agent: &'a str,
    own_from_other: Option<&'a Isometry3<f64>>,
}

impl FrameChange<'_> {
    /// The transform for values in a frame, if they are to be transformed.
    fn of(&self, frame: &Frame) -> Option<&Isometry3<f64>> {
        self.own_from_other.filter(|_| frame.0 == "root")
    }

    fn frame(&self, frame: &Frame) -> Frame {
        if frame.0 == WORLD || self.of(frame).is_some() {
            frame.clone()
        } else {
            Frame(format!("{}/{}", self.agent, frame.0))
        }
    }

    fn value(&self, value: &Value, is_free: bool) -> Value {
        match value {
            Value::Vector(v) => {
                let vector = Vector3::from(v.components);
                let moved = match self.of(&v.frame) {
                    Some(by) if is_free => by.rotation * vector,
                    Some(by) => (by * Point3::from(vector)).coords,
                    None => vector,
                };
                Value::Vector(Vector::new(self.frame(&v.frame), &moved))
            }
            Value::Pose(p) => match self.of(&p.frame) {
                Some(by) => Value::Pose(Pose::new(p.frame.clone(), &(by * p.isometry()))),
                None => Value::Pose(Pose { frame: self.frame(&p.frame), ..p.clone() }),
            },
            Value::Wrench(w) => {
                let (force, torque) = (Vector3::from(w.force), Vector3::from(w.torque));
                let (force, torque) = match self.of(&w.frame) {
                    // About the new origin: the torque includes the moment of the force.
                    Some(by) => {
                        let force = by.rotation * force;
                        (force, by.rotation * torque + by.translation.vector.cross(&force))
                    }
                    None => (force, torque),
                };
                Value::Wrench(Wrench {
                    frame: self.frame(&w.frame),
                    force: force.into(),
                    torque: torque.into(),
                })
            }
            Value::List(items) => Value::List(items.iter().map(|item| self.value(item, is_free)).collect()),
            Value::Map(fields) => Value::Map(
                fields
                    .iter()
                    .map(|(name, field)| {
                        (name.clone(), self.value(field, DIRECTIONS.contains(&name.as_str())))
                    })
                    .collect(),
            ),
            other => other.clone(),
        }
    }
}
