//! What memory knows of places, such as a table, for the robot's guard: its bodies keep their distance from them.

use armarium_robot::planning::KnownBox;
use tokio::sync::broadcast::error::RecvError;

use crate::equipment::Equipment;
use crate::places::places;

/// Passes the places in memory on to the robot, now and whenever they change.
pub(super) async fn observe(equipment: Equipment) {
    let mut updates = equipment.memory.subscribe();
    let mut known: Option<Vec<KnownBox>> = None;
    loop {
        match places(&*equipment.memory).await {
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
                Ok(update) if update.id.segment() != "EnvironmentModels" => {}
                Ok(_) | Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
    }
}
