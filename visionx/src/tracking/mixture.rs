//! Gaussian mixtures of colours, fitted by expectation maximisation. Deterministic: the start is a farthest-first
//! choice of colours.
//!
//! # Source
//! Dempster, Laird, Rubin 1977 (EM); Gonzalez 1985 (farthest-first start).

use nalgebra::{Matrix3, Vector3};

use super::lab::apart;

/// A mixture.
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    parts: Vec<MixtureComponent>,
}

#[derive(Clone, Debug)]
struct MixtureComponent {
    mean: Vector3<f32>,
    inverse: Matrix3<f32>,
    /// Logarithm of its weight times the density at its mean.
    log_top: f32,
}

/// Least variance along any axis, squared units of CIELAB; below it, noise and rounding dominate.
const MIN_VARIANCE: f32 = 2.0;
/// Most colours used for the fit.
const MAX_SAMPLES: usize = 3000;
const ROUNDS: usize = 8;

impl Mixture {
    /// Fits a mixture of at most `k` components; `None` without colours.
    pub(super) fn fit(colors: &[[f32; 3]], k: usize) -> Option<Self> {
        let stride = colors.len().div_ceil(MAX_SAMPLES).max(1);
        let samples: Vec<[f32; 3]> = colors.iter().copied().step_by(stride).collect();
        let mut of = assign(&samples, &farthest_first(&samples, k)?);
        // A few rounds of k-means give EM a start that is robust against shading.
        for _ in 0..4 {
            of = assign(&samples, &means(&samples, &of, k));
        }
        let mut weights: Vec<Vec<f32>> =
            of.iter().map(|&o| (0..k).map(|i| f32::from(u8::from(i == o))).collect()).collect();
        let mut mixture = Self { parts: Vec::new() };
        for _ in 0..ROUNDS {
            mixture.parts = (0..k).map(|i| part(&samples, |s| weights[s][i])).collect();
            for (w, color) in weights.iter_mut().zip(&samples) {
                let total = mixture.log_density(color);
                for (share, part) in w.iter_mut().zip(&mixture.parts) {
                    *share = libm::expf(part.log(color) - total);
                }
            }
        }
        Some(mixture)
    }

    /// The logarithm of the density at a colour.
    pub(super) fn log_density(&self, color: &[f32; 3]) -> f32 {
        let logs = self.parts.iter().map(|p| p.log(color));
        let top = logs.clone().fold(f32::NEG_INFINITY, f32::max);
        top + libm::logf(logs.map(|l| libm::expf(l - top)).sum::<f32>())
    }

    /// The components whose means are `wanted`, and the others; `None` for an empty side.
    pub(super) fn divided(&self, wanted: impl Fn(&[f32; 3]) -> bool) -> (Option<Self>, Option<Self>) {
        let (yes, no): (Vec<MixtureComponent>, Vec<MixtureComponent>) =
            self.parts.iter().cloned().partition(|p| wanted(&[p.mean.x, p.mean.y, p.mean.z]));
        let some = |parts: Vec<MixtureComponent>| (!parts.is_empty()).then_some(Self { parts });
        (some(yes), some(no))
    }

    /// The means of the components.
    pub(super) fn means(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        self.parts.iter().map(|p| [p.mean.x, p.mean.y, p.mean.z])
    }

    /// The most likely component of a colour.
    pub(super) fn part_of(&self, color: &[f32; 3]) -> usize {
        let log = |i: &usize| self.parts[*i].log(color);
        (0..self.parts.len()).max_by(|a, b| log(a).total_cmp(&log(b))).unwrap_or(0)
    }
}

impl MixtureComponent {
    fn log(&self, color: &[f32; 3]) -> f32 {
        let d = Vector3::from(*color) - self.mean;
        self.log_top - 0.5 * d.dot(&(self.inverse * d))
    }
}

