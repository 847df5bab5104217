//! Geometric values that carry the frame they are expressed in. SI units, right-handed frames (REP 103).

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// The name of a coordinate frame, for instance `root` (robot's root frame), `world` or `tcp_right`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Frame(pub String);

impl Frame {
    /// The robot's root frame: x right, y forward, z up, origin on the floor.
    pub fn root() -> Self {
        Self("root".into())
    }
}

impl From<&str> for Frame {
    fn from(name: &str) -> Self {
        Self(name.into())
    }
}

/// A free vector or a point, expressed in `frame`. The unit is the context's (m, m/s, N).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vector {
    /// The frame that the components are expressed in.
    pub frame: Frame,
    /// Components x, y, z.
    pub components: [f64; 3],
}

/// Position (m) and orientation (unit quaternion x, y, z, w) of something, expressed in `frame`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The frame that the pose is expressed in.
    pub frame: Frame,
    /// Position, m.
    pub position: [f64; 3],
    /// Orientation, unit quaternion in the order x, y, z, w.
    pub orientation: [f64; 4],
}

/// A force (N) and a torque (N m) about the origin of `frame`, expressed in `frame`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// The frame that the wrench is expressed in, and about whose origin the torque is taken.
    pub frame: Frame,
    /// Force, N.
    pub force: [f64; 3],
    /// Torque, N m.
    pub torque: [f64; 3],
}

impl Vector {
    /// A vector with its frame.
    pub fn new(frame: Frame, v: &Vector3<f64>) -> Self {
        Self { frame, components: [v.x, v.y, v.z] }
    }

    /// The components as a nalgebra vector.
    pub fn vector(&self) -> Vector3<f64> {
        Vector3::from(self.components)
    }
}

impl Pose {
    /// A pose with its frame.
    pub fn new(frame: Frame, pose: &Isometry3<f64>) -> Self {
        let t = pose.translation.vector;
        let q = pose.rotation.coords;
        Self { frame, position: [t.x, t.y, t.z], orientation: [q.x, q.y, q.z, q.w] }
    }

    /// The pose as an isometry that maps coordinates of the posed body into `frame`. A quaternion that is not of unit
    /// length is normalised; one of length zero or not finite becomes the identity.
    pub fn isometry(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.orientation;
        let q = Quaternion::new(w, x, y, z);
        let rotation = UnitQuaternion::try_new(q, 1e-9).unwrap_or_else(UnitQuaternion::identity);
        Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation)
    }
}

/// The distance of a point from a box with these edges, m; 0 inside. The point and the box's middle are in the same frame.
pub fn distance_from_box(point: &Point3<f64>, frame_from_box: &Isometry3<f64>, edges: &Vector3<f64>) -> f64 {
    let in_box = frame_from_box.inverse_transform_point(point);
    (in_box.coords.abs() - edges / 2.0).sup(&Vector3::zeros()).norm()
}
