//! The two kernel sets of (5): one around the limit cycle (6), one along the spiral that leads to it (7).

use std::f64::consts::PI;
use std::ops::Range;

use super::CanonicalRule;
use super::DiscretePeriodicConfig;
use super::phase::CanonicalSystem;
use crate::dmp::{Canonical, KernelActivation, TimeScale};
use crate::error::{MotionError, finite};
use crate::periodic::PhaseKernels;

/// Both sets, blended by the radius.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BlendedKernels {
    canonical: CanonicalSystem,
    /// Frequency of the demonstration, rad/s.
    omega: f64,
    periodic: PhaseKernels,
    /// Centres q of (7) in the phase plane, and their widths h.
    spiral: Vec<([f64; 2], f64)>,
    pub(super) start_radius: f64,
}

impl BlendedKernels {
    /// For a demonstration of `omega` rad/s with a discrete part of `turn` rad.
    pub(super) fn new(config: &DiscretePeriodicConfig, omega: f64, turn: f64) -> Result<Self, MotionError> {
        let n = config.periodic_kernels;
        let width = config.periodic_width.unwrap_or(1.25 * n as f64);
        let phases = config.canonical.spiral(turn, config.discrete_kernels)?;
        let centres: Vec<[f64; 2]> =
            phases.iter().map(|(phi, r)| [r * libm::cos(*phi), r * libm::sin(*phi)]).collect();
        let mut widths: Vec<f64> = centres.windows(2).map(|q| 0.5 / distance_squared(q[0], q[1])).collect();
        widths.extend(widths.last().copied());
        finite("kernel widths", &widths)?;
        Ok(Self {
            canonical: config.canonical.clone(),
            omega,
            periodic: PhaseKernels::new(n, width),
            start_radius: phases.first().map_or(config.canonical.mu1, |(_, r)| *r),
            spiral: centres.into_iter().zip(widths).collect(),
        })
    }

    /// Writes the kernel values at a phase, divided by their sum, to `out`: first the periodic, then the discrete
    /// ones. Returns the range of those that are not 0; the others are not written. Does not allocate.
    fn evaluate(&self, phase: f64, radius: f64, out: &mut [f64]) -> Range<usize> {
        let n = self.periodic.len();
        let (b, a) = self.canonical.blend(radius);
        let (periodic, discrete) = out.split_at_mut(n);
        let mut sum = 0.0;
        if b > 0.0 {
            // The first centre is at pi / N and not at 0.
            sum += b * self.periodic.evaluate(phase - PI / n as f64, periodic);
            periodic.iter_mut().for_each(|p| *p *= b);
        }
        let mut near = 0..0;
        if a > 0.0 {
            sum += self.along_spiral(phase, radius, a, b <= 0.0, discrete);
            let first = discrete.iter().position(|p| *p > 0.0).unwrap_or(0);
            near = first..discrete.iter().rposition(|p| *p > 0.0).map_or(first, |last| last + 1);
        }
        let used = if b > 0.0 { 0 } else { n + near.start }..n + near.end;
        out[used.clone()].iter_mut().for_each(|p| *p /= sum);
        used
    }

    /// Writes (7) times `a`. If the discrete set is used `alone`, its values are relative to the largest one, so
    /// that their sum is never 0, however far the phase is from every centre.
    fn along_spiral(&self, phase: f64, radius: f64, a: f64, alone: bool, out: &mut [f64]) -> f64 {
        let (sin, cos) = libm::sincos(phase);
        let here = [radius * cos, radius * sin];
        let mut nearest = f64::INFINITY;
        for (o, (q, h)) in out.iter_mut().zip(&self.spiral) {
            *o = h * distance_squared(here, *q);
            nearest = nearest.min(*o);
        }
        let offset = if alone { nearest } else { 0.0 };
        let mut sum = 0.0;
        for o in out.iter_mut() {
            let exponent = *o - offset;
            // Beyond this, a value is below the rounding error of the largest.
            *o = if exponent > 60.0 { 0.0 } else { a * libm::exp(-exponent) };
            sum += *o;
        }
        sum
    }
}

/// The canonical system (3), (4): a phase that spirals onto a circle.
impl Canonical for BlendedKernels {
    /// The phase angle phi, rad, and the radius r.
    type Phase = (f64, f64);

    fn kernels(&self) -> usize {
        self.periodic.len() + self.spiral.len()
    }

    fn advance(
        &self,
        (phase, radius): (f64, f64),
        dt: f64,
        scale: TimeScale,
    ) -> Result<(f64, f64), MotionError> {
        let advance = scale.advance(dt);
        let turned = match self.canonical.rule {
            CanonicalRule::Modified => advance,
            CanonicalRule::Original => self.omega * dt,
        };
        let radius = self.canonical.advance(radius, turned);
        let phase = phase + advance;
        finite("phase", &[phase, radius])?;
        Ok((phase, radius))
    }

    /// The values are normalised already: far from every kernel their plain sum would be 0.
    fn activate(&self, (phase, radius): (f64, f64), psi: &mut [f64]) -> KernelActivation {
        KernelActivation { used: self.evaluate(phase, radius, psi), sum: 1.0, gate: 1.0 }
    }
}

fn distance_squared(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
