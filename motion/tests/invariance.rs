//! Properties that must not change with time, size, phase or frame; and nothing jumps when a constant changes while
//! a primitive runs. For every primitive and law of the crate.

use std::f64::consts::TAU;

use armarium_motion::{
    AdaptiveOscillator, CoachConfig, CoachInput, CoachedMotion, DiscreteDmp, DiscreteDmpConfig,
    DiscretePeriodicConfig, DiscretePeriodicDmp, FeedbackError, LearningControl, LearningControlConfig,
    OscillatorConfig, PeriodicDmp, PeriodicDmpConfig, PhaseSample, PositionServo, PotentialField,
    ServoConfig, ServoObservation, SurfaceAdaptation, SurfaceConfig, TimeSample, differentiate,
};
use nalgebra::{Isometry3, Vector3};

const DT: f64 = 0.002;

fn circle(radius: f64) -> PeriodicDmp {
    let sample = |k: i32| {
        let phase = TAU * f64::from(k) / 200.0;
        let (s, c) = libm::sincos(phase);
        let by = |v: [f64; 3]| v.iter().map(|v| radius * v).collect();
        PhaseSample { phase, y: by([c, s, 0.0]), dy: by([-s, c, 0.0]), ddy: by([-c, -s, 0.0]) }
    };
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
    dmp.learn_batch(&(0..200).map(sample).collect::<Vec<_>>()).unwrap();
    dmp.start_on_path(0.0, 3.0).unwrap();
    dmp
}

fn reach(scale: f64) -> DiscreteDmp {
    let w = TAU / 2.0;
    let sample = |k: i32| {
        let (t, (s, c)) = (f64::from(k) * 0.01, libm::sincos(w * f64::from(k) * 0.01));
        let of = |v: f64| vec![scale * v];
        TimeSample { t, y: of(0.5 - 0.5 * c), yd: of(0.5 * w * s), ydd: of(0.5 * w * w * c) }
    };
    let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::default()).unwrap();
    dmp.learn_batch(&(0..=100).map(sample).collect::<Vec<_>>()).unwrap();
    dmp.begin(&[0.0], &[0.0], 1.0).unwrap();
    dmp
}

/// A step of 1 s, followed by a first harmonic of 1 Hz.
fn walk(scale: f64) -> DiscretePeriodicDmp {
    let height = |t: f64| {
        let s = t.min(1.0);
        scale * (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s) + 0.2 * s * s * s * libm::sin(TAU * t))
    };
    let shown: Vec<Vec<f64>> = (0..=2000).map(|k| vec![height(f64::from(k) * DT)]).collect();
    let mut dmp = DiscretePeriodicDmp::new(DiscretePeriodicConfig::with_dofs(1), TAU, 1.0).unwrap();
    dmp.learn(&differentiate(DT, &shown).unwrap()).unwrap();
    dmp
}

#[test]
fn at_twice_the_frequency_everything_is_the_same_in_half_the_time() {
    let (mut slow, mut fast) = (circle(0.7), circle(0.7));
    fast.start_on_path(0.0, 6.0).unwrap();
    let (mut long, mut short) = (reach(1.0), reach(1.0));
    let (mut stroll, mut run) = (walk(1.0), walk(1.0));
    for _ in 0..800 {
        let (a, b) = (slow.step(DT, 3.0).unwrap(), fast.step(0.5 * DT, 6.0).unwrap());
        for d in 0..2 {
            assert!((a.y[d] - b.y[d]).abs() < 1e-12 && (2.0 * a.yd[d] - b.yd[d]).abs() < 1e-11);
        }
        let (a, b) = (long.step(DT, 1.0).unwrap(), short.step(0.5 * DT, 0.5).unwrap());
        assert!((a.y[0] - b.y[0]).abs() < 1e-12 && (2.0 * a.yd[0] - b.yd[0]).abs() < 1e-11);
        let (a, b) = (stroll.step(DT, TAU).unwrap(), run.step(0.5 * DT, 2.0 * TAU).unwrap());
        assert!((a.y[0] - b.y[0]).abs() < 1e-9, "{} {}", a.y[0], b.y[0]);
    }
}

