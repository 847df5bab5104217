//! The surface on which something stands, as far as memory knows it; level where nobody knows.
//!
//! It is what skills ask instead of taking z for up. Its outward normal is the way from which a hand grasps and along which a
//! tool presses.

use armarium_memoryx::Snapshot;
use armarium_robot::planning::KnownBox;
use armarium_runtime::skill::Failure;
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

use crate::places::{Remembered, is_bulk, places_where};

/// What stands on a surface has its underside within this of it, m.
const STANDS: f64 = 0.04;
/// What is above a surface by less than this stands on it or is carried over it, m.
const OVER: f64 = 0.3;
/// How far beside what was seen of a surface it goes on, m.
const GOES_ON: f64 = 0.1;
/// Most visible surfaces are level: one that is steeper than this, rad, is no table.
const STEEPEST: f64 = 0.35;

/// A plane with an outward normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ContactPlane {
    /// A point of it, root frame, m.
    at: Point3<f64>,
    normal: Unit<Vector3<f64>>,
}

impl ContactPlane {
    /// The surface through a point.
    pub(crate) fn new(at: Point3<f64>, normal: Unit<Vector3<f64>>) -> Self {
        Self { at, normal }
    }

    /// The surface in whose frame z is the normal.
    pub(crate) fn of(root_from_surface: Isometry3<f64>) -> Self {
        let normal = Unit::new_normalize(root_from_surface * Vector3::z());
        Self::new(root_from_surface.translation.vector.into(), normal)
    }

    /// The level surface through a point.
    pub(crate) fn level(at: Point3<f64>) -> Self {
        Self::new(at, Vector3::z_axis())
    }

    /// The surface in memory over which a point is; the level one through the point where memory knows none.
    pub(crate) async fn under(memory: Remembered<'_>, point: &Point3<f64>) -> Result<Self, Failure> {
        Ok(Self::known_under(memory, point).await?.unwrap_or_else(|| Self::level(*point)))
    }

    /// The surface in memory over which a point is, if there is one. The box around a bulk has none.
    pub(crate) async fn known_under(
        memory: Remembered<'_>,
        point: &Point3<f64>,
    ) -> Result<Option<Self>, Failure> {
        let known = places_where(memory, |place| !is_bulk(place)).await?;
        Ok(nearest_under(&known, point))
    }

    /// The surface of this robot's model of its environment over which a point is, if there is one.
    pub(crate) async fn modelled_under(
        memory: Remembered<'_>,
        point: &Point3<f64>,
    ) -> Result<Option<Self>, Failure> {
        let modelled = |place: &Snapshot| place.attribute("plane_covariance").is_some();
        let known = places_where(memory, modelled).await?;
        Ok(nearest_under(&known, point))
    }

    /// A pose on it, with its normal as z.
    pub(crate) fn pose(&self) -> Isometry3<f64> {
        Isometry3::from_parts(self.at.coords.into(), self.rotation())
    }

    /// The outward normal.
    pub(crate) fn normal(&self) -> Unit<Vector3<f64>> {
        self.normal
    }

    /// The rotation from a level surface to this one, without a turn about the vertical.
    pub(crate) fn rotation(&self) -> UnitQuaternion<f64> {
        from_level(&self.normal)
    }

    /// The height of a point above it, m.
    pub(crate) fn above(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&(point - self.at))
    }

    /// The point of it that is vertically above or below a place, root frame, m.
    pub(crate) fn at(&self, x: f64, y: f64) -> Point3<f64> {
        let off = Vector3::new(x - self.at.x, y - self.at.y, 0.0);
        Point3::new(x, y, self.at.z - self.normal.dot(&off) / self.normal.z.max(libm::cos(STEEPEST)))
    }
}

/// The rotation that turns a level surface's normal to this one, the shortest way.
pub(crate) fn from_level(normal: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), normal)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// Of the upper faces over which a point is, the one that is nearest below it.
fn nearest_under(places: &[KnownBox], point: &Point3<f64>) -> Option<ContactPlane> {
    let tops = places.iter().filter_map(|place| top_under(place, point));
    tops.min_by(|a, b| a.above(point).abs().total_cmp(&b.above(point).abs()))
}

