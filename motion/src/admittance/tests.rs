use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;

use super::*;

const DT: f64 = 1e-3;

fn hand() -> Admittance {
    Admittance::new(AdmittanceConfig::default()).unwrap()
}

fn pushed(force: f64) -> Vector6<f64> {
    Vector6::new(force, 0.0, 0.0, 0.0, 0.0, 0.0)
}

fn energy(config: &AdmittanceConfig, twist: &Vector6<f64>) -> f64 {
    let (linear, angular) = parts(twist);
    0.5 * (config.mass * linear.norm_squared() + config.inertia * angular.norm_squared())
}

/// A person who holds the hand with a spring and a damper, and swings a mass of their own along with it. The hand follows the
/// law after a dead time. All of it along x.
struct Swing {
    stiffness: f64,
    damping: f64,
    own_mass: f64,
    delay: usize,
}

impl Swing {
    /// The displacement of the hand in each step, released at `start` m.
    fn run(&self, law: &mut Admittance, start: f64, steps: usize) -> Vec<f64> {
        let (mut x, mut v) = (start, 0.0);
        let mut late = vec![0.0; self.delay + 1];
        let mut places = Vec::with_capacity(steps);
        for k in 0..steps {
            let slot = k % late.len();
            let next = late[slot];
            let force = -self.stiffness * x - self.damping * v - self.own_mass * (next - v) / DT;
            v = next;
            x += v * DT;
            late[slot] = law.step(DT, &pushed(force), &Vector3::new(x, 0.0, 0.0)).unwrap().twist.x;
            places.push(x);
        }
        places
    }
}

proptest! {
    #[test]
    fn it_never_gives_back_more_energy_than_it_got(
        mass in 0.5..20.0_f64,
        damping in 0.0..60.0_f64,
        friction in 0.0..5.0_f64,
        max_linear in 0.05..1.0_f64,
        inputs in prop::collection::vec((prop::array::uniform6(-25.0..25.0_f64), 1e-4..0.1_f64), 1..200)
    ) {
        // The zero does not move: otherwise the energy would count against another wrench.
        let zero_time = f64::MAX;
        let config = AdmittanceConfig { mass, damping, friction, max_linear, zero_time, shove: 1e9, ..AdmittanceConfig::default() };
        let mut law = Admittance::new(config.clone()).unwrap();
        let (mut place, mut stored) = (Vector3::zeros(), 0.0);
        for (k, (wrench, dt)) in inputs.into_iter().enumerate() {
            let wrench = Vector6::from(wrench);
            let mut twist = law.step(dt, &wrench, &place).unwrap().twist;
            if k % 5 == 0 {
                // The hand comes to a wall across x.
                twist.x = 0.0;
                law.hold_to(&twist).unwrap();
            }
            let now = energy(&config, &twist);
            prop_assert!(now - stored <= dt * wrench.dot(&twist) + 1e-9, "{now} after {stored}");
            stored = now;
            place += twist.fixed_rows::<3>(0) * dt;
        }
    }

    #[test]
    fn the_energy_of_hand_and_person_together_never_grows(
        stiffness in 100.0..800.0_f64,
        damping in 5.0..40.0_f64,
        start in -0.03..0.03_f64,
    ) {
        let config = AdmittanceConfig { zero_time: f64::MAX, ..AdmittanceConfig::default() };
        let mut law = Admittance::new(config.clone()).unwrap();
        let (mut x, mut v) = (start, 0.0);
        let mut before = 0.5 * stiffness * x * x;
        for _ in 0..8000 {
            let wrench = pushed(-stiffness * x - damping * v);
            let twist = law.step(DT, &wrench, &Vector3::new(x, 0.0, 0.0)).unwrap().twist;
            v = twist.x;
            x += v * DT;
            let together = energy(&config, &twist) + 0.5 * stiffness * x * x;
            prop_assert!(together <= before + 1e-12, "{together} after {before}");
            before = together;
        }
        prop_assert!(stiffness * x.abs() <= config.friction + 1e-9, "it rests where the friction holds it");
    }

    #[test]
    fn every_person_and_hand_come_to_rest_though_the_drives_lag(
        stiffness in 100.0..800.0_f64,
        damping in 5.0..40.0_f64,
        own_mass in 1.0..3.0_f64,
    ) {
        let person = Swing { stiffness, damping, own_mass, delay: 25 };
        let places = person.run(&mut hand(), 0.02, 5000);
        let last = &places[4500..];
        prop_assert!(last.iter().all(|x| (x - last[0]).abs() < 1e-9), "it still swings");
        prop_assert!(stiffness * last[0].abs() < 2.0, "{}", last[0]);
    }
}