#[test]
fn what_was_shown_larger_is_done_larger() {
    let (mut one, mut four) = (circle(0.7), circle(2.8));
    let (mut near, mut far) = (reach(1.0), reach(4.0));
    let (mut low, mut high) = (walk(1.0), walk(4.0));
    let radius = |dmp: &PeriodicDmp| {
        let path = dmp.steady_path(64).unwrap();
        path.y.iter().map(|y| y[0] - path.mean()[0]).fold(0.0, f64::max)
    };
    assert!((radius(&one) - 0.7).abs() < 1e-3 && (radius(&four) - 2.8).abs() < 4e-3);
    assert_eq!((far.demonstrated_start(), far.goal()), (&[0.0][..], &[4.0][..]));
    for _ in 0..800 {
        let (a, b) = (one.step(DT, 3.0).unwrap(), four.step(DT, 3.0).unwrap());
        assert!((4.0 * a.y[0] - b.y[0]).abs() < 1e-9 && (4.0 * a.yd[1] - b.yd[1]).abs() < 1e-9);
        let (a, b) = (near.step(DT, 1.0).unwrap(), far.step(DT, 1.0).unwrap());
        assert!((4.0 * a.y[0] - b.y[0]).abs() < 1e-9);
        let (a, b) = (low.step(DT, TAU).unwrap(), high.step(DT, TAU).unwrap());
        assert!((4.0 * a.y[0] - b.y[0]).abs() < 1e-6, "{} {}", a.y[0], b.y[0]);
    }
}

/// Change of position and velocity of the first degree of freedom in the step in which `change` is applied.
fn jump(change: impl FnOnce(&mut PeriodicDmp), omega: f64) -> (f64, f64) {
    let mut dmp = circle(1.0);
    let dt = 1e-6;
    for _ in 0..50 {
        dmp.step(DT, 3.0).unwrap();
    }
    let (y, z) = (dmp.state().y[0], dmp.state().yd[0] / 3.0);
    change(&mut dmp);
    let after = dmp.step(dt, omega).unwrap();
    ((after.y[0] - y).abs(), (after.yd[0] / omega - z).abs())
}

#[test]
fn a_periodic_primitive_does_not_jump_when_it_is_changed_while_it_runs() {
    let changes: [fn(&mut PeriodicDmp); 6] = [
        |d| d.set_amplitude(3.0).unwrap(),
        |d| d.set_centre(&[5.0, 0.0, 0.0]).unwrap(),
        |d| d.set_weights(&[2.0; 75]).unwrap(),
        |d| d.set_phase(3.0).unwrap(),
        |d| d.couple(&[30.0; 3]).unwrap(),
        |d| d.perturb(&[30.0; 3]).unwrap(),
    ];
    for (k, change) in changes.into_iter().enumerate() {
        let (y, z) = jump(change, 3.0);
        assert!(y < 1e-5 && z < 2e-3, "change {k}: {y} {z}");
    }
    let (y, z) = jump(|_| (), 12.0);
    assert!(y < 2e-5 && z < 1e-4, "another frequency: {y} {z}");
}

#[test]
fn goals_durations_and_controls_change_without_a_jump_too() {
    let mut dmp = reach(1.0);
    for _ in 0..200 {
        dmp.step(DT, 1.0).unwrap();
    }
    let before = dmp.state().y[0];
    dmp.set_goal(&[-4.0]).unwrap();
    dmp.set_amplitude(3.0).unwrap();
    assert!((dmp.step(1e-6, 0.3).unwrap().y[0] - before).abs() < 1e-4);

    let mut dmp = walk(1.0);
    for _ in 0..700 {
        dmp.step(DT, TAU).unwrap();
    }
    let before = dmp.state().y[0];
    dmp.set_centre(&[4.0]).unwrap();
    dmp.set_control_weights(&[3.0; 50]).unwrap();
    dmp.correct(&[5.0]).unwrap();
    let after = dmp.step(1e-6, 3.0 * TAU).unwrap();
    assert!((after.y[0] - before).abs() < 1e-4, "{before} {}", after.y[0]);
}

