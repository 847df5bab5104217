//! How cameras are mounted on a head that turns, as far as two markers at known places and a level surface show it.
//!
//! Where cameras are not where they are believed to be, what they show moves as the head turns. Two markers that are seen one after the
//! other, and not in one picture, therefore say little as long as the mounting is not known. This keeps it up to date with every marker that
//! is seen: how it is turned by all places at which markers were seen and by a surface that is taken for level, and how it is displaced
//! by where both are now. It is not a calibration: what the joints say of the markers is wrong by millimetres, too.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::error::{MotionError, finite};
use crate::rigid_fit::nearest_rotation;

/// A marker as it was seen in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerView {
    /// When, s.
    pub at: f64,
    /// Where the camera was believed to be (root frame).
    pub root_from_camera: Isometry3<f64>,
    /// Where the picture shows the marker, in the camera's frame, m.
    pub in_camera: Point3<f64>,
    /// Where it is by the joints, root frame, m.
    pub in_root: Point3<f64>,
}

/// A place at which a marker was seen.
#[derive(Debug, Clone, Copy)]
struct SeenPlace {
    /// By the joints, root frame, m.
    in_root: Point3<f64>,
    /// The means over `pictures` pictures, in the frames of the true and of the believed camera, m.
    in_camera: Vector3<f64>,
    in_believed: Vector3<f64>,
    pictures: u32,
}

/// The mounting of a camera; see the module.
#[derive(Debug, Clone)]
pub struct CameraMounting {
    /// The camera's true pose in the frame of its believed one.
    believed_from_camera: Isometry3<f64>,
    /// What the level surface says of its turn: outer product of the upward normal in both frames, with its weight, m^2.
    level: Matrix3<f64>,
    /// Where each marker was seen, the newest place last, and when it was seen last, s.
    places: [Vec<SeenPlace>; 2],
    seen_at: [f64; 2],
    known: bool,
}

/// Pictures that show a marker within this show it at one place, m. The oldest of more places than this are forgotten: the errors of the
/// arms' joints change with their postures.
const PLACE: f64 = 0.02;
const PLACES: usize = 40;
/// How exactly places are known, m, over how level the surface is, rad, squared: the weight of the surface, m^2.
const LEVEL: f64 = (0.004 / 0.023) * (0.004 / 0.023);
/// Both markers show the turn when they were seen within this, s.
const TOGETHER: f64 = 2.5;
/// Markers that are nearer to each other than this do not show it, m.
const APART: f64 = 0.2;

impl CameraMounting {
    /// A camera believed at `root_from_camera`, which shows the upward normal of a level surface as `shown_up` (root frame).
    pub fn levelled(root_from_camera: &Isometry3<f64>, shown_up: &Unit<Vector3<f64>>) -> Self {
        let level = UnitQuaternion::rotation_between_axis(shown_up, &Vector3::z_axis()).unwrap_or_default();
        let camera_from_root = root_from_camera.rotation.inverse();
        let turned = camera_from_root * level * root_from_camera.rotation;
        let [up, shown] = [Vector3::z(), shown_up.into_inner()].map(|up| camera_from_root * up);
        Self {
            believed_from_camera: Isometry3::from_parts(Translation3::identity(), turned),
            level: up * shown.transpose() * LEVEL,
            places: [Vec::new(), Vec::new()],
            seen_at: [f64::NEG_INFINITY; 2],
            known: false,
        }
    }

