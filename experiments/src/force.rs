//! Force adaptation after Gams et al. 2014 (T-RO): a wiping motion over a tilted table with a bump learns the height
//! that keeps the contact force, accurately enough to keep it without feedback.

use std::f64::consts::TAU;

use armarium_motion::{SurfaceAdaptation, SurfaceConfig};
use armarium_values::random::StandardNormal;
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use rand::SeedableRng as _;
use rand::distr::Distribution as _;
use rand_chacha::ChaCha8Rng;

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::settings::{ExperimentSettings as _, settings};

settings! {
    /// Settings of the adaptation.
    Force {
        /// Stiffness of the contact, N/m.
        stiffness: f64 = 2000.0, 10.0..=1e6;
        /// Desired force, N.
        force: f64 = 10.0, 0.01..=1000.0;
        /// Cycles of adaptation.
        cycles: u32 = 16, 1.0..=500.0;
        /// Cycles without feedback that follow.
        off_cycles: u32 = 4, 1.0..=500.0;
        /// Amplitudes of the wiping in x and y, m; y has twice the frequency.
        amplitude: [f64; 2] = [0.15, 0.1], -10.0..=10.0;
        /// Phase lead of y, rad.
        phase: f64 = 0.3, -1e3..=1e3;
        /// Slope of the table in x and y.
        tilt: [f64; 2] = [0.02, -0.03], -10.0..=10.0;
        /// Height of its bump, m.
        bump: f64 = 0.01, -1.0..=1.0;
        /// Position of the bump, m.
        bump_at: [f64; 2] = [0.1, 0.05], -1e3..=1e3;
        /// Its shape is exp(-(squared distance) / this), m^2.
        bump_width: f64 = 0.005, 1e-9..=1e9;
        /// Frequency of the wiping, Hz.
        frequency: f64 = 0.5;
        /// Standard deviation of the measured force, N.
        noise: f64 = 0.2, 0.0..=100.0;
        /// Height above the table at the start, m.
        start_height: f64 = 0.02, -0.05..=0.05;
        /// Step, s.
        dt: f64 = 0.005, 1e-4..=0.05;
        /// Kernels over the phase.
        kernels: usize = 36;
        /// Initial estimate of the stiffness, N/m; it is then identified.
        stiffness_guess: f64 = 4000.0, 10.0..=1e6;
        /// Bandwidth of the feedback, rad/s.
        bandwidth: f64 = 7.0;
        /// Largest speed of the height, m/s; the hand approaches with 0.3 of it.
        max_speed: f64 = 0.12;
        /// Share of the remaining error that each cycle adds to the learned height.
        learning: f64 = 0.7;
        /// Delay from a command to its force, s; none for one step, as in this simulation.
        delay: Option<f64> = None;
        /// Seed of the noise.
        seed: u64 = 1;
    }
}

/// The log, one entry per step.
#[derive(Default)]
struct ForceLog {
    /// The force without noise, N.
    force: Vec<f64>,
    height: Vec<f64>,
}

impl Experiment for Force {
    const NAME: &'static str = "force";
    const ABOUT: &'static str = "wiping over an unknown table learns to keep a force (Gams et al. 2014)";

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let (log, stiffness) = self.wipe()?;
        let (rms, off) = self.rms(&log);
        let mut outcome = ExperimentResult::default();
        outcome.figure("rms_n", rms.clone());
        outcome.figure("rms_off_n", off);
        outcome.figure("stiffness_found_n_m", stiffness);
        outcome.plot("force", self.plot(&log, &rms));
        Ok(outcome)
    }
}

impl Force {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("frequency", self.frequency, 0.01, 0.02 / self.dt)
    }

    /// Height of the table below the wiping motion at a phase, m.
    fn table_height(&self, phase: f64) -> f64 {
        let x = self.amplitude[0] * libm::sin(phase);
        let y = self.amplitude[1] * libm::sin(2.0 * phase + self.phase);
        let from_bump = (x - self.bump_at[0]).powi(2) + (y - self.bump_at[1]).powi(2);
        self.tilt[0] * x + self.tilt[1] * y + self.bump * libm::exp(-from_bump / self.bump_width)
    }

    fn period(&self) -> usize {
        (1.0 / (self.frequency * self.dt)).round() as usize
    }

    fn config(&self) -> SurfaceConfig {
        SurfaceConfig {
            force: self.force,
            kernels: self.kernels,
            stiffness: self.stiffness_guess,
            bandwidth: self.bandwidth,
            learning: self.learning,
            max_speed: self.max_speed,
            delay: self.delay.unwrap_or(self.dt),
            ..SurfaceConfig::default()
        }
    }

    fn wipe(&self) -> Result<(ForceLog, f64), ExperimentError> {
        let mut adaptation = SurfaceAdaptation::new(self.config())?;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let (period, omega) = (self.period(), TAU * self.frequency);
        let base = self.table_height(0.0) + self.start_height;
        let mut log = ForceLog::default();
        let mut height = base;
        for k in 0..(self.cycles + self.off_cycles) as usize * period {
            if k == self.cycles as usize * period {
                adaptation.set_feedback(false);
                adaptation.set_learning(false);
            }
            let phase = omega * self.dt * k as f64;
            let force = (self.stiffness * (self.table_height(phase) - height)).max(0.0);
            log.force.push(force);
            log.height.push(height);
            let noise: f64 = StandardNormal.sample(&mut rng);
            let command = adaptation.step(self.dt, phase, omega, force + self.noise * noise)?;
            height = base + command.offset;
        }
        Ok((log, adaptation.stiffness()))
    }

    /// Root mean square error of the force in each cycle, and over the cycles without feedback, N.
    fn rms(&self, log: &ForceLog) -> (Vec<f64>, f64) {
        let rms = |forces: &[f64]| {
            (forces.iter().map(|f| (f - self.force).powi(2)).sum::<f64>() / forces.len() as f64).sqrt()
        };
        let off = &log.force[self.cycles as usize * self.period()..];
        (log.force.chunks(self.period()).map(rms).collect(), rms(off))
    }

    fn plot(&self, log: &ForceLog, rms: &[f64]) -> String {
        let time = |k: usize| self.dt * k as f64;
        let off = (self.dt * (self.cycles as usize * self.period()) as f64, "feedback off".to_owned());
        let over_time = |values: &[f64]| values.iter().enumerate().map(|(k, v)| [time(k), *v]).collect();
        let surface: Vec<f64> =
            (0..log.height.len()).map(|k| self.table_height(TAU * self.frequency * time(k)) * 1e3).collect();
        let height: Vec<f64> = log.height.iter().map(|h| h * 1e3).collect();
        let force = Panel {
            marks: vec![off.clone()],
            ..panel("time, s", "force, N", vec![Curve::new("", over_time(&log.force))])
        };
        let heights = Panel {
            marks: vec![off],
            ..panel(
                "time, s",
                "height, mm",
                vec![
                    Curve::new("table under the hand", over_time(&surface)).looking(Look::Reference),
                    Curve::new("hand", over_time(&height)).looking(Look::Colour(1)),
                ],
            )
        };
        let cycles = Panel {
            marks: vec![(f64::from(self.cycles) + 0.5, "feedback off".into())],
            ..panel(
                "cycle",
                "log10 of the RMS force error, N",
                vec![Curve::new(
                    "",
                    rms.iter().zip(1..).map(|(r, n)| [f64::from(n), libm::log10(*r)]).collect(),
                )],
            )
        };
        let row = |panel| PanelRow { height: 260.0, panels: vec![panel] };
        picture("Force over an unknown table", &[row(force), row(heights), row(cycles)])
    }
}
