//! The duration of control steps: `cargo bench -p armarium-motion`.

#![allow(clippy::unwrap_used, missing_docs, reason = "a bench that cannot go on says where")]

use armarium_motion::{
    AdaptiveOscillator, Admittance, AdmittanceConfig, CoachConfig, CoachInput, CoachedMotion, DiscreteDmp,
    DiscreteDmpConfig, DiscretePeriodicConfig, DiscretePeriodicDmp, FrictionConfig, FrictionModel,
    LearningControl, LearningControlConfig, OscillatorConfig, PeriodicDmp, PeriodicDmpConfig, PhaseSample,
    PositionServo, PotentialField, ServoConfig, ServoObservation, SurfaceAdaptation, SurfaceConfig,
    joint_coupling,
};
use divan::{Bencher, black_box};
use nalgebra::{Isometry3, Vector3, Vector6};

fn main() {
    divan::main();
}

fn samples(dofs: usize) -> Vec<PhaseSample> {
    (0..1000)
        .map(|k| {
            let phase = std::f64::consts::TAU * f64::from(k) / 1000.0;
            let (s, c) = libm::sincos(phase);
            PhaseSample { phase, y: vec![s; dofs], dy: vec![c; dofs], ddy: vec![-s; dofs] }
        })
        .collect()
}

fn learned(dofs: usize) -> PeriodicDmp {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(dofs)).unwrap();
    dmp.learn_batch(&samples(dofs)).unwrap();
    dmp.start_on_path(0.0, 3.0).unwrap();
    dmp
}

#[divan::bench]
fn step_7_dofs(bencher: Bencher) {
    let mut dmp = learned(7);
    bencher.bench_local(|| dmp.step(black_box(0.001), black_box(3.0)).map(|s| s.y[0]));
}

#[divan::bench]
fn rollout_of_1000_steps_7_dofs(bencher: Bencher) {
    let mut dmp = learned(7);
    bencher.bench_local(|| (0..1000).try_fold(0.0, |sum, _| dmp.step(0.001, 3.0).map(|s| sum + s.y[0])));
}

#[divan::bench]
fn learn_online_7_dofs(bencher: Bencher) {
    let mut dmp = learned(7);
    let mut phase = 0.0;
    bencher.bench_local(|| {
        phase += 0.003;
        dmp.learn(phase, 3.0, 0.001, &[0.1; 7], &[0.2; 7], &[0.3; 7])
    });
}

#[divan::bench]
fn learn_batch_of_1000_7_dofs(bencher: Bencher) {
    let samples = samples(7);
    let mut dmp = learned(7);
    bencher.bench_local(|| dmp.learn_batch(&samples));
}

#[divan::bench]
fn coach_attracts(bencher: Bencher) {
    let mut dmp = learned(3);
    let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
    let input = CoachInput::Attract { hand: Vector3::new(1.1, 1.0, 1.0) };
    bencher.bench_local(|| coach.step(&mut dmp, 0.001, 3.0, input));
}

#[divan::bench]
fn surface_adaptation(bencher: Bencher) {
    let mut surface = SurfaceAdaptation::new(SurfaceConfig::default()).unwrap();
    let mut phase = 0.0;
    bencher.bench_local(|| {
        phase += 0.003;
        surface.step(0.001, phase, 3.0, 8.0)
    });
}

#[divan::bench]
fn friction(bencher: Bencher) {
    let mut friction = FrictionModel::new(FrictionConfig::default()).unwrap();
    bencher.bench_local(|| friction.step(0.001, 8.0, [0.1, 0.05], [3.0, 1.0]));
}

#[divan::bench]
fn discrete_step_7_dofs(bencher: Bencher) {
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(7)).unwrap();
    dmp.set_weights(&[1.0; 175]).unwrap();
    dmp.begin(&[0.0; 7], &[0.0; 7], 2.0).unwrap();
    bencher.bench_local(|| dmp.step(black_box(0.001), black_box(2.0)).map(|s| s.y[0]));
}

#[divan::bench]
fn coupled_step_7_dofs(bencher: Bencher) {
    let mut dmp = learned(7);
    let field = PotentialField::default();
    let columns = [0, 1, 2, 3, 4, 5, 6].map(|i| Vector3::new(f64::from(i), 1.0, f64::from(i * i)));
    let (o, x, v) = ([0.1, 0.2, 0.3], [0.1, 0.1, 0.2], [0.2, 0.3, 0.1]);
    bencher.bench_local(|| {
        let mut coupling = [0.0; 7];
        let strength = field.strength(black_box(&o), black_box(&x), black_box(&v));
        joint_coupling(&columns, &(1e-6 * strength * Vector3::x()), 0.0, &mut coupling)?;
        dmp.couple(&coupling)?;
        dmp.step(0.001, 3.0).map(|s| s.y[0])
    });
}

#[divan::bench]
fn servo(bencher: Bencher) {
    let mut servo = PositionServo::new(ServoConfig { timeout: 1e9, ..ServoConfig::default() }).unwrap();
    let seen =
        ServoObservation { hand: Isometry3::translation(0.1, 0.0, 0.2), target: Isometry3::identity() };
    bencher.bench_local(|| servo.step(0.001, Some(black_box(&seen))));
}

#[divan::bench]
fn guiding(bencher: Bencher) {
    let mut led = Admittance::new(AdmittanceConfig::default()).unwrap();
    bencher.bench_local(|| led.step(0.001, black_box(&Vector6::repeat(5.0)), black_box(&Vector3::zeros())));
}

/// A discrete-periodic primitive at its start.
fn discrete_periodic(dofs: usize) -> DiscretePeriodicDmp {
    let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::with_dofs(dofs), 6.0, 1.0).unwrap();
    dmp.set_weights(&vec![0.3; dmp.weights().len()]).unwrap();
    dmp
}

#[divan::bench]
fn discrete_periodic_step_7_dofs(bencher: Bencher) {
    let mut dmp = discrete_periodic(7);
    bencher.bench_local(|| {
        if dmp.state().phase >= 0.0 {
            dmp.restart();
        }
        dmp.step(black_box(0.001), black_box(6.0)).map(|s| s.y[0])
    });
}

#[divan::bench]
fn discrete_periodic_step_7_dofs_on_the_cycle(bencher: Bencher) {
    let mut dmp = discrete_periodic(7);
    for _ in 0..5000 {
        dmp.step(0.001, 6.0).unwrap();
    }
    bencher.bench_local(|| dmp.step(black_box(0.001), black_box(6.0)).map(|s| s.y[0]));
}

#[divan::bench]
fn learning_control_step_7_dofs(bencher: Bencher) {
    let mut dmp = discrete_periodic(7);
    let mut control = LearningControl::new(LearningControlConfig::default(), 7, 1000).unwrap();
    bencher.bench_local(|| {
        if control.samples() == 1000 {
            control.abandon();
            dmp.restart();
        }
        control.step(&mut dmp, 6.0, &[0.01; 7]).unwrap();
        dmp.step(0.001, 6.0).map(|s| s.y[0])
    });
}

#[divan::bench]
fn oscillator_10_harmonics(bencher: Bencher) {
    let mut oscillator = AdaptiveOscillator::new(OscillatorConfig::default()).unwrap();
    let mut phase = 0.0_f64;
    bencher.bench_local(|| {
        phase += 0.006;
        oscillator.update(0.001, &[libm::sin(phase)])
    });
}
