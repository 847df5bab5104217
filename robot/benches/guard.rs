//! The duration of the guard's control step: `cargo bench -p armarium-robot`.

#![allow(clippy::unwrap_used, missing_docs, reason = "a bench that cannot go on says where")]

use std::sync::Arc;

use armarium_robot::{Guard, GuardConfig, Lease, LeaseLimits, Model, Robot, Sample};
use divan::Bencher;

fn main() {
    divan::main();
}

/// Both arms and the torso follow a wave about a posture, `amplitude` rad wide.
fn step(bencher: Bencher, amplitude: f64) {
    let model = Model::shipped("armar3").unwrap();
    let (mut guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::default());
    let limbs = ["left_arm", "right_arm", "torso"];
    let leases: Vec<Lease> =
        limbs.iter().map(|limb| robot.lease(limb, "bench", LeaseLimits::default()).unwrap()).collect();
    let mut sample = Sample::resting(&model, model.zero());
    let mut now_ms = 0_u64;
    bencher.bench_local(|| {
        now_ms += 1;
        let speed = amplitude * (now_ms as f64 * 2e-3).sin();
        for (lease, limb) in leases.iter().zip(limbs) {
            let speeds: Vec<f64> = model.limb(limb).iter().map(|_| speed).collect();
            let _ = lease.command(&speeds);
        }
        // Never the same wrench twice: a frozen sensor is a fault.
        for wrench in &mut sample.wrenches {
            wrench.force.x = 1e-3 * speed + 1e-9 * now_ms as f64;
        }
        let targets = guard.step(now_ms * 1_000_000, &sample);
        sample.position.copy_from_slice(&targets.position);
        sample.velocity.copy_from_slice(&targets.velocity);
    });
}

#[divan::bench]
fn standing(bencher: Bencher) {
    step(bencher, 0.0);
}

#[divan::bench]
fn both_arms_moving(bencher: Bencher) {
    step(bencher, 0.5);
}
