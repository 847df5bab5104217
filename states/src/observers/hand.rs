//! The coach's hand: detected in the camera frames while the channel `hand` has a reader, and written to memory.
//! While a motion runs, `came_at` is the phase (rad) at which the hand came to rest.

use std::collections::BTreeMap;

use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::channels::Channels;
use armarium_values::{Frame, Value, Vector};
use armarium_visionx::{HandObservation, HandObserver, StereoFrame};
use nalgebra::{Isometry3, Vector3};

use crate::arm::tcp_of;
use crate::equipment::Equipment;
use crate::hand_eye::HandEye;
use crate::inputs::as_vector;
use crate::observers::arrival::Arrival;

/// Publishes `hand` for each frame while the channel has a reader.
pub(super) async fn observe(equipment: Equipment, channels: Channels) {
    let mut wanted = channels.wanted("hand");
    let mut observer = HandObserver::new(equipment.images.calibration());
    let mut arrival = Arrival::default();
    loop {
        while *wanted.borrow_and_update() == 0 {
            if wanted.changed().await.is_err() {
                return;
            }
            observer = HandObserver::new(equipment.images.calibration());
        }
        let Ok(frame) = equipment.images.next().await else { return };
        let Ok(hand_eye) = HandEye::load(&*equipment.memory, &equipment.agent).await else { return };
        let frame = hand_eye.corrected(&frame);
        let seen = observer.update(&frame);
        let mut value = describe(&equipment, &channels, &frame, seen.as_ref());
        let motion = channels.newest("motion");
        let field = |name: &str| motion.as_ref().and_then(|s| s.value.get(name).and_then(Value::as_f64));
        let palm = value.get("position").and_then(as_vector);
        let came = arrival.update(frame.stamp_ns, palm, field("phase").zip(field("frequency")));
        if let (Value::Map(fields), Some(came)) = (&mut value, came) {
            fields.insert("came_at".into(), Value::Float(came));
        }
        remember(&equipment, &frame, &value, seen.map_or(1.0, |s| s.confidence)).await;
        channels.publish("hand", value);
    }
}

/// The detection in the root frame; the gesture is `none` without a hand.
fn describe(
    equipment: &Equipment,
    channels: &Channels,
    frame: &StereoFrame,
    seen: Option<&HandObservation>,
) -> Value {
    let Some(seen) = seen else {
        return Value::record([("gesture", Value::from("none")), ("confidence", Value::Float(1.0))]);
    };
    let palm = frame.root_from_left * seen.palm_in_left;
    let direction = seen.pointing.map_or_else(Vector3::zeros, |d| frame.root_from_left * d);
    let sensed = equipment.robot.sensed().borrow().clone();
    let model = equipment.robot.model();
    let tcp = equipment.executing_arm(channels).and_then(tcp_of);
    let tcp = tcp.map_or_else(|_| Isometry3::identity(), |tcp| model.link_pose(&sensed.position, tcp));
    Value::record([
        ("gesture", Value::from(seen.gesture.name())),
        ("confidence", Value::Float(seen.confidence)),
        ("position", Value::Vector(Vector::new(Frame::root(), &palm.coords))),
        ("direction", Value::Vector(Vector::new(Frame::root(), &direction))),
        ("distance", Value::Float((palm.coords - tcp.translation.vector).norm())),
        ("hidden", Value::Float(seen.hidden)),
    ])
}

/// Writes the detection to the memory's `HumanHands`. A failed write does not stop the observer.
async fn remember(equipment: &Equipment, frame: &StereoFrame, value: &Value, confidence: f64) {
    let Ok(id) = EntityId::new("HumanHands", &equipment.agent, "coach") else { return };
    let attributes = match value {
        Value::Map(fields) => fields.clone(),
        _ => BTreeMap::new(),
    };
    let commit = Commit::new(id, frame.stamp_ns, attributes).with_confidence(confidence.clamp(0.0, 1.0));
    if let Err(error) = equipment.memory.commit(vec![commit]).await {
        tracing::warn!("the coach's hand was not kept in memory: {error}");
    }
}
