//! The simulated experiment of Petrič et al. 2014, section III: a planar arm moves on a circle, and a coaching
//! point changes its path (Figs 2 and 3) or follows the end effector (Fig. 4).

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use armarium_motion::{Integrator, PeriodicDmp, PeriodicDmpConfig, PotentialField, joint_coupling};
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::phase::{mean, over_period};
use super::planar::{PlanarArm, Redundancy};
use super::settings::{ExperimentSettings as _, Setting, settings};

/// The direction of motion on the circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Direction {
    /// Counterclockwise.
    Ccw,
    /// Clockwise.
    Cw,
}

impl Setting for Direction {}

settings! {
    /// Settings; lengths in m, angles in rad, times in s.
    Coaching {
        /// Coaching point, m; with `follow` only the place where the displacement is measured.
        o: [f64; 2] = [1.8, -0.6], -1e3..=1e3;
        /// Coaching direction, any length.
        d: [f64; 2] = [0.0, 1.0];
        /// Scale of the coupling (14).
        gamma: f64 = 100.0, -1e6..=1e6;
        /// Steepness of the field's edge (16), 1/m.
        eta: f64 = 20.0, 0.0..=1e6;
        /// Reach of the field (16), m.
        rm: f64 = 0.35;
        /// Decay of the field with the angle (14), 1/rad; the sign is ignored.
        beta: f64 = -8.0 / PI;
        /// The coaching point trails the end effector and pushes towards the circle's centre (Fig. 4).
        follow: bool = false;
        /// Its distance behind the end effector, m; negative leads.
        trail: f64 = 0.2;
        /// Direction of motion: ccw or cw.
        direction: Direction = Direction::Ccw;
        /// Centre of the demonstrated circle, m.
        center: [f64; 2] = [1.8, 0.2], -1e3..=1e3;
        /// Radius of the demonstrated circle, m.
        radius: f64 = 0.7, 1e-3..=100.0;
        /// Its frequency, Hz.
        frequency: f64 = 0.5;
        /// Lengths of the links, m.
        links: [f64; 3] = [1.0; 3], 1e-3..=100.0;
        /// World angle of the last link, rad.
        psi: f64 = FRAC_PI_4, -1e3..=1e3;
        /// Posture near which the inverse kinematics stays instead, three angles, rad.
        posture: Option<[f64; 3]> = None;
        /// Kernels N of the primitive.
        kernels: usize = 25;
        /// Kernel width h; none for 2.5 N.
        h: Option<f64> = None;
        /// Constant of (4).
        alpha_z: f64 = 8.0;
        /// Constant of (4).
        beta_z: f64 = 2.0;
        /// Forgetting factor of (9) per 10 ms.
        lambda: f64 = 0.9995;
        /// P(0) of (9).
        p0: f64 = 1.0;
        /// w(0) of (10), for all weights.
        w0: f64 = 0.0, -1e6..=1e6;
        /// Step, s.
        dt: f64 = 0.01, 1e-4..=0.1;
        /// Learning cycles before the run.
        cycles: u32 = 40, 1.0..=1000.0;
        /// Length of the run, s.
        seconds: f64 = 60.0;
        /// Start of the coaching, s.
        start: f64 = 5.0;
        /// Distance from o beyond which the path is on the far side, m.
        far: f64 = 0.8;
    }
}

/// The log of a run, one entry per step.
struct CoachingLog {
    q: Vec<Vector3<f64>>,
    x: Vec<Vector2<f64>>,
    /// |C_y| of (14).
    coupling: Vec<f64>,
}

impl Experiment for Coaching {
    const NAME: &'static str = "coaching";
    const ABOUT: &'static str = "planar arm on a circle, coached at a point (Petric et al. 2014, Figs 2-4)";
    const ALIASES: &'static [(&'static str, &'static str)] =
        &[("width", "h"), ("forgetting", "lambda"), ("initial_gain", "p0")];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let mut dmp = self.learn()?;
        let log = self.execute(&mut dmp)?;
        let mut outcome = self.figures(&log);
        outcome.plot("coaching", self.plot(&log));
        Ok(outcome)
    }
}

