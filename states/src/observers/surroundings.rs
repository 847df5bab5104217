//! What memory knows of places, such as a table, for the robot's guard: its bodies keep their distance from them. And where the
//! robot, other agents and those places stand, for the frames.

use armarium_knowledge::WORLD;
use armarium_memoryx::{Pattern, Snapshot};
use armarium_robot::planning::KnownBox;
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, Value};
use parking_lot::RwLock;
use tokio::sync::broadcast::error::RecvError;

use crate::equipment::Equipment;
use crate::places::{PLACES, places};

/// The core segments that say where something stands.
pub(super) const AGENTS: &str = "AgentInstances";

/// Passes places in memory on to the robot, and the pose of its root frame on to the frames, now and whenever they change.
pub(super) async fn observe(equipment: Equipment) {
    let Ok(mut updates) = equipment.memory.subscribe(&Pattern::any()).await else {
        return tracing::warn!("the places in memory are not known to the guard: it cannot be followed");
    };
    let mut known: Option<Vec<KnownBox>> = None;
    loop {
        let links = equipment.robot.model().links();
        for segment in [AGENTS, PLACES] {
            let known = equipment.memory.segment(segment).await.unwrap_or_default();
            // The robot knows best where its own links are.
            let known = known.iter().filter(|thing| links.iter().all(|link| link.name != thing.id.entity()));
            known.for_each(|thing| stand((&equipment.transforms, &equipment.agent), thing));
        }
        match places(equipment.remembered()).await {
            Ok(places) if known.as_ref() != Some(&places) => {
                if let Err(error) = equipment.robot.set_surroundings(places.clone()) {
                    tracing::warn!("the guard does not know the places in memory: {error}");
                }
                known = Some(places);
            }
            Ok(_) => {}
            Err(failure) => {
                tracing::warn!("the guard does not know the places in memory: {}", failure.reason)
            }
        }
        loop {
            match updates.recv().await {
                Ok(update) if ![PLACES, AGENTS].contains(&update.id.segment()) => {}
                Ok(_) | Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
    }
}

/// Tells the frames where an agent's root or a place is, if that is what a snapshot says: the root of the agent `own` is `root`, another
/// agent's `alice/root`, and a table `table`.
pub(super) fn stand((transforms, own): (&RwLock<Transforms>, &str), thing: &Snapshot) {
    let Some(Value::Pose(pose)) = thing.attribute("pose") else { return };
    let name = thing.id.entity();
    let frame = match thing.id.segment() == AGENTS {
        true if name == own => Frame::root(),
        true => Frame(format!("{name}/root")),
        false => Frame(name.to_owned()),
    };
    let fixed = [Frame::root(), Frame(WORLD.to_owned())];
    let stands = fixed.contains(&pose.frame) && pose.frame != frame && frame.0 != WORLD;
    if stands && let Err(error) = transforms.write().fix(&frame, pose) {
        tracing::warn!("the frames do not know where `{}` stands: {error}", thing.id);
    }
}
