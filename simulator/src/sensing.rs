//! From the true to the sensed state: noise, bias and drift, determined by the seed; and broken sensors.

use armarium_values::random::StandardNormal;
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use armarium_robot::{ForceTorque, JointKind, Limb, Model, Sample};

use crate::world::{Faults, NoiseSpec, WrenchFault};

/// Torque noise over force noise, m.
const TORQUE_SHARE: f64 = 0.05;
/// Noise of a force axis where a world wants none, N: a sensor that repeats itself bit by bit counts as broken.
const LEAST_NOISE: f64 = 1e-6;
/// Time constant of the coloured noise, s.
const COLOUR_TIME: f64 = 0.05;
/// Time constant of the offsets' drift, s: an offset nears where it drifts to, and after this time drifts to another place.
const DRIFT_TIME: f64 = 300.0;
/// Noise of a joint's velocity over that of its angle, 1/s.
const VELOCITY_SHARE: f64 = 1.0;
/// Noise of a sliding joint's position over that of a turning joint's, m/rad.
const SLIDING_SHARE: f64 = 0.05;

/// The robot's joint encoders and wrench sensors.
#[derive(Clone, Debug)]
pub(crate) struct RobotSensors {
    noise: NoiseSpec,
    faults: Faults,
    /// Of each joint, whether it slides.
    sliding: Vec<bool>,
    odometry: Vec<Odometry>,
    rng: ChaCha8Rng,
    wrenches: Vec<NoisyWrench>,
    /// The wrench sensor that the faults concern: that of the arm that works.
    faulty: Option<usize>,
}

/// One wrench sensor.
#[derive(Clone, Debug)]
struct NoisyWrench {
    bias: [f64; 6],
    drift: Drift,
    /// The coloured noise, over its standard deviation, and when it was so, s.
    slow: ([f64; 6], f64),
    rng: ChaCha8Rng,
    frozen: Option<ForceTorque>,
}

impl RobotSensors {
    /// Draws biases and drifts. `stream` gives independent sources of random numbers: 0 is for the joints, the others are
    /// for the wrench sensors in their order. `arm` is the arm that works.
    pub(crate) fn new(
        model: &Model,
        arm: &Limb,
        (noise, faults): (&NoiseSpec, &Faults),
        stream: impl Fn(u64) -> ChaCha8Rng,
    ) -> Self {
        Self {
            noise: noise.clone(),
            faults: faults.clone(),
            odometry: Odometry::all(model, noise, &mut stream(64)),
            sliding: model.joints().iter().map(|joint| joint.kind == JointKind::Prismatic).collect(),
            rng: stream(0),
            wrenches: (1..).zip(model.wrenches()).map(|(n, _)| NoisyWrench::new(noise, stream(n))).collect(),
            faulty: arm.wrench,
        }
    }

    /// Writes one sample of the true state at `t` s to `sample`, with the sensors' errors.
    pub(crate) fn sense(
        &mut self,
        t: f64,
        position: &[f64],
        velocity: &[f64],
        wrenches: impl Iterator<Item = ForceTorque>,
        sample: &mut Sample,
    ) {
        for j in 0..position.len() {
            let sigma = self.noise.joint * if self.sliding[j] { SLIDING_SHARE } else { 1.0 };
            let [a, b]: [f64; 2] = std::array::from_fn(|_| self.rng.sample(StandardNormal));
            sample.position[j] = position[j] + sigma * a;
            sample.velocity[j] = velocity[j] + VELOCITY_SHARE * sigma * b;
        }
        for odometry in &mut self.odometry {
            sample.position[odometry.joint] += odometry.error(position[odometry.joint]);
        }
        let frozen = self.faults.wrench == WrenchFault::Frozen && self.faults.at(t);
        for (i, (sensor, truth)) in self.wrenches.iter_mut().zip(wrenches).enumerate() {
            let felt = sensor.sense(t, &truth, &self.noise);
            let broken = frozen && self.faulty == Some(i);
            sample.wrenches[i] = if broken { *sensor.frozen.get_or_insert(felt) } else { felt };
        }
    }

    /// Turns set points of a platform into where they take it: its wheels follow them, and slip.
    pub(crate) fn slip(&self, targets: &mut [f64]) {
        for odometry in &self.odometry {
            targets[odometry.joint] -= odometry.off;
        }
    }
}

/// The share of an axis in the noise: forces come first, then torques.
fn share(axis: usize) -> f64 {
    if axis < 3 { 1.0 } else { TORQUE_SHARE }
}

impl NoisyWrench {
    fn new(noise: &NoiseSpec, mut rng: ChaCha8Rng) -> Self {
        let bias = std::array::from_fn(|axis| {
            noise.wrench_bias * share(axis) * rng.sample::<f64, _>(StandardNormal)
        });
        let drift = Drift::new(noise.wrench_drift, &mut rng);
        Self { bias, drift, slow: ([0.0; 6], 0.0), rng, frozen: None }
    }