#[test]
fn less_than_the_friction_moves_nothing_and_more_moves_it_at_once() {
    let mut law = hand();
    for _ in 0..500 {
        let step = law.step(DT, &pushed(1.4), &Vector3::zeros()).unwrap();
        assert_eq!((step.status, step.twist), (GuidingStatus::Resting, Vector6::zeros()));
    }
    let step = law.step(DT, &pushed(1.7), &Vector3::zeros()).unwrap();
    assert!(step.status == GuidingStatus::Led && step.twist.x > 0.0);
}

#[test]
fn a_steady_force_moves_it_as_its_damping_and_friction_say() {
    let c = AdmittanceConfig::default();
    let mut law = hand();
    let mut place = Vector3::zeros();
    let mut last = None;
    for _ in 0..5000 {
        let step = law.step(DT, &pushed(6.0), &place).unwrap();
        place += step.twist.fixed_rows::<3>(0) * DT;
        last = Some(step);
    }
    let last = last.unwrap();
    assert!((last.twist.x - (6.0 - c.friction) / last.damping).abs() < 1e-6);
    let mut law = hand();
    let turn = Vector6::new(0.0, 0.0, 0.0, 0.0, 0.35, 0.0);
    let twist = (0..5000).map(|_| law.step(DT, &turn, &Vector3::zeros()).unwrap().twist).last().unwrap();
    assert!((twist[4] - (0.35 - c.turning_friction) / c.turning_damping).abs() < 1e-6);
}

#[test]
fn a_sensor_that_drifts_moves_nothing_and_the_hand_can_be_led_after_it() {
    let mut law = hand();
    for k in 0..600_000_u32 {
        // 0.01 N/s, far beyond the friction in the end.
        let step = law.step(DT, &pushed(1e-5 * f64::from(k)), &Vector3::zeros()).unwrap();
        assert_eq!(step.status, GuidingStatus::Resting, "after {k} ms");
    }
    assert!((law.zero().x - 5.9).abs() < 0.01);
    let moved: f64 =
        (0..500).map(|_| DT * law.step(DT, &pushed(6.0 + 5.0), &Vector3::zeros()).unwrap().twist.x).sum();
    assert!(moved > 0.02, "{moved}");
}

#[test]
fn the_stiffness_of_who_swings_is_found_and_damped() {
    // Nearly no damping of the hand or of the person, so that it swings.
    let config = AdmittanceConfig { damping: 2.0, friction: 0.1, ..AdmittanceConfig::default() };
    for stiffness in [300.0, 500.0, 800.0] {
        let person = Swing { stiffness, damping: 5.0, own_mass: 1.0, delay: 25 };
        let swings = |config: AdmittanceConfig| {
            let mut law = Admittance::new(config).unwrap();
            let places = person.run(&mut law, 0.02, 4000);
            let late = places[2000..].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            (late, law.stiffness())
        };
        let (without, seen) = swings(AdmittanceConfig { lag: 0.0, ..config.clone() });
        let (with, _) = swings(config.clone());
        // The share of it that does not move the person's own hand.
        let expected = stiffness * config.mass / (config.mass + person.own_mass);
        assert!((seen / expected - 1.0).abs() < 0.3, "{seen} instead of {expected}");
        assert!(with < without / 3.0, "{stiffness} N/m: {without} m without it, {with} m with it");
    }
}

#[test]
fn a_shove_stops_it_for_good_and_says_how_hard_it_was() {
    let mut law = hand();
    law.step(DT, &pushed(10.0), &Vector3::zeros()).unwrap();
    for force in [40.0, 60.0, 5.0] {
        law.step(DT, &pushed(force), &Vector3::zeros()).unwrap();
    }
    let step = law.step(DT, &pushed(5.0), &Vector3::zeros()).unwrap();
    assert_eq!((step.status, step.twist), (GuidingStatus::Shoved(60.0), Vector6::zeros()));
}

#[test]
fn what_is_no_number_is_refused_and_changes_nothing() {
    let mut law = hand();
    let first = law.step(DT, &pushed(8.0), &Vector3::zeros()).unwrap();
    let nan = Vector3::new(f64::NAN, 0.0, 0.0);
    assert!(law.step(DT, &pushed(f64::NAN), &Vector3::zeros()).is_err());
    assert!(law.step(DT, &pushed(1.0), &nan).is_err());
    assert!(law.step(0.0, &pushed(1.0), &Vector3::zeros()).is_err());
    assert!(law.hold_to(&pushed(f64::INFINITY)).is_err());
    let mut fresh = hand();
    assert_eq!(first, fresh.step(DT, &pushed(8.0), &Vector3::zeros()).unwrap());
    let next = |law: &mut Admittance| law.step(DT, &pushed(8.0), &Vector3::zeros()).unwrap();
    assert_eq!(next(&mut law), next(&mut fresh));
    assert!(Admittance::new(AdmittanceConfig { mass: 0.0, ..AdmittanceConfig::default() }).is_err());
}
