//! Normally distributed numbers. They have the same bits on every machine, where those of `rand_distr` depend on the logarithm of
//! the C library.

use rand::{Rng, RngExt as _, distr::Distribution};

/// The normal distribution with mean 0 and standard deviation 1, for `rng.sample(StandardNormal)`.
///
/// # Source
/// Box and Muller, "A Note on the Generation of Random Normal Deviates", 1958.
#[derive(Clone, Copy, Debug)]
pub struct StandardNormal;

impl Distribution<f64> for StandardNormal {
    fn sample<R: Rng + ?Sized>(&self, rng: &mut R) -> f64 {
        let [above, turn]: [f64; 2] = rng.random();
        (-2.0 * libm::log(1.0 - above)).sqrt() * libm::cos(std::f64::consts::TAU * turn)
    }
}

impl Distribution<f32> for StandardNormal {
    fn sample<R: Rng + ?Sized>(&self, rng: &mut R) -> f32 {
        let normal: f64 = self.sample(rng);
        normal as f32
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::StandardNormal;

    #[test]
    fn the_moments_are_those_of_the_normal_distribution() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let n = 200_000;
        let samples: Vec<f64> = (0..n).map(|_| rng.sample(StandardNormal)).collect();
        let moment = |power: i32| samples.iter().map(|x| x.powi(power)).sum::<f64>() / f64::from(n);
        // Their own deviations are sqrt(1, 2, 15, 96) / sqrt(n).
        for (power, expected, deviation) in [(1, 0.0, 1.0_f64), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)]
        {
            let off = (moment(power) - expected).abs();
            assert!(off < 4.0 * (deviation / f64::from(n)).sqrt(), "moment {power} is off by {off}");
        }
    }
}
