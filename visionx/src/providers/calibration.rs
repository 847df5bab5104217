//! `calibration.yaml` beside image files: the cameras that took them, by role, and the first camera's pose. Unknown
//! keys are errors, so that a misspelt key does not silently drop a camera.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, UnitQuaternion};
use serde::Deserialize;

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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    left: Option<Camera>,
    right: Option<Camera>,
    depth: Option<Camera>,
    image: Option<Camera>,
    root_from_camera: Option<Isometry3<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Camera {
    focal: [f64; 2],
    center: [f64; 2],
    distortion: Lens,
    reference_from_camera: Isometry3<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Lens {
    k1: f64,
    k2: f64,
    p1: f64,
    p2: f64,
    k3: f64,
}

impl From<Camera> for CameraModel {
    fn from(camera: Camera) -> Self {
        let Lens { k1, k2, p1, p2, k3 } = camera.distortion;
        Self {
            focal: camera.focal,
            center: camera.center,
            distortion: Distortion { k1, k2, p1, p2, k3 },
            reference_from_camera: camera.reference_from_camera,
        }
    }
}

impl Calibration {
    /// Reads the calibration beside an image file; empty when there is no such file.
    ///
    /// # Errors
    /// The calibration's path, and why it is not valid.
    pub(super) fn beside(image: &Path) -> Result<Self, (PathBuf, FileError)> {
        let path = image.with_file_name(CALIBRATION);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = std::fs::read_to_string(&path).map_err(|e| (path.clone(), FileError::Read(e)))?;
        Self::from_yaml(&text).map_err(|what| (path, FileError::Calibration { what }))
    }

    fn from_yaml(text: &str) -> Result<Self, String> {
        let file: File = serde_saphyr::from_str(text).map_err(|e| said(&e.to_string()))?;
        let roles =
            [("left", file.left), ("right", file.right), ("depth", file.depth), ("image", file.image)];
        let mut cameras = BTreeMap::new();
        for (role, camera) in roles {
            let Some(camera) = camera.map(CameraModel::from) else { continue };
            if !camera.is_usable() {
                return Err(format!(
                    "`{role}` is no camera: focal lengths are positive and all numbers finite"
                ));
            }
            cameras.insert(role.to_owned(), camera);
        }
        let root_from_camera = file.root_from_camera.map(pose).transpose()?;
        Ok(Self { cameras, root_from_camera })
    }
}

/// The parser's message without its leading `error: `.
fn said(error: &str) -> String {
    error.strip_prefix("error: ").unwrap_or(error).to_owned()
}

/// The pose with its rotation normalised.
fn pose(read: Isometry3<f64>) -> Result<Isometry3<f64>, String> {
    let rotation = read.rotation.into_inner();
    let finite = read.translation.vector.iter().all(|v| v.is_finite());
    let unit = (rotation.norm() - 1.0).abs() < UNIT;
    if !(finite && unit) {
        return Err(
            "`root_from_camera` is no pose: a translation, m, and a unit quaternion x, y, z, w".into()
        );
    }
    Ok(Isometry3::from_parts(read.translation, UnitQuaternion::new_normalize(rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEFT: &str = "left: {focal: [515, 515], center: [320, 240], distortion: {k1: 0, k2: 0, p1: 0, p2: 0, k3: 0}, \
                        reference_from_camera: {rotation: [0, 0, 0, 1], translation: [0, 0, 0]}}\n";

    #[test]
    fn cameras_and_their_place_are_read() {
        let text = format!(
            "{LEFT}root_from_camera: {{rotation: [-0.7071, 0, 0, 0.7071], translation: [0, 0, 1.5]}}\n"
        );
        let read = Calibration::from_yaml(&text).unwrap();
        assert_eq!(read.cameras.keys().collect::<Vec<_>>(), ["left"]);
        let pose = read.root_from_camera.unwrap();
        assert_eq!(pose.translation.vector.z, 1.5);
        assert!((pose.rotation.into_inner().norm() - 1.0).abs() < 1e-12);
        assert!(Calibration::from_yaml(LEFT).unwrap().root_from_camera.is_none());
    }

    #[test]
    fn what_is_not_understood_is_refused_by_its_name() {
        for (from, to, word) in [
            ("left:", "rigth:", "rigth"),
            ("center", "middle", "middle"),
            ("k3: 0", "k3: 0, k4: 0", "k4"),
            ("515, 515", "-515, 515", "`left` is no camera"),
            (
                "left:",
                "root_from_camera: {rotation: [0, 0, 0, 2], translation: [0, 0, 0]}\nleft:",
                "root_from_camera",
            ),
        ] {
            let error = Calibration::from_yaml(&LEFT.replace(from, to)).unwrap_err();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
