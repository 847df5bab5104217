//! Where the right hand can wipe: searches torso postures and hand orientations for reach, margin and speed.
//!
//! `cargo run --release -p armarium-robot --example workspace` prints the table from which `posture.rs` was chosen. For each
//! torso posture and hand orientation it solves the arm's pose over a grid of TCP points and takes, at each point, the
//! arm posture with the largest TCP speed in its worst direction. The figure of a combination is its worst point.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::sync::Arc;

use armarium_robot::{Jacobian, Kinematics, LinkId, Model, PoseOptions, solve_pose};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The TCP's orientation: fingers `yaw` left of forward, palm down, fingers' tips lowered by `pitch`.
fn hand(yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
    let level = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
    let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * level
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
}

/// The largest TCP speed, m/s, in the worst of ten directions with the orientation held and every joint within 1 rad/s.
fn worst_speed(jacobian: &Jacobian) -> f64 {
    let gram = jacobian * jacobian.transpose();
    let Some(inverse) = gram.try_inverse() else { return 0.0 };
    let pinv = jacobian.transpose() * inverse;
    let n = jacobian.ncols();
    let free = nalgebra::DMatrix::identity(n, n) - &pinv * jacobian;
    let (mut null, mut most) = (vec![0.0; n], 0.0);
    for column in free.column_iter() {
        if column.norm() > most {
            most = column.norm();
            null = (column / most).iter().copied().collect();
        }
    }
    let mut worst = f64::INFINITY;
    for k in 0..10 {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_8;
        let d = if k < 8 { [angle.cos(), angle.sin(), 0.0] } else { [0.0, 0.0, 1.0] };
        let joint = &pinv * Vector6::new(d[0], d[1], d[2], 0.0, 0.0, 0.0);
        let peak = |t: f64| joint.iter().zip(&null).map(|(a, b)| (a + t * b).abs()).fold(0.0, f64::max);
        let (mut low, mut high) = (-6.0, 6.0);
        for _ in 0..40 {
            let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if peak(a) < peak(b) { high = b } else { low = a }
        }
        worst = worst.min(1.0 / peak(0.5 * (low + high)));
    }
    worst
}

struct Search {
    model: Arc<Model>,
    kinematics: Kinematics,
    tcp: LinkId,
    arm: Vec<usize>,
    rng: ChaCha8Rng,
}

impl Search {
    /// The fastest arm posture for a TCP pose: its speed (m/s) and all joints; none out of reach.
    fn best(
        &mut self,
        start: &[f64],
        target: &Isometry3<f64>,
        tries: usize,
        near: Option<&[f64]>,
    ) -> Option<(f64, Vec<f64>)> {
        let options = PoseOptions { margin: 0.05, restarts: 0, iterations: 40, ..PoseOptions::default() };
        let mut best: Option<(f64, Vec<f64>)> = None;
        for k in 0..tries {
            let mut seed = near.filter(|_| k == 0).map_or_else(|| start.to_vec(), <[f64]>::to_vec);
            if k > 0 || near.is_none() {
                use rand::RngExt;
                for &j in &self.arm {
                    let joint = &self.model.joints()[j];
                    seed[j] = self.rng.random_range(joint.lower..joint.upper);
                }
            }
            let Ok(q) = solve_pose(&self.model, self.tcp, &self.arm, target, &seed, &options, &mut self.rng)
            else {
                continue;
            };
            self.kinematics.update(&q);
            let speed = worst_speed(&self.kinematics.jacobian(self.tcp, &self.arm));
            if best.as_ref().is_none_or(|(s, _)| speed > *s) {
                best = Some((speed, q));
            }
        }
        best
    }
}

fn main() {
    let model = Arc::new(Model::armar3());
    let tcp = model.link("tcp_right").expect("the model has it");
    let arm = model.limb("right_arm").to_vec();
    let torso = model.limb("torso").to_vec();
    let mut search = Search {
        kinematics: Kinematics::new(&model),
        tcp,
        arm,
        rng: ChaCha8Rng::seed_from_u64(1),
        model: Arc::clone(&model),
    };
    let deg = |values: &[f64]| values.iter().map(|v| v.to_radians()).collect::<Vec<_>>();
    let args: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let reach = args.first().copied().unwrap_or(0.13);
    let mut rows = Vec::new();
    for &pitch in &deg(&[0.0, -10.0, -20.0, -30.0, -40.0]) {
        for &roll in &deg(&[-30.0, -15.0, 0.0, 15.0, 30.0]) {
            for &yaw in &deg(&[-40.0, -20.0, 0.0, 20.0, 40.0]) {
                let mut start = model.zero();
                for (&j, v) in torso.iter().zip([pitch, roll, yaw]) {
                    start[j] = v;
                }
                for &hand_pitch in &deg(&[-15.0, 0.0, 15.0, 30.0]) {
                    for &hand_yaw in &deg(&[-30.0, 0.0, 30.0, 60.0, 90.0]) {
                        let mut worst = f64::INFINITY;
                        for p in [
                            [0.0, 0.0, 0.0],
                            [1.0, 1.0, 1.0],
                            [-1.0, 1.0, 1.0],
                            [1.0, -1.0, 1.0],
                            [-1.0, -1.0, 1.0],
                            [1.0, 1.0, -1.0],
                            [-1.0, 1.0, -1.0],
                            [1.0, -1.0, -1.0],
                            [-1.0, -1.0, -1.0],
                        ] {
                            let at =
                                Vector3::new(0.28 + reach * p[0], 0.53 + reach * p[1], 1.05 + 0.03 * p[2]);
                            let target =
                                Isometry3::from_parts(Translation3::from(at), hand(hand_yaw, hand_pitch));
                            let found = search.best(&start, &target, 8, None).map_or(0.0, |(s, _)| s);
                            worst = worst.min(found);
                            if worst <= 0.0 {
                                break;
                            }
                        }
                        if worst > 0.0 {
                            rows.push((
                                worst,
                                [pitch, roll, yaw, hand_pitch, hand_yaw].map(|v: f64| v.to_degrees().round()),
                            ));
                        }
                    }
                }
            }
        }
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    println!("{} combinations reach every point", rows.len());
    println!("speed  torso pitch roll yaw, hand pitch yaw");
    for (speed, row) in rows.iter().take(60) {
        println!("{speed:.3} {row:?}");
    }
    for hp in [-15.0, 0.0, 15.0, 30.0] {
        let top = rows.iter().filter(|r| (r.1[3] - hp).abs() < 0.1).take(3).collect::<Vec<_>>();
        println!("hand pitch {hp}: {top:?}");
    }
    for upright in rows.iter().filter(|r| r.1[0] == 0.0 && r.1[1] == 0.0).take(5) {
        println!("upright: {upright:?}");
    }
}
