//! `export -o FILE.mcap`: what memory had, on the timeline of its data, in Foxglove's schemas.
//!
//! Each snapshot is a JSON message on `/memory/SEGMENT/PROVIDER/ENTITY`. Its poses and places in the frame `root` are
//! `foxglove.PoseInFrame` on `/memory/SEGMENT/PROVIDER/ATTRIBUTE/ENTITY`, and on `/tf`; its images are `foxglove.CompressedImage` there.
//! Other bytes are left out.

use std::collections::BTreeMap;
use std::path::Path;

use armarium_host::image_coding::jpeg_file;
use armarium_memoryx::{Pattern, Query, Snapshot};
use armarium_values::Value;
use armarium_viewer::recorder::{Recorder, RecorderError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::CommandFailure;
use super::reach::OpenedMemory;
use super::show::json_of;

/// The quality of images that memory has raw.
const JPEG_QUALITY: u8 = 85;

/// Records all snapshots that match, and returns how many.
pub(super) async fn record(
    reached: &OpenedMemory,
    pattern: Pattern,
    path: &Path,
) -> Result<u64, CommandFailure> {
    let failed = |error: RecorderError| CommandFailure::Refused(format!("`{}`: {error}", path.display()));
    let mut recorder = Recorder::create(path, BTreeMap::new()).map_err(failed)?;
    let mut first: Option<Snapshot> = None;
    let each = |snapshot: &Snapshot| -> Result<(), CommandFailure> {
        let first = first.get_or_insert_with(|| snapshot.clone());
        if first.clock() != snapshot.clock() {
            return Err(CommandFailure::Argument(format!(
                "`{}` is of {}, `{}` of {}, which are not on one timeline: name a pattern of one of them",
                first.id,
                first.clock(),
                snapshot.id,
                snapshot.clock()
            )));
        }
        put(&mut recorder, snapshot).map_err(failed)
    };
    let count = reached.each(Query::history(pattern).with_long_term(), each).await?;
    recorder.finish().map_err(failed)?;
    Ok(count)
}

fn put(recorder: &mut Recorder, snapshot: &Snapshot) -> Result<(), RecorderError> {
    let (id, time_ns) = (&snapshot.id, snapshot.referenced_ns);
    let attributes = snapshot.instance().into_iter().flat_map(|instance| instance.attributes.iter());
    for (name, value) in attributes {
        let topic = || format!("/memory/{}/{}/{name}/{}", id.segment(), id.provider(), id.entity());
        if let Some(pose) = pose_of(value) {
            recorder.pose(&topic(), time_ns, &pose);
        } else if let Some(file) = jpeg_file(value, JPEG_QUALITY) {
            recorder.jpeg(&topic(), time_ns, file);
        }
    }
    let mut plain = snapshot.clone();
    for instance in &mut plain.instances {
        let small = instance.attributes.iter().filter(|(_, value)| !has_bytes(value));
        let small: BTreeMap<String, Value> =
            small.map(|(name, value)| (name.into(), value.clone())).collect();
        instance.attributes = small.into();
    }
    recorder.json(&format!("/memory/{}", id.as_str()), time_ns, &json_of(&plain))
}

/// The pose of a value in the frame `root`.
fn pose_of(value: &Value) -> Option<Isometry3<f64>> {
    let (frame, [x, y, z], [i, j, k, w]) = match value {
        Value::Pose(pose) => (&pose.frame, pose.position, pose.orientation),
        Value::Vector(vector) => (&vector.frame, vector.components, [0.0, 0.0, 0.0, 1.0]),
        _ => return None,
    };
    let turned = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    (frame.0 == "root").then(|| Isometry3::from_parts(Translation3::new(x, y, z), turned))
}

fn has_bytes(value: &Value) -> bool {
    match value {
        Value::Bytes(_) => true,
        Value::List(items) => items.iter().any(has_bytes),
        Value::Map(fields) => fields.values().any(has_bytes),
        _ => false,
    }
}
