//! How cameras are mounted on a head that turns, as far as two markers at known places and a flat surface show it.
//!
//! Where cameras are not where they are believed to be, what they show moves as the head turns. Two markers that are seen one after the
//! other, and not in one picture, therefore say little as long as the mounting is not known. This keeps it up to date with every picture:
//!
//! - The line between both markers shows how it is turned, but not about that line.
//! - The surface shows the rest. In one picture nobody can tell a tilted surface from tilted cameras; but the cameras' tilt turns with the
//!   head, and the surface's does not. Both are estimated at once, by a Kalman filter.
//! - The markers' middle shows how it is displaced.
//!
//! It is not a calibration: what the joints say of the markers is wrong by millimetres, too.
//!
//! # Source
//! Kalman, "A new approach to linear filtering and prediction problems", J. Basic Engineering 82, 1960, linearised about what is known; the
//! covariance in Joseph's form (Bucy and Joseph, "Filtering for Stochastic Processes with Applications to Guidance", 1968).

use nalgebra::{Isometry3, Matrix3, Point3, SMatrix, SVector, Unit, UnitQuaternion, Vector2, Vector3};

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

/// The mounting of a camera, and the tilt of a surface that it shows; see the module.
#[derive(Debug, Clone)]
pub struct CameraMounting {
    /// The camera's true pose in the frame of its believed one.
    believed_from_camera: Isometry3<f64>,
    /// The x and y of the surface's upward normal in the root frame, divided by its z: small angles, rad.
    tilt: Vector2<f64>,
    /// The covariance of how the camera is turned (rad, its own frame), and of the tilt.
    covariance: SMatrix<f64, 5, 5>,
    seen: [Option<MarkerView>; 2],
    /// How many pictures have shown the line between both markers.
    pictures: u32,
}

/// Cameras are turned by as much, rad, and surfaces tilted, before anything is seen: standard deviations about each axis.
const MOUNTED: f64 = 0.05;
const TILTED: f64 = 0.015;
/// Standard deviations of what one picture shows: of the direction of the line between both markers, and of the surface's normal, rad. Errors
/// of successive pictures are much the same, so that these are larger than the noise.
const LINE: f64 = 0.012;
const NORMAL: f64 = 0.008;
/// By how much what the joints say of the markers drifts from picture to picture as the arms go, rad: standard deviation.
const DRIFT: f64 = 5e-4;
/// The least weight of a new picture for where the camera is: the mean of as many, for the same reason.
const WEIGHT: f64 = 0.05;
/// Both markers show the turn when they were seen within this, s.
const TOGETHER: f64 = 2.5;
/// Markers that are nearer to each other than this do not show it, m.
const APART: f64 = 0.2;

impl Default for CameraMounting {
    /// A camera that is where it is believed to be, and a level surface, as long as nothing else is seen.
    fn default() -> Self {
        let [turned, tilted] = [MOUNTED, TILTED].map(|sigma| sigma * sigma);
        let covariance = SVector::from([turned, turned, turned, tilted, tilted]);
        Self {
            believed_from_camera: Isometry3::identity(),
            tilt: Vector2::zeros(),
            covariance: SMatrix::from_diagonal(&covariance),
            seen: [None; 2],
            pictures: 0,
        }
    }
}

impl CameraMounting {
    /// The camera's true pose in the frame of its believed one.
    pub fn believed_from_camera(&self) -> Isometry3<f64> {
        self.believed_from_camera
    }

