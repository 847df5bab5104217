//! A cloud of moving points: the particle filter under the marker tracking.
//!
//! Each particle is a position (m) and a velocity (m/s). The prediction adds random acceleration, the images'
//! likelihood resamples the cloud, and an ensemble Kalman update draws it towards a measured position and keeps
//! its correlation of position and velocity. It knows nothing of images.
//!
//! # Source
//! Gordon, Salmond, Smith 1993 (bootstrap filter); Evensen 2003 (ensemble update with perturbed measurements).

use armarium_values::random::StandardNormal;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rand::{Rng, RngExt};

/// One hypothesis.
#[derive(Clone, Copy, Debug)]
struct Particle {
    position: Point3<f64>,
    velocity: Vector3<f64>,
}

/// The hypotheses, all of the same weight between the steps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cloud {
    particles: Vec<Particle>,
}

fn normal3(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

impl Cloud {
    /// `n` particles about `position` with the given covariance (m^2), with speeds of about `speed` m/s.
    pub(crate) fn around(
        position: &Point3<f64>,
        covariance: &Matrix3<f64>,
        speed: f64,
        n: usize,
        rng: &mut impl Rng,
    ) -> Self {
        let factor = square_root(covariance);
        let mut draw =
            || Particle { position: position + factor * normal3(rng), velocity: normal3(rng) * speed };
        Self { particles: (0..n.max(2)).map(|_| draw()).collect() }
    }

    /// Moves the cloud by `dt` s with accelerations of standard deviation `acceleration` m/s^2.
    pub(crate) fn predict(&mut self, dt: f64, acceleration: f64, rng: &mut impl Rng) {
        for p in &mut self.particles {
            let a = normal3(rng) * acceleration;
            p.position += p.velocity * dt + a * (0.5 * dt * dt);
            p.velocity += a * dt;
        }
    }

    /// Expresses the cloud in another frame.
    pub(crate) fn transform(&mut self, new_from_old: &Isometry3<f64>) {
        for p in &mut self.particles {
            p.position = new_from_old * p.position;
            p.velocity = new_from_old * p.velocity;
        }
    }

    /// Systematic resampling by likelihood; without effect when the likelihood is zero everywhere.
    pub(crate) fn resample(&mut self, likelihood: impl Fn(&Point3<f64>) -> f64, rng: &mut impl Rng) {
        let weights: Vec<f64> = self.particles.iter().map(|p| likelihood(&p.position).max(0.0)).collect();
        resample(&mut self.particles, &weights, rng);
    }

    /// Draws the cloud towards a measured position with the given covariance, m^2.
    pub(crate) fn correct(&mut self, measured: &Point3<f64>, covariance: &Matrix3<f64>, rng: &mut impl Rng) {
        let (position, velocity) = self.mean();
        let n = (self.particles.len() - 1) as f64;
        let (mut pp, mut vp) = (Matrix3::zeros(), Matrix3::zeros());
        for p in &self.particles {
            let d = p.position - position;
            pp += d * d.transpose() / n;
            vp += (p.velocity - velocity) * d.transpose() / n;
        }
        let Some(inverse) = (pp + covariance).try_inverse() else { return };
        let (gain_p, gain_v) = (pp * inverse, vp * inverse);
        let factor = square_root(covariance);
        for p in &mut self.particles {
            let innovation = measured + factor * normal3(rng) - p.position;
            p.position += gain_p * innovation;
            p.velocity += gain_v * innovation;
        }
    }

    /// Mean position (m) and velocity (m/s).
    pub(crate) fn mean(&self) -> (Point3<f64>, Vector3<f64>) {
        let n = self.particles.len().max(1) as f64;
        let position: Vector3<f64> = self.particles.iter().map(|p| p.position.coords).sum();
        let velocity: Vector3<f64> = self.particles.iter().map(|p| p.velocity).sum();
        (Point3::from(position / n), velocity / n)
    }

    /// Covariance of the position, m^2.
    pub(crate) fn covariance(&self) -> Matrix3<f64> {
        let (mean, _) = self.mean();
        let n = self.particles.len().max(2) as f64 - 1.0;
        self.particles.iter().map(|p| p.position - mean).map(|d| d * d.transpose() / n).sum()
    }
}

/// Systematic resampling by weight (Kitagawa 1996, appendix), of as many as there are; without effect when the weights
/// have no finite, positive sum.
pub(crate) fn resample<T: Clone>(particles: &mut Vec<T>, weights: &[f64], rng: &mut impl Rng) {
    let total: f64 = weights.iter().sum();
    if !(total.is_finite() && total > 0.0) {
        return;
    }
    let step = total / weights.len() as f64;
    let (mut target, mut reached, mut i) = (rng.random::<f64>() * step, weights[0], 0);
    let mut drawn = Vec::with_capacity(weights.len());
    for _ in 0..weights.len() {
        while reached < target && i + 1 < weights.len() {
            i += 1;
            reached += weights[i];
        }
        drawn.push(particles[i].clone());
        target += step;
    }
    *particles = drawn;
}

/// A matrix `s` with `s * s^T` equal to the covariance; zero when it is not positive definite.
fn square_root(covariance: &Matrix3<f64>) -> Matrix3<f64> {
    covariance.cholesky().map_or_else(Matrix3::zeros, |c| c.l())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// With linear motion and Gaussian measurements the ensemble must agree with the Kalman filter.
    #[test]
    fn agrees_with_the_kalman_filter() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (prior, r) = (4e-4, 1e-4);
        let mut cloud =
            Cloud::around(&Point3::origin(), &(Matrix3::identity() * prior), 0.1, 20_000, &mut rng);
        let dt = 0.5;
        cloud.predict(dt, 0.0, &mut rng);
        // Position variance prior + speed^2 dt^2, covariance with velocity speed^2 dt.
        let p = prior + 0.01 * dt * dt;
        let z = Point3::new(0.05, -0.02, 0.01);
        cloud.correct(&z, &(Matrix3::identity() * r), &mut rng);
        let (position, velocity) = cloud.mean();
        let gain = p / (p + r);
        assert!((position - z * gain).norm() < 1e-3, "{position}");
        assert!((velocity - z.coords * (0.01 * dt / (p + r))).norm() < 3e-3, "{velocity}");
        assert!((cloud.covariance() / ((1.0 - gain) * p) - Matrix3::identity()).amax() < 0.05);
    }

    #[test]
    fn resampling_follows_the_likelihood() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut cloud = Cloud::around(&Point3::origin(), &Matrix3::identity(), 0.0, 20_000, &mut rng);
        // Prior N(0, 1) times likelihood N(1, 1) is N(1/2, 1/2).
        cloud.resample(|p| libm::exp(-0.5 * (p.x - 1.0).powi(2)), &mut rng);
        assert!((cloud.mean().0.x - 0.5).abs() < 0.03);
        assert!((cloud.covariance()[(0, 0)] - 0.5).abs() < 0.03);
        cloud.resample(|_| 0.0, &mut rng);
        cloud.resample(|_| f64::NAN, &mut rng);
        assert!((cloud.mean().0.x - 0.5).abs() < 0.03);
    }
}
