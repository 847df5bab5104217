//! Tells memory where the things are that the robot carries, while it carries any: whoever follows it knows it too.

use std::time::Duration;

use armarium_memoryx::Pattern;
use tokio::sync::broadcast::error::RecvError;

use crate::equipment::Equipment;
use crate::held::{OwnHands, carry_on};

/// How often memory is told.
const PERIOD: Duration = Duration::from_millis(20);

pub(super) async fn observe(equipment: Equipment) {
    let hands = OwnHands(equipment.clone());
    loop {
        let Ok(mut changes) = equipment.memory.subscribe(&Pattern::any()).await else {
            return tracing::warn!("where things are carried is not written: memory cannot be followed");
        };
        let carries = carry_on(&equipment, &hands).await.unwrap_or_else(|failure| {
            // Somebody else has written it meanwhile, or memory is full.
            tracing::debug!("where things are carried was not written: {}", failure.reason);
            true
        });
        if carries {
            tokio::time::sleep(PERIOD).await;
            continue;
        }
        // Nothing is carried until memory says so.
        loop {
            match changes.recv().await {
                Ok(change) if change.attribute("attached_to").is_none() => {}
                Ok(_) | Err(RecvError::Lagged(_)) => break,
                Err(RecvError::Closed) => return,
            }
        }
    }
}
