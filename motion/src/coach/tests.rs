//! Pushes, gestures and shifts on simulated wiping loops.

use super::*;
use crate::{PeriodicDmpConfig, PeriodicPath, PhaseSample};
use std::f64::consts::TAU;

const SAMPLES: usize = 200;
const DT: f64 = 0.005;

fn shape(kind: &str, size: [f64; 2], phase: f64) -> [Vector3<f64>; 3] {
    let (a, b) = (0.5 * size[0], 0.5 * size[1]);
    let (k, turn) = match kind {
        "eight" => (2.0, 0.0),
        "line" => (1.0, 0.0),
        _ => (1.0, TAU / 4.0),
    };
    let (p, q) = (phase, k * phase + turn);
    [
        Vector3::new(a * libm::sin(p) + 0.3, b * libm::sin(q) + 0.5, 1.0),
        Vector3::new(a * libm::cos(p), b * k * libm::cos(q), 0.0),
        Vector3::new(-a * libm::sin(p), -b * k * k * libm::sin(q), 0.0),
    ]
}

fn wiping(kind: &str, size: [f64; 2]) -> PeriodicDmp {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
    let samples: Vec<PhaseSample> = (0..SAMPLES)
        .map(|s| {
            let phase = TAU * s as f64 / SAMPLES as f64;
            let [y, dy, ddy] = shape(kind, size, phase).map(|v| v.as_slice().to_vec());
            PhaseSample { phase, y, dy, ddy }
        })
        .collect();
    dmp.learn_batch(&samples).unwrap();
    dmp
}

fn point(path: &PeriodicPath, phase: f64) -> Vector3<f64> {
    Vector3::from_column_slice(&path.y[((phase / TAU).rem_euclid(1.0) * SAMPLES as f64) as usize % SAMPLES])
}

struct Change {
    at_phase: Vector3<f64>,
    far_rms: f64,
}