/// Phase (minus that of the signal) and frequency, Hz, of an oscillator after 20 s of a wave of 1.1 Hz.
fn listened(amplitude: f64, start: f64, offset: f64) -> (f64, f64) {
    let mut oscillator = AdaptiveOscillator::new(OscillatorConfig::default()).unwrap();
    let mut phase = start;
    for _ in 0..10_000 {
        phase += TAU * 1.1 * DT;
        let v = offset + 0.7 * libm::sin(phase) + 0.3 * libm::sin(2.0 * phase + 0.5);
        oscillator.update(DT, &[amplitude * v]).unwrap();
    }
    ((oscillator.phase() - phase).rem_euclid(TAU), oscillator.frequency_hz())
}

#[test]
fn the_oscillator_hears_size_and_beginning_of_a_signal_no_more_than_it_should() {
    let (phase, hz) = listened(1.0, 0.0, 0.0);
    assert!((hz - 1.1).abs() < 1e-4);
    for (amplitude, start, offset) in [(4.0, 0.0, 0.0), (0.0625, 0.0, 0.0), (1.0, 2.0, 0.0), (3.0, 5.0, 7.0)]
    {
        let (p, f) = listened(amplitude, start, offset);
        let apart = (p - phase + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
        assert!(apart.abs() < 0.02 && (f / hz - 1.0).abs() < 1e-3, "{amplitude} {start}: {apart} {f}");
    }
}

#[test]
fn a_gesture_moves_the_path_by_the_same_at_every_pace_and_nothing_jumps() {
    let moved = |omega: f64, dt: f64| {
        let mut dmp = circle(0.1);
        let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
        let before = dmp.steady_path(64).unwrap();
        dmp.start_on_path(0.0, omega).unwrap();
        let mut last = dmp.state().y.to_vec();
        for k in 0..(60.0 / dt) as usize {
            // The hand is present for a limited time.
            let hand = Vector3::new(0.25, 0.0, 0.0);
            let input = if k > 100 { CoachInput::Attract { hand } } else { CoachInput::None };
            coach.step(&mut dmp, dt, omega, input).unwrap();
            let y = dmp.step(dt, omega).unwrap().y;
            let went = (0..3).map(|d| (y[d] - last[d]).powi(2)).sum::<f64>().sqrt();
            assert!(went < 2.0 * 0.12 * omega * dt, "{went}");
            last.copy_from_slice(y);
        }
        let after = dmp.steady_path(64).unwrap();
        (0..64).map(|s| after.y[s][0] - before.y[s][0]).fold(f64::NEG_INFINITY, f64::max)
    };
    let [slow, fast] = [moved(1.5, 0.01), moved(6.0, 0.0025)];
    assert!(slow > 0.01 && (slow / fast - 1.0).abs() < 0.1, "{slow} {fast}");
}

#[test]
fn the_coaching_field_knows_no_frame_and_scales_with_its_lengths() {
    let field = PotentialField::default();
    let (o, x, v) = ([0.3, 0.1, -0.2], [0.1, 0.2, 0.1], [0.5, -0.1, 0.3]);
    let strength = field.strength(&o, &x, &v);
    let frame = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.9, -0.4));
    let turned = |p: [f64; 3]| frame.transform_vector(&Vector3::from(p));
    let shifted = |p: [f64; 3]| turned(p) + frame.translation.vector;
    let there = field.strength(shifted(o).as_slice(), shifted(x).as_slice(), turned(v).as_slice());
    assert!((there / strength - 1.0).abs() < 1e-12);
    let larger = PotentialField { eta: field.eta / 3.0, r_m: 3.0 * field.r_m, ..field };
    let scaled = |p: [f64; 3]| p.map(|p| 3.0 * p);
    let there = larger.strength(&scaled(o), &scaled(x), &scaled(v));
    assert!((there / strength - 1.0).abs() < 1e-12);
}

#[test]
fn learning_control_is_linear_in_its_errors() {
    let learned = |scale: f64| {
        let mut dmp = walk(1.0);
        let mut control = LearningControl::new(LearningControlConfig::default(), 1, 2000).unwrap();
        for epoch in 0..3 {
            dmp.restart();
            for k in 0..1500 {
                let (mut e, t) = ([0.0], f64::from(k) * DT);
                let force = scale * libm::sin(t - f64::from(epoch));
                FeedbackError::default().in_task_space(&[force], &[0.1 * force], &mut e).unwrap();
                control.step(&mut dmp, TAU, &e).unwrap();
                dmp.step(DT, TAU).unwrap();
            }
            control.finish(&mut dmp).unwrap();
        }
        dmp.control_weights().to_vec()
    };
    let (one, four) = (learned(1.0), learned(4.0));
    assert!(one.iter().any(|w| w.abs() > 0.1));
    assert!(one.iter().zip(&four).all(|(a, b)| (4.0 * a - b).abs() < 1e-9 * (1.0 + b.abs())));
}

