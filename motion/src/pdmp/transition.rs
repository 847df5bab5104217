//! The linear part of the primitives, which is integrated exactly, and how wide a step of Euler's rule may be.

/// The `alpha_z * omega * dt` from which on Euler's rule on (4), (5) does not decay any more (Jury's criterion on
/// `l^2 - (2 - u) l + 1 - u + u^2 beta / alpha`): 4 where it is critically damped.
pub(super) fn widest_euler_step(alpha: f64, beta: f64) -> f64 {
    let ratio = beta / alpha;
    if 4.0 * ratio < 1.0 { 4.0 / (1.0 + (1.0 - 4.0 * ratio).sqrt()) } else { 1.0 / ratio }
}

/// The exact transition of `(y - rest, z)` over a piece of phase.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Transition {
    yy: f64,
    yz: f64,
    zy: f64,
    zz: f64,
}

impl Transition {
    /// `exp(M advance)` of `M = [[0, 1], [-alpha beta, -alpha]]`, in its three cases.
    pub(crate) fn new(alpha: f64, beta: f64, advance: f64) -> Self {
        let half = 0.5 * alpha;
        let stiffness = alpha * beta;
        let squared = stiffness - half * half;
        // exp(-half a) times cos and sin / rate, written so that nothing overflows for wide steps.
        let (cosine, sine) = if squared > 1e-12 * stiffness {
            let rate = squared.sqrt();
            let decay = (-half * advance).exp();
            (decay * (rate * advance).cos(), decay * (rate * advance).sin() / rate)
        } else if squared < -1e-12 * stiffness {
            let rate = (-squared).sqrt();
            let slow = ((rate - half) * advance).exp();
            let fast = ((-rate - half) * advance).exp();
            (0.5 * (slow + fast), 0.5 * (slow - fast) / rate)
        } else {
            let decay = (-half * advance).exp();
            (decay, decay * advance)
        };
        Self { yy: cosine + half * sine, yz: sine, zy: -stiffness * sine, zz: cosine - half * sine }
    }

    pub(crate) fn apply(&self, y: f64, z: f64) -> (f64, f64) {
        (self.yy * y + self.yz * z, self.zy * y + self.zz * z)
    }
}