fn change(before: &PeriodicPath, after: &PeriodicPath, phase: f64) -> Change {
    let (mut sum, mut count) = (0.0, 0.0);
    for s in 0..SAMPLES {
        let away = (before.phase(s) - phase + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
        if away.abs() > TAU / 4.0 {
            sum += (point(after, before.phase(s)) - point(before, before.phase(s))).norm_squared();
            count += 1.0;
        }
    }
    Change { at_phase: point(after, phase) - point(before, phase), far_rms: f64::sqrt(sum / count) }
}

/// Runs `seconds` (or until the coach has gone) with `input(phase passed, dmp)`, then two cycles without input.
fn coached(
    dmp: &mut PeriodicDmp,
    hz: f64,
    seconds: f64,
    start: f64,
    input: impl Fn(f64, &PeriodicDmp) -> CoachInput,
) -> (PeriodicPath, PeriodicPath, PeriodicPath) {
    coached_with(dmp, hz, seconds, start, None, input)
}

/// As [`coached`], for a hand that arrived at the phase `came`.
fn coached_with(
    dmp: &mut PeriodicDmp,
    hz: f64,
    seconds: f64,
    start: f64,
    came: Option<f64>,
    input: impl Fn(f64, &PeriodicDmp) -> CoachInput,
) -> (PeriodicPath, PeriodicPath, PeriodicPath) {
    let mut coach = CoachedMotion::new(CoachConfig::default(), dmp).unwrap();
    coach.set_arrival(came);
    let before = dmp.steady_path(SAMPLES).unwrap();
    let omega = TAU * hz;
    dmp.start_on_path(start, omega).unwrap();
    let mut passed = start;
    for _ in 0..(seconds / DT) as usize {
        let input = input(passed, dmp);
        coach.step(dmp, DT, omega, input).unwrap();
        dmp.step(DT, omega).unwrap();
        passed += omega * DT;
    }
    let after = dmp.steady_path(SAMPLES).unwrap();
    for _ in 0..(2.0 / hz / DT) as usize {
        coach.step(dmp, DT, omega, CoachInput::None).unwrap();
        dmp.step(DT, omega).unwrap();
    }
    let later = dmp.steady_path(SAMPLES).unwrap();
    (before, after, later)
}

/// A fist for a positive `sign`, otherwise two fingers.
fn gesture(sign: f64, hand: Vector3<f64>) -> CoachInput {
    if sign > 0.0 { CoachInput::Attract { hand } } else { CoachInput::Repel { hand } }
}

#[test]
fn pushes_move_the_path_where_and_whither_they_push() {
    // How far around its middle a push is felt, in turn.
    let mut half_arcs = [0.15, 0.2].into_iter().cycle();
    // Two directions at each place: all four with each shape, size and phase.
    let mut turns = [[0.0, 2.5], [1.0, 4.0], [4.0, 1.0], [2.5, 0.0]].into_iter().cycle();
    for kind in ["ellipse", "eight", "line"] {
        for size in [[0.10, 0.06], [0.16, 0.12]] {
            for phase in [0.25, 0.5, 0.9] {
                for turn in turns.next().expect("it has no end") {
                    let half_arc = half_arcs.next().expect("it has no end");
                    let mut moved = Vec::new();
                    for hz in [0.3, 0.5, 0.8] {
                        let direction = Vector3::new(libm::cos(turn), libm::sin(turn), 0.0);
                        let push = |force: f64, cycles: f64| {
                            let mut dmp = wiping(kind, size);
                            let (before, after, later) =
                                coached(&mut dmp, hz, cycles / hz, 0.3, |passed, _| {
                                    let away = (passed / TAU - phase + 0.5).rem_euclid(1.0) - 0.5;
                                    // Rises and falls like a hand's push; forces below the threshold are not
                                    // passed on.
                                    let felt = force
                                        * libm::cos(TAU / 4.0 * (away.abs() / half_arc).min(1.0)).powi(2);
                                    if felt > 4.0 {
                                        CoachInput::Push { force: felt * direction }
                                    } else {
                                        CoachInput::None
                                    }
                                });
                            assert_eq!(after, later);
                            change(&before, &after, phase * TAU)
                        };
                        let c = push(12.0, 6.0);
                        let along = c.at_phase.dot(&direction);
                        assert!(along > 0.02 && along < 0.06, "{kind} {phase} {turn} {hz}: {along}");
                        assert!(c.at_phase.angle(&direction) < 0.2);
                        assert!(c.far_rms < 0.005, "far {}", c.far_rms);
                        let (stronger, longer, weaker) = (push(20.0, 6.0), push(12.0, 10.0), push(6.0, 6.0));
                        assert!(stronger.at_phase.dot(&direction) > along + 0.002);
                        assert!(longer.at_phase.dot(&direction) > along + 0.002);
                        assert!(weaker.at_phase.dot(&direction) < along - 0.002);
                        let most = push(40.0, 20.0);
                        let far = most.at_phase.dot(&direction);
                        assert!(far < 0.065 && most.far_rms < 0.008, "{far} {}", most.far_rms);
                        moved.push(along);
                    }
                    assert!(moved[2] / moved[0] < 1.1 && moved[0] / moved[2] < 1.1, "{moved:?}");
                }
            }
        }
    }
}

#[test]
fn gestures_move_the_near_side_and_end_there() {
    for size in [[0.10, 0.06], [0.16, 0.12]] {
        for hz in [0.18, 0.3, 0.5, 0.8] {
            for phase in [0.0, 0.25, 0.4, 0.75] {
                for (sign, name) in [(1.0, "fist"), (-1.0, "point two")] {
                    for start in [0.0, 2.0, 4.0] {
                        let mut dmp = wiping("ellipse", size);
                        let [y, ..] = shape("ellipse", size, phase * TAU);
                        let outward = (y - Vector3::new(0.3, 0.5, 1.0)).normalize();
                        let hand = y + outward * 0.12 + Vector3::new(0.0, 0.0, 0.05);
                        let (before, after, later) =
                            coached(&mut dmp, hz, 12.0, start, |_, _| gesture(sign, hand));
                        assert_eq!(after, later);
                        let c = change(&before, &after, phase * TAU);
                        let along = sign * c.at_phase.dot(&outward);
                        assert!(
                            along > 0.012 && along < 0.05,
                            "{name} {size:?} {hz} Hz at {phase} from {start}: {along}"
                        );
                        assert!(c.far_rms < 0.005, "{name} {hz} far {}", c.far_rms);
                    }
                }
            }
        }
    }
}

#[test]
fn a_hand_that_goes_takes_nothing_back() {
    let mut dmp = wiping("ellipse", [0.1, 0.06]);
    let [y, ..] = shape("ellipse", [0.1, 0.06], 0.75 * TAU);
    let hand = y - 0.12 * Vector3::y();
    let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
    let omega = TAU * 0.3;
    dmp.start_on_path(0.0, omega).unwrap();
    let mut stood = None;
    for k in 0..2600 {
        let t = f64::from(k) * DT;
        let gone = (t - 12.0).clamp(0.0, 1.0);
        let away = 0.35 * gone.powi(3) * (10.0 - 15.0 * gone + 6.0 * gone * gone);
        if t > 12.0 && stood.is_none() {
            stood = Some(dmp.steady_path(SAMPLES).unwrap());
        }
        let seen = hand + Vector3::new(away, -0.3 * away, 0.1 * away);
        coach.step(&mut dmp, DT, omega, CoachInput::Attract { hand: seen }).unwrap();
        dmp.step(DT, omega).unwrap();
    }
    let (stood, later) = (stood.unwrap(), dmp.steady_path(SAMPLES).unwrap());
    let change = change(&stood, &later, 0.75 * TAU);
    assert!(
        change.at_phase.norm() < 0.002 && change.far_rms < 0.002,
        "{:?} {}",
        change.at_phase,
        change.far_rms
    );
}

#[test]
fn of_a_line_or_an_eight_the_pass_moves_that_the_hand_came_with() {
    for (kind, phase, outward) in [
        ("line", 0.0, [-1.0, 1.6]),
        ("line", 0.0, [1.0, -1.6]),
        ("line", 0.5, [0.0, -1.0]),
        ("line", 0.25, [1.0, 1.0]),
        ("eight", 0.25, [1.0, 0.0]),
        ("eight", 0.0, [0.0, -1.0]),
        ("eight", 0.5, [0.0, -1.0]),
        ("eight", 0.5, [0.0, 1.0]),
        ("eight", 0.125, [0.0, 1.0]),
        ("eight", 0.375, [0.0, -1.0]),
    ] {
        for (hz, size) in
            [(0.18, [0.12, 0.08]), (0.3, [0.12, 0.04]), (0.5, [0.12, 0.08]), (0.8, [0.08, 0.05])]
        {
            for (sign, late) in
                [(1.0, 0.0), (-1.0, 0.0), (1.0, 0.05), (-1.0, 0.05), (1.0, -0.05), (-1.0, -0.05)]
            {
                let mut dmp = wiping(kind, size);
                let outward = Vector3::new(outward[0], outward[1], 0.0).normalize();
                let [y, ..] = shape(kind, size, phase * TAU);
                let hand = y + 0.11 * outward;
                let came = Some((phase + late) * TAU);
                let (before, after, _) =
                    coached_with(&mut dmp, hz, 11.0, phase * TAU + 1.0, came, |_, _| gesture(sign, hand));
                let c = change(&before, &after, phase * TAU);
                let along = sign * c.at_phase.dot(&outward);
                let what = format!("{kind} {phase} {outward:?} {size:?} {hz} Hz {sign} {late}");
                assert!(along > 0.01 && along < 0.05, "{what}: {along}");
                assert!(c.far_rms < 0.004, "{what}: far {}", c.far_rms);
            }
        }
    }
}

#[test]
fn pointing_shifts_the_whole_motion() {
    let mut dmp = wiping("eight", [0.12, 0.08]);
    let direction = Vector3::new(0.0, 0.04, 0.3);
    let (before, after, _) = coached(&mut dmp, 0.5, 8.0, 0.0, |_, _| CoachInput::Shift { direction });
    for s in 0..SAMPLES {
        let moved = point(&after, before.phase(s)) - point(&before, before.phase(s));
        assert!((moved - Vector3::new(0.0, 0.04, 0.0)).norm() < 1e-9, "{moved}");
    }
}

#[test]
fn a_refused_step_changes_nothing() {
    let mut dmp = wiping("ellipse", [0.1, 0.1]);
    let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
    let weights = dmp.weights().to_vec();
    let hand = Vector3::new(f64::NAN, 0.0, 0.0);
    assert!(coach.step(&mut dmp, DT, 3.0, CoachInput::Attract { hand }).is_err());
    assert!(coach.step(&mut dmp, -DT, 3.0, CoachInput::Push { force: Vector3::x() }).is_err());
    assert!(coach.step(&mut dmp, DT, f64::NAN, CoachInput::Push { force: Vector3::x() }).is_err());
    let mut other = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(2)).unwrap();
    assert!(coach.step(&mut other, DT, 3.0, CoachInput::Push { force: Vector3::x() }).is_err());
    assert_eq!(dmp.weights(), weights);
    assert!(CoachedMotion::new(CoachConfig::default(), &other).is_err());
}

