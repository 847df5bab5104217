//! What memory knows of places, such as a table, for the robot's guard: its bodies keep their distance from them. And where the
//! robot stands in the world, for the frames.

use armarium_memoryx::Snapshot;
use armarium_robot::planning::KnownBox;
use armarium_values::transforms::Transforms;
use armarium_values::{Frame, Value};
use parking_lot::RwLock;
use tokio::sync::broadcast::error::RecvError;

use crate::equipment::Equipment;
use crate::places::places;

/// The core segment of agents.
pub(super) const AGENTS: &str = "AgentInstances";

/// Passes places in memory on to the robot, and the pose of its root frame on to the frames, now and whenever they change.
pub(super) async fn observe(equipment: Equipment) {
    let mut updates = equipment.memory.subscribe();
    let mut known: Option<Vec<KnownBox>> = None;
    loop {
        if let Ok(agents) = equipment.memory.segment(AGENTS).await {
            agents.iter().for_each(|agent| stand((&equipment.transforms, &equipment.agent), agent));
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
                Ok(update) if !["EnvironmentModels", AGENTS].contains(&update.id.segment()) => {}
                Ok(_) | Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
    }
}

/// Tells the frames where the robot's root is, if that is what a snapshot says: that of the agent of this name.
pub(super) fn stand((transforms, own): (&RwLock<Transforms>, &str), agent: &Snapshot) {
    let Some(Value::Pose(pose)) = agent.attribute("pose").filter(|_| agent.id.entity() == own) else {
        return;
    };
    if pose.frame != Frame::root()
        && let Err(error) = transforms.write().fix(&Frame::root(), pose)
    {
        tracing::warn!("the frames do not know where `{}` stands: {error}", agent.id);
    }
}
