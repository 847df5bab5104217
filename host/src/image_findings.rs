//! What a processor of images found, as a line of JSON and as observations for a memory. It knows neither the processors
//! nor the memory.

use std::collections::BTreeMap;

use armarium_memoryx::updater::Observation;
use armarium_memoryx::{Commit, EntityId, MemoryError};
use armarium_values::{Frame, Pose, Value, Vector};
use armarium_visionx::{FindingSource, ImageFinding, TableObject, Tabletop};
use nalgebra::{Isometry3, Matrix3, Vector3};
use serde_json::{Value as Json, json};

/// Variance of a palm's position along each axis, m²: the observer gives none, and the palm's centre is known to
/// about 1 cm.
const PALM: f64 = 1e-4;
/// Confidence of an object on a table after one observation.
const THING: f64 = 0.8;

/// A finding as a line of JSON.
#[must_use]
pub fn line(source: &FindingSource, finding: &ImageFinding) -> Json {
    let mut line = json!({"provider": source.provider, "stamp_ns": source.stamp_ns});
    line[source.processor.as_str()] = match finding {
        ImageFinding::Hand(Some(hand)) => json!({
            "gesture": hand.gesture.to_string(), "confidence": hand.confidence,
            "palm_m": hand.palm_in_left.coords.as_slice(), "palm_px": hand.palm_px.coords.as_slice(),
        }),
        ImageFinding::Marker(Some(marker)) => json!({
            "position_m": marker.point_in_left.coords.as_slice(), "visible": marker.visible,
        }),
        ImageFinding::Fingertips(tips) => tips
            .iter()
            .map(|tip| {
                json!({
                    "id": tip.id, "x": tip.px.x, "y": tip.px.y, "score": tip.score,
                })
            })
            .collect(),
        ImageFinding::Tabletop(Some(seen)) => json!({
            "table": {"pose_m_rad": pose(&seen.table.root_from_table), "size_m": seen.table.size},
            "objects": seen.objects.iter().map(thing).collect::<Vec<_>>(),
        }),
        _ => Json::Null,
    };
    line
}

fn thing(object: &TableObject) -> Json {
    json!({
        "pose_m_rad": pose(&object.root_from_object), "size_m": object.size.as_slice(), "color": object.color,
        "box_px": object.bounding_box,
    })
}

/// x, y, z, m, and roll, pitch, yaw, rad.
fn pose(pose: &Isometry3<f64>) -> [f64; 6] {
    let (p, (roll, pitch, yaw)) = (pose.translation.vector, pose.rotation.euler_angles());
    [p.x, p.y, p.z, roll, pitch, yaw]
}

/// The observations of positions in a finding; empty without one. Those in a camera's frame have the frame
/// `frame_id`.
#[must_use]
pub fn observations(source: &FindingSource, finding: &ImageFinding, frame_id: &str) -> Vec<Observation> {
    let observed =
        |class: &str, frame: &str, position: &Vector3<f64>, covariance: &Matrix3<f64>| Observation {
            class: class.to_owned(),
            stamp_ns: source.stamp_ns,
            position: Vector::new(Frame::from(frame), position),
            covariance: std::array::from_fn(|i| covariance[(i / 3, i % 3)]),
            confidence: 1.0,
            attributes: BTreeMap::new(),
        };
    let in_camera = |position: &Vector3<f64>, covariance: &Matrix3<f64>| {
        observed(&source.processor, frame_id, position, covariance)
    };
    match finding {
        ImageFinding::Hand(Some(hand)) => {
            let gesture = Value::from(hand.gesture.to_string().as_str());
            vec![Observation {
                confidence: hand.confidence.clamp(0.0, 1.0),
                attributes: BTreeMap::from([("gesture".to_owned(), gesture)]),
                ..in_camera(&hand.palm_in_left.coords, &(Matrix3::identity() * PALM))
            }]
        }
        ImageFinding::Marker(Some(marker)) => vec![Observation {
            confidence: marker.visible.clamp(0.0, 1.0),
            ..in_camera(&marker.point_in_left.coords, &marker.covariance)
        }],
        ImageFinding::Tabletop(Some(seen)) => {
            let thing = |object: &TableObject| Observation {
                confidence: THING,
                attributes: attributes_of(object),
                ..observed("thing", "root", &object.root_from_object.translation.vector, &object.covariance)
            };
            seen.objects.iter().map(thing).collect()
        }
        _ => Vec::new(),
    }
}

fn attributes_of(object: &TableObject) -> BTreeMap<String, Value> {
    let color: Vec<f64> = object.color.iter().map(|c| f64::from(*c)).collect();
    BTreeMap::from([
        ("pose".to_owned(), Value::Pose(Pose::new(Frame::from("root"), &object.root_from_object))),
        ("size".to_owned(), Value::from(object.size.as_slice().to_vec())),
        ("color".to_owned(), Value::from(color)),
    ])
}

/// The fixed objects in a finding: a table, as `EnvironmentModels/{processor}/table`.
///
/// # Errors
/// [`MemoryError::Name`] when the processor's name is not valid in an address.
pub fn surroundings(source: &FindingSource, finding: &ImageFinding) -> Result<Option<Commit>, MemoryError> {
    let ImageFinding::Tabletop(Some(Tabletop { table, .. })) = finding else { return Ok(None) };
    let id = EntityId::new("EnvironmentModels", &source.processor, "table")?;
    let pose = Value::Pose(Pose::new(Frame::from("root"), &table.root_from_table));
    let size = Value::from([table.size[0], table.size[1], 0.0]);
    Ok(Some(Commit::new(id, source.stamp_ns, [("pose", pose), ("size", size)])))
}
