//! A discrete movement that becomes periodic, in one primitive (Gams et al. 2015, II and Fig. 7): replayed as
//! demonstrated, and at another frequency with the original and the modified canonical system, before and after an
//! adaptation.

use std::f64::consts::{PI, TAU};

use armarium_motion::{
    CanonicalRule, CanonicalSystem, DiscretePeriodicConfig, DiscretePeriodicDmp, LearningControl,
    LearningControlConfig, TimeSample, rise,
};
use armarium_viewer::report::{Curve, Look, PanelRow, picture};

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::settings::{ExperimentSettings as _, settings};

settings! {
    /// Settings of the demonstration and of its replays.
    Dpdmp {
        /// Frequency Omega of the demonstration, rad/s.
        omega: f64 = 4.0 * PI, 0.01..=1000.0;
        /// Frequency of the second replay, rad/s.
        omega_new: f64 = 2.0 * PI, 0.01..=1000.0;
        /// Duration T of the discrete part, s.
        duration: f64 = 1.0, 0.01..=100.0;
        /// Periods after the discrete part.
        periods: f64 = 4.0, 0.5..=100.0;
        /// Step, s.
        dt: f64 = 0.001, 1e-5..=0.1;
        /// Centre c of y = c + A sin phi + B cos 2 phi, one value per degree of freedom.
        center: [f64; 2] = [1.0, -0.5], -1e6..=1e6;
        /// A.
        a: [f64; 2] = [0.3, 0.2], -1e6..=1e6;
        /// B.
        b: [f64; 2] = [0.1, -0.08], -1e6..=1e6;
        /// Constant of (1).
        alpha_z: f64 = 48.0;
        /// Constant of (1).
        beta_z: f64 = 12.0;
        /// Periodic kernels N.
        n: usize = 25;
        /// Discrete kernels M.
        m: usize = 25;
        /// Ridge of the regression.
        ridge: f64 = 1e-8;
        /// Constant of (4).
        eta: f64 = 6.0;
        /// Constant of (4).
        alpha: f64 = 1.0 / 6.0;
        /// Constant of (4).
        beta: f64 = 0.001;
        /// Radius of the limit cycle.
        mu: f64 = 1.0;
        /// Radius at which the discrete part ends.
        mu1: f64 = 1.2;
        /// Radius at which the transition begins.
        mu2: f64 = 1.4;
        /// Centre of the adapted motion.
        adapted_center: [f64; 2] = [1.1, -0.45], -1e6..=1e6;
        /// A of the adapted motion; B is unchanged.
        adapted_a: [f64; 2] = [0.4, 0.12], -1e6..=1e6;
        /// Epochs of the adaptation (11).
        epochs: u32 = 20, 1.0..=1000.0;
        /// Control per unit of error, 1/s; multiplied by L and C.
        gain: f64 = 150.0, -1e6..=1e6;
        /// L of (11).
        l: f64 = 0.3;
        /// C of (11).
        c: f64 = 0.3;
    }
}

/// Fifth-order polynomials from rest at 0 to the periodic part, then the periodic part.
struct Demonstration {
    omega: f64,
    duration: f64,
    center: [f64; 2],
    a: [f64; 2],
    b: [f64; 2],
}

impl Demonstration {
    /// Position, velocity and acceleration of degree of freedom `d` in the periodic part, `t` s after its start.
    fn periodic(&self, d: usize, t: f64) -> [f64; 3] {
        let (w, p) = (self.omega, self.omega * t);
        let (a, b) = (self.a[d], self.b[d]);
        [
            self.center[d] + a * libm::sin(p) + b * libm::cos(2.0 * p),
            w * (a * libm::cos(p) - 2.0 * b * libm::sin(2.0 * p)),
            -w * w * (a * libm::sin(p) + 4.0 * b * libm::cos(2.0 * p)),
        ]
    }

    fn at(&self, d: usize, t: f64) -> [f64; 3] {
        if t >= self.duration {
            return self.periodic(d, t - self.duration);
        }
        rise(self.periodic(d, 0.0), self.duration, t.max(0.0))
    }

    fn sample(&self, t: f64) -> TimeSample {
        let both = [self.at(0, t), self.at(1, t)];
        let of = |i: usize| both.iter().map(|v| v[i]).collect();
        TimeSample { t, y: of(0), yd: of(1), ydd: of(2) }
    }
}

/// A replay: actual and reference positions, one entry per step.
struct ReplayedMotion {
    dt: f64,
    y: Vec<[f64; 2]>,
    wanted: Vec<[f64; 2]>,
}

