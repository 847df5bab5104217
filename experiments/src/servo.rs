//! Position-based visual servoing from a start pose to its target: duration, straightness, and the effect of a rotated
//! camera mount or of measurement noise.

use armarium_motion::{PositionServo, ServoConfig, ServoObservation, ServoStatus};
use armarium_values::random::StandardNormal;
use armarium_viewer::report::{Curve, Look, PanelRow, picture};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng as _;
use rand::distr::Distribution as _;
use rand_chacha::ChaCha8Rng;

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::settings::{ExperimentSettings as _, settings};

settings! {
    /// Settings of the servo.
    Servo {
        /// Start pose relative to the target: x, y, z, m, then the rotation vector, deg.
        start: [f64; 6] = [0.15, -0.1, 0.25, 20.0, -30.0, 60.0];
        /// Gain of v = -lambda t and omega = -lambda theta u, 1/s.
        lambda: f64 = 1.0;
        /// Gain at the target when it adapts to the error, 1/s; none keeps lambda.
        lambda_near: Option<f64> = None;
        /// Error at which the adaptive gain is halfway, m.
        lambda_scale: f64 = 0.05;
        /// Time between frames, s.
        dt: f64 = 0.04, 1e-4..=1.0;
        /// Standard deviation of the measurement, m per coordinate and rad per rotation.
        noise: f64 = 0.0, 0.0..=1.0;
        /// Rotation of the camera against its calibration, deg.
        hand_eye_error_deg: f64 = 0.0, -180.0..=180.0;
        /// Axis of this rotation, any length.
        hand_eye_axis: [f64; 3] = [0.0, 0.0, 1.0];
        /// Speed limit, m/s; none for unlimited. Linear and angular speed are scaled down together.
        max_linear: Option<f64> = None;
        /// Angular speed limit, rad/s; none for unlimited.
        max_angular: Option<f64> = None;
        /// Converged below this position error, m.
        tolerance_m: f64 = 5e-4;
        /// Converged below this angular error, deg.
        tolerance_deg: f64 = 0.5;
        /// Converged after this many frames in a row.
        frames: u32 = 5;
        /// Stops after this time, s.
        timeout: f64 = 60.0;
        /// Seed of the noise.
        seed: u64 = 1;
    }
}

/// One frame: the true error and the command.
struct ServoFrame {
    t: f64,
    position: Vector3<f64>,
    angle: f64,
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

impl Experiment for Servo {
    const NAME: &'static str = "servo";
    const ABOUT: &'static str = "position-based visual servoing from a start pose to its target";
    const ALIASES: &'static [(&'static str, &'static str)] = &[
        ("gain_scale", "lambda_scale"),
        ("position_tolerance", "tolerance_m"),
        ("rotation_tolerance", "tolerance_deg"),
    ];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let (frames, status) = self.servo()?;
        let mut outcome = self.figures(&frames, status);
        outcome.plot("servo", plot(&frames));
        Ok(outcome)
    }
}