    /// A first-order Gauss-Markov process of standard deviation 1 at `t` s, which never goes back.
    fn colored(&mut self, t: f64) -> [f64; 6] {
        let (last, at) = &mut self.slow;
        let kept = libm::exp(-(t - *at).max(0.0) / COLOUR_TIME);
        let fresh = (1.0 - kept * kept).sqrt();
        for axis in last.iter_mut() {
            *axis = kept * *axis + fresh * self.rng.sample::<f64, _>(StandardNormal);
        }
        *at = t;
        *last
    }

    fn sense(&mut self, t: f64, truth: &ForceTorque, noise: &NoiseSpec) -> ForceTorque {
        let sigma = noise.wrench.max(LEAST_NOISE);
        let drift = self.drift.at(t, &mut self.rng);
        // A sensor without it draws nothing, so that its other errors are the same.
        let colored = if noise.wrench_colored > 0.0 { self.colored(t) } else { [0.0; 6] };
        let offset: [f64; 6] = std::array::from_fn(|axis| {
            let white = sigma * self.rng.sample::<f64, _>(StandardNormal);
            self.bias[axis] + drift[axis] + share(axis) * (white + noise.wrench_colored * colored[axis])
        });
        ForceTorque {
            force: truth.force + Vector3::new(offset[0], offset[1], offset[2]),
            torque: truth.torque + Vector3::new(offset[3], offset[4], offset[5]),
        }
    }
}

/// The error of one joint of a platform: its wheels slip by a share of the way.
#[derive(Clone, Debug)]
struct Odometry {
    joint: usize,
    slip: f64,
    /// Where it was in the last step, m or rad, and the error since the start.
    last: Option<f64>,
    off: f64,
}

impl Odometry {
    fn all(model: &Model, noise: &NoiseSpec, rng: &mut ChaCha8Rng) -> Vec<Self> {
        let joints = model.platform().into_iter().flat_map(|platform| platform.joints);
        let slip = |rng: &mut ChaCha8Rng| noise.odometry * rng.sample::<f64, _>(StandardNormal);
        joints.map(|joint| Self { joint, slip: slip(rng), last: None, off: 0.0 }).collect()
    }

    fn error(&mut self, position: f64) -> f64 {
        // There and back again does not undo the error.
        self.off += self.slip * (position - self.last.replace(position).unwrap_or(position)).abs();
        self.off
    }
}

/// A random walk that returns: each axis nears a goal exponentially, and draws another one each [`DRIFT_TIME`]. So it leaves its
/// place at the rate that the world says, and stays within that rate times [`DRIFT_TIME`].
#[derive(Clone, Debug)]
struct Drift {
    /// Fastest rate of a force axis, N/s.
    rate: f64,
    /// Number of the goal.
    leg: u64,
    /// Where each axis was when the goal was drawn, and the goal, N and N m.
    from: [f64; 6],
    to: [f64; 6],
}

impl Drift {
    fn new(rate: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut drift = Self { rate, leg: 0, from: [0.0; 6], to: [0.0; 6] };
        drift.to = drift.goal(rng);
        drift
    }

    fn goal(&self, rng: &mut ChaCha8Rng) -> [f64; 6] {
        std::array::from_fn(|axis| self.rate * DRIFT_TIME * share(axis) * (2.0 * rng.random::<f64>() - 1.0))
    }

    /// The offsets at `t` s, which never goes back.
    fn at(&mut self, t: f64, rng: &mut ChaCha8Rng) -> [f64; 6] {
        while t >= (self.leg + 1) as f64 * DRIFT_TIME {
            self.leg += 1;
            self.from = self.after(DRIFT_TIME);
            self.to = self.goal(rng);
        }
        self.after(t - self.leg as f64 * DRIFT_TIME)
    }

