//! The channel `hand`: the coach's hand. While a motion runs, `came_at` is the phase (rad) at which the hand came to rest.

use std::collections::BTreeMap;

use armarium_runtime::channels::Channels;
use armarium_values::{Frame, Observation, Value, Vector};
use armarium_visionx::HandStep;
use nalgebra::{Isometry3, Vector3};

use super::arrival::Arrival;
use super::seen;
use crate::arm::tcp_of;
use crate::equipment::Equipment;

pub(super) async fn observe(equipment: Equipment, channels: Channels) {
    let look = || equipment.look(HandStep::new(equipment.hands.observer(equipment.images.calibration())));
    let mut arrival = Arrival::default();
    seen::publish(&equipment, &channels, "hand", look, |frame, seen| {
        let mut value = describe(&equipment, &channels, seen);
        let motion = channels.newest("motion");
        let field = |name: &str| motion.as_ref().and_then(|s| s.value.get(name).and_then(Value::as_f64));
        let palm = seen.place.as_ref().map(|place| place.position.vector());
        let came = arrival.update(frame.stamp_ns, palm, field("phase").zip(field("frequency")));
        if let (Value::Map(fields), Some(came)) = (&mut value, came) {
            fields.insert("came_at".into(), Value::Float(came));
        }
        value
    })
    .await;
}

/// The fields of the channel.
fn describe(equipment: &Equipment, channels: &Channels, seen: &Observation) -> Value {
    let attribute = |name: &str| seen.attributes.get(name).cloned().map(|value| (name.to_owned(), value));
    let told = ["gesture", "hidden", "direction", "shown"].into_iter().filter_map(attribute);
    let mut fields: BTreeMap<String, Value> = told.collect();
    fields.insert("confidence".into(), seen.confidence.into());
    if let Some(place) = &seen.place {
        let sensed = equipment.robot.sensed().borrow().clone();
        let tcp = equipment.executing_arm(channels).and_then(tcp_of);
        let pose = |tcp| equipment.robot.model().link_pose(&sensed.position, tcp);
        let tcp = tcp.map_or_else(|_| Isometry3::identity(), pose);
        let distance = (place.position.vector() - tcp.translation.vector).norm();
        fields.insert("position".into(), Value::Vector(place.position.clone()));
        fields.insert("distance".into(), distance.into());
        let nowhere = || Value::Vector(Vector::new(Frame::root(), &Vector3::zeros()));
        fields.entry("direction".into()).or_insert_with(nowhere);
    }
    Value::Map(fields)
}