impl Servo {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("lambda", self.lambda, 1e-3, 1.9 / self.dt)?;
        within("lambda_near", self.lambda_near.unwrap_or(self.lambda), 1e-3, 1.9 / self.dt)?;
        let [x, y, z, a, b, c] = self.start;
        [x, y, z].iter().try_for_each(|v| within("start", *v, -1e3, 1e3))?;
        [a, b, c].iter().try_for_each(|v| within("start", *v, -360.0, 360.0))?;
        within("hand_eye_axis", Vector3::from(self.hand_eye_axis).norm(), 1e-9, 1e9)?;
        within("timeout", self.timeout, self.dt, 1e5 * self.dt)
    }

    fn config(&self) -> ServoConfig {
        ServoConfig {
            gain_far: self.lambda,
            gain_near: self.lambda_near.unwrap_or(self.lambda),
            gain_scale: self.lambda_scale,
            max_linear: self.max_linear.unwrap_or(1e6),
            max_angular: self.max_angular.unwrap_or(1e6),
            position_tolerance: self.tolerance_m,
            rotation_tolerance: self.tolerance_deg.to_radians(),
            hold_frames: self.frames,
            timeout: self.timeout,
            ..ServoConfig::default()
        }
    }

    /// Runs until the true, not only the measured, hand pose is at the target, or the servo gives up. The camera stands
    /// still and sees hand and target.
    fn servo(&self) -> Result<(Vec<ServoFrame>, ServoStatus), ExperimentError> {
        let mut servo = PositionServo::new(self.config())?;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let turned = Vector3::from(self.hand_eye_axis).normalize() * self.hand_eye_error_deg.to_radians();
        let camera_from_robot = Isometry3::rotation(turned);
        let mut hand = pose(&self.start);
        let mut frames: Vec<ServoFrame> = Vec::new();
        let mut held = 0;
        loop {
            let seen = camera_from_robot * hand * self.error(&mut rng);
            let observation = ServoObservation { hand: seen, target: camera_from_robot };
            let command = servo.step(self.dt, Some(&observation))?;
            frames.push(ServoFrame {
                t: self.dt * frames.len() as f64,
                position: hand.translation.vector,
                angle: hand.rotation.angle(),
                linear: command.linear,
                angular: command.angular,
            });
            let near = self.reached(hand.translation.vector.norm(), hand.rotation.angle());
            held = if near { held + 1 } else { 0 };
            if held >= self.frames.max(1) || near && command.status == ServoStatus::Converged {
                return Ok((frames, ServoStatus::Converged));
            }
            if command.status != ServoStatus::Running {
                return Ok((frames, command.status));
            }
            // The robot assumes the calibrated camera frame.
            hand = Isometry3::from_parts(
                Translation3::from(hand.translation.vector + command.linear * self.dt),
                UnitQuaternion::from_scaled_axis(command.angular * self.dt) * hand.rotation,
            );
        }
    }

    fn reached(&self, distance: f64, angle: f64) -> bool {
        distance <= self.tolerance_m && angle <= self.tolerance_deg.to_radians()
    }

    fn figures(&self, frames: &[ServoFrame], status: ServoStatus) -> ExperimentResult {
        let mut outcome = ExperimentResult::default();
        let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return outcome };
        let length: f64 = frames.windows(2).map(|w| (w[1].position - w[0].position).norm()).sum();
        let straight = (last.position - first.position).norm();
        // With noise the servo may report convergence too early.
        let there = self.reached(last.position.norm(), last.angle);
        let converged = status == ServoStatus::Converged && there;
        outcome.figure("converged_s", if converged { last.t } else { f64::NAN });
        outcome.figure("path_ratio", length / straight);
        outcome.figure("final_m", last.position.norm());
        outcome.figure("final_rad", last.angle);
        outcome.figure("outcome", format!("{status:?}").to_lowercase());
        outcome
    }

    /// The measurement error of a pose.
    fn error(&self, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
        let mut three = || -> Vector3<f64> {
            Vector3::from_fn(|_, _| {
                let normal: f64 = StandardNormal.sample(&mut *rng);
                self.noise * normal
            })
        };
        Isometry3::new(three(), three())
    }
}

fn pose([x, y, z, a, b, c]: &[f64; 6]) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(*x, *y, *z), Vector3::new(*a, *b, *c).map(f64::to_radians))
}

fn plot(frames: &[ServoFrame]) -> String {
    let over_time = |value: &dyn Fn(&ServoFrame) -> f64| {
        frames.iter().map(|f| [f.t, value(f)]).collect::<Vec<[f64; 2]>>()
    };
    let line = |label: &str, value: &dyn Fn(&ServoFrame) -> f64, colour: u8| {
        Curve::new(label, over_time(value)).looking(Look::Colour(colour))
    };
    let path = |axis: usize, colour: u8| {
        let points = frames.iter().map(|f| [f.position.x, f.position[axis]]).collect();
        Curve::new(["x", "y", "z"][axis], points).looking(Look::Colour(colour))
    };
    let errors = PanelRow {
        height: 300.0,
        panels: vec![
            panel("time, s", "distance, m", vec![line("", &|f| f.position.norm(), 1)]),
            panel("time, s", "angle, deg", vec![line("", &|f| f.angle.to_degrees(), 2)]),
        ],
    };
    let twist = |i: usize| ["x", "y", "z"][i];
    let linear: Vec<Curve> = (0..3).map(|i| line(twist(i), &|f| f.linear[i], i as u8 + 1)).collect();
    let angular: Vec<Curve> = (0..3).map(|i| line(twist(i), &|f| f.angular[i], i as u8 + 1)).collect();
    let commands = PanelRow {
        height: 300.0,
        panels: vec![panel("time, s", "velocity, m/s", linear), panel("time, s", "turning, rad/s", angular)],
    };
    let paths =
        PanelRow { height: 300.0, panels: vec![panel("x, m", "path, m", vec![path(1, 1), path(2, 2)])] };
    picture("Visual servoing", &[errors, commands, paths])
}