    /// The upward normal of the surface (root frame).
    pub fn surface_up(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.tilt.push(1.0))
    }

    /// Whether both markers have shown how the camera is turned.
    pub fn known(&self) -> bool {
        self.pictures > 0
    }

    /// From where things are shown, with the camera believed at `root_from_camera`, to where they are; both in the root frame.
    pub fn from_shown(&self, root_from_camera: &Isometry3<f64>) -> Isometry3<f64> {
        root_from_camera * self.believed_from_camera * root_from_camera.inverse()
    }

    /// Takes over that a picture shows the surface with the upward normal `shown_up`, the camera being believed at `root_from_camera` (both
    /// root frame).
    ///
    /// # Errors
    /// When a number is not finite, or the normal does not point up; nothing is changed.
    pub fn see_surface(
        &mut self,
        root_from_camera: &Isometry3<f64>,
        shown_up: &Unit<Vector3<f64>>,
    ) -> Result<(), MotionError> {
        finite("shown_up", shown_up.as_slice())?;
        finite("root_from_camera", root_from_camera.rotation.coords.as_slice())?;
        let in_camera = root_from_camera.inverse() * shown_up.into_inner();
        let root_from_true = root_from_camera.rotation * self.believed_from_camera.rotation;
        let up = root_from_true * in_camera;
        if up.z <= 0.5 {
            return Err(MotionError::OutOfRange { what: "shown_up.z", value: up.z, low: 0.5, high: 1.0 });
        }
        // up = tilt - d(up)/d(turned) turned
        let turns = turns(&root_from_true, &in_camera) * -1.0;
        let mut shows = SMatrix::<f64, 2, 5>::zeros();
        shows.fixed_view_mut::<2, 3>(0, 0).copy_from(&turns.fixed_rows::<2>(0));
        shows.fixed_view_mut::<2, 2>(0, 3).fill_with_identity();
        let off = up.xy() / up.z - self.tilt;
        self.update(&off, &shows, NORMAL);
        Ok(())
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
        let [Some(first), Some(second)] = self.seen else { return Ok(()) };
        if (first.at - second.at).abs() > TOGETHER || (first.in_root - second.in_root).norm() < APART {
            return Ok(());
        }
        self.pictures = self.pictures.saturating_add(1);
        let mounting = self.believed_from_camera;
        let place = |view: &MarkerView| view.root_from_camera * mounting * view.in_camera;
        let turns = |view: &MarkerView| {
            turns(&(view.root_from_camera.rotation * mounting.rotation), &view.in_camera.coords)
        };
        let line = first.in_root - second.in_root;
        let off = line - (place(&first) - place(&second));
        let mut shows = SMatrix::<f64, 3, 5>::zeros();
        shows.fixed_view_mut::<3, 3>(0, 0).copy_from(&(turns(&first) - turns(&second)));
        (0..3).for_each(|i| self.covariance[(i, i)] += DRIFT * DRIFT);
        self.update(&off, &shows, LINE * line.norm());
        let mounting = self.believed_from_camera;
        let missing =
            |view: &MarkerView| view.root_from_camera.inverse() * view.in_root - mounting * view.in_camera;
        let weight = WEIGHT.max(1.0 / f64::from(self.pictures));
        self.believed_from_camera.translation.vector += (missing(&first) + missing(&second)) * (weight / 2.0);
        Ok(())
    }

    /// A step of the Kalman filter: `off` is what was measured less what was expected, `shows` its derivative, `sigma` its standard deviation.
    fn update<const N: usize>(&mut self, off: &SVector<f64, N>, shows: &SMatrix<f64, N, 5>, sigma: f64) {
        let noise = SMatrix::<f64, N, N>::identity() * (sigma * sigma);
        let spread = shows * self.covariance * shows.transpose() + noise;
        let Some(inverse) = spread.try_inverse() else { return };
        let gain = self.covariance * shows.transpose() * inverse;
        let change = gain * off;
        let kept = SMatrix::<f64, 5, 5>::identity() - gain * shows;
        // Joseph's form stays symmetric and positive.
        self.covariance = kept * self.covariance * kept.transpose() + gain * noise * gain.transpose();
        self.believed_from_camera.rotation *=
            UnitQuaternion::from_scaled_axis(change.fixed_rows::<3>(0).into_owned());
        self.tilt += change.fixed_rows::<2>(3);
    }
}

/// How a vector of the true camera moves in the root frame as the camera is turned a little further, per rad about its own axes.
fn turns(root_from_true: &UnitQuaternion<f64>, in_camera: &Vector3<f64>) -> Matrix3<f64> {
    root_from_true.to_rotation_matrix() * in_camera.cross_matrix() * -1.0
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;

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
        let true_head = |believed: &Isometry3<f64>| believed * mounted;
        // The surface is tilted about the line between both markers, and along it.
        let up = UnitQuaternion::from_euler_angles(0.025, -0.03, 0.0) * Vector3::z_axis();
        let mut mounting = CameraMounting::default();
        for k in 0..60 {
            let marker = (k / 4) % 2;
            let believed = head(if marker == 0 { -0.4 } else { 0.4 }, 0.1);
            let shown_up = believed * true_head(&believed).inverse() * up;
            mounting.see_surface(&believed, &shown_up).unwrap();
            let in_camera = true_head(&believed).inverse() * markers[marker];
            let view = MarkerView {
                at: 0.07 * f64::from(k as u32),
                root_from_camera: believed,
                in_camera,
                in_root: markers[marker],
            };
            mounting.see(marker, view).unwrap();
        }
        assert!(mounting.surface_up().angle(&up) < 0.004, "{:?}", mounting.surface_up());
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
    fn the_floor_on_all_sides_tells_tilted_cameras_from_a_neck_that_leans() {
        let mounted = UnitQuaternion::from_euler_angles(0.03, -0.02, 0.0);
        // Where a neck that leans takes the floor's normal to be.
        let up = UnitQuaternion::from_euler_angles(-0.006, 0.008, 0.0) * Vector3::z_axis();
        let mut mounting = CameraMounting::default();
        let heads = [-0.8, -0.5, -0.2, 0.2, 0.5, 0.8].map(|yaw| head(yaw, 0.1));
        for _ in 0..5 {
            for believed in &heads {
                let shown_up = believed.rotation * mounted.inverse() * believed.rotation.inverse() * up;
                mounting.see_surface(believed, &shown_up).unwrap();
            }
        }
        assert!(mounting.surface_up().angle(&up) < 5e-4, "{:?}", mounting.surface_up());
        // Nothing shows a turn about the vertical.
        for believed in &heads {
            let by = believed.rotation * mounting.believed_from_camera().rotation * mounted.inverse();
            let off = (by * believed.rotation.inverse()).scaled_axis();
            assert!(off.xy().norm() < 1e-3, "{off}");
        }
    }

    #[test]
    fn what_is_not_finite_changes_nothing() {
        let mut mounting = CameraMounting::default();
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
