//! How cameras are mounted on a head that turns, as far as two markers at known places and a level surface show it.
//!
//! Where cameras are not where they are believed to be, what they show moves as the head turns. Two markers that are seen one after the
//! other, and not in one picture, therefore say little as long as the mounting is not known. This keeps it up to date with every marker that
//! is seen: how it is turned from the line between both markers, about that line from a surface that is taken for level, and how it is
//! displaced from their middle. It is not a calibration: what the joints say of the markers is wrong by millimetres, too.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::error::{MotionError, finite};

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

/// The mounting of a camera; see the module.
#[derive(Debug, Clone)]
pub struct CameraMounting {
    /// The camera's true pose in the frame of its believed one.
    believed_from_camera: Isometry3<f64>,
    seen: [Option<MarkerView>; 2],
    /// How many pictures have shown it.
    pictures: u32,
}

/// The least weight of a new picture: the mean of as many, as the errors of the arms' joints change with their postures.
const WEIGHT: f64 = 0.05;
/// Both markers show the turn when they were seen within this, s.
const TOGETHER: f64 = 2.5;
/// Markers that are nearer to each other than this do not show it, m.
const APART: f64 = 0.2;

impl CameraMounting {
    /// A camera believed at `root_from_camera`, which shows the upward normal of a level surface as `shown_up` (root frame).
    pub fn levelled(root_from_camera: &Isometry3<f64>, shown_up: &Unit<Vector3<f64>>) -> Self {
        let level = UnitQuaternion::rotation_between_axis(shown_up, &Vector3::z_axis()).unwrap_or_default();
        let root_from_camera = root_from_camera.rotation;
        let turned = root_from_camera.inverse() * level * root_from_camera;
        let believed_from_camera = Isometry3::from_parts(Translation3::identity(), turned);
        Self { believed_from_camera, seen: [None; 2], pictures: 0 }
    }

    /// The camera's true pose in the frame of its believed one.
    pub fn believed_from_camera(&self) -> Isometry3<f64> {
        self.believed_from_camera
    }

    /// Whether both markers have shown how the camera is turned.
    pub fn known(&self) -> bool {
        self.pictures > 0
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
        self.seen[marker] = Some(view);
        let [Some(first), Some(second)] = &self.seen else { return Ok(()) };
        if (first.at - second.at).abs() > TOGETHER || (first.in_root - second.in_root).norm() < APART {
            return Ok(());
        }
        self.pictures = self.pictures.saturating_add(1);
        let weight = WEIGHT.max(1.0 / f64::from(self.pictures));
        let mounting = self.believed_from_camera;
        let place = |view: &MarkerView| view.root_from_camera * mounting * view.in_camera;
        let (shown, true_line) = (place(first) - place(second), first.in_root - second.in_root);
        let turn = UnitQuaternion::rotation_between(&shown, &true_line).unwrap_or_default();
        let turn = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * weight);
        let root_from_camera = view.root_from_camera.rotation;
        let turned = root_from_camera.inverse() * turn * root_from_camera * mounting;
        let missing =
            |view: &MarkerView| view.root_from_camera.inverse() * view.in_root - turned * view.in_camera;
        let shift = Translation3::from((missing(first) + missing(second)) * (weight / 2.0));
        self.believed_from_camera = shift * turned;
        Ok(())
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
    fn what_is_not_finite_changes_nothing() {
        let mut mounting = CameraMounting::levelled(&Isometry3::identity(), &Vector3::z_axis());
        let view = MarkerView {
            at: 0.0,
            root_from_camera: Isometry3::identity(),
            in_camera: Point3::new(f64::NAN, 0.0, 0.5),
            in_root: Point3::origin(),
        };
        assert!(mounting.see(0, view).is_err());
        assert!(mounting.believed_from_camera().rotation.angle() < 1e-12 && !mounting.known());
    }
}