impl ReplayedMotion {
    /// Root mean square error of each degree of freedom, relative to `range`.
    fn error(&self, range: [f64; 2]) -> Vec<f64> {
        let square =
            |d: usize| self.y.iter().zip(&self.wanted).map(|(y, w)| (y[d] - w[d]).powi(2)).sum::<f64>();
        (0..2).map(|d| (square(d) / self.y.len() as f64).sqrt() / range[d]).collect()
    }

    fn curve(&self, of: &[[f64; 2]], d: usize) -> Vec<[f64; 2]> {
        let stride = of.len().div_ceil(2500);
        of.iter().enumerate().step_by(stride).map(|(k, y)| [self.dt * k as f64, y[d]]).collect()
    }
}

impl Experiment for Dpdmp {
    const NAME: &'static str = "dpdmp";
    const ABOUT: &'static str =
        "discrete-periodic primitive at another frequency (Gams et al. 2015, II, Fig. 7)";
    const ALIASES: &'static [(&'static str, &'static str)] =
        &[("periodic_kernels", "n"), ("discrete_kernels", "m")];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let demonstrated = self.shape(self.center, self.a);
        let adapted = self.shape(self.adapted_center, self.adapted_a);
        let mut modified = self.learn(CanonicalRule::Modified, &demonstrated)?;
        let mut original = self.learn(CanonicalRule::Original, &demonstrated)?;
        let range = self.range(&demonstrated);
        let mut outcome = ExperimentResult::default();
        let (phi, r) = modified.initial_phase();
        outcome.figure("phi_init", phi);
        outcome.figure("r_init", r);
        let mut replays = vec![
            ("rmse_replay", self.replay(&mut modified, self.omega, &demonstrated)?),
            ("rmse_modified", self.replay(&mut modified, self.omega_new, &demonstrated)?),
            ("rmse_original", self.replay(&mut original, self.omega_new, &demonstrated)?),
            ("rmse_before_adaptation", self.replay(&mut modified, self.omega, &adapted)?),
        ];
        self.adapt(&mut modified, &adapted)?;
        original.set_control_weights(modified.control_weights())?;
        replays.push(("rmse_adapted", self.replay(&mut modified, self.omega, &adapted)?));
        replays.push(("rmse_adapted_modified", self.replay(&mut modified, self.omega_new, &adapted)?));
        replays.push(("rmse_adapted_original", self.replay(&mut original, self.omega_new, &adapted)?));
        for (name, replay) in &replays {
            outcome.figure(name, replay.error(range));
        }
        let replays: Vec<ReplayedMotion> = replays.into_iter().map(|(_, replay)| replay).collect();
        outcome.plot("dpdmp", plot(&replays));
        Ok(outcome)
    }
}

impl Dpdmp {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        let longest = (self.omega * self.duration + TAU * self.periods) / self.omega.min(self.omega_new);
        within("steps of a replay", longest / self.dt, 10.0, 2e6)
    }

    fn shape(&self, center: [f64; 2], a: [f64; 2]) -> Demonstration {
        Demonstration { omega: self.omega, duration: self.duration, center, a, b: self.b }
    }

    /// Number of steps of the demonstration.
    fn steps(&self) -> usize {
        ((self.duration + TAU * self.periods / self.omega) / self.dt).round() as usize
    }

    fn range(&self, shape: &Demonstration) -> [f64; 2] {
        [0, 1].map(|d| {
            let values = || (0..=self.steps()).map(|k| shape.at(d, self.dt * k as f64)[0]);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        })
    }

    fn learn(
        &self,
        rule: CanonicalRule,
        shape: &Demonstration,
    ) -> Result<DiscretePeriodicDmp, ExperimentError> {
        let canonical = CanonicalSystem {
            eta: self.eta,
            alpha: self.alpha,
            beta: self.beta,
            mu: self.mu,
            mu1: self.mu1,
            mu2: self.mu2,
            rule,
        };
        let config = DiscretePeriodicConfig {
            discrete_kernels: self.m,
            periodic_kernels: self.n,
            alpha_z: self.alpha_z,
            beta_z: self.beta_z,
            ridge: self.ridge,
            canonical,
            ..DiscretePeriodicConfig::with_dofs(2)
        };
        let mut dmp = DiscretePeriodicDmp::new(config, self.omega, self.duration)?;
        let samples: Vec<TimeSample> = (0..=self.steps()).map(|k| shape.sample(self.dt * k as f64)).collect();
        dmp.learn(&samples)?;
        Ok(dmp)
    }

    /// One execution at `omega`, with `shape` stretched in time as its reference.
    fn replay(
        &self,
        dmp: &mut DiscretePeriodicDmp,
        omega: f64,
        shape: &Demonstration,
    ) -> Result<ReplayedMotion, ExperimentError> {
        dmp.restart();
        let steps = (dmp.length(self.periods, omega) / self.dt).round() as usize;
        let mut replay = ReplayedMotion { dt: self.dt, y: Vec::new(), wanted: Vec::new() };
        for k in 0..=steps {
            let t = self.dt * k as f64 * omega / self.omega;
            replay.y.push([dmp.state().y[0], dmp.state().y[1]]);
            replay.wanted.push([shape.at(0, t)[0], shape.at(1, t)[0]]);
            dmp.step(self.dt, omega)?;
        }
        Ok(replay)
    }

    /// Learns the control signal that changes the motion to `shape`.
    fn adapt(&self, dmp: &mut DiscretePeriodicDmp, shape: &Demonstration) -> Result<(), ExperimentError> {
        let steps = self.steps();
        let config = LearningControlConfig { q: 1.0, l: self.l, c: self.c };
        let mut learning = LearningControl::new(config, 2, steps)?;
        for _ in 0..self.epochs {
            dmp.restart();
            for k in 0..steps {
                let t = self.dt * k as f64;
                let error = [0, 1].map(|d| self.gain * (shape.at(d, t)[0] - dmp.state().y[d]));
                learning.step(dmp, self.omega, &error)?;
                dmp.step(self.dt, self.omega)?;
            }
            learning.finish(dmp)?;
        }
        Ok(())
    }
}