fn part(samples: &[[f32; 3]], weight: impl Fn(usize) -> f32) -> MixtureComponent {
    let (mut sum, mut mean, mut square) = (1e-6, Vector3::zeros(), Matrix3::zeros());
    for (i, s) in samples.iter().enumerate() {
        let (w, v) = (weight(i), Vector3::from(*s));
        sum += w;
        mean += v * w;
        square += v * v.transpose() * w;
    }
    mean /= sum;
    let covariance = square / sum - mean * mean.transpose() + Matrix3::identity() * MIN_VARIANCE;
    let share = sum / samples.len().max(1) as f32;
    let inverse = covariance.try_inverse().unwrap_or_else(Matrix3::identity);
    let log_top = libm::logf(share.max(1e-12)) - 0.5 * libm::logf(covariance.determinant().max(1e-12));
    MixtureComponent { mean, inverse, log_top }
}

/// `k` colours, each the farthest from those before; the first is the farthest from black.
fn farthest_first(samples: &[[f32; 3]], k: usize) -> Option<Vec<[f32; 3]>> {
    let n = samples.len() as f32;
    let middle = samples.iter().fold([0.0; 3], |m, s| std::array::from_fn(|i| m[i] + s[i] / n));
    let mut chosen = vec![middle];
    let mut distance: Vec<f32> = samples.iter().map(|s| apart(s, &middle)).collect();
    for _ in 1..k {
        let far = (0..samples.len()).max_by(|&a, &b| distance[a].total_cmp(&distance[b]))?;
        // Half way to it from the mean: the farthest colours themselves are often outliers.
        let seed = std::array::from_fn(|i| 0.5 * (samples[far][i] + middle[i]));
        chosen.push(seed);
        for (d, s) in distance.iter_mut().zip(samples) {
            *d = d.min(apart(s, &samples[far]));
        }
    }
    (!samples.is_empty()).then_some(chosen)
}

fn assign(samples: &[[f32; 3]], centers: &[[f32; 3]]) -> Vec<usize> {
    let nearest = |s: &[f32; 3]| {
        let distance = |i: &usize| apart(s, &centers[*i]);
        (0..centers.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    };
    samples.iter().map(nearest).collect()
}

/// The means of `k` groups; black for an empty group.
fn means(samples: &[[f32; 3]], of: &[usize], k: usize) -> Vec<[f32; 3]> {
    let mut sums = vec![([0.0f32; 3], 0.0f32); k];
    for (s, &o) in samples.iter().zip(of) {
        sums[o].1 += 1.0;
        (0..3).for_each(|i| sums[o].0[i] += s[i]);
    }
    sums.into_iter().map(|(sum, n)| sum.map(|v| v / n.max(1.0))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_values::random::StandardNormal;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn finds_the_parts_that_colours_were_drawn_from() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let centers = [[70.0f32, 15.0, 20.0], [40.0, 5.0, 30.0], [80.0, 0.0, 5.0]];
        let colors: Vec<[f32; 3]> = (0..3000)
            .map(|i| centers[i % 3].map(|c| c + 3.0 * rng.sample::<f32, _>(StandardNormal)))
            .collect();
        let mixture = Mixture::fit(&colors, 3).unwrap();
        let parts: Vec<usize> = centers.iter().map(|c| mixture.part_of(c)).collect();
        assert!(parts[0] != parts[1] && parts[1] != parts[2] && parts[0] != parts[2], "{parts:?}");
        let right = colors.iter().enumerate().filter(|(i, c)| mixture.part_of(c) == parts[i % 3]).count();
        assert!(right > 2900, "{right}");
        assert!(mixture.log_density(&centers[0]) > mixture.log_density(&[0.0, 0.0, 0.0]) + 10.0);
        assert!(Mixture::fit(&[], 3).is_none());
        assert!(Mixture::fit(&[[1.0; 3]], 4).unwrap().log_density(&[1.0; 3]).is_finite());
    }
}
