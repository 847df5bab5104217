//! The coaching experiment of Petrič et al. 2014, section III: a planar arm of three joints on a circle is coached in
//! task space, and its joint motion changes (Figs 2-4).

use std::f64::consts::{FRAC_PI_4, TAU};

use armarium_motion::{Integrator, PeriodicDmp, PeriodicDmpConfig, PotentialField};
use nalgebra::{Matrix2x3, Vector2, Vector3};

const DT: f64 = 0.01;
const OMEGA: f64 = TAU * 0.5;
const PERIOD: usize = 200;

fn forward(q: &[f64]) -> Vector2<f64> {
    let (a, b, c) = (q[0], q[0] + q[1], q[0] + q[1] + q[2]);
    Vector2::new(libm::cos(a) + libm::cos(b) + libm::cos(c), libm::sin(a) + libm::sin(b) + libm::sin(c))
}

fn jacobian(q: &[f64]) -> Matrix2x3<f64> {
    let angles = [q[0], q[0] + q[1], q[0] + q[1] + q[2]];
    Matrix2x3::from_fn(|row, column| {
        angles[column..].iter().map(|a| if row == 0 { -libm::sin(*a) } else { libm::cos(*a) }).sum()
    })
}

/// Closed form with the last link at pi/4 and the elbow branch q2 < 0.
fn inverse(x: Vector2<f64>) -> Vector3<f64> {
    let wrist = x - Vector2::new(libm::cos(FRAC_PI_4), libm::sin(FRAC_PI_4));
    let q2 = -libm::acos((wrist.norm_squared() - 2.0) / 2.0);
    let q1 = libm::atan2(wrist.y, wrist.x) - libm::atan2(libm::sin(q2), 1.0 + libm::cos(q2));
    Vector3::new(q1, q2, FRAC_PI_4 - q1 - q2)
}

fn circle(phase: f64, sense: f64) -> Vector2<f64> {
    Vector2::new(1.8 + 0.7 * libm::cos(phase), 0.2 + 0.7 * sense * libm::sin(phase))
}

struct Outcome {
    before: Vec<Vector2<f64>>,
    after: Vec<Vector2<f64>>,
    coupling: Vec<f64>,
}

/// 40 cycles of learning, then 60 s of execution, coached from 5 s on by `o(x, v)` along `d(x, v)`.
fn run(
    sense: f64,
    field: PotentialField,
    command: impl Fn(Vector2<f64>, Vector2<f64>) -> (Vector2<f64>, Vector2<f64>),
) -> Outcome {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig {
        integrator: Integrator::Euler,
        ..PeriodicDmpConfig::with_dofs(3)
    })
    .unwrap();
    let q = |phase: f64| inverse(circle(phase, sense));
    let mean = (0..PERIOD).map(|k| q(TAU * k as f64 / PERIOD as f64)).sum::<Vector3<f64>>() / PERIOD as f64;
    dmp.set_centre(mean.as_slice()).unwrap();
    let h = 1e-4;
    let slope = |phase: f64| (q(phase + h) - q(phase - h)) / (2.0 * h);
    let bend = |phase: f64| (q(phase + h) - 2.0 * q(phase) + q(phase - h)) / (h * h);
    for k in 0..40 * PERIOD {
        let phase = OMEGA * DT * k as f64;
        let (yd, ydd) = (slope(phase) * OMEGA, bend(phase) * OMEGA * OMEGA);
        dmp.learn(phase, OMEGA, DT, q(phase).as_slice(), yd.as_slice(), ydd.as_slice()).unwrap();
    }
    dmp.reset(0.0, q(0.0).as_slice(), (slope(0.0) * OMEGA).as_slice(), OMEGA).unwrap();
    let (mut xs, mut coupling) = (Vec::new(), Vec::new());
    for k in 0..6000 {
        let q = dmp.state().y.to_vec();
        let (x, j) = (forward(&q), jacobian(&q));
        let v = j * Vector3::from_column_slice(dmp.state().yd);
        xs.push(x);
        if k >= 500 {
            let (o, d) = command(x, v);
            let c = field.strength(o.as_slice(), x.as_slice(), v.as_slice());
            coupling.push(c);
            let task = d * c;
            let joint = j.transpose() * (j * j.transpose()).try_inverse().unwrap() * task;
            dmp.couple(joint.as_slice()).unwrap();
        }
        dmp.step(DT, OMEGA).unwrap();
    }
    Outcome { before: xs[300..500].to_vec(), after: xs[5800..].to_vec(), coupling }
}

#[test]
fn pushing_in_moves_the_path_at_the_point_and_not_opposite() {
    for sense in [1.0, -1.0] {
        let o = Vector2::new(1.8, -0.6);
        let r = run(sense, PotentialField::default(), |_, _| (o, Vector2::y()));
        // Both windows start at whole periods plus the same phase: 300 and 5800 steps are 1.5 and 29 periods.
        let align = |k: usize| (k + PERIOD / 2) % PERIOD;
        let moved = |k: usize| (r.after[align(k)] - r.before[k]).norm();
        let nearest = (0..PERIOD)
            .min_by(|a, b| (r.before[*a] - o).norm().total_cmp(&(r.before[*b] - o).norm()))
            .unwrap();
        let at_o = moved(nearest);
        let opposite = moved((nearest + PERIOD / 2) % PERIOD);
        let far: Vec<f64> = (0..PERIOD).filter(|k| (r.before[*k] - o).norm() > 0.8).map(moved).collect();
        let far_rms = (far.iter().map(|d| d * d).sum::<f64>() / far.len() as f64).sqrt();
        let mean = |c: &[f64]| c.iter().sum::<f64>() / c.len() as f64;
        let (first, last) = (mean(&r.coupling[..PERIOD]), mean(&r.coupling[r.coupling.len() - PERIOD..]));
        println!(
            "sense {sense}: at o {at_o:.4} opposite {opposite:.6} far {far_rms:.6} coupling {first:.3} {last:.3}"
        );
        assert!((at_o / 0.35 - 1.0).abs() < 0.15, "{at_o}");
        assert!(opposite < 1e-3, "{opposite}");
        assert!(first / last > 8.0, "{first} {last}");
    }
}
