//! The planar arm with three revolute joints of the coaching paper; its base is the origin.

use nalgebra::{Matrix2x3, Vector2, Vector3};

/// An arm, given by the lengths of its links, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanarArm {
    pub(crate) links: [f64; 3],
}

/// Resolves the third degree of freedom, which a point in the plane leaves free.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Redundancy {
    /// The last link has this angle in the world, rad; of the two elbow solutions the one with q2 < 0.
    LastLink(f64),
    /// The joint angles nearest to this posture, rad.
    NearestTo(Vector3<f64>),
}

/// Angle of each link in the world, rad.
fn angles(q: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(q.x, q.x + q.y, q.x + q.y + q.z)
}

impl PlanarArm {
    /// The position of the last link's end, m, for joint angles `q`, rad.
    pub(crate) fn end(&self, q: &Vector3<f64>) -> Vector2<f64> {
        let link = |(a, l): (&f64, &f64)| Vector2::new(l * libm::cos(*a), l * libm::sin(*a));
        angles(q).iter().zip(&self.links).map(link).sum()
    }

    /// `v = J(q) dq/dt`, m/rad.
    pub(crate) fn jacobian(&self, q: &Vector3<f64>) -> Matrix2x3<f64> {
        let angles = angles(q);
        let column = |from: usize| -> Vector2<f64> {
            (from..3).map(|i| self.links[i] * Vector2::new(-libm::sin(angles[i]), libm::cos(angles[i]))).sum()
        };
        Matrix2x3::from_columns(&[column(0), column(1), column(2)])
    }

    /// Joint angles that move the end to `x`, m; `None` where the arm does not reach.
    pub(crate) fn inverse(&self, x: Vector2<f64>, redundancy: Redundancy) -> Option<Vector3<f64>> {
        match redundancy {
            Redundancy::LastLink(angle) => self.with_last_link(x, angle),
            Redundancy::NearestTo(posture) => self.nearest(x, posture),
        }
    }

    fn with_last_link(&self, x: Vector2<f64>, angle: f64) -> Option<Vector3<f64>> {
        let [a, b, c] = self.links;
        let wrist = x - c * Vector2::new(libm::cos(angle), libm::sin(angle));
        let cosine = (wrist.norm_squared() - a * a - b * b) / (2.0 * a * b);
        if cosine.abs() > 1.0 {
            return None;
        }
        let q2 = -libm::acos(cosine);
        let q1 = libm::atan2(wrist.y, wrist.x) - libm::atan2(b * libm::sin(q2), a + b * libm::cos(q2));
        Some(Vector3::new(q1, q2, angle - q1 - q2))
    }

    /// Minimises `|q - posture|` under `end(q) = x`: each iteration solves the problem linearised at the last
    /// one.
    fn nearest(&self, x: Vector2<f64>, posture: Vector3<f64>) -> Option<Vector3<f64>> {
        let mut q = posture;
        for _ in 0..2000 {
            let j = self.jacobian(&q);
            let inverse = (j * j.transpose() + nalgebra::Matrix2::identity() * 1e-12).try_inverse()?;
            let away = q - posture;
            let step = -away + j.transpose() * inverse * (j * away + x - self.end(&q));
            // Far away the linearisation is inaccurate, so the step is limited.
            q += step * (0.5 / step.norm()).min(0.7);
            if step.norm() < 1e-13 {
                break;
            }
        }
        ((self.end(&q) - x).norm() < 1e-9).then_some(q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: PlanarArm = PlanarArm { links: [1.0, 0.9, 0.8] };

    #[test]
    fn the_jacobian_is_the_derivative() {
        let q = Vector3::new(0.3, -0.7, 1.1);
        for i in 0..3 {
            let h = Vector3::ith(i, 1e-6);
            let numeric = (ARM.end(&(q + h)) - ARM.end(&(q - h))) / 2e-6;
            assert!((numeric - ARM.jacobian(&q).column(i)).norm() < 1e-9);
        }
    }

    #[test]
    fn the_inverse_reaches_the_point_in_both_ways() {
        let x = Vector2::new(1.4, 0.6);
        let posture = Vector3::new(-0.5, 0.6, 0.6);
        let by_link = ARM.inverse(x, Redundancy::LastLink(0.7)).unwrap();
        assert!((ARM.end(&by_link) - x).norm() < 1e-12 && by_link.y < 0.0);
        assert!((by_link.sum() - 0.7).abs() < 1e-12);
        let nearest = ARM.inverse(x, Redundancy::NearestTo(posture)).unwrap();
        assert!((ARM.end(&nearest) - x).norm() < 1e-9);
        // At the optimum the remaining distance to the posture has no part in the null space.
        let j = ARM.jacobian(&nearest);
        let null = j.row(0).transpose().cross(&j.row(1).transpose()).normalize();
        assert!(null.dot(&(nearest - posture)).abs() < 1e-9);
        assert!(ARM.inverse(Vector2::new(3.0, 0.0), Redundancy::LastLink(0.0)).is_none());
        assert!(ARM.inverse(Vector2::new(3.0, 0.0), Redundancy::NearestTo(posture)).is_none());
    }
}
