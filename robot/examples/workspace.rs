//! Finds where the first arm of the default robot can wipe: searches torso postures and hand orientations for reach, margin and speed.
//!
//! `cargo run --release -p armarium-robot --example workspace -- HEIGHT REACH [FIVE ANGLES]` prints the search from
//! which the robot file's postures were chosen (HEIGHT of the TCP, m; REACH about the centre, m), or rates the given torso
//! pitch, roll and yaw and hand pitch and yaw (rad). The search climbs from random torso postures and hand
//! orientations. It solves the arm's pose at the centre from several seeds. From there it solves the corners of a
//! box, as a controller that starts at the centre would reach them. The rating is the TCP's speed in its worst
//! direction at the worst of these points.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::sync::Arc;

use armarium_robot::{
    DifferentialIk, IkConfig, Jacobian, Kinematics, LinkId, Model, PoseOptions, Twist, description,
    pose_error, solve_pose,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The largest TCP speed, m/s, in the worst of ten directions, with constant orientation and every joint within 1
/// rad/s.
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
        let d = if k < 8 { [libm::cos(angle), libm::sin(angle), 0.0] } else { [0.0, 0.0, 1.0] };
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

/// The TCP's speed, m/s, in the worst of ten directions.
fn ten_speed(ik: &mut DifferentialIk, q: &[f64]) -> f64 {
    let mut worst = f64::INFINITY;
    for k in 0..10 {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_4;
        let d = match k {
            8 => Vector3::z(),
            9 => -Vector3::z(),
            _ => Vector3::new(libm::cos(angle), libm::sin(angle), 0.0),
        };
        let step = ik.step(q, &Twist { linear: d, angular: Vector3::zeros() }, None);
        worst = worst.min(if step.residual > 0.05 * step.scale { 0.0 } else { step.scale });
    }
    worst
}

/// Torso pitch, roll, yaw, then the hand's pitch and yaw, rad.
type Choice = [f64; 5];
const RANGE: [(f64, f64); 5] = [(-0.6, 0.1), (-0.5, 0.6), (-0.75, 0.75), (-0.4, 0.6), (-0.5, 1.6)];
const CENTER: [f64; 2] = [0.28, 0.53];

/// How a choice is rated; see [`Search::climb`].
type Rate = fn(&mut Search, &Choice, usize, Option<&[f64]>, f64) -> Option<Evaluated>;

struct Search {
    model: Arc<Model>,
    kinematics: Kinematics,
    tcp: LinkId,
    arm: Vec<usize>,
    name: String,
    torso: String,
    height: f64,
    reach: f64,
    fixed: [Option<f64>; 5],
    rng: ChaCha8Rng,
}

/// A choice, its figure (m/s) and the whole configuration at the centre.
#[derive(Clone, Debug)]
struct Evaluated {
    choice: Choice,
    speed: f64,
    center: Vec<f64>,
}

impl Search {
    /// The orientation of the level hand, with the fingertips lowered by `pitch` rad.
    fn palm_down(&self, yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
        let arm = self.model.find_limb(&self.name).expect("the arm is there");
        let hand = self.model.hand_of(arm).expect("the arm has a hand");
        hand.palm_down(yaw) * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
    }

    fn target(&self, choice: &Choice, offset: [f64; 3]) -> Isometry3<f64> {
        let at = Vector3::new(CENTER[0] + offset[0], CENTER[1] + offset[1], self.height + offset[2]);
        Isometry3::from_parts(Translation3::from(at), self.palm_down(choice[4], choice[3]))
    }

    fn solve(&mut self, choice: &Choice, offset: [f64; 3], seed: &[f64]) -> Option<(f64, Vec<f64>)> {
        let options = PoseOptions { margin: 0.06, restarts: 0, iterations: 40, ..PoseOptions::default() };
        let target = self.target(choice, offset);
        let q = solve_pose(&self.model, self.tcp, &self.arm, &target, seed, &options, &mut self.rng).ok()?;
        self.kinematics.update(&q);
        Some((worst_speed(&self.kinematics.jacobian(self.tcp, &self.arm)), q))
    }

    /// The torso as chosen; the arm as in `near`, else at random.
    fn seed(&mut self, choice: &Choice, near: Option<&[f64]>) -> Vec<f64> {
        let mut seed = near.map_or_else(|| self.model.zero(), <[f64]>::to_vec);
        for (&j, v) in self.model.limb(&self.torso).iter().zip(choice) {
            seed[j] = *v;
        }
        if near.is_none() {
            for &j in &self.arm {
                let joint = &self.model.joints()[j];
                seed[j] = self.rng.random_range(joint.lower..joint.upper);
            }
        }
        seed
    }

    /// The rating for the arm alone; `None` when it is not above `floor`.
    fn rate(&mut self, choice: &Choice, seeds: usize, near: Option<&[f64]>, floor: f64) -> Option<Evaluated> {
        let mut best: Option<Evaluated> = None;
        for k in 0..seeds {
            let seed = self.seed(choice, near.filter(|_| k == 0));
            let Some((mut worst, center)) = self.solve(choice, [0.0; 3], &seed) else { continue };
            for corner in 0..8_u8 {
                let sign = |bit: u8| if (corner >> bit) & 1 == 1 { 1.0 } else { -1.0 };
                let offset = [self.reach * sign(0), self.reach * sign(1), 0.03 * sign(2)];
                worst = worst.min(self.solve(choice, offset, &center).map_or(0.0, |(speed, _)| speed));
                if best.as_ref().is_some_and(|found| worst <= found.speed) {
                    break;
                }
            }
            if worst > best.as_ref().map_or(floor, |found| found.speed) {
                best = Some(Evaluated { choice: *choice, speed: worst, center });
            }
        }
        best
    }

    /// Whether the elbow (0.05 m thick) stays 0.03 m over a table 0.10 m below the TCP.
    fn clears_the_table(&self, q: &[f64], target: &Isometry3<f64>) -> bool {
        let middle = self.arm.get(self.arm.len() / 2).map(|&joint| self.model.joints()[joint].link);
        let elbow = middle.map(|l| self.model.link_pose(q, l).translation.z);
        elbow.is_some_and(|z| z >= target.translation.z - 0.02)
    }

    /// As [`rate`](Self::rate), for arm and torso together and for tables up to 0.05 m higher and lower: the TCP
    /// speed that [`DifferentialIk`] reaches for a fast twist in its worst direction.
    fn rate_ten(
        &mut self,
        choice: &Choice,
        seeds: usize,
        near: Option<&[f64]>,
        floor: f64,
    ) -> Option<Evaluated> {
        let ten: Vec<usize> = self.model.reaching_joints(&self.name);
        let mut ik = DifferentialIk::new(&self.model, self.tcp, &ten, IkConfig::default());
        let options = PoseOptions { margin: 0.06, restarts: 0, iterations: 40, ..PoseOptions::default() };
        let mut best: Option<Evaluated> = None;
        for k in 0..seeds {
            let seed = self.seed(choice, near.filter(|_| k == 0));
            let Some((_, center)) = self.solve(choice, [0.0; 3], &seed) else { continue };
            let mut worst = f64::INFINITY;
            for point in 0..15_u8 {
                let sign = |bit: u8| if ((point % 5) >> bit) & 1 == 1 { self.reach } else { -self.reach };
                let z = 0.05 * (f64::from(point / 5) - 1.0);
                let offset = if point % 5 == 4 { [0.0, 0.0, z] } else { [sign(0), sign(1), z] };
                let target = self.target(choice, offset);
                let solved =
                    solve_pose(&self.model, self.tcp, &ten, &target, &center, &options, &mut self.rng);
                let speed = match solved {
                    Ok(q) if self.clears_the_table(&q, &target) => ten_speed(&mut ik, &q),
                    _ => 0.0,
                };
                worst = worst.min(speed);
                if worst <= best.as_ref().map_or(floor, |found| found.speed) {
                    break;
                }
            }
            if worst > best.as_ref().map_or(floor, |found| found.speed) {
                best = Some(Evaluated { choice: *choice, speed: worst, center });
            }
        }
        best
    }

    fn random(&mut self) -> Choice {
        let mut choice = [0.0; 5];
        for (i, c) in choice.iter_mut().enumerate() {
            *c = self.fixed[i].unwrap_or_else(|| self.rng.random_range(RANGE[i].0..RANGE[i].1));
        }
        choice
    }

    /// Climbs from the best of `starts` random choices in `steps` ever smaller steps. `rate` gets a choice, a number of
    /// seeds, a configuration near which the arm is, and the speed that has to be exceeded.
    fn climb(&mut self, (starts, steps): (u32, u32), seeds: (usize, usize), rate: Rate) -> Option<Evaluated> {
        let mut best: Option<Evaluated> = None;
        for _ in 0..starts {
            let choice = self.random();
            let floor = best.as_ref().map_or(0.0, |b| b.speed);
            best = rate(self, &choice, seeds.0, None, floor).or(best);
        }
        let mut best = best?;
        for step in 0..steps {
            let size = 0.3 * (1.0 - f64::from(step) / f64::from(steps)) + 0.01;
            let mut choice = best.choice;
            for i in (0..5).filter(|i| self.fixed[*i].is_none()) {
                choice[i] = (choice[i] + self.rng.random_range(-size..size)).clamp(RANGE[i].0, RANGE[i].1);
            }
            let near = best.center.clone();
            best = rate(self, &choice, seeds.1, Some(&near), best.speed).unwrap_or(best);
        }
        Some(best)
    }

    /// The highest frequency, Hz, at which the TCP follows a circle of `radius` (m) about the centre plus `offset`
    /// with every joint within its limits. Also the least distance of a joint to its limits, rad.
    fn circle(
        &self,
        found: &Evaluated,
        joints: &[usize],
        config: &IkConfig,
        radius: f64,
        offset: [f64; 2],
    ) -> (f64, f64) {
        let (mut good, mut bad, mut margin) = (0.0, 2.0, 0.0);
        while bad - good > 0.01 {
            let frequency = 0.5 * (good + bad);
            match self.follows(found, joints, config, radius, offset, frequency) {
                Some(m) => (good, margin) = (frequency, m),
                None => bad = frequency,
            }
        }
        (good, margin)
    }

    fn follows(
        &self,
        found: &Evaluated,
        joints: &[usize],
        config: &IkConfig,
        radius: f64,
        offset: [f64; 2],
        frequency: f64,
    ) -> Option<f64> {
        let mut ik = DifferentialIk::new(&self.model, self.tcp, joints, *config);
        let mut q = found.center.clone();
        let posture: Vec<f64> = joints.iter().map(|&j| q[j]).collect();
        let mut margin = f64::INFINITY;
        let omega = std::f64::consts::TAU * frequency;
        let dt = 4e-3;
        let start = 2.0;
        for k in 0..((start + 2.0 / frequency) / dt) as u32 {
            let t = f64::from(k) * dt;
            let grow = (t / start).min(1.0);
            let spin = omega * (t - start).max(0.0);
            let (s, c) = libm::sincos(spin);
            let at = [grow * (offset[0] + radius * c), grow * (offset[1] + radius * s), 0.0];
            let error = pose_error(&self.model.link_pose(&q, self.tcp), &self.target(&found.choice, at));
            let feed = if t < start { Vector3::zeros() } else { Vector3::new(-s, c, 0.0) * radius * omega };
            let twist = Twist { linear: feed + 5.0 * error.linear, angular: 5.0 * error.angular };
            let step = ik.step(&q, &twist, Some(&posture));
            if t > start + 0.5 && (step.scale < 1.0 || step.residual > 0.02 || error.linear.norm() > 0.01) {
                return None;
            }
            let velocities = step.velocities.to_vec();
            for (&j, v) in joints.iter().zip(&velocities) {
                let joint = &self.model.joints()[j];
                q[j] += v * dt;
                margin = margin.min(joint.upper - q[j]).min(q[j] - joint.lower);
            }
        }
        Some(margin)
    }

    fn report(&self, name: &str, found: Option<&Evaluated>) {
        let Some(found) = found else { return println!("{name}: none reaches every point") };
        let degrees = found.choice.map(|c| c.to_degrees().round());
        let choice = found.choice.map(|c| (c * 1e3).round() / 1e3);
        let arm: Vec<String> = self.arm.iter().map(|&j| format!("{:.3}", found.center[j])).collect();
        println!("{name}: {:.3} m/s {degrees:?} deg = {choice:?} arm [{}]", found.speed, arm.join(", "));
        let fixed = IkConfig::default();
        let free = IkConfig { angular_weight: Vector3::new(0.0, 0.3, 0.3), ..fixed };
        let ten: Vec<usize> = self.model.reaching_joints(&self.name);
        for (what, joints, config) in
            [("arm", &self.arm, fixed), ("arm, yaw free", &self.arm, free), ("arm and torso", &ten, fixed)]
        {
            let mut line = String::new();
            for radius in [0.05, 0.08] {
                let (mut worst, mut margin) = self.circle(found, joints, &config, radius, [0.0; 2]);
                line += &format!(" r {radius}: {worst:.2} Hz, margin {margin:.2};");
                for offset in [[0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]] {
                    let (f, m) = self.circle(found, joints, &config, radius, offset);
                    (worst, margin) = (worst.min(f), margin.min(m));
                }
                line += &format!(" 5 cm off: {worst:.2} Hz, margin {margin:.2};");
            }
            println!("   {what}:{line}");
        }
    }
}

/// For each place of the TCP, the reachable hand yaws (degrees, palm level): with the arm alone and the torso in
/// the wiping posture, and with arm and torso.
fn map(search: &mut Search) {
    let model = Arc::clone(&search.model);
    let (own, start) = (search.arm.clone(), model.ready(&search.name).to_vec());
    let ten: Vec<usize> = model.reaching_joints(&search.name);
    let options = PoseOptions { margin: 0.05, restarts: 6, iterations: 60, ..PoseOptions::default() };
    for height in [1.00, 1.05, 1.10, 1.20] {
        println!("TCP at {height} m; columns x 0.10 to 0.50; arm | arm and torso");
        for row in 0..6 {
            let y = 0.70 - 0.07 * f64::from(row);
            let mut line = format!("y {y:.2}");
            for joints in [&own, &ten] {
                for column in 0..5 {
                    let at = Vector3::new(0.10 + 0.10 * f64::from(column), y, height);
                    let reached = |yaw: &i32| {
                        let target = Isometry3::from_parts(
                            Translation3::from(at),
                            search.palm_down(f64::from(*yaw).to_radians(), 0.0),
                        );
                        solve_pose(&model, search.tcp, joints, &target, &start, &options, &mut search.rng)
                            .is_ok()
                    };
                    let yaws: Vec<i32> = (-4..=11).map(|k| 10 * k).filter(reached).collect();
                    match (yaws.first(), yaws.last()) {
                        (Some(a), Some(b)) => line += &format!(" {a:>4}..{b:<4}"),
                        _ => line += "     -     ",
                    }
                }
                line += " |";
            }
            println!("{line}");
        }
    }
}

fn main() {
    let model = Model::shipped(description::default_robot()).expect("the program carries it");
    let arm = model.arms().next().expect("the robot has an arm").clone();
    let args: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let mut search = Search {
        kinematics: Kinematics::new(&model),
        tcp: arm.tcp.expect("an arm has a TCP"),
        arm: arm.joints.clone(),
        name: arm.name.clone(),
        torso: arm.helped_by.concat(),
        height: args.first().copied().unwrap_or(1.05),
        reach: args.get(1).copied().unwrap_or(0.13),
        fixed: [None; 5],
        rng: ChaCha8Rng::seed_from_u64(1),
        model: Arc::clone(&model),
    };
    println!(
        "TCP at {} m, corners at {} m; torso pitch, roll, yaw, hand pitch, yaw in degrees",
        search.height, search.reach
    );
    if std::env::args().nth(1).is_some_and(|a| a == "torso") {
        for hand_pitch in [Some(0.0), None] {
            search.fixed = [None, None, None, hand_pitch, None];
            let found = search.climb((400, 400), (4, 2), Search::rate_ten);
            search.report("arm and torso", found.as_ref());
        }
        return;
    }
    if std::env::args().nth(1).is_some_and(|a| a == "map") {
        return map(&mut search);
    }
    if let Some(choice) = args.get(2..7).and_then(|c| Choice::try_from(c).ok()) {
        let near = search.model.ready(&search.name).to_vec();
        let found = search.rate_ten(&choice, 50, Some(&near), 0.0);
        return search.report("given", found.as_ref());
    }
    for (name, fixed) in [
        ("free", [None; 5]),
        ("level palm", [None, None, None, Some(0.0), None]),
        ("level palm, lean only", [None, Some(0.0), Some(0.0), Some(0.0), None]),
        ("upright torso, yaw only", [Some(0.0), Some(0.0), None, None, None]),
        ("upright torso, level palm", [Some(0.0), Some(0.0), Some(0.0), Some(0.0), None]),
    ] {
        search.fixed = fixed;
        let found = search.climb((600, 600), (8, 3), Search::rate);
        search.report(name, found.as_ref());
    }
}
