//! The Kalman filter of a position: prediction adds uncertainty, an observation removes some.

use nalgebra::{Cholesky, Matrix3, Vector3};

/// Halvings of the search for the best weight: 1e-4 of the whole.
const HALVINGS: usize = 20;

/// A position with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussian {
    mean: Vector3<f64>,
    covariance: Matrix3<f64>,
}

impl Gaussian {
    /// A position, m, with its covariance, m². `None` unless all numbers are finite and the covariance is symmetric
    /// and positive definite.
    pub fn new(mean: Vector3<f64>, covariance: Matrix3<f64>) -> Option<Self> {
        let finite = mean.iter().chain(covariance.iter()).all(|x| x.is_finite());
        let scale = covariance.amax();
        let symmetric = (covariance - covariance.transpose()).amax() <= 1e-9 * scale;
        let definite = finite && Cholesky::new(covariance).is_some();
        (symmetric && definite).then_some(Self { mean, covariance })
    }

    /// The position, m.
    pub fn mean(&self) -> Vector3<f64> {
        self.mean
    }

    /// Its covariance, m².
    pub fn covariance(&self) -> Matrix3<f64> {
        self.covariance
    }

    /// The same position with the variance along each axis increased by `variance`, m².
    pub fn spread(&self, variance: f64) -> Self {
        Self { mean: self.mean, covariance: self.covariance + Matrix3::identity() * variance }
    }

    /// The squared Mahalanobis distance of two independent estimates: chi-squared with 3 degrees of freedom if both
    /// are of one object.
    pub fn distance_squared(&self, other: &Self) -> Option<f64> {
        let innovation = other.mean - self.mean;
        let decomposed = Cholesky::new(self.covariance + other.covariance)?;
        Some(innovation.dot(&decomposed.solve(&innovation)))
    }

    /// Fuses two independent estimates of one position: the Kalman update with observation matrix I; the covariance
    /// in Joseph's form stays symmetric and positive.
    ///
    /// # Source
    /// Bar-Shalom, Li, Kirubarajan 2001, eqs. (5.2.3-11) to (5.2.3-18).
    pub fn fuse(&self, observed: &Self) -> Option<Self> {
        let inverse = Cholesky::new(self.covariance + observed.covariance)?.inverse();
        let gain = self.covariance * inverse;
        let rest = Matrix3::identity() - gain;
        let covariance =
            rest * self.covariance * rest.transpose() + gain * observed.covariance * gain.transpose();
        let covariance = (covariance + covariance.transpose()) * 0.5;
        Some(Self { mean: self.mean + gain * (observed.mean - self.mean), covariance })
    }

    /// Fuses two estimates of one position of which it is not known how much they have in common, such as one that another agent
    /// has fused: covariance intersection, with the weight for which the trace of the covariance is least. The result claims no
    /// more than is certain, whatever both have in common.
    ///
    /// # Source
    /// Julier, Uhlmann 1997, "A non-divergent estimation algorithm in the presence of unknown correlations", eqs. (4) and (5).
    pub fn intersect(&self, other: &Self) -> Option<Self> {
        let (a, b) = (Cholesky::new(self.covariance)?.inverse(), Cholesky::new(other.covariance)?.inverse());
        let weighted = |w: f64| Some(Cholesky::new(a * w + b * (1.0 - w))?.inverse());
        let trace = |w: f64| weighted(w).map_or(f64::INFINITY, |covariance| covariance.trace());
        // The trace is convex in the weight: golden section.
        let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
            match trace(left) <= trace(right) {
                true => high = right,
                false => low = left,
            }
        }
        let middle = 0.5 * (low + high);
        let best = [0.0, middle, 1.0].into_iter().min_by(|x, y| trace(*x).total_cmp(&trace(*y)))?;
        let covariance = weighted(best)?;
        let mean = covariance * (a * best * self.mean + b * (1.0 - best) * other.mean);
        Some(Self { mean, covariance: (covariance + covariance.transpose()) * 0.5 })
    }
}

/// The confidence after a look that did not find it where it should have been seen, with the probability of finding what is
/// there: Bayes' rule.
pub fn fuse_absence(before: f64, detection: f64) -> f64 {
    let missed = before * (1.0 - detection);
    (missed / (missed + 1.0 - before)).clamp(0.0, 1.0)
}

