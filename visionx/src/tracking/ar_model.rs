//! The motion of fingertips from frame to frame, learned from sequences: a second-order autoregressive model.
//!
//! # Source
//! Do, Asfour, Dillmann 2011 (AR(2) of fingertips); the fit is the conditional least squares of Lütkepohl 2005, 3.2.

use std::sync::Arc;

use armarium_source::yaml::Node;
use armarium_source::{Finding, Findings, Source, code, form};
use nalgebra::{DMatrix, Matrix2, Point2, Vector2};

/// `x(t) = A1 x(t-1) + A2 x(t-2) + d + e` with Gaussian `e`: positions of one fingertip in normalised image
/// coordinates (pixels from the principal point over the focal length), one step per frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerARModel {
    /// A1.
    pub from_last: Matrix2<f64>,
    /// A2.
    pub from_last_but_one: Matrix2<f64>,
    /// d.
    pub offset: Vector2<f64>,
    /// Covariance of e.
    pub noise: Matrix2<f64>,
    /// Frame rate of the training sequences, Hz.
    pub frame_rate_hz: f64,
    /// Number of training steps.
    pub samples: usize,
}

form! {
    /// The model as it is written.
    struct Written: "a model of fingertips", check Self::is_usable {
        frame_rate_hz: f64;
        from_last: [[f64; 2]; 2];
        from_last_but_one: [[f64; 2]; 2];
        offset: [f64; 2];
        noise: [[f64; 2]; 2];
        samples: usize;
    }
}

/// Why a model cannot be fitted: these steps are too few, or all alike.
#[derive(Debug, thiserror::Error)]
#[error("{0} steps do not determine the model")]
pub struct ArModelError(usize);

/// The built-in model.
const BUILT_IN: &str = include_str!("finger_ar2.yaml");

impl Default for FingerARModel {
    fn default() -> Self {
        Self::read(Arc::new(Source::new("finger_ar2.yaml", BUILT_IN)))
            .expect("the model that ships is tested")
    }
}

fn matrix(m: [[f64; 2]; 2]) -> Matrix2<f64> {
    Matrix2::new(m[0][0], m[0][1], m[1][0], m[1][1])
}

impl Written {
    fn is_usable(&self, node: &Node, findings: &mut Findings) {
        if matrix(self.noise).cholesky().is_none() {
            findings.error(code::VALUE, node.place("noise"), "the noise is no covariance");
        }
        if self.frame_rate_hz <= 0.0 {
            findings.error(code::VALUE, node.place("frame_rate_hz"), "the frame rate must be positive");
        }
    }
}

impl FingerARModel {
    /// The model of a fingertip that stands still, with noise of a standard deviation in normalised
    /// coordinates.
    pub fn random_walk(deviation: f64, frame_rate_hz: f64) -> Self {
        Self {
            from_last: Matrix2::identity(),
            from_last_but_one: Matrix2::zeros(),
            offset: Vector2::zeros(),
            noise: Matrix2::identity() * (deviation * deviation),
            frame_rate_hz,
            samples: 0,
        }
    }

    /// Fits the model by least squares to sequences of positions, one per frame; a position that is not finite
    /// splits a sequence.
    ///
    /// # Errors
    /// When the steps do not determine the ten coefficients.
    pub fn fit(sequences: &[Vec<Point2<f64>>], frame_rate_hz: f64) -> Result<Self, ArModelError> {
        let finite = |w: &&[Point2<f64>]| w.iter().all(|p| p.coords.amax().is_finite());
        let steps: Vec<&[Point2<f64>]> = sequences.iter().flat_map(|s| s.windows(3)).filter(finite).collect();
        let n = steps.len();
        let too_little = || ArModelError(n);
        if n < 20 {
            return Err(too_little());
        }
        let row = |i: usize, j: usize| match j {
            0 => steps[i][1].x,
            1 => steps[i][1].y,
            2 => steps[i][0].x,
            3 => steps[i][0].y,
            _ => 1.0,
        };
        let regressors = DMatrix::from_fn(n, 5, row);
        let targets = DMatrix::from_fn(n, 2, |i, j| steps[i][2][j]);
        let svd = regressors.clone().svd(true, true);
        if svd.singular_values[4] < 1e-9 * svd.singular_values[0] {
            return Err(too_little());
        }
        let solution = svd.solve(&targets, 0.0).map_err(|_| too_little())?;
        let residuals = &targets - regressors * &solution;
        let covariance = residuals.transpose() * &residuals / (n - 5) as f64;
        let block = |from: usize| Matrix2::from_fn(|i, j| solution[(from + j, i)]);
        Ok(Self {
            from_last: block(0),
            from_last_but_one: block(2),
            offset: Vector2::new(solution[(4, 0)], solution[(4, 1)]),
            noise: Matrix2::from_fn(|i, j| covariance[(i, j)]),
            frame_rate_hz,
            samples: n,
        })
    }

