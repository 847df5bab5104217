//! Triangles: the surface of a part whose form is no simple solid.

use nalgebra::{Point3, Vector3};

/// A surface of triangles in its own frame. It has at least one triangle, and its numbers are finite.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    vertices: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    bounds: [Point3<f64>; 2],
}

impl Mesh {
    /// A surface; `None` without triangles, when a triangle names a vertex that is not there, or when a number is not
    /// finite.
    pub fn new(vertices: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>) -> Option<Self> {
        let known = |index: &u32| (*index as usize) < vertices.len();
        let sound = triangles.iter().flatten().all(known)
            && vertices.iter().all(|v| v.iter().all(|c| c.is_finite() && c.abs() < 1e6));
        if triangles.is_empty() || !sound {
            return None;
        }
        let start =
            [Point3::from(Vector3::repeat(f64::INFINITY)), Point3::from(Vector3::repeat(f64::NEG_INFINITY))];
        let bounds = vertices.iter().fold(start, |[low, high], v| [low.inf(v), high.sup(v)]);
        Some(Self { vertices, triangles, bounds })
    }

    /// Its vertices, m.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// Its triangles: indices of vertices.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The lower and the upper corner of the box around it, m.
    pub fn bounds(&self) -> &[Point3<f64>; 2] {
        &self.bounds
    }

    /// Middle and half the edges of the box around it, m.
    pub fn surrounding_box(&self) -> (Point3<f64>, Vector3<f64>) {
        let [low, high] = self.bounds;
        (nalgebra::center(&low, &high), (high - low) / 2.0)
    }
}
