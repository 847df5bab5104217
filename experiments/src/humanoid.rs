//! The robot experiment of Petrič et al. 2014, section IV, on the right arm of ARMAR-III: four times a coach changes a
//! circle with hand gestures, pushing with the right hand and pulling with the left (Figs 6, 7 and 9).
//!
//! The arm moves in the simulator, with its noisy sensors and behind its guard. The referee computes the figures from
//! the hand's true path.

use std::f64::consts::{PI, TAU};

use armarium_motion::{
    CoachingCommand, PeriodicDmp, PeriodicDmpConfig, PhaseSample, PotentialField, joint_coupling,
};
use armarium_simulator::modification::{Compared, ModificationFigures};
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use nalgebra::Vector3;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::humanoid_arm::{DT, HumanoidArm, JOINTS, Joints, largest};
use super::humanoid_coach::{Arms, Modification, Tracker};
use super::phase::{mean, over_period};
use super::settings::{ExperimentSettings as _, settings};

settings! {
    /// Settings of the four modifications; root frame: x right, y forward over the table, z up.
    HumanoidCoaching {
        /// Centre of the circle, m.
        center: [f64; 3] = [0.28, 0.53, 1.2];
        /// Its radius, m.
        radius: f64 = 0.1, 1e-3..=0.3;
        /// Its frequency, Hz.
        frequency: f64 = 0.2, 0.05..=1.0;
        /// Scale of the coupling (14).
        gamma: f64 = 10.0, 0.0..=1e6;
        /// Steepness of the field's edge (16), 1/m.
        eta: f64 = 60.0, 0.0..=1e6;
        /// Reach of the field (16), m.
        rm: f64 = 0.08;
        /// Decay of the field with the angle (14), 1/rad; the sign is ignored.
        beta: f64 = -10.0 / PI;
        /// Distance from the wrist to the coaching point (20), (21), m.
        xi: f64 = 0.1, 0.0..=1.0;
        /// Distance of the coaching point outside of the circle, m.
        gap: f64 = 0.03;
        /// Kernels N of the primitive.
        kernels: usize = 25;
        /// Constant of (4).
        alpha_z: f64 = 8.0;
        /// Constant of (4).
        beta_z: f64 = 2.0;
        /// Forgetting factor of (9) per 10 ms.
        lambda: f64 = 0.9995;
        /// Start of the coaching, s.
        start: f64 = 5.0;
        /// End of the coaching, s.
        stop: f64 = 50.0;
        /// Time at which the motion returns to the original one, s.
        back: f64 = 55.0;
        /// Length of a run, s.
        seconds: f64 = 65.0;
        /// Frame rate of the body tracker, Hz.
        camera_rate: f64 = 30.0, 1.0..=1000.0;
        /// Standard deviation of a tracked wrist or elbow, m per coordinate.
        noise: f64 = 0.005, 0.0..=0.1;
        /// Point pairs of the calibration.
        pairs: usize = 8, 4.0..=1000.0;
        /// Distance from the coaching point beyond which the path is on the far side, m.
        far: f64 = 0.15;
        /// Runs in the simulator; false for ideal joints.
        physics: bool = true;
        /// Seed of the tracker's and the robot's noise.
        seed: u64 = 1;
    }
}

/// Time between entries of the log, s.
const LOG_INTERVAL: f64 = 0.01;

/// The log of a run; lists with one entry per [`LOG_INTERVAL`].
struct ModificationLog {
    modification: Modification,
    o: Vector3<f64>,
    q: Vec<Joints>,
    qd: Vec<Joints>,
    /// The hand's true position, m, and the primitive's desired one.
    x: Vec<Vector3<f64>>,
    wanted: Vec<Vector3<f64>>,
    coupling: Vec<f64>,
    judged: ModificationFigures,
}

