//! Geometric values expressed in another frame, with their covariances.

use nalgebra::{Isometry3, Point3, SMatrix, Vector3};

use crate::{Frame, Pose, Value, Vector, Wrench};

/// Attributes whose vectors are directions: rotated, not translated.
const DIRECTIONS: [&str; 6] = ["velocity", "direction", "force", "axis", "normal", "acceleration"];

/// From one frame to another.
#[derive(Clone, Copy, Debug)]
pub struct FrameChange<'a> {
    /// The frame that values are expressed in.
    pub from: &'a Frame,
    /// The frame that they are to be expressed in.
    pub to: &'a Frame,
    /// Pose of `from` in `to`.
    pub to_from_from: &'a Isometry3<f64>,
}

impl FrameChange<'_> {
    /// The value of an attribute in the new frame; what is in other frames is left as it is. Vectors are points, unless the
    /// attribute's name is that of a direction, such as `velocity` or `normal`.
    #[must_use]
    pub fn value(&self, name: &str, value: &Value) -> Value {
        let by = self.to_from_from;
        match value {
            Value::Vector(v) if v.frame == *self.from => {
                let vector = v.vector();
                let moved = match DIRECTIONS.contains(&name) {
                    true => by.rotation * vector,
                    false => (by * Point3::from(vector)).coords,
                };
                Value::Vector(Vector::new(self.to.clone(), &moved))
            }
            Value::Pose(p) if p.frame == *self.from => {
                Value::Pose(Pose::new(self.to.clone(), &(by * p.isometry())))
            }
            Value::Wrench(w) if w.frame == *self.from => {
                // About the new origin: the torque includes the moment of the force.
                let force = by.rotation * Vector3::from(w.force);
                let torque = by.rotation * Vector3::from(w.torque) + by.translation.vector.cross(&force);
                Value::Wrench(Wrench { frame: self.to.clone(), force: force.into(), torque: torque.into() })
            }
            Value::List(items) => Value::List(items.iter().map(|item| self.value(name, item)).collect()),
            Value::Map(fields) => Value::Map(
                fields.iter().map(|(name, field)| (name.clone(), self.value(name, field))).collect(),
            ),
            other => other.clone(),
        }
    }

    /// A covariance of three or six numbers, row by row, in the new frame: `R P R'` for each block of three rows and columns.
    /// Others are left as they are.
    #[must_use]
    pub fn covariance(&self, rows: &[f64]) -> Vec<f64> {
        match rows.len() {
            9 => self.turned::<3>(rows),
            36 => self.turned::<6>(rows),
            _ => rows.to_vec(),
        }
    }

    fn turned<const N: usize>(&self, rows: &[f64]) -> Vec<f64> {
        let covariance = SMatrix::<f64, N, N>::from_row_slice(rows);
        let mut by = SMatrix::<f64, N, N>::zeros();
        let matrix = self.to_from_from.rotation.to_rotation_matrix();
        for block in (0..N).step_by(3) {
            by.fixed_view_mut::<3, 3>(block, block).copy_from(matrix.matrix());
        }
        let turned = by * covariance * by.transpose();
        // Remove the asymmetry that rounding causes.
        let turned = (turned + turned.transpose()) * 0.5;
        turned.as_slice().to_vec()
    }
}