/// Rows: original, modified and adapted; columns: the two degrees of freedom. The replays are in the order of the
/// figures.
fn plot(replays: &[ReplayedMotion]) -> String {
    let of_dof = |d: usize, title: &str, shown: &[(usize, &str, u8)]| {
        let mut curves = Vec::new();
        if let Some((last, _, _)) = shown.last() {
            let replay = &replays[*last];
            curves.push(
                Curve::new("wanted, stretched", replay.curve(&replay.wanted, d)).looking(Look::Reference),
            );
        }
        curves.extend(shown.iter().map(|(i, name, colour)| {
            let replay = &replays[*i];
            Curve::new(*name, replay.curve(&replay.y, d)).looking(Look::Colour(*colour))
        }));
        panel("time, s", format!("y{} ({title})", d + 1), curves)
    };
    let row = |title: &str, shown: &[(usize, &str, u8)]| PanelRow {
        height: 270.0,
        panels: vec![of_dof(0, title, shown), of_dof(1, title, shown)],
    };
    picture(
        "A discrete-periodic movement at another frequency",
        &[
            row("original", &[(0, "as shown", 1), (2, "new frequency", 2)]),
            row("modified", &[(0, "as shown", 1), (1, "new frequency", 2)]),
            row("adapted, original", &[(4, "adapted", 1), (6, "new frequency", 2)]),
            row("adapted, modified", &[(4, "adapted", 1), (5, "new frequency", 2)]),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_modified_canonical_system_scales_before_and_after_an_adaptation() {
        let outcome = Dpdmp::default().run().unwrap();
        let worst = |name: &str| {
            let values = outcome.figures[name].as_array().unwrap();
            values.iter().map(|v| v.as_f64().unwrap()).fold(0.0, f64::max)
        };
        // An independent integration with the midpoint rule gives 34.070, 3.43e-4 and 0.313.
        assert!((outcome.figures["r_init"].as_f64().unwrap() / 34.070 - 1.0).abs() < 1e-3);
        assert!((worst("rmse_replay") / 3.43e-4 - 1.0).abs() < 0.05, "{}", worst("rmse_replay"));
        assert!((worst("rmse_original") / 0.3127 - 1.0).abs() < 0.05, "{}", worst("rmse_original"));
        assert!(worst("rmse_modified") < 0.01);
        assert!(worst("rmse_adapted") < 0.01, "{}", worst("rmse_adapted"));
        assert!(worst("rmse_before_adaptation") > 0.04);
        assert!(worst("rmse_adapted_modified") < 0.01 && worst("rmse_adapted_original") > 0.15);
        assert_eq!(outcome.plots.len(), 1);
    }

    #[test]
    fn other_settings_agree_with_the_independent_integration_too() {
        let settings = Dpdmp { omega: 3.0 * PI, omega_new: 5.0, duration: 0.7, ..Dpdmp::default() };
        let outcome = settings.run().unwrap();
        let values = |name: &str| -> Vec<f64> {
            outcome.figures[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
        };
        assert!((outcome.figures["r_init"].as_f64().unwrap() / 10.589_869 - 1.0).abs() < 1e-3);
        for (ours, theirs) in values("rmse_original").iter().zip([0.135_806, 0.070_605]) {
            assert!((ours / theirs - 1.0).abs() < 0.05, "{ours} {theirs}");
        }
        assert!(values("rmse_modified").iter().all(|e| *e < 1e-4));
    }
}
