//! The wrist of the arm that executes a motion, or else of the arm that works: the force on the hand, and the push: the part along the surface that friction does not explain. With
//! one wrist sensor, a push along the surface's normal cannot be distinguished from the surface's force.

use std::collections::BTreeMap;

use armarium_motion::{ContactFrame, FrictionConfig, FrictionModel};
use armarium_robot::Kinematics;
use armarium_runtime::channels::Channels;
use armarium_values::Value;
use nalgebra::{Point3, Vector3};

use crate::arm::{force_at, seconds, sensor_of, tcp_of};
use crate::equipment::{Equipment, running_motion};
use crate::inputs::as_vector;

/// Samples of the robot for each one that is published: 200 Hz at 1 kHz.
const DECIMATION: u32 = 5;

/// Publishes `wrist`, and estimates the friction of wiping, whether or not the channel has readers.
pub(super) async fn observe(equipment: Equipment, channels: Channels) {
    let model = equipment.robot.model();
    let Ok(unknown) = FrictionModel::new(FrictionConfig::default()) else { return };
    // What each arm's wiping feels like is learned by itself.
    let mut frictions: BTreeMap<&str, FrictionModel> = BTreeMap::new();
    let mut kinematics = Kinematics::new(model);
    let mut sensed = equipment.robot.sensed();
    let (mut last_ns, mut count) = (None, 0_u32);
    while sensed.changed().await.is_ok() {
        let sample = sensed.borrow_and_update().clone();
        let before = last_ns.replace(sample.stamp_ns).unwrap_or(sample.stamp_ns);
        let dt = seconds(before, sample.stamp_ns);
        let Ok(arm) = equipment.executing_arm(&channels) else { return };
        let (Ok(tcp), Ok(sensor)) = (tcp_of(arm), sensor_of(arm)) else { continue };
        let friction = frictions.entry(&arm.name).or_insert_with(|| unknown.clone());
        kinematics.update(&sample.position);
        let velocity = kinematics.twist(tcp, &Point3::origin(), &sample.velocity).linear;
        let force = force_at(sensor, &sample);
        // Who wipes knows the surface's normal; without a motion nothing is wiped.
        let normal = running_motion(&channels).and_then(|motion| motion.get("normal").and_then(as_vector));
        let normal = normal.unwrap_or_else(Vector3::z);
        let Ok(contact) = ContactFrame::new(&normal) else { continue };
        let pressing = contact.pressing(&force);
        let push = friction.step(dt, pressing, contact.along(&velocity), contact.along(&force));
        // An unusable sample (the first one, or one that is not finite) keeps the previous push.
        let push = push.unwrap_or_else(|_| friction.push());
        count += 1;
        if count % DECIMATION == 0 {
            let [first, second] = contact.tangents();
            let in_root = first.scale(push[0]) + second.scale(push[1]);
            channels.publish(
                "wrist",
                Value::record([
                    ("force", Value::from([force.x, force.y, force.z])),
                    ("push", Value::from([in_root.x, in_root.y, in_root.z])),
                    ("normal", Value::Float(pressing)),
                    ("friction", Value::Float(friction.mu())),
                ]),
            );
        }
    }
}