/// The upper face of a place, if the point is over it.
fn top_under(place: &KnownBox, point: &Point3<f64>) -> Option<ContactPlane> {
    let half = place.size / 2.0;
    let up = (place.root_from_box * Vector3::z()).z.signum();
    let in_box = place.root_from_box.inverse() * point;
    let above = up * in_box.z - half.z;
    let over = in_box.x.abs() < half.x + GOES_ON
        && in_box.y.abs() < half.y + GOES_ON
        && (-STANDS..OVER).contains(&above);
    let normal = Unit::new_normalize(place.root_from_box * Vector3::z() * up);
    let level_enough = normal.angle(&Vector3::z_axis()) < STEEPEST;
    let at = place.root_from_box * Point3::new(0.0, 0.0, up * half.z);
    (over && level_enough).then(|| ContactPlane::new(at, normal))
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::{Commit, EntityId, Instance, Memory as _, Snapshot, tokio_clock};
    use armarium_values::transforms::Transforms;
    use armarium_values::{Frame, Observation, Pose, Value};
    use parking_lot::RwLock;

    use super::*;
    use crate::inputs::pose_value;

    fn top_in(remembered: &Remembered<'_>, pose: &Pose) -> Option<Vector3<f64>> {
        let snapshot = Snapshot {
            id: EntityId::new("EnvironmentModels", "test", "there").unwrap(),
            version: 1,
            referenced_ns: 0,
            sent_ns: 0,
            arrived_ns: 0,
            instances: vec![Instance::new([("pose", Value::Pose(pose.clone()))])],
        };
        Some(remembered.root_pose(&snapshot)?.translation.vector)
    }

    #[tokio::test(start_paused = true)]
    async fn memory_says_what_a_thing_stands_on() {
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(Transforms::new()));
        let remembered = Remembered { memory: &memory, transforms: &transforms };
        let point = Point3::new(0.3, 0.5, 0.93);
        let known = ContactPlane::under(remembered, &point).await.unwrap();
        assert_eq!(known, ContactPlane::level(point), "nothing is known");
        let id = EntityId::new("EnvironmentModels", "test", "table").unwrap();
        let pose = Isometry3::new(Vector3::new(0.2, 0.6, 0.9), Vector3::x() * 0.2);
        let size = Value::from([1.0, 0.7, 0.0]);
        memory.commit(vec![Commit::new(id, 0, [("pose", pose_value(&pose)), ("size", size)])]).await.unwrap();
        let known = ContactPlane::under(remembered, &point).await.unwrap();
        assert!((known.normal().into_inner() - pose * Vector3::z()).norm() < 1e-9);
        assert!(known.above(&(pose * Point3::new(0.1, 0.1, 0.0))).abs() < 1e-9);
        let there = known.at(0.35, 0.45);
        assert!(known.above(&there).abs() < 1e-9 && there.x == 0.35 && there.y == 0.45);
        // The robot stands 0.1 m beside the origin of the world in which another one has put the table.
        let stands = Pose::new(Frame("world".into()), &Isometry3::translation(0.1, 0.0, 0.0));
        let (there, here) = (Pose::new(Frame("world".into()), &pose), Pose::new(Frame::root(), &pose));
        assert_eq!(top_in(&remembered, &there), None);
        let seen = |pose| Observation::new("EnvironmentModels", "table", 0).with("pose", pose_value(pose));
        assert_eq!(remembered.placed(vec![seen(&pose)], None).0, [seen(&pose)]);
        transforms.write().fix(&Frame::root(), &stands).unwrap();
        let (placed, _) = remembered.placed(vec![seen(&Isometry3::identity())], None);
        assert!(
            matches!(&placed[0].attributes["pose"], Value::Pose(pose) if pose.frame.0 == "world" && pose.position[0] == 0.1)
        );
        assert!((top_in(&remembered, &there).unwrap().x - 0.1).abs() < 1e-9);
        assert!((top_in(&remembered, &here).unwrap().x - 0.2).abs() < 1e-9);
        let beside = ContactPlane::under(remembered, &Point3::new(2.0, 0.5, 0.93)).await.unwrap();
        assert_eq!(beside.normal(), Vector3::z_axis());
    }
}