    fn after(&self, since: f64) -> [f64; 6] {
        let kept = libm::exp(-since / DRIFT_TIME);
        std::array::from_fn(|axis| self.to[axis] + (self.from[axis] - self.to[axis]) * kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn the_drift_begins_at_its_rate_returns_and_is_bounded() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut drift = Drift::new(0.01, &mut rng);
        let rates = drift.to.map(|goal| goal / DRIFT_TIME);
        let soon = drift.at(30.0, &mut rng);
        for axis in 0..6 {
            assert!((soon[axis] - 30.0 * rates[axis]).abs() < 0.06 * 30.0 * rates[axis].abs());
        }
        let (mut most, mut before, mut turned) = (0.0_f64, 0.0, 0);
        for minute in 1..600 {
            let now = drift.at(60.0 * f64::from(minute), &mut rng);
            assert!(now.iter().enumerate().all(|(axis, offset)| offset.abs() <= 3.0 * share(axis)));
            most = most.max(now[0].abs());
            turned += u32::from(now[0] * before < 0.0);
            before = now[0];
        }
        assert!(most > 1.0 && turned > 5, "{most} N, {turned} times through zero");
    }

    fn sensors(model: &Model, faults: Faults) -> RobotSensors {
        let stream = |n: u64| ChaCha8Rng::seed_from_u64(7 + n);
        let arm = model.arms().next().unwrap();
        RobotSensors::new(model, arm, (&NoiseSpec::default(), &faults), stream)
    }

    #[test]
    fn noise_has_its_deviation_and_the_biases_stay_and_differ() {
        let model = Model::shipped("armar3").unwrap();
        let mut s = sensors(&model, Faults::default());
        s.wrenches.iter_mut().for_each(|sensor| sensor.drift = Drift::new(0.0, &mut sensor.rng));
        let (position, velocity) = (vec![0.5; model.joints().len()], vec![0.0; model.joints().len()]);
        let mut sample = Sample::resting(&model, position.clone());
        let (mut sums, mut squares, mut angles) = ([0.0; 2], [0.0; 2], 0.0);
        let n = 200_000;
        for step in 0..n {
            s.sense(
                f64::from(step) * 1e-3,
                &position,
                &velocity,
                [ForceTorque::default(); 2].into_iter(),
                &mut sample,
            );
            for i in 0..2 {
                sums[i] += sample.wrenches[i].force.x;
                squares[i] += sample.wrenches[i].force.x.powi(2);
            }
            angles += (sample.position[0] - 0.5).powi(2);
        }
        for i in 0..2 {
            let mean = sums[i] / f64::from(n);
            assert!((mean - s.wrenches[i].bias[0]).abs() < 0.02);
            let white_and_colored = libm::hypot(0.3_f64, 0.1);
            assert!(((squares[i] / f64::from(n) - mean * mean).sqrt() - white_and_colored).abs() < 0.003);
        }
        assert!(((angles / f64::from(n)).sqrt() - 0.0002).abs() < 1e-5);
        assert_ne!(s.wrenches[0].bias, s.wrenches[1].bias);
    }

    #[test]
    fn coloured_noise_has_its_deviation_and_is_alike_for_its_time_only() {
        let model = Model::shipped("armar3").unwrap();
        let mut s = sensors(&model, Faults::default());
        let axis: Vec<f64> =
            (0..200_000).map(|ms| s.wrenches[0].colored(f64::from(ms) * 1e-3)[0]).skip(1000).collect();
        let alike = |after: usize| {
            let pairs = axis.iter().zip(&axis[after..]);
            pairs.map(|(a, b)| a * b).sum::<f64>() / (axis.len() - after) as f64
        };
        let expected = |after: f64| libm::exp(-after / COLOUR_TIME);
        for after in [0_u32, 10, 50, 500] {
            let off = alike(after as usize) - expected(f64::from(after) * 1e-3);
            assert!(off.abs() < 0.1, "{off} after {after} ms");
        }
    }

    #[test]
    fn a_platform_that_goes_to_its_set_point_is_there_by_its_odometry() {
        let model = Model::shipped("rover2").unwrap();
        let mut s = sensors(&model, Faults::default());
        let [along, ..] = model.platform().unwrap().joints;
        s.odometry[0].slip = 0.02;
        let mut sample = Sample::resting(&model, vec![0.0; model.joints().len()]);
        let (mut truth, still) = (vec![0.0; model.joints().len()], vec![0.0; model.joints().len()]);
        let mut goal = truth.clone();
        for step in 0..5000_u32 {
            s.sense(f64::from(step) * 1e-3, &truth, &still, std::iter::empty(), &mut sample);
            goal.fill(0.0);
            goal[along] = f64::from(step) * 1e-3;
            s.slip(&mut goal);
            truth[along] = goal[along];
        }
        assert!((truth[along] - 5.0).abs() > 0.05, "its wheels slip: {} m", truth[along]);
        assert!((sample.position[along] - 5.0).abs() < 0.005, "{} m", sample.position[along]);
    }

    #[test]
    fn a_frozen_sensor_repeats_itself_and_the_other_does_not() {
        let model = Model::shipped("armar3").unwrap();
        let mut s = sensors(&model, Faults { wrench: WrenchFault::Frozen, from: 1.0, ..Faults::default() });
        let still = vec![0.0; model.joints().len()];
        let mut sample = Sample::resting(&model, still.clone());
        let mut read = |s: &mut RobotSensors, t: f64| {
            s.sense(t, &still, &still, [ForceTorque::default(); 2].into_iter(), &mut sample);
            [sample.wrenches[0].force, sample.wrenches[1].force]
        };
        assert_ne!(read(&mut s, 0.5)[0], read(&mut s, 0.6)[0]);
        let first = read(&mut s, 1.0);
        let later = read(&mut s, 2.0);
        assert_eq!(later[0], first[0]);
        assert_ne!(later[1], first[1]);
    }
}