/// Offsets of 5 cycles over a wavy table of `stiff` N/m, with everything `pace` times as fast and `ahead` rad
/// later.
fn wiped(stiff: f64, force: f64, pace: f64, ahead: f64) -> Vec<f64> {
    let config = SurfaceConfig {
        force,
        stiffness: stiff,
        identify: false,
        bandwidth: 7.0 * pace,
        max_speed: 0.12 * pace,
        delay: 0.0,
        ..SurfaceConfig::default()
    };
    let mut adaptation = SurfaceAdaptation::new(config).unwrap();
    let (omega, dt, mut offset) = (3.0 * pace, 0.02 / pace, 0.0);
    let step = |k: i32| {
        let phase = omega * dt * f64::from(k);
        let table = 0.004 * libm::sin(phase) - 0.002;
        offset =
            adaptation.step(dt, phase + ahead, omega, (stiff * (table - offset)).max(0.0)).unwrap().offset;
        offset
    };
    (0..600).map(step).collect()
}

#[test]
fn force_adaptation_scales_with_force_time_and_phase() {
    let one = wiped(2000.0, 8.0, 1.0, 0.0);
    assert!(one.iter().any(|o| o.abs() > 0.003));
    let kernel = TAU / 36.0;
    for (name, other) in [
        ("force", wiped(8000.0, 32.0, 1.0, 0.0)),
        ("time", wiped(2000.0, 8.0, 2.0, 0.0)),
        ("phase", wiped(2000.0, 8.0, 1.0, 7.0 * kernel)),
    ] {
        assert!(one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-9), "{name}");
    }
}

#[test]
fn the_servo_scales_with_distance_and_time_and_knows_no_frame() {
    let config = |gain: f64| ServoConfig {
        gain_far: gain,
        gain_near: gain,
        max_linear: 1e6,
        max_angular: 1e6,
        ..ServoConfig::default()
    };
    let target = Isometry3::new(Vector3::new(0.3, 0.1, 0.9), Vector3::new(0.1, 0.2, 0.3));
    let offset = |scale: f64| {
        let t = scale * Vector3::new(0.15, -0.1, 0.25);
        Isometry3::from_parts(t.into(), Isometry3::rotation(Vector3::new(0.3, -0.5, 1.0)).rotation)
    };
    let hand = |scale: f64| {
        Isometry3::from_parts(
            (target.translation.vector + offset(scale).translation.vector).into(),
            offset(scale).rotation * target.rotation,
        )
    };
    let command = |gain: f64, hand: Isometry3<f64>, target: Isometry3<f64>| {
        let mut servo = PositionServo::new(config(gain)).unwrap();
        servo.step(0.04, Some(&ServoObservation { hand, target })).unwrap()
    };
    let one = command(1.0, hand(1.0), target);
    let farther = command(1.0, hand(4.0), target);
    assert!((4.0 * one.linear - farther.linear).norm() < 1e-12);
    assert!((one.angular - farther.angular).norm() < 1e-12);
    let faster = command(2.0, hand(1.0), target);
    assert!((2.0 * one.linear - faster.linear).norm() + (2.0 * one.angular - faster.angular).norm() < 1e-12);
    let frame = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.9, -0.4));
    let turned = command(1.0, frame * hand(1.0), frame * target);
    assert!((frame.rotation * one.linear - turned.linear).norm() < 1e-12);
    assert!((frame.rotation * one.angular - turned.angular).norm() < 1e-12);
    let nudge = Isometry3::new(Vector3::repeat(1e-6), Vector3::repeat(1e-6));
    let nudged = command(1.0, hand(1.0) * nudge, target);
    assert!((one.linear - nudged.linear).norm() + (one.angular - nudged.angular).norm() < 1e-5);
}
