//! The person before the robot: while the channel `person` has a reader, each camera frame is searched for their body, without the
//! pixels that the robot's own body fills; memory and the channel tell what was observed.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::updater::Updater;
use armarium_runtime::channels::Channels;
use armarium_values::{Observation, Value};
use armarium_visionx::{BodyObserver, ImageError, PeopleStep};

use crate::equipment::Equipment;
use crate::own_hand::own_body;

/// Publishes `person` for each frame while the channel has a reader.
pub(super) async fn observe(equipment: Equipment, channels: Channels) {
    let mut wanted = channels.wanted("person");
    let Ok(updater) = Updater::new(Arc::clone(&equipment.memory), &equipment.agent) else { return };
    let look = || {
        let observer = BodyObserver::new(equipment.images.calibration());
        equipment.look(PeopleStep::new(observer, own_body(&equipment)))
    };
    let mut sight = None;
    loop {
        while *wanted.borrow_and_update() == 0 {
            sight = None;
            if wanted.changed().await.is_err() {
                return;
            }
        }
        let frame = match sight.get_or_insert_with(look).next().await {
            Ok(frame) => frame,
            Err(ImageError::Gone { .. }) => return,
            Err(_) => continue,
        };
        let Some(seen) = frame.of_class("person") else { continue };
        let value = describe(seen);
        if let Err(error) = updater.update(std::slice::from_ref(seen)).await {
            tracing::warn!("the person was not kept in memory: {error}");
        }
        channels.publish("person", value);
    }
}

/// The fields of the channel.
fn describe(seen: &Observation) -> Value {
    let attribute = |name: &str| seen.attributes.get(name).cloned().map(|value| (name.to_owned(), value));
    let mut fields: BTreeMap<String, Value> =
        ["keypoints", "covariances"].into_iter().filter_map(attribute).collect();
    fields.insert("seen".into(), Value::Bool(fields.contains_key("keypoints")));
    fields.insert("confidence".into(), seen.confidence.into());
    fields.extend(seen.place.as_ref().map(|at| ("position".to_owned(), Value::Vector(at.position.clone()))));
    Value::Map(fields)
}
