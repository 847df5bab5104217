//! The geometry of a grasp straight against the surface on which something stands, shared by the skills that plan, servo and verify it.

use armarium_robot::{Hand, Limb, Marker, Model};
use armarium_runtime::skill::Failure;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

/// The hand of an arm.
pub(crate) fn hand<'m>(model: &'m Model, arm: &Limb) -> Result<&'m Hand, Failure> {
    model.hand_of(arm).ok_or_else(|| Failure::new(format!("the arm `{}` has no hand", arm.name)))
}

/// The mark by which the cameras track the hand of an arm.
pub(crate) fn marker(model: &Model, arm: &Limb) -> Result<Marker, Failure> {
    let hand = hand(model, arm)?;
    hand.marker.ok_or_else(|| Failure::new(format!("the hand `{}` has no marker", hand.name)))
}

/// The middle of what a hand holds, in the frame of its TCP, m.
pub(crate) fn held_in_tcp(hand: &Hand) -> Point3<f64> {
    hand.grasp_in_tcp.translation.vector.into()
}

/// The TCP pose that grasps an object at `center` (root frame) with the palm along a surface, whose rotation from a level one is
/// given, turned by `yaw` in it.
pub(crate) fn tcp_at(
    hand: &Hand,
    center: &Point3<f64>,
    surface: &UnitQuaternion<f64>,
    yaw: f64,
) -> Isometry3<f64> {
    let rotation = surface * hand.palm_down(yaw);
    Isometry3::from_parts((center.coords - rotation * hand.grasp_in_tcp.translation.vector).into(), rotation)
}

/// The level direction from the fingers to the wrist of an arm whose TCP has an orientation (root frame): a unit vector, or zero where
/// there is none.
pub(crate) fn towards_wrist(model: &Model, arm: &Limb, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (Some(&last), Some(tcp)) = (arm.joints.last(), arm.tcp) else { return Vector3::zeros() };
    let zero = model.zero();
    // The last joint moves both together.
    let wrist = model.link_pose(&zero, tcp).inv_mul(&model.link_pose(&zero, model.joints()[last].link));
    let way = rotation * wrist.translation.vector;
    Vector3::new(way.x, way.y, 0.0).try_normalize(1e-3).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_object_is_below_the_tcp() {
        let model = Model::shipped("armar3").unwrap();
        let hand = hand(&model, model.arms().next().unwrap()).unwrap();
        let place = Point3::new(0.3, 0.5, 0.97);
        let tcp = tcp_at(hand, &place, &UnitQuaternion::identity(), 0.4);
        assert!((tcp * held_in_tcp(hand) - place).norm() < 1e-12);
        assert!((tcp.translation.z - 1.05).abs() < 1e-12);
        let tilted = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.0);
        let tcp = tcp_at(hand, &place, &tilted, 0.4);
        assert!((tcp * held_in_tcp(hand) - place).norm() < 1e-12);
        assert!(hand.grasps_from(&tcp.rotation).angle(&(tilted * Vector3::z_axis())) < 1e-6);
    }

    #[test]
    fn the_wrist_is_behind_the_fingers_however_the_hand_is_turned() {
        let model = Model::shipped("armar3").unwrap();
        for arm in model.arms() {
            let hand = hand(&model, arm).unwrap();
            for yaw in [-2.0, 0.0, 0.5] {
                let rotation = hand.palm_down(yaw);
                // The fingers are along z of the TCP.
                let way = towards_wrist(&model, arm, &rotation);
                assert!(way.z == 0.0 && way.angle(&-(rotation * Vector3::z())) < 0.2, "{yaw}: {way}");
            }
        }
    }
}