impl Coaching {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("frequency", self.frequency, 0.01, 0.125 / self.dt)?;
        within("start", self.start, 1.0 / self.frequency, 600.0)?;
        within("seconds", self.seconds, self.start + 1.0 / self.frequency, 3600.0)?;
        within("d", libm::hypot(self.d[0], self.d[1]), 1e-9, 1e9)
    }

    fn omega(&self) -> f64 {
        TAU * self.frequency
    }

    /// Steps per period, rounded.
    fn period(&self) -> usize {
        (1.0 / (self.frequency * self.dt)).round() as usize
    }

    fn arm(&self) -> PlanarArm {
        PlanarArm { links: self.links }
    }

    /// Joint angles of the demonstration at a phase, rad.
    fn demonstrated(&self, phase: f64) -> Result<Vector3<f64>, ExperimentError> {
        let sense = if self.direction == Direction::Ccw { 1.0 } else { -1.0 };
        let point = self.centre() + self.radius * Vector2::new(libm::cos(phase), sense * libm::sin(phase));
        let redundancy =
            self.posture.map_or(Redundancy::LastLink(self.psi), |p| Redundancy::NearestTo(Vector3::from(p)));
        self.arm().inverse(point, redundancy).ok_or_else(|| {
            ExperimentError::Failed(format!("the arm does not reach ({:.3}, {:.3}) m", point.x, point.y))
        })
    }

    fn centre(&self) -> Vector2<f64> {
        Vector2::from(self.center)
    }

    /// The primitive after `cycles` periods of the demonstration, at its start phase.
    fn learn(&self) -> Result<PeriodicDmp, ExperimentError> {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig {
            kernels: self.kernels,
            width: self.h,
            alpha_z: self.alpha_z,
            beta_z: self.beta_z,
            forgetting: self.lambda,
            initial_gain: self.p0,
            integrator: Integrator::Euler,
            ..PeriodicDmpConfig::with_dofs(3)
        })?;
        let omega = self.omega();
        let samples = self.demonstration()?;
        let mean = samples.iter().map(|s| s[0]).sum::<Vector3<f64>>() / samples.len() as f64;
        dmp.set_centre(mean.as_slice())?;
        dmp.set_weights(&vec![self.w0; dmp.weights().len()])?;
        for k in 0..self.cycles as usize * self.period() {
            let [y, yd, ydd] = &samples[k % samples.len()];
            let phase = omega * self.dt * k as f64;
            dmp.learn(phase, omega, self.dt, y.as_slice(), yd.as_slice(), ydd.as_slice())?;
        }
        dmp.reset(0.0, samples[0][0].as_slice(), samples[0][1].as_slice(), omega)?;
        Ok(dmp)
    }

    /// Position, velocity and acceleration of the joints at each step: of one period, or of all periods when a period
    /// is not a whole number of steps.
    fn demonstration(&self) -> Result<Vec<[Vector3<f64>; 3]>, ExperimentError> {
        let (omega, h) = (self.omega(), 1e-3);
        let sample = |k: usize| -> Result<[Vector3<f64>; 3], ExperimentError> {
            let phase = omega * self.dt * k as f64;
            let [before, here, after] =
                [self.demonstrated(phase - h)?, self.demonstrated(phase)?, self.demonstrated(phase + h)?];
            let slope = nearest_turn(after - before) / (2.0 * h) * omega;
            let bend = (nearest_turn(after - here) - nearest_turn(here - before)) / (h * h) * omega * omega;
            Ok([here, slope, bend])
        };
        let steps = 1.0 / (self.frequency * self.dt);
        let whole = (steps - steps.round()).abs() < 1e-9 * steps;
        let count = if whole { self.period() } else { self.cycles as usize * self.period() };
        let mut samples = (0..count).map(sample).collect::<Result<Vec<_>, _>>()?;
        for k in 1..count {
            let last = samples[k - 1][0];
            samples[k][0] = last + nearest_turn(samples[k][0] - last);
        }
        Ok(samples)
    }

    fn execute(&self, dmp: &mut PeriodicDmp) -> Result<CoachingLog, ExperimentError> {
        let steps = (self.seconds / self.dt).round() as usize;
        let begin = self.first_coached();
        let mut log = CoachingLog { q: Vec::new(), x: Vec::new(), coupling: Vec::new() };
        let mut coupling = [0.0; 3];
        for k in 0..steps {
            let q = Vector3::from_column_slice(dmp.state().y);
            let j = self.arm().jacobian(&q);
            let (x, v) = (self.arm().end(&q), j * Vector3::from_column_slice(dmp.state().yd));
            let mut strength = 0.0;
            if k >= begin {
                let (o, d) = self.command(x, v);
                strength = self.field().strength(o.as_slice(), x.as_slice(), v.as_slice());
                let columns = [0, 1, 2].map(|i| j.column(i).into_owned());
                joint_coupling(&columns, &(strength * d), 0.0, &mut coupling)?;
                dmp.couple(&coupling)?;
            }
            log.q.push(q);
            log.x.push(x);
            log.coupling.push(strength.abs());
            dmp.step(self.dt, self.omega())?;
        }
        Ok(log)
    }

    fn first_coached(&self) -> usize {
        (self.start / self.dt).round() as usize
    }

    fn field(&self) -> PotentialField {
        PotentialField { gamma: self.gamma, eta: self.eta, r_m: self.rm, beta: self.beta }
    }

    /// Coaching point and unit direction for the end effector at `x`, m, with velocity `v`, m/s.
    fn command(&self, x: Vector2<f64>, v: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>) {
        if self.follow {
            let back = v.try_normalize(1e-12).unwrap_or_else(Vector2::zeros);
            let inwards = (self.centre() - x).try_normalize(1e-12).unwrap_or_else(Vector2::zeros);
            return (x - self.trail * back, inwards);
        }
        (Vector2::from(self.o), Vector2::from(self.d).normalize())
    }

    fn over_period<const N: usize>(
        &self,
        log: &[nalgebra::SVector<f64, N>],
        end: f64,
    ) -> Vec<nalgebra::SVector<f64, N>> {
        over_period(log, end, 1.0 / (self.frequency * self.dt))
    }

    /// The last steps of the compared periods: before the coaching, and at the end of the run.
    fn compared(&self) -> [f64; 2] {
        [self.first_coached() as f64, (self.seconds / self.dt).round()]
    }

    fn figures(&self, log: &CoachingLog) -> ExperimentResult {
        let [before, after] = self.compared();
        let (x, y) = (self.over_period(&log.x, before), self.over_period(&log.x, after));
        let (p, q) = (self.over_period(&log.q, before), self.over_period(&log.q, after));
        let o = Vector2::from(self.o);
        let mut outcome = ExperimentResult::default();
        let moved: Vec<f64> = x.iter().zip(&y).map(|(a, b)| (b - a).norm()).collect();
        let distance: Vec<f64> = x.iter().map(|a| (a - o).norm()).collect();
        let count = moved.len();
        let nearest = (0..count).min_by(|a, b| distance[*a].total_cmp(&distance[*b])).unwrap_or(0);
        let far: Vec<f64> = (0..count).filter(|k| distance[*k] > self.far).map(|k| moved[k]).collect();
        outcome.figure("displacement_at_o_m", moved[nearest]);
        outcome.figure("far_side_rms_m", mean(far.iter().map(|m| m * m)).sqrt());
        outcome.figure("opposite_phase_m", moved[(nearest + count / 2) % count]);
        let begin = self.first_coached();
        let last = log.coupling.len() - count;
        outcome.figure("coupling_mean_first", mean(log.coupling[begin..].iter().take(count).copied()));
        outcome.figure("coupling_mean_last", mean(log.coupling[last..].iter().copied()));
        outcome.figure("joint_amplitude_before", half_ranges(&p));
        outcome.figure("joint_amplitude_after", half_ranges(&q));
        let radius = |path: &[Vector2<f64>]| mean(path.iter().map(|a| (a - self.centre()).norm()));
        outcome.figure("radius_before_m", radius(&x));
        outcome.figure("radius_after_m", radius(&y));
        outcome
    }

    /// Plots as in the paper's figures: the path in selected periods, the coupling, and the joints over time.
    fn plot(&self, log: &CoachingLog) -> String {
        let [before, after] = self.compared();
        let closed = |end: f64| -> Vec<[f64; 2]> {
            let mut points: Vec<[f64; 2]> =
                self.over_period(&log.x, end).into_iter().map(Into::into).collect();
            points.extend(points.first().copied());
            points
        };
        let period = 1.0 / (self.frequency * self.dt);
        let pass = |i: u32| {
            let steps = [i, i + 1].map(|i| (before + period * f64::from(i)) as usize);
            let path = log.x.get(steps[0]..=steps[1])?;
            Some(Curve::new("", path.iter().map(|p| [p.x, p.y]).collect()).looking(Look::Faint))
        };
        let mut paths: Vec<Curve> = (0..).step_by(2).map_while(pass).collect();
        paths.push(Curve::new("before", closed(before)).looking(Look::Colour(5)));
        paths.push(Curve::new("after coaching", closed(after)).looking(Look::Colour(3)));
        if !self.follow {
            paths.push(Curve::new("coaching point", vec![self.o]).looking(Look::Dots(2)));
        }
        let time = |k: usize| self.dt * k as f64;
        let series = |value: &dyn Fn(usize) -> f64| (0..log.q.len()).map(|k| [time(k), value(k)]).collect();
        let over_time = |y_label: &str, points: Vec<[f64; 2]>, colour: u8, mark: &str| Panel {
            marks: vec![(self.start, mark.to_owned())],
            ..panel("time, s", y_label, vec![Curve::new("", points).looking(Look::Colour(colour))])
        };
        let path = Panel { equal_units: true, ..panel("x, m", "y, m", paths) };
        let coupling = over_time("|C_y|", series(&|k| log.coupling[k]), 2, "coaching");
        let joint = |i: usize| {
            let label = format!("q{}, rad", i + 1);
            PanelRow { height: 170.0, panels: vec![over_time(&label, series(&|k| log.q[k][i]), 1, "")] }
        };
        let top = PanelRow { height: 470.0, panels: vec![path, coupling] };
        picture("A circle coached while it runs", &[top, joint(0), joint(1), joint(2)])
    }
}

/// Each angle within half a turn of zero, rad.
fn nearest_turn(difference: Vector3<f64>) -> Vector3<f64> {
    difference.map(|a| a - TAU * (a / TAU).round())
}

fn half_ranges(path: &[Vector3<f64>]) -> Vec<f64> {
    let range = |i: usize| {
        let (low, high) = path
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| (low.min(q[i]), high.max(q[i])));
        0.5 * (high - low)
    };
    (0..3).map(range).collect()
}