#[test]
fn a_stored_field_with_the_angle_that_never_acted_is_read_or_refused_with_what_to_do() {
    let read = |text: &str| serde_json::from_str::<CoachConfig>(text);
    let earlier = r#"{"field": {"gamma": 1.0, "eta": 60.0, "r_m": 0.25, "beta": 0.0}, "reach": 0.024}"#;
    assert_eq!(read(earlier).unwrap(), CoachConfig::default());
    let said = read(r#"{"field": {"beta": -2.5}}"#).unwrap_err().to_string();
    assert!(said.contains("field.beta") && said.contains("leave it out"), "{said}");
    let text = serde_json::to_string(&CoachConfig::default()).unwrap();
    assert_eq!(read(&text).unwrap(), CoachConfig::default());
}

#[test]
fn an_arm_moves_the_near_part_along_its_direction_in_space() {
    for (phase, direction) in [
        (0.0, -Vector3::x()),
        (0.25, Vector3::y()),
        (0.5, Vector3::z()),
        (0.75, Vector3::new(0.3, 0.8, -0.5)),
    ] {
        let mut dmp = wiping("ellipse", [0.16, 0.12]);
        let start = dmp.steady_path(SAMPLES).unwrap();
        let on_path = point(&start, TAU * phase);
        let at = on_path + (on_path - centre_of(&dmp)).normalize() * 0.12;
        let config = CoachConfig { normal: [0.0; 3], ..CoachConfig::default() };
        let mut coach = CoachedMotion::new(config, &dmp).unwrap();
        let omega = TAU * 0.3;
        dmp.start_on_path(0.3, omega).unwrap();
        for step in 0..(14.0 / DT) as usize {
            // A body is seen less exactly than a hand.
            let jitter = 0.015 * libm::sin(step as f64 * DT * 9.0) * Vector3::new(1.0, -1.0, 1.0);
            coach.step(&mut dmp, DT, omega, CoachInput::Along { at: at + jitter, direction }).unwrap();
            dmp.step(DT, omega).unwrap();
        }
        let end = dmp.steady_path(SAMPLES).unwrap();
        let Change { at_phase, far_rms } = change(&start, &end, TAU * phase);
        let moved = at_phase.dot(&direction.normalize());
        assert!((0.022..0.037).contains(&moved), "{phase}: {moved}");
        assert!((at_phase - moved * direction.normalize()).norm() < 0.004, "{phase}: {at_phase}");
        assert!(far_rms < 0.005, "{phase}: {far_rms}");
    }
    let mut dmp = wiping("ellipse", [0.16, 0.12]);
    let mut coach = CoachedMotion::new(CoachConfig::default(), &dmp).unwrap();
    let wrong = CoachInput::Along { at: Vector3::zeros(), direction: Vector3::repeat(f64::NAN) };
    assert!(coach.step(&mut dmp, DT, 1.0, wrong).is_err());
}