    /// The expected position after `last` and, before it, `last_but_one`.
    pub fn predict(&self, last: &Point2<f64>, last_but_one: &Point2<f64>) -> Point2<f64> {
        Point2::from(
            self.from_last * last.coords + self.from_last_but_one * last_but_one.coords + self.offset,
        )
    }

    /// Reads the model from a file's text.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(source: Arc<Source>) -> Result<Self, Vec<Finding>> {
        let w: Written = armarium_source::read(source)?;
        Ok(Self {
            from_last: matrix(w.from_last),
            from_last_but_one: matrix(w.from_last_but_one),
            offset: Vector2::from(w.offset),
            noise: matrix(w.noise),
            frame_rate_hz: w.frame_rate_hz,
            samples: w.samples,
        })
    }

    /// Writes the model as a file's text.
    pub fn to_yaml(&self) -> String {
        let rows = |m: &Matrix2<f64>| m.transpose().data.0;
        format!(
            "# How a fingertip moves from frame to frame, in normalised image coordinates.\nframe_rate_hz: {:?}\n\
             from_last: {:?}\nfrom_last_but_one: {:?}\noffset: {:?}\nnoise: {:?}\nsamples: {}\n",
            self.frame_rate_hz,
            rows(&self.from_last),
            rows(&self.from_last_but_one),
            self.offset.data.0[0],
            rows(&self.noise),
            self.samples,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<FingerARModel, Vec<Finding>> {
        FingerARModel::read(Arc::new(Source::new("model.yaml", text)))
    }
    use armarium_values::random::StandardNormal;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_fit_finds_the_model_that_made_the_sequences() {
        let truth = FingerARModel {
            from_last: Matrix2::new(1.6, 0.05, -0.04, 1.5),
            from_last_but_one: Matrix2::new(-0.7, 0.0, 0.02, -0.6),
            offset: Vector2::new(0.01, -0.02),
            noise: Matrix2::new(1e-4, 2e-5, 2e-5, 2e-4),
            frame_rate_hz: 30.0,
            samples: 0,
        };
        let factor = truth.noise.cholesky().unwrap().l();
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut sequence = vec![Point2::new(0.1, 0.2), Point2::new(0.11, 0.2)];
        for i in 2..20_000 {
            let e = factor * Vector2::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
            sequence.push(truth.predict(&sequence[i - 1], &sequence[i - 2]) + e);
        }
        let found = FingerARModel::fit(&[sequence], 30.0).unwrap();
        // The coefficients' standard errors are about 1 / sqrt(n) at this ratio of signal to noise.
        assert!((found.from_last - truth.from_last).amax() < 0.03, "{found:?}");
        assert!((found.from_last_but_one - truth.from_last_but_one).amax() < 0.03);
        assert!((found.noise - truth.noise).amax() < 0.05 * truth.noise.amax());
        let again = read(&found.to_yaml()).unwrap();
        assert_eq!(again, found);
    }

    #[test]
    fn too_little_and_nonsense_are_refused() {
        assert!(FingerARModel::fit(&[], 30.0).is_err());
        assert!(FingerARModel::fit(&[vec![Point2::new(0.1, 0.2); 100]], 30.0).is_err());
        for text in
            ["", "from_last: 3", &FingerARModel::default().to_yaml().replace("noise: [[", "noise: [[-")]
        {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
