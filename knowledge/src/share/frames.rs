//! Transforms from another agent's frame into one's own, by the poses of the two agents.
//!
//! An agent's poses are in `root`, its own root frame, or in [`WORLD`], which all agents share. `AgentInstances` has
//! an entity with the agent's name, whose `pose` is in the world frame. If one of the two poses is unknown, the
//! agent's name is put before the frame (`alice/root`), so that no reader takes it for its own.

use std::collections::BTreeMap;

use armarium_memoryx::{Attributes, Instance, Pattern, Query, WorkingMemory};
use armarium_values::{Frame, FrameChange, Pose, Value, Vector, Wrench};
use nalgebra::Isometry3;

/// The frame that all agents share.
pub const WORLD: &str = "world";
/// The core segment of agents.
pub(super) const AGENTS: &str = "AgentInstances";

/// The pose of another agent's root frame in one's own, if memory has both agents' poses.
pub(super) fn own_from_other(memory: &WorkingMemory, own: &str, other: &str) -> Option<Isometry3<f64>> {
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
pub(super) fn transformed(
    instance: &Instance,
    agent: &str,
    own_from_other: Option<&Isometry3<f64>>,
) -> Instance {
    let root = Frame::root();
    let change = own_from_other.map(|to_from_from| FrameChange { from: &root, to: &root, to_from_from });
    let moved = |name: &str, value: &Value| change.map_or_else(|| value.clone(), |by| by.value(name, value));
    let mut covariance = BTreeMap::new();
    for (name, rows) in &instance.covariance {
        let in_root = instance.attributes.get(name).and_then(Value::frame) == Some(&root);
        let turned = change.filter(|_| in_root).map(|by| by.covariance(rows));
        covariance.insert(name.clone(), turned.unwrap_or_else(|| rows.clone()));
    }
    let frame = |frame: Frame| {
        let is_known = frame.0 == WORLD || (frame == root && own_from_other.is_some());
        if is_known { frame } else { Frame(format!("{agent}/{}", frame.0)) }
    };
    let named = |(name, value): (&str, &Value)| (name.into(), in_frames(moved(name, value), &frame));
    let attributes = Attributes::from_pairs(instance.attributes.iter().map(named).collect());
    Instance { attributes, confidence: instance.confidence, covariance }
}

/// The value with each of its frames replaced.
fn in_frames(value: Value, frame: &dyn Fn(Frame) -> Frame) -> Value {
    match value {
        Value::Vector(v) => Value::Vector(Vector { frame: frame(v.frame), ..v }),
        Value::Pose(p) => Value::Pose(Pose { frame: frame(p.frame), ..p }),
        Value::Wrench(w) => Value::Wrench(Wrench { frame: frame(w.frame), ..w }),
        Value::List(items) => Value::List(items.into_iter().map(|item| in_frames(item, frame)).collect()),
        Value::Map(fields) => {
            Value::Map(fields.into_iter().map(|(name, field)| (name, in_frames(field, frame))).collect())
        }
        other => other,
    }
}
