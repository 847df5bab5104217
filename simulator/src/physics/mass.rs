//! Mass, centre and inertia of what moves as one body, summed over links and shapes.

use armarium_robot::Inertial;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rapier3d_f64::math::{Matrix, Vector};
use rapier3d_f64::parry::mass_properties::details;
use rapier3d_f64::parry::shape::{ConvexPolyhedron, Tetrahedron};
use rapier3d_f64::prelude as rapier;

use super::convert;

/// Mass, centre and inertia about the centre, in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Mass {
    pub(super) mass: f64,
    /// First moment: mass times centre, kg m.
    moment: Vector3<f64>,
    /// Inertia about the frame's origin, kg m^2.
    about_origin: Matrix3<f64>,
}

impl Mass {
    /// Adds a body whose inertia about its own centre is given along the frame's axes.
    pub(super) fn add(&mut self, mass: f64, center: &Point3<f64>, inertia: &Matrix3<f64>) {
        self.mass += mass;
        self.moment += center.coords * mass;
        self.about_origin += inertia + steiner(mass, &center.coords);
    }

    /// Adds a link at its pose in the frame, `scale` times as heavy as its description says.
    pub(super) fn add_link(&mut self, inertial: &Inertial, frame_from_link: &Isometry3<f64>, scale: f64) {
        let r = frame_from_link.rotation.to_rotation_matrix();
        let inertia = r.matrix() * inertial.inertia * r.matrix().transpose() * scale;
        self.add(inertial.mass * scale, &(frame_from_link * inertial.center), &inertia);
    }

    pub(super) fn center(&self) -> Point3<f64> {
        if self.mass > 0.0 { Point3::from(self.moment / self.mass) } else { Point3::origin() }
    }

    /// Inertia about the centre, kg m^2.
    pub(super) fn inertia(&self) -> Matrix3<f64> {
        self.about_origin - steiner(self.mass, &self.center().coords)
    }

    /// Adds a shape of this density, kg/m^3.
    pub(super) fn add_shape(&mut self, form: &rapier::ColliderBuilder, density: f64) {
        let of_form = convert::to_pose(&form.position);
        let (mass, center, inertia) = match form.shape.as_convex_polyhedron() {
            Some(hull) => of_hull(hull),
            None => {
                let unit = form.shape.mass_properties(1.0);
                (unit.mass(), unit.local_com, unit.reconstruct_inertia_matrix())
            }
        };
        let r = of_form.rotation.to_rotation_matrix();
        let inertia = r.matrix() * convert::to_matrix(&inertia) * r.matrix().transpose();
        let center = of_form * Point3::from(convert::to_vector(center));
        self.add(density * mass, &center, &(inertia * density));
    }

    /// The same for Rapier, with a mass of `least` kg at least. Its own decomposition of an inertia calls the C library, whose last bit depends on the machine.
    pub(super) fn properties(&self, least: f64) -> rapier::MassProperties {
        let eigen = self.inertia().symmetric_eigen();
        let mut axes = eigen.eigenvectors;
        if axes.determinant() < 0.0 {
            axes.column_mut(2).neg_mut();
        }
        let axes = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        rapier::MassProperties::with_principal_inertia_frame(
            convert::vector(&self.center().coords),
            self.mass.max(least),
            convert::vector(&eigen.eigenvalues.map(|moment| moment.max(0.0))),
            convert::rotation(&axes),
        )
    }
}

/// Mass, centre and inertia about it of a convex hull of density 1.
fn of_hull(hull: &ConvexPolyhedron) -> (f64, Vector, Matrix) {
    let (points, triangles) = hull.to_trimesh();
    let (volume, center) = details::trimesh_signed_volume_and_center_of_mass(&points, &triangles);
    let inertia = triangles.iter().fold(Matrix::ZERO, |sum, corners| {
        let [a, b, c] = corners.map(|corner| points[corner as usize]);
        let part = Tetrahedron::new(center, a, b, c).signed_volume();
        sum + details::tetrahedron_unit_inertia_tensor_wrt_point(center, center, a, b, c) * part
    });
    (volume.abs(), center, inertia * volume.signum())
}

fn steiner(mass: f64, c: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * mass
}