    /// How the camera is turned in the frame of its believed pose.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.believed_from_camera.rotation
    }

    /// Whether both markers have shown how the camera is turned.
    pub fn known(&self) -> bool {
        self.known
    }

    /// From where things are shown, with the camera believed at `root_from_camera`, to where they are; both in the root frame.
    pub fn from_shown(&self, root_from_camera: &Isometry3<f64>) -> Isometry3<f64> {
        root_from_camera * self.believed_from_camera * root_from_camera.inverse()
    }

    /// Takes over that the first (0) or the second (1) marker was seen.
    ///
    /// # Errors
    /// When a number is not finite; nothing is changed.
    pub fn see(&mut self, marker: usize, view: MarkerView) -> Result<(), MotionError> {
        finite("at", &[view.at])?;
        finite("in_camera", view.in_camera.coords.as_slice())?;
        finite("in_root", view.in_root.coords.as_slice())?;
        finite("root_from_camera", view.root_from_camera.translation.vector.as_slice())?;
        finite("root_from_camera", view.root_from_camera.rotation.coords.as_slice())?;
        self.remember(marker, &view);
        let [Some(first), Some(second)] = self.places.each_ref().map(|places| places.last().copied()) else {
            return Ok(());
        };
        let together = (self.seen_at[0] - self.seen_at[1]).abs() <= TOGETHER;
        if !together || (first.in_root - second.in_root).norm() < APART {
            return Ok(());
        }
        let all = || self.places.iter().flatten();
        let count = all().count() as f64;
        let [mean, mean_believed] = [
            all().map(|seen| seen.in_camera).sum::<Vector3<f64>>() / count,
            all().map(|seen| seen.in_believed).sum::<Vector3<f64>>() / count,
        ];
        let product =
            |seen: &SeenPlace| (seen.in_believed - mean_believed) * (seen.in_camera - mean).transpose();
        let rotation = nearest_rotation(&(self.level + all().map(product).sum::<Matrix3<f64>>()))?;
        let missing = |seen: &SeenPlace| seen.in_believed - rotation * seen.in_camera;
        let shift = (missing(&first) + missing(&second)) / 2.0;
        self.believed_from_camera =
            Isometry3::from_parts(shift.into(), UnitQuaternion::from_rotation_matrix(&rotation));
        self.known = true;
        Ok(())
    }

    fn remember(&mut self, marker: usize, view: &MarkerView) {
        self.seen_at[marker] = view.at;
        let in_believed = view.root_from_camera.inverse() * view.in_root;
        let places = &mut self.places[marker];
        let near = places.iter().position(|seen| (seen.in_root - view.in_root).norm() < PLACE);
        let mut seen = match near {
            Some(near) => places.remove(near),
            None => SeenPlace {
                in_root: view.in_root,
                in_camera: Vector3::zeros(),
                in_believed: Vector3::zeros(),
                pictures: 0,
            },
        };
        seen.pictures = seen.pictures.saturating_add(1);
        let weight = 1.0 / f64::from(seen.pictures);
        seen.in_camera += (view.in_camera.coords - seen.in_camera) * weight;
        seen.in_believed += (in_believed.coords - seen.in_believed) * weight;
        places.push(seen);
        if places.len() > PLACES {
            places.remove(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The head turned to one side or the other, as it is believed to be.
    fn head(yaw: f64, pitch: f64) -> Isometry3<f64> {
        let forward = UnitQuaternion::from_euler_angles(-2.4 + pitch, 0.0, 0.0);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Isometry3::from_parts(Translation3::new(0.05 * yaw, 0.2, 1.65), turned * forward)
    }

    #[test]
    fn markers_that_are_seen_in_turns_show_how_the_cameras_are_mounted() {
        let tilt = Vector3::new(0.05, 0.04, -0.06);
        let mounted = Isometry3::new(Vector3::new(0.015, -0.02, 0.01), tilt);
        let markers = [Point3::new(0.36, 0.43, 1.18), Point3::new(-0.34, 0.45, 1.17)];
        let first = head(0.0, 0.0);
        let true_head = |believed: &Isometry3<f64>| believed * mounted;
        // The surface is tilted to the side, towards the line between both markers.
        let up = UnitQuaternion::from_euler_angles(0.0, -0.03, 0.0) * Vector3::z_axis();
        let shown_up = first * true_head(&first).inverse() * up;
        let mut mounting = CameraMounting::levelled(&first, &shown_up);
        for k in 0..60 {
            let marker = (k / 4) % 2;
            let believed = head(if marker == 0 { -0.2 } else { 0.2 }, 0.1);
            let in_camera = true_head(&believed).inverse() * markers[marker];
            let view = MarkerView {
                at: 0.07 * f64::from(k as u32),
                root_from_camera: believed,
                in_camera,
                in_root: markers[marker],
            };
            mounting.see(marker, view).unwrap();
        }
        for yaw in [-0.3, 0.0, 0.25] {
            let believed = head(yaw, 0.05);
            let thing = Isometry3::new(Vector3::new(0.1, 0.5, 0.98), Vector3::z() * 0.3);
            let shown = believed * true_head(&believed).inverse() * thing;
            let off = thing.inverse() * mounting.from_shown(&believed) * shown;
            assert!(off.rotation.angle() < 0.01, "{yaw}: {} rad", off.rotation.angle());
            assert!(off.translation.vector.norm() < 0.006, "{yaw}: {off}");
            let without = (thing.inverse() * shown).translation.vector.norm();
            assert!(without > 0.03, "{without}");
        }
    }

    #[test]
    fn hands_that_go_down_show_the_turn_about_the_line_between_them_although_the_surface_is_tilted() {
        let mounted = Isometry3::new(Vector3::new(0.015, -0.02, 0.01), Vector3::new(0.05, 0.04, -0.06));
        let up = UnitQuaternion::from_euler_angles(0.035, 0.0, 0.0) * Vector3::z_axis();
        // How far a thing below the hands is turned wrongly about the line between them, where they have gone down by so much.
        let wrong = |way: f64| {
            let first = head(0.0, 0.0);
            let mut mounting = CameraMounting::levelled(&first, &(first * (first * mounted).inverse() * up));
            for k in 0..80 {
                let marker = (k / 4) % 2;
                let believed = head(if marker == 0 { -0.2 } else { 0.2 }, 0.1);
                let x = if marker == 0 { 0.36 } else { -0.34 };
                let in_root = Point3::new(x, 0.44, 1.28 - way * f64::from(k as u32) / 80.0);
                let view = MarkerView {
                    at: 0.07 * f64::from(k as u32),
                    root_from_camera: believed,
                    in_camera: (believed * mounted).inverse() * in_root,
                    in_root,
                };
                mounting.see(marker, view).unwrap();
            }
            let believed = head(0.0, 0.1);
            let turned = mounting.from_shown(&believed) * believed * (believed * mounted).inverse();
            turned.rotation.scaled_axis().x.abs()
        };
        let (still, moved) = (wrong(0.0), wrong(0.2));
        assert!((still - 0.035).abs() < 0.004, "as wrong as the surface is: {still}");
        assert!(moved < 0.6 * still, "{moved} of {still}");
    }

    #[test]
    fn what_is_not_finite_changes_nothing() {
        let mut mounting = CameraMounting::levelled(&Isometry3::identity(), &Vector3::z_axis());
        let view = MarkerView {
            at: 0.0,
            root_from_camera: Isometry3::identity(),
            in_camera: Point3::new(f64::NAN, 0.0, 0.5),
            in_root: Point3::origin(),
        };
        assert!(mounting.see(0, view).is_err());
        assert!(mounting.rotation().angle() < 1e-12 && !mounting.known());
    }
}
