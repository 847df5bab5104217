//! The messages of a recording: Foxglove's schemas where they exist, otherwise JSON with our own schemas.

use foxglove::messages as fg;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// The coordinate frame of recorded poses: x right, y forward, z up, origin on the floor.
pub(super) const ROOT: &str = "root";

/// The true contact between the judged object and the table at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrueContact {
    /// Force along the table's normal, N; positive presses.
    pub normal_n: f64,
    /// Magnitude of the force in the table's plane, N.
    pub tangential_n: f64,
}

/// The wrist's force and torque at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WrenchSample {
    /// Raw force of the sensor, in the sensor's frame, N.
    pub force_raw: [f64; 3],
    /// Raw torque of the sensor about its origin, in the sensor's frame, N m.
    pub torque_raw: [f64; 3],
    /// Force of the environment on the hand, compensated, in the root frame, N.
    pub force: [f64; 3],
    /// Torque of the environment on the hand about the TCP, compensated, in the root frame, N m.
    pub torque: [f64; 3],
}

/// The severity of a log line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LogLevel {
    /// Details for finding faults.
    Debug,
    /// Normal events.
    Info,
    /// Possible problems.
    Warning,
    /// Errors.
    Error,
}

pub(super) const CONTACT_SCHEMA: &str = r#"{"title":"armarium.TrueContact","description":"True contact of the object in the hand with the table.","type":"object","properties":{"normal_n":{"type":"number","description":"Force along the table's normal, N; positive presses."},"tangential_n":{"type":"number","description":"Size of the force in the table's plane, N."}},"required":["normal_n","tangential_n"]}"#;

pub(super) const WRENCH_SCHEMA: &str = r#"{"title":"armarium.WrenchSample","description":"Force and torque at the wrist.","type":"object","properties":{"force_raw":{"type":"array","items":{"type":"number"},"description":"As the sensor gives it, sensor frame, N."},"torque_raw":{"type":"array","items":{"type":"number"},"description":"As the sensor gives it, about the sensor's origin, sensor frame, N m."},"force":{"type":"array","items":{"type":"number"},"description":"Of the environment on the hand, compensated, root frame, N."},"torque":{"type":"array","items":{"type":"number"},"description":"Of the environment on the hand about the TCP, compensated, root frame, N m."}},"required":["force_raw","torque_raw","force","torque"]}"#;

pub(super) const EVENT_SCHEMA: &str = r#"{"title":"armarium.ChartEvent","description":"Something that happened in the chart.","type":"object"}"#;

pub(super) const TRUTH_EVENT_SCHEMA: &str = r#"{"title":"armarium.TruthEvent","description":"Something that truly happened: what the robot said, what the coach began or ended, what was reached, which object was grasped, whether one is held.","type":"object","properties":{"what":{"type":"string","enum":["said","coach","reached","grasped","held"]},"detail":{"description":"Of the coach: step of the world's coaching from 0, kind, event, t in s."}},"required":["what","detail"]}"#;

pub(super) const SHOWN_HAND_SCHEMA: &str = r#"{"title":"armarium.ShownHand","description":"What the coach's hand truly showed in one camera frame.","type":"object","properties":{"stamp_ns":{"type":"integer","description":"When the frame was taken, ns."},"gesture":{"type":["string","null"],"enum":["fist","point_one","point_two","open_hand",null],"description":"The gesture; null without a hand."},"since_s":{"type":"number","description":"For how long it has been so, s."},"visible":{"type":"boolean","description":"Whether the whole hand is in both images and nothing hides it."}},"required":["stamp_ns","gesture","since_s","visible"]}"#;

pub(super) const SEEN_HAND_SCHEMA: &str = r#"{"title":"armarium.SeenHand","description":"What vision took the coach's hand for in one camera frame; log time is the frame's.","type":"object","properties":{"gesture":{"type":"string","description":"fist, point_one, point_two, open_hand or none."}}}"#;

pub(super) const OBJECT_SCHEMA: &str = r#"{"title":"armarium.Object","type":"object"}"#;

pub(super) fn stamp(t_ns: u64) -> Option<fg::Timestamp> {
    let seconds = u32::try_from(t_ns / 1_000_000_000).unwrap_or(u32::MAX);
    fg::Timestamp::new_checked(seconds, (t_ns % 1_000_000_000) as u32)
}

pub(super) fn pose(root_from_thing: &Isometry3<f64>) -> fg::Pose {
    let t = root_from_thing.translation.vector;
    let q = root_from_thing.rotation.coords;
    fg::Pose {
        position: Some(fg::Vector3 { x: t.x, y: t.y, z: t.z }),
        orientation: Some(fg::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w }),
    }
}

/// The part of a topic after its last slash: the frame of the topic's subject.
pub(super) fn frame_of(topic: &str) -> String {
    topic.rsplit('/').next().unwrap_or(topic).to_owned()
}

pub(super) fn transform(topic: &str) -> fg::FrameTransform {
    fg::FrameTransform { parent_frame_id: ROOT.into(), child_frame_id: frame_of(topic), ..Default::default() }
}

pub(super) fn compressed_image(topic: &str, t_ns: u64, data: Vec<u8>) -> fg::CompressedImage {
    fg::CompressedImage {
        timestamp: stamp(t_ns),
        frame_id: frame_of(topic),
        data: data.into(),
        format: "jpeg".into(),
    }
}

pub(super) fn log(t_ns: u64, level: LogLevel, source: &str, message: &str) -> fg::Log {
    let level = match level {
        LogLevel::Debug => fg::log::Level::Debug,
        LogLevel::Info => fg::log::Level::Info,
        LogLevel::Warning => fg::log::Level::Warning,
        LogLevel::Error => fg::log::Level::Error,
    };
    fg::Log {
        timestamp: stamp(t_ns),
        level: level.into(),
        message: message.to_owned(),
        name: source.to_owned(),
        ..Default::default()
    }
}
