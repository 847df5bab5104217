//! What the hands of this robot hold, in memory: it moves with the hand, and what stands on it moves with it.
//!
//! It moves no hand; the skills that do say here what has been taken and what has been let go.

use std::sync::Arc;

use armarium_knowledge::WORLD;
use armarium_knowledge::updater::{Carriers, MotionModel, Settings, carried, predict};
use armarium_memoryx::{Commit, EntityId, Instance, Pattern, Query, Snapshot};
use armarium_runtime::skill::Failure;
use armarium_values::{Frame, Pose, Value, Vector};
use nalgebra::{Isometry3, Point3};

use crate::arm::tcp_of;
use crate::equipment::Equipment;
use crate::inputs::pose_value;
use crate::motions::failed;
use crate::places::{KnownPlace, known};

/// The core segments of things, and of how they stand to each other.
const THINGS: &str = "ObjectInstances";
const RELATIONS: &str = "ObjectRelations";
/// What stands on a thing has its underside within this of that one's upper side, m.
const STANDS: f64 = 0.02;
/// What stands on a thing was seen this much later at most than that thing where it stood, ns.
const SEEN_TOGETHER_NS: u64 = 500_000_000;
/// A thing that has moved by less, m and rad, since it was last written is not written again.
const MOVED: (f64, f64) = (5e-4, 5e-3);

/// A hand's name for all agents: the agent's name as prefix distinguishes the hands of several agents.
fn hand_of_agent(equipment: &Equipment, hand: &str) -> String {
    format!("{}/{hand}", equipment.agent)
}

/// The hands of this robot, by those names.
pub(crate) struct OwnHands(pub(crate) Equipment);

impl Carriers for OwnHands {
    fn hand(&self, name: &str, at_ns: u64) -> Option<Pose> {
        let hand = name.strip_prefix(self.0.agent.as_str())?.strip_prefix('/')?;
        let arm = self.0.robot.model().arms().find(|arm| arm.hand.as_deref() == Some(hand))?;
        let root_from_tcp = self.0.link_at(tcp_of(arm).ok()?, at_ns).ok()?;
        let world = Frame(WORLD.to_owned());
        Some(match self.0.transforms.read().transform(&world, &Frame::root(), at_ns) {
            Ok(world_from_root) => Pose::new(world, &(world_from_root * root_from_tcp)),
            Err(_) => Pose::new(Frame::root(), &root_from_tcp),
        })
    }
}

/// The things in memory that this agent has written.
async fn own_things(equipment: &Equipment) -> Result<Vec<Arc<Snapshot>>, Failure> {
    let own = Pattern::segment(THINGS).of_provider(&equipment.agent);
    equipment.memory.query(&Query::latest(own)).await.map_err(failed)
}

/// Says in memory that a hand holds a thing, which is at `root_from_thing` now and at `tcp_from_thing` in the hand; and that what
/// stands on it moves along. Returns the thing's address.
pub(crate) async fn take(
    equipment: &Equipment,
    (hand, thing): (&str, &Snapshot),
    root_from_thing: &Isometry3<f64>,
    tcp_from_thing: &Isometry3<f64>,
) -> Result<EntityId, Failure> {
    let stamp_ns = equipment.robot.sensed().borrow().stamp_ns;
    let name = hand_of_agent(equipment, hand);
    let id = EntityId::new(THINGS, &equipment.agent, thing.id.entity()).map_err(failed)?;
    let model = MotionModel::Hand { name: name.clone(), offset: *tcp_from_thing };
    let mut commits = vec![moving(&id, thing, stamp_ns, root_from_thing, &model)];
    let all = known(equipment.remembered()).await?;
    if let Some(below) = all.iter().find(|known| known.thing.as_ref() == Some(&thing.id)) {
        for on_it in all.iter().filter(|known| stands_on(known, below)) {
            let Some(other) = &on_it.thing else { continue };
            let snapshot = equipment.memory.latest(other).await.map_err(failed)?;
            // What was seen later may be the thing itself, in the hand already.
            if snapshot.referenced_ns > thing.referenced_ns.saturating_add(SEEN_TOGETHER_NS) {
                continue;
            }
            let offset = below.shape.root_from_box.inverse() * on_it.shape.root_from_box;
            let model = MotionModel::Object { id: id.to_string(), offset };
            let own = EntityId::new(THINGS, &equipment.agent, other.entity()).map_err(failed)?;
            commits.push(moving(&own, &snapshot, stamp_ns, &(root_from_thing * offset), &model));
        }
    }
    let related = [("subject", id.as_str().into()), ("relation", "in".into()), ("object", name.into())];
    commits.push(Commit::new(relation(equipment, &id, hand)?, stamp_ns, related));
    equipment.memory.commit(commits).await.map_err(failed)?;
    Ok(id)
}

/// The address of the relation that a thing is in a hand.
fn relation(equipment: &Equipment, thing: &EntityId, hand: &str) -> Result<EntityId, Failure> {
    let name = format!("{}-in-{hand}", thing.entity());
    EntityId::new(RELATIONS, &equipment.agent, &name).map_err(failed)
}

