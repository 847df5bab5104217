//! The noise of a camera's sensor: independent in every pixel and channel, and the same for the same seed and
//! frame.
//!
//! Drawing a million Gaussian numbers per frame costs more than rendering it. So they are drawn once, into a tile.
//! Every stretch of a picture adds a piece of the tile from a random position, unchanged or negated.

use std::sync::Arc;

use armarium_values::random::StandardNormal;
use armarium_visionx::RgbImage;
use rand::distr::Distribution;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of bytes of a picture that share one random position in the tile.
const STRETCH: usize = 640;
/// Number of start positions in the tile.
const PLACES: usize = 1 << 16;
/// Below this deviation, rounding to whole grey levels would remove the noise. Rare steps of one level are used
/// instead.
const COARSE: f64 = 0.7;

/// Additive Gaussian noise, rounded to whole grey levels.
#[derive(Clone, Debug)]
pub struct SensorNoise {
    seed: u64,
    tile: Arc<[i16]>,
}

impl SensorNoise {
    /// Noise with standard deviation `sigma`, in grey levels per channel; no noise if that is not positive and
    /// finite.
    pub fn new(sigma: f64, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let wanted = sigma > 0.0 && sigma.is_finite();
        let tile =
            (0..if wanted { PLACES + STRETCH } else { 0 }).map(|_| level(sigma, &mut random)).collect();
        Self { seed, tile }
    }

    /// The seed that determines it.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Adds the noise of one frame of one camera. `eye` is the camera's number.
    pub fn apply(&self, image: &mut RgbImage, frame: u64, eye: u64) {
        if self.tile.is_empty() {
            return;
        }
        let mut random = ChaCha8Rng::seed_from_u64(self.seed ^ eye.rotate_right(16));
        random.set_stream(frame.wrapping_add(1));
        for stretch in image.data_mut().chunks_mut(STRETCH) {
            let place = random.random_range(0..PLACES);
            let piece = &self.tile[place..place + stretch.len()];
            let sign = if random.random::<bool>() { 1 } else { -1 };
            for (byte, noise) in stretch.iter_mut().zip(piece) {
                *byte = (i16::from(*byte) + noise * sign).clamp(0, 255) as u8;
            }
        }
    }
}

/// One random level. For wide noise, the variance of 1/12 that rounding adds is subtracted beforehand.
fn level(sigma: f64, random: &mut ChaCha8Rng) -> i16 {
    if sigma < COARSE {
        let draw: f64 = random.random::<f64>() * 2.0 - 1.0;
        return if draw.abs() < sigma * sigma { draw.signum() as i16 } else { 0 };
    }
    let normal: f64 = StandardNormal.sample(random);
    let narrowed = (sigma * sigma - 1.0 / 12.0).sqrt();
    (normal * narrowed).round().clamp(-255.0, 255.0) as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray() -> RgbImage {
        RgbImage::from_rgb(640, 480, vec![128; 640 * 480 * 3]).unwrap()
    }

    fn noisy(noise: &SensorNoise, frame: u64, eye: u64) -> Vec<f64> {
        let mut image = gray();
        noise.apply(&mut image, frame, eye);
        image.data().iter().map(|&byte| f64::from(byte) - 128.0).collect()
    }

    fn mean_product(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64
    }

    #[test]
    fn has_the_deviation_that_was_asked_for() {
        for sigma in [0.2, 0.5, 1.0, 2.0, 6.0] {
            let data = noisy(&SensorNoise::new(sigma, 3), 7, 0);
            let mean = data.iter().sum::<f64>() / data.len() as f64;
            // The tile has 66 000 independent values: 1 % is about four standard errors of the deviation.
            assert!(mean.abs() < 0.02 * sigma, "{sigma}: mean {mean}");
            let deviation = mean_product(&data, &data).sqrt();
            assert!((deviation / sigma - 1.0).abs() < 0.02, "{sigma}: deviation {deviation}");
        }
    }

    #[test]
    fn repeats_by_seed_frame_and_eye_and_only_then() {
        let noise = SensorNoise::new(2.0, 3);
        assert_eq!(noisy(&noise, 7, 0), noisy(&SensorNoise::new(2.0, 3), 7, 0));
        let first = noisy(&noise, 7, 0);
        for other in [noisy(&noise, 8, 0), noisy(&noise, 7, 1), noisy(&SensorNoise::new(2.0, 4), 7, 0)] {
            assert!(mean_product(&first, &other).abs() < 0.05, "frames are independent");
        }
    }

    #[test]
    fn channels_and_rows_are_independent() {
        let data = noisy(&SensorNoise::new(2.0, 9), 1, 1);
        for lag in [1, 2, 3, 640, 1920] {
            assert!(mean_product(&data[lag..], &data[..data.len() - lag]).abs() < 0.06, "lag {lag}");
        }
    }

    #[test]
    fn without_deviation_nothing_changes() {
        for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut image = gray();
            SensorNoise::new(sigma, 1).apply(&mut image, 0, 0);
            assert_eq!(image, gray());
        }
    }
}
