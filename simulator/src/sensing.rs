//! From the true to the sensed state: noise, bias and drift, determined by the seed; and broken sensors.

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use armarium_robot::Sample;

use crate::world::{Faults, NoiseSpec, WrenchFault};

/// Torque noise over force noise, m.
const TORQUE_SHARE: f64 = 0.05;
/// Noise of a joint's velocity over that of its angle, 1/s.
const VELOCITY_SHARE: f64 = 1.0;
/// Noise of a sliding joint's position over that of a turning joint's, m/rad.
const SLIDING_SHARE: f64 = 0.05;

/// The robot's joint encoders and wrist sensor.
#[derive(Clone, Debug)]
pub(crate) struct Sensors {
    noise: NoiseSpec,
    faults: Faults,
    sliding: Vec<bool>,
    bias: [f64; 6],
    drift: [f64; 6],
    rng: ChaCha8Rng,
    frozen: Option<(Vector3<f64>, Vector3<f64>)>,
}

impl Sensors {
    /// Draws bias and drift; `sliding` tells for each joint whether it slides.
    pub(crate) fn new(noise: &NoiseSpec, faults: &Faults, sliding: Vec<bool>, mut rng: ChaCha8Rng) -> Self {
        let share = |axis: usize| if axis < 3 { 1.0 } else { TORQUE_SHARE };
        let bias = std::array::from_fn(|axis| {
            noise.wrench_bias * share(axis) * rng.sample::<f64, _>(StandardNormal)
        });
        let drift =
            std::array::from_fn(|axis| noise.wrench_drift * share(axis) * (2.0 * rng.random::<f64>() - 1.0));
        Self { noise: noise.clone(), faults: faults.clone(), sliding, bias, drift, rng, frozen: None }
    }

    /// Writes one sample of the true state at `t` s to `sample`, with the sensors' errors.
    pub(crate) fn sense(
        &mut self,
        t: f64,
        position: &[f64],
        velocity: &[f64],
        wrist: (Vector3<f64>, Vector3<f64>),
        sample: &mut Sample,
    ) {
        for j in 0..position.len() {
            let sigma = self.noise.joint * if self.sliding[j] { SLIDING_SHARE } else { 1.0 };
            let [a, b] = [self.normal(), self.normal()];
            sample.position[j] = position[j] + sigma * a;
            sample.velocity[j] = velocity[j] + VELOCITY_SHARE * sigma * b;
        }
        let raw = self.wrench(t, wrist);
        (sample.force_raw, sample.torque_raw) = raw;
    }

    fn normal(&mut self) -> f64 {
        self.rng.sample(StandardNormal)
    }

    fn wrench(&mut self, t: f64, truth: (Vector3<f64>, Vector3<f64>)) -> (Vector3<f64>, Vector3<f64>) {
        let offset: [f64; 6] = std::array::from_fn(|axis| {
            let share = if axis < 3 { 1.0 } else { TORQUE_SHARE };
            self.bias[axis]
                + self.drift[axis] * t
                + self.noise.wrench * share * self.rng.sample::<f64, _>(StandardNormal)
        });
        let force = truth.0 + Vector3::new(offset[0], offset[1], offset[2]);
        let torque = truth.1 + Vector3::new(offset[3], offset[4], offset[5]);
        match self.faults.wrench {
            WrenchFault::Frozen if t >= self.faults.from => *self.frozen.get_or_insert((force, torque)),
            _ => (force, torque),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn sensors(faults: Faults) -> Sensors {
        Sensors::new(&NoiseSpec::default(), &faults, vec![false], ChaCha8Rng::seed_from_u64(7))
    }

    #[test]
    fn noise_has_its_deviation_and_the_bias_stays() {
        let mut s = sensors(Faults::default());
        let mut sample = Sample::resting(vec![0.0]);
        let (mut sum, mut squares, mut angles) = (0.0, 0.0, 0.0);
        let n = 20_000;
        for _ in 0..n {
            s.sense(0.0, &[0.5], &[0.0], (Vector3::zeros(), Vector3::zeros()), &mut sample);
            sum += sample.force_raw.x;
            squares += sample.force_raw.x.powi(2);
            angles += (sample.position[0] - 0.5).powi(2);
        }
        let mean = sum / f64::from(n);
        assert!((mean - s.bias[0]).abs() < 0.01);
        assert!(((squares / f64::from(n) - mean * mean).sqrt() - 0.3).abs() < 0.01);
        assert!(((angles / f64::from(n)).sqrt() - 0.0002).abs() < 1e-5);
    }

    #[test]
    fn a_frozen_sensor_repeats_itself() {
        let mut s = sensors(Faults { wrench: WrenchFault::Frozen, from: 1.0, ..Faults::default() });
        let read = |s: &mut Sensors, t: f64| s.wrench(t, (Vector3::x() * t, Vector3::zeros())).0;
        assert_ne!(read(&mut s, 0.5), read(&mut s, 0.6));
        let first = read(&mut s, 1.0);
        assert_eq!(read(&mut s, 2.0), first);
    }
}
