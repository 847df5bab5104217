//! Messages as bytes with the schema that their encoding names.

use armarium_bus::{Bounds, CodecError, Payload, codec};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// What a message of this room may be at most: it is read on a thread of the link.
const BOUNDS: Bounds = Bounds { bytes: 256 << 10, items: 32 << 10, depth: 16 };

/// Decodes a payload whose encoding names the type.
pub(crate) fn read<T: Payload>(encoding: &str, payload: &[u8]) -> Result<T, CodecError> {
    T::SCHEMA.check(encoding)?;
    codec::decode_within(payload, BOUNDS)
}

/// Encoding and payload; the messages of this room can be encoded.
pub(crate) fn written<T: Payload>(message: &T) -> (String, Vec<u8>) {
    (T::SCHEMA.encoding(), codec::encode(message).expect("numbers, texts and lists can be encoded"))
}

/// A position and a unit quaternion x y z w.
pub(crate) type WirePose = ([f64; 3], [f64; 4]);

pub(crate) fn wire_pose(pose: &Isometry3<f64>) -> WirePose {
    (pose.translation.vector.into(), pose.rotation.coords.into())
}

pub(crate) fn pose((position, [x, y, z, w]): WirePose) -> Isometry3<f64> {
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Vector3::from(position).into(), rotation)
}
