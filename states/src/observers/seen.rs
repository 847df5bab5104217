//! What pictures show, on a channel: while it has a reader, each camera frame is searched; memory and the channel tell what was observed.

use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_runtime::channels::Channels;
use armarium_values::{Observation, Value};
use armarium_visionx::{ImageError, Sight, Sighting};

use crate::equipment::Equipment;

/// Publishes what is observed of a class on the channel of the same name: `look` starts the search, and `describe` gives the channel's
/// fields. It ends when the images do.
pub(super) async fn publish(
    equipment: &Equipment,
    channels: &Channels,
    class: &str,
    look: impl Fn() -> Sight,
    mut describe: impl FnMut(&Sighting, &Observation) -> Value,
) {
    let mut wanted = channels.wanted(class);
    let Ok(updater) = Updater::new(Arc::clone(&equipment.memory), &equipment.agent) else { return };
    let mut sight = None;
    loop {
        while *wanted.borrow_and_update() == 0 {
            sight = None;
            if wanted.changed().await.is_err() {
                return;
            }
        }
        let frame = match sight.get_or_insert_with(&look).next().await {
            Ok(frame) => frame,
            Err(ImageError::Gone { .. }) => return,
            Err(_) => continue,
        };
        let Some(seen) = frame.of_class(class) else { continue };
        let value = describe(&frame, seen);
        if let Err(error) = updater.update(std::slice::from_ref(seen)).await {
            tracing::warn!("the {class} was not kept in memory: {error}");
        }
        channels.publish(class, value);
    }
}