/// The confidence after one more independent observation; all are 0 to 1. It grows to 0.999 at most, unless one of
/// the two is higher already.
pub fn fuse_confidence(before: f64, observed: f64) -> f64 {
    (1.0 - (1.0 - before) * (1.0 - observed)).min(before.max(observed).max(0.999)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn equal_estimates_are_averaged_and_twice_as_sure() {
        let at = |x: f64| Gaussian::new(Vector3::new(x, 0.0, 0.0), Matrix3::identity() * 4e-4).unwrap();
        let fused = at(0.1).fuse(&at(0.3)).unwrap();
        assert!((fused.mean().x - 0.2).abs() < 1e-12);
        assert!((fused.covariance() - Matrix3::identity() * 2e-4).amax() < 1e-15);
        assert!((at(0.1).distance_squared(&at(0.3)).unwrap() - 0.04 / 8e-4).abs() < 1e-9);
    }

    proptest! {
        /// Compared with the information form: inverse covariances add.
        #[test]
        fn fusion_adds_information(a in proptest::array::uniform6(-1.0..1.0), b in proptest::array::uniform6(-1.0..1.0)) {
            let gaussian = |n: [f64; 6]| {
                let root = Matrix3::new(n[0], 0.0, 0.0, n[1], n[2], 0.0, n[3], n[4], n[5]);
                let covariance = root * root.transpose() + Matrix3::identity() * 0.1;
                Gaussian::new(Vector3::new(n[0], n[3], n[5]), covariance).unwrap()
            };
            let (a, b) = (gaussian(a), gaussian(b));
            let fused = a.fuse(&b).unwrap();
            let inverse = |g: &Gaussian| g.covariance().try_inverse().unwrap();
            let expected = (inverse(&a) + inverse(&b)).try_inverse().unwrap();
            let mean = expected * (inverse(&a) * a.mean() + inverse(&b) * b.mean());
            prop_assert!((fused.covariance() - expected).amax() < 1e-9);
            prop_assert!((fused.mean() - mean).amax() < 1e-9);
        }
    }

    proptest! {
        /// Whatever two estimates have in common, what covariance intersection claims is not too sure: the real covariance of its
        /// result is less in every direction.
        #[test]
        fn intersection_is_never_too_sure(
            a in proptest::array::uniform3(0.01..1.0), b in proptest::array::uniform3(0.01..1.0), common in -1.0..1.0,
        ) {
            let diagonal = |n: [f64; 3]| Matrix3::from_diagonal(&Vector3::from(n));
            let (pa, pb) = (diagonal(a), diagonal(b));
            let one = Gaussian::new(Vector3::zeros(), pa).unwrap();
            let two = Gaussian::new(Vector3::new(0.1, 0.0, -0.1), pb).unwrap();
            let fused = one.intersect(&two).unwrap();
            // The gains follow from the weight, which follows from the result: P = (w A + (1 - w) B)^-1.
            let information = fused.covariance().try_inverse().unwrap();
            let (ia, ib) = (pa.try_inverse().unwrap(), pb.try_inverse().unwrap());
            let w = (information[(0, 0)] - ib[(0, 0)]) / (ia[(0, 0)] - ib[(0, 0)]);
            prop_assume!(w.is_finite() && (ia[(0, 0)] - ib[(0, 0)]).abs() > 1e-3);
            let (ka, kb) = (fused.covariance() * ia * w, fused.covariance() * ib * (1.0 - w));
            let cross = diagonal(std::array::from_fn(|i| common * (a[i] * b[i]).sqrt()));
            let real = ka * pa * ka.transpose() + kb * pb * kb.transpose() + ka * cross * kb.transpose() + kb * cross * ka.transpose();
            let slack = fused.covariance() - real + Matrix3::identity() * 1e-9;
            prop_assert!(Cholesky::new(slack).is_some(), "{slack}");
            prop_assert!(fused.covariance().trace() <= pa.trace().min(pb.trace()) + 1e-9);
        }
    }

    #[test]
    fn the_same_estimate_twice_is_no_surer() {
        let one = Gaussian::new(Vector3::new(0.1, 0.2, 0.3), Matrix3::identity() * 4e-4).unwrap();
        let both = one.intersect(&one).unwrap();
        assert!(
            (both.mean() - one.mean()).amax() < 1e-12
                && (both.covariance() - one.covariance()).amax() < 1e-12
        );
        let sure = Gaussian::new(Vector3::zeros(), Matrix3::identity() * 1e-6).unwrap();
        assert!((one.intersect(&sure).unwrap().covariance() - sure.covariance()).amax() < 1e-9);
    }

    #[test]
    fn what_is_missed_again_and_again_is_soon_doubted() {
        let after = |times: usize| (0..times).fold(0.999, |confidence, _| fuse_absence(confidence, 0.7));
        assert!(after(3) > 0.9 && after(10) < 0.02, "{} {}", after(3), after(10));
        assert_eq!((fuse_absence(0.0, 0.7), fuse_absence(1.0, 0.7)), (0.0, 1.0));
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let zero = Vector3::zeros();
        for bad in [Matrix3::zeros(), -Matrix3::identity(), Matrix3::identity() * f64::NAN] {
            assert_eq!(Gaussian::new(zero, bad), None);
        }
        assert_eq!(Gaussian::new(Vector3::repeat(f64::INFINITY), Matrix3::identity()), None);
    }
}
