//! `calibration.yaml` beside image files: the cameras that took them, by role, and the first camera's pose. Unknown
//! keys are errors, so that a misspelt key does not silently drop a camera.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::yaml::Node;
use armarium_source::{Finding, Findings, Rule, Source, code, form};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::description::{CameraModel, Distortion};
use crate::files::FileError;

/// Name of the file.
pub(super) const CALIBRATION: &str = "calibration.yaml";
/// Tolerance on the length of a rotation's quaternion, because people write few digits.
const UNIT: f64 = 1e-3;

/// Content of the file.
#[derive(Debug, Default)]
pub(super) struct Calibration {
    /// The cameras by the role of their images.
    pub(super) cameras: BTreeMap<String, CameraModel>,
    /// The first camera's pose in the robot's root frame, if the camera does not move.
    pub(super) root_from_camera: Option<Isometry3<f64>>,
}

form! {
    struct File: "a file of calibration" {
        left: Option<Camera> = None;
        right: Option<Camera> = None;
        depth: Option<Camera> = None;
        image: Option<Camera> = None;
        /// The first camera's pose in the robot's root frame.
        root_from_camera: Option<Pose> = None;
    }
}

form! {
    struct Camera: "a camera", check Self::is_usable {
        /// Focal lengths along x and y, px.
        focal: [f64; 2], Rule::unit("px");
        /// Principal point, px.
        center: [f64; 2], Rule::unit("px");
        distortion: Distortion;
        /// Its pose in the provider's coordinate frame.
        reference_from_camera: Pose;
    }
}

form! {
    struct Pose: "a pose", check Self::is_a_pose {
        /// A unit quaternion x, y, z, w.
        rotation: [f64; 4];
        /// m.
        translation: [f64; 3], Rule::unit("m");
    }
}

impl Camera {
    fn is_usable(&self, node: &Node, findings: &mut Findings) {
        if !CameraModel::from(self.clone()).is_usable() {
            findings.error(code::VALUE, node.place("focal"), "this is no camera: focal lengths are positive");
        }
    }
}

impl Pose {
    fn is_a_pose(&self, node: &Node, findings: &mut Findings) {
        if (Quaternion::from(self.rotation).norm() - 1.0).abs() >= UNIT {
            let message = "this is no pose: a translation, m, and a unit quaternion x, y, z, w";
            findings.error(code::VALUE, node.place("rotation"), message);
        }
    }
}

/// The pose with a rotation of length 1.
impl From<Pose> for Isometry3<f64> {
    fn from(pose: Pose) -> Self {
        let rotation = UnitQuaternion::new_normalize(Quaternion::from(pose.rotation));
        Self::from_parts(Translation3::from(pose.translation), rotation)
    }
}

impl From<Camera> for CameraModel {
    fn from(camera: Camera) -> Self {
        Self {
            focal: camera.focal,
            center: camera.center,
            distortion: camera.distortion,
            reference_from_camera: camera.reference_from_camera.into(),
        }
    }
}

impl Calibration {
    /// Reads the calibration beside an image file; empty when there is no such file.
    pub(super) fn beside(image: &Path) -> Result<Self, (PathBuf, FileError)> {
        let path = image.with_file_name(CALIBRATION);
        if !path.exists() {
            return Ok(Self::default());
        }
        let source = Source::read(&path).map_err(|finding| vec![*finding]);
        source.and_then(Self::read).map_err(|findings| (path, FileError::Calibration(findings)))
    }

    fn read(source: Arc<Source>) -> Result<Self, Vec<Finding>> {
        let file: File = armarium_source::read(source)?;
        let roles =
            [("left", file.left), ("right", file.right), ("depth", file.depth), ("image", file.image)];
        let cameras = roles.into_iter().filter_map(|(role, camera)| Some((role.to_owned(), camera?.into())));
        Ok(Self { cameras: cameras.collect(), root_from_camera: file.root_from_camera.map(Isometry3::from) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Calibration, Vec<Finding>> {
        Calibration::read(Arc::new(Source::new(CALIBRATION, text)))
    }

    const LEFT: &str = "left: {focal: [515, 515], center: [320, 240], distortion: {k1: 0, k2: 0, p1: 0, p2: 0, k3: 0}, \
                        reference_from_camera: {rotation: [0, 0, 0, 1], translation: [0, 0, 0]}}\n";

    #[test]
    fn cameras_and_their_place_are_read() {
        let text = format!(
            "{LEFT}root_from_camera: {{rotation: [-0.7071, 0, 0, 0.7071], translation: [0, 0, 1.5]}}\n"
        );
        let found = read(&text).unwrap();
        assert_eq!(found.cameras.keys().collect::<Vec<_>>(), ["left"]);
        let pose = found.root_from_camera.unwrap();
        assert_eq!(pose.translation.vector.z, 1.5);
        assert!((pose.rotation.into_inner().norm() - 1.0).abs() < 1e-12);
        assert!(read(LEFT).unwrap().root_from_camera.is_none());
    }

    #[test]
    fn what_is_not_understood_is_refused_by_its_name() {
        for (from, to, word) in [
            ("left:", "rigth:", "rigth"),
            ("center", "middle", "middle"),
            ("k3: 0", "k3: 0, k4: 0", "k4"),
            ("515, 515", "-515, 515", "this is no camera"),
            ("left:", "root_from_camera: {rotation: [0, 0, 0, 2], translation: [0, 0, 0]}\nleft:", "no pose"),
        ] {
            let findings = read(&LEFT.replace(from, to)).unwrap_err();
            let errors: Vec<String> = findings.iter().map(ToString::to_string).collect();
            let is_meant = |error: &String| error.contains(word) && error.starts_with("calibration.yaml:1:");
            assert!(errors.iter().any(is_meant), "{word}: {errors:?}");
        }
    }
}