impl Experiment for HumanoidCoaching {
    const NAME: &'static str = "humanoid_coaching";
    const ABOUT: &'static str =
        "coach's hands push and pull the arm of ARMAR-III (Petric et al. 2014, Figs 6, 7, 9)";
    const ALIASES: &'static [(&'static str, &'static str)] = &[("forgetting", "lambda")];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let mut arm = HumanoidArm::new()?;
        let mut tracker = self.calibrate()?;
        let logs = Modification::ALL
            .iter()
            .map(|m| self.modify(&mut arm, &mut tracker, *m))
            .collect::<Result<Vec<_>, _>>()?;
        let mut outcome = self.figures(&arm, &tracker, &logs);
        outcome.plot("humanoid_coaching", self.paths_plot(&logs));
        outcome.plot("humanoid_coaching_joints", self.joints_plot(&logs[1]));
        Ok(outcome)
    }
}

impl HumanoidCoaching {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("start", self.start, 1.0 / self.frequency, 600.0)?;
        within("stop", self.stop, self.start + 1.0 / self.frequency, 600.0)?;
        within("back", self.back, self.stop, 600.0)?;
        within("seconds", self.seconds, self.back, 600.0)
    }

    fn centre(&self) -> Vector3<f64> {
        Vector3::from(self.center)
    }

    fn omega(&self) -> f64 {
        TAU * self.frequency
    }

    /// Log entries per period, not a whole number.
    fn period(&self) -> f64 {
        1.0 / (self.frequency * LOG_INTERVAL)
    }

    /// Calibrates the tracker at positions over the table, spread like the corners of a box.
    fn calibrate(&self) -> Result<Tracker, ExperimentError> {
        let corner = |k: usize| {
            let sign = |bit: usize| if (k >> bit) & 1 == 0 { -1.0 } else { 1.0 };
            self.centre() + Vector3::new(0.15 * sign(0), 0.12 * sign(1), 0.1 * sign(2))
        };
        let places: Vec<_> =
            (0..self.pairs).map(|k| corner(if k < 4 { [0, 3, 5, 6][k] } else { k })).collect();
        Tracker::calibrated(&places, self.noise, ChaCha8Rng::seed_from_u64(self.seed))
    }

    /// The learned circle in the plane of a modification.
    fn learn(&self, arm: &mut HumanoidArm, plane: [usize; 2]) -> Result<PeriodicDmp, ExperimentError> {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig {
            kernels: self.kernels,
            alpha_z: self.alpha_z,
            beta_z: self.beta_z,
            forgetting: self.lambda,
            ..PeriodicDmpConfig::with_dofs(JOINTS)
        })?;
        let posture = arm.inverse(self.centre(), &arm.posture())?;
        let count = 360;
        let step = TAU / count as f64;
        let mut angle = |k: usize| {
            let (sin, cos) = libm::sincos(step * k as f64);
            let mut x = self.centre();
            x[plane[0]] += self.radius * cos;
            x[plane[1]] += self.radius * sin;
            arm.inverse(x, &posture)
        };
        let q = (0..count).map(&mut angle).collect::<Result<Vec<_>, _>>()?;
        let sample = |k: usize| {
            let [before, after] = [q[(k + count - 1) % count], q[(k + 1) % count]];
            PhaseSample {
                phase: step * k as f64,
                y: q[k].as_slice().to_vec(),
                dy: ((after - before) / (2.0 * step)).as_slice().to_vec(),
                ddy: ((after - 2.0 * q[k] + before) / (step * step)).as_slice().to_vec(),
            }
        };
        dmp.learn_batch(&(0..count).map(sample).collect::<Vec<_>>())?;
        // Sets the gain as after a long demonstration, so that the coach's effect does not depend on the
        // demonstration's length.
        dmp.settle_gain(DT)?;
        dmp.start_on_path(0.0, self.omega())?;
        Ok(dmp)
    }

    fn modify(
        &self,
        arm: &mut HumanoidArm,
        tracker: &mut Tracker,
        modification: Modification,
    ) -> Result<ModificationLog, ExperimentError> {
        let mut dmp = self.learn(arm, modification.plane())?;
        let original = dmp.weights().to_vec();
        let o = self.centre() + (self.radius + self.gap) * modification.outward();
        let arms = Arms::pointing(modification, o, self.xi);
        let start_q = Joints::from_column_slice(dmp.state().y);
        let mut execution = arm.execution(&start_q, self.physics, self.seed)?;
        let (start, stop, back) = (step_of(self.start), step_of(self.stop), step_of(self.back));
        let image = (1.0 / (self.camera_rate * DT)).round().max(1.0) as usize;
        let mut log = ModificationLog::new(modification, o);
        let mut command = None;
        for k in 0..=step_of(self.seconds) {
            let (q, qd) = execution.joints().unwrap_or((start_q, Joints::zeros()));
            let (x, columns) = arm.at(&q);
            if (k.max(start) - start).is_multiple_of(image) {
                let there = (start..stop).contains(&k);
                command = if there { tracker.command(&arms, &x, self.xi) } else { None };
            }
            if k == back {
                dmp.set_weights(&original)?;
            }
            let strength = self.coach(&mut dmp, command, x, &columns, &qd)?;
            if k.is_multiple_of(step_of(LOG_INTERVAL)) {
                let wanted = arm.at(&Joints::from_column_slice(dmp.state().y)).0;
                log.note(q, qd, wanted, strength);
            }
            let state = dmp.step(DT, self.omega())?;
            execution.drive(arm, state.y, state.yd)?;
        }
        log.x = execution.truth().into_iter().step_by(step_of(LOG_INTERVAL)).collect();
        log.judged = execution.judge(&self.compared(&log));
        Ok(log)
    }

    /// Applies the coach's command to the weights; returns |C_y|.
    fn coach(
        &self,
        dmp: &mut PeriodicDmp,
        command: Option<CoachingCommand>,
        x: Vector3<f64>,
        columns: &[Vector3<f64>],
        qd: &Joints,
    ) -> Result<f64, ExperimentError> {
        let Some(CoachingCommand { o, d }) = command else { return Ok(0.0) };
        let field = PotentialField { gamma: self.gamma, eta: self.eta, r_m: self.rm, beta: self.beta };
        let v: Vector3<f64> = columns.iter().zip(qd.iter()).map(|(c, qd)| c * *qd).sum();
        let strength = field.strength(o.as_slice(), x.as_slice(), v.as_slice());
        let mut coupling = [0.0; JOINTS];
        joint_coupling(columns, &(strength * d), 0.0, &mut coupling)?;
        dmp.couple(&coupling)?;
        Ok(strength)
    }

    /// The periods that the referee compares: before the coaching, and the last one before the motion returns.
    fn compared(&self, log: &ModificationLog) -> Compared {
        Compared {
            period_s: 1.0 / self.frequency,
            before_s: self.start,
            after_s: self.back,
            place: log.o,
            way: log.modification.way(),
            far_m: self.far,
        }
    }

    fn figures(&self, arm: &HumanoidArm, tracker: &Tracker, logs: &[ModificationLog]) -> ExperimentResult {
        let mut outcome = ExperimentResult::default();
        let each = |of: &dyn Fn(&ModificationLog) -> f64| logs.iter().map(of).collect::<Vec<f64>>();
        let names: Vec<_> = logs.iter().map(|log| log.modification.name()).collect();
        outcome.figure("modifications", names);
        outcome.figure("displacement_m", each(&|log| log.judged.displacement_m));
        outcome.figure("far_side_rms_m", each(&|log| log.judged.far_side_rms_m));
        let begin = (self.start / LOG_INTERVAL).round() as usize;
        let end = (self.stop / LOG_INTERVAL).round() as usize;
        let count = self.period().round() as usize;
        let over =
            |log: &ModificationLog, from: usize| mean(log.coupling[from..].iter().take(count).copied());
        outcome.figure("coupling_mean_first", each(&|log| over(log, begin)));
        outcome.figure("coupling_mean_last", each(&|log| over(log, end - count)));
        let settled = (1.0 / LOG_INTERVAL) as usize;
        let lag = |log: &ModificationLog| {
            log.x.iter().zip(&log.wanted).map(|(x, w)| (x - w).norm_squared()).collect()
        };
        let rms = |log: &ModificationLog| -> f64 {
            let squares: Vec<f64> = lag(log);
            mean(squares[settled.min(squares.len())..].iter().copied()).sqrt()
        };
        outcome.figure("tracking_rms_m", each(&rms));
        outcome.figure("joint_speed_rad_s", each(&|log| largest(&log.qd)));
        let margin =
            |log: &ModificationLog| log.q.iter().map(|q| arm.margin(q)).fold(f64::INFINITY, f64::min);
        outcome.figure("joint_margin_rad", each(&margin));
        outcome.figure("calibration_rms_m", tracker.calibration_rms);
        outcome
    }

    /// As Fig. 9: the four modifications, with the intermediate paths.
    fn paths_plot(&self, logs: &[ModificationLog]) -> String {
        let path = |log: &ModificationLog| {
            let axes = log.modification.plane();
            let project = |p: &Vector3<f64>| [p[axes[0]], p[axes[1]]];
            let closed = |end: f64| {
                let path = over_period(&log.x, end / LOG_INTERVAL, self.period());
                path.iter().chain(path.first()).map(project).collect::<Vec<_>>()
            };
            let between = |i: u32| {
                let steps =
                    [i, i + 1].map(|i| (self.start / LOG_INTERVAL + self.period() * f64::from(i)) as usize);
                let path = log.x.get(steps[0]..=steps[1])?;
                Some(Curve::new("", path.iter().map(project).collect()).looking(Look::Faint))
            };
            let passes = ((self.stop - self.start) * self.frequency) as u32;
            let mut curves: Vec<Curve> = (0..passes).filter_map(between).collect();
            curves.push(Curve::new("before", closed(self.start)).looking(Look::Colour(5)));
            curves.push(Curve::new(log.modification.name(), closed(self.back)).looking(Look::Colour(3)));
            curves.push(Curve::new("coaching point", vec![project(&log.o)]).looking(Look::Dots(2)));
            Panel {
                equal_units: true,
                ..panel(
                    format!("{}, m", ["x", "y", "z"][axes[0]]),
                    format!("{}, m", ["x", "y", "z"][axes[1]]),
                    curves,
                )
            }
        };
        let row =
            |logs: &[ModificationLog]| PanelRow { height: 420.0, panels: logs.iter().map(path).collect() };
        let rows: Vec<_> = logs.chunks(2).map(row).collect();
        picture("Four modifications of the arm's motion by the coach's hands", &rows)
    }

    /// As Fig. 7: the joints over time.
    fn joints_plot(&self, log: &ModificationLog) -> String {
        let over_time =
            |i: usize| log.q.iter().enumerate().map(|(k, q)| [LOG_INTERVAL * k as f64, q[i]]).collect();
        // Labels appear once; the lines cross all panels.
        let marks = |i: usize| {
            let named = [(self.start, "coach comes"), (self.stop, "goes"), (self.back, "back")];
            named.map(|(t, name)| (t, if i == 0 { name.to_owned() } else { String::new() })).to_vec()
        };
        let joint = |i: usize| Panel {
            marks: marks(i),
            ..panel(
                if i + 1 == JOINTS { "time, s".into() } else { String::new() },
                format!("q{}, rad", i + 1),
                vec![Curve::new("", over_time(i)).looking(Look::Colour(1))],
            )
        };
        let rows: Vec<_> = (0..JOINTS).map(|i| PanelRow { height: 130.0, panels: vec![joint(i)] }).collect();
        picture("Joints of the arm while its motion is pulled", &rows)
    }
}

impl ModificationLog {
    fn new(modification: Modification, o: Vector3<f64>) -> Self {
        let (q, qd, x, wanted, coupling, judged) = Default::default();
        Self { modification, o, q, qd, x, wanted, coupling, judged }
    }

    fn note(&mut self, q: Joints, qd: Joints, wanted: Vector3<f64>, coupling: f64) {
        self.q.push(q);
        self.qd.push(qd);
        self.wanted.push(wanted);
        self.coupling.push(coupling);
    }
}

fn step_of(time: f64) -> usize {
    (time / DT).round() as usize
}
