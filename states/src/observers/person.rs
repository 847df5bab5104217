//! The channel `person`: the body of the person before the robot, without the pixels that the robot's own body fills.

use std::collections::BTreeMap;

use armarium_runtime::channels::Channels;
use armarium_values::{Observation, Value};
use armarium_visionx::{BodyObserver, PeopleStep};

use super::seen;
use crate::equipment::Equipment;
use crate::own_hand::own_body;

pub(super) async fn observe(equipment: Equipment, channels: Channels) {
    let look = || {
        let observer = BodyObserver::new(equipment.images.calibration());
        equipment.look(PeopleStep::new(observer, own_body(&equipment)))
    };
    seen::publish(&equipment, &channels, "person", look, |_, seen| describe(seen)).await;
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