/// That a thing is here now and moves by a model.
fn moving(
    id: &EntityId,
    was: &Snapshot,
    stamp_ns: u64,
    root_from_thing: &Isometry3<f64>,
    model: &MotionModel,
) -> Commit {
    let mut attributes = was.instance().map(|instance| instance.attributes.to_map()).unwrap_or_default();
    attributes.insert("pose".into(), pose_value(root_from_thing));
    let position = Vector::new(Frame::root(), &root_from_thing.translation.vector);
    attributes.insert("position".into(), Value::Vector(position));
    attributes.extend(model.attributes());
    // It is this agent's knowledge now, whoever told it before.
    attributes.remove("origin");
    let confidence = was.instance().map_or(1.0, |instance| instance.confidence);
    Commit::new(id.clone(), stamp_ns, attributes).with_confidence(confidence)
}

/// Whether a thing stands on another one: its middle is over it, and its underside on its upper side.
fn stands_on(thing: &KnownPlace, below: &KnownPlace) -> bool {
    let (half, size) = (thing.shape.size / 2.0, below.shape.size / 2.0);
    let at = below.shape.root_from_box.inverse() * Point3::from(thing.shape.root_from_box.translation.vector);
    let over = at.x.abs() < size.x && at.y.abs() < size.y;
    thing.thing != below.thing && over && (at.z - half.z - size.z).abs() < STANDS
}

/// Says in memory that a hand has let go: what it held, and what stands on that, stays where it is now.
pub(crate) async fn let_go(equipment: &Equipment, hand: &str) -> Result<(), Failure> {
    let name = hand_of_agent(equipment, hand);
    let with_model = |thing: Arc<Snapshot>| {
        let model = MotionModel::of(thing.instance()?);
        Some((thing, model))
    };
    let mut attached: Vec<_> = own_things(equipment).await?.into_iter().filter_map(with_model).collect();
    let held = |model: &MotionModel| matches!(model, MotionModel::Hand { name: by, .. } if *by == name);
    let mut free: Vec<Arc<Snapshot>> =
        attached.extract_if(.., |(_, model)| held(model)).map(|(thing, _)| thing).collect();
    let mut commits: Vec<Commit> = Vec::new();
    for thing in &free {
        commits.push(Commit::removal(relation(equipment, &thing.id, hand)?, thing.referenced_ns));
    }
    // What stands on one of them, and what stands on that in turn.
    let mut next = 0;
    while let Some(below) = free.get(next).map(|thing| thing.id.to_string()) {
        let on_it = |model: &MotionModel| matches!(model, MotionModel::Object { id, .. } if *id == below);
        free.extend(attached.extract_if(.., |(_, model)| on_it(model)).map(|(thing, _)| thing));
        next += 1;
    }
    for thing in free {
        let Some(instance) = thing.instance() else { continue };
        let mut attributes = instance.attributes.to_map();
        attributes.retain(|name, _| !["attached_to", "offset"].contains(&name.as_str()));
        attributes.extend(MotionModel::Static.attributes());
        let instances = vec![Instance { attributes: attributes.into(), ..instance.clone() }];
        commits.push(Commit::of(thing.id.clone(), thing.referenced_ns, instances));
    }
    if !commits.is_empty() {
        equipment.memory.commit(commits).await.map_err(failed)?;
    }
    Ok(())
}

/// Writes where what is carried is now, as far as it has moved. Returns whether anything is carried.
pub(crate) async fn carry_on(equipment: &Equipment, hands: &OwnHands) -> Result<bool, Failure> {
    let things = own_things(equipment).await?;
    let now_ns = equipment.robot.sensed().borrow().stamp_ns;
    let (mut carries, mut commits) = (false, Vec::new());
    for thing in &things {
        let Some(pose) = carried(thing, now_ns, &things, hands) else { continue };
        carries = true;
        let Some(instance) = thing.instance().filter(|_| has_moved(thing, &pose)) else { continue };
        let mut attributes = instance.attributes.to_map();
        attributes
            .insert("position".into(), Value::Vector(Vector::new(pose.frame.clone(), &pose.position.into())));
        attributes.insert("pose".into(), Value::Pose(pose));
        let mut carried = Instance { attributes: attributes.into(), ..instance.clone() };
        if let Some((_, place)) = predict(thing, now_ns, &things, hands, &Settings::default()) {
            carried = carried.with_covariance("position", place.covariance().transpose().as_slice().to_vec());
        }
        commits.push(Commit::of(thing.id.clone(), now_ns, vec![carried]).expecting(thing.version));
    }
    if !commits.is_empty() {
        equipment.memory.commit(commits).await.map_err(failed)?;
    }
    Ok(carries)
}

fn has_moved(thing: &Snapshot, now: &Pose) -> bool {
    let Some(Value::Pose(before)) = thing.attribute("pose") else { return true };
    let off = before.isometry().inverse() * now.isometry();
    before.frame != now.frame || off.translation.vector.norm() > MOVED.0 || off.rotation.angle() > MOVED.1
}
