//! The duration of the guard's control step: `cargo bench -p armarium-robot`.

#![allow(clippy::unwrap_used, missing_docs, reason = "a bench that cannot go on says where")]

use std::sync::Arc;

use armarium_robot::planning::KnownBox;
use armarium_robot::{Guard, GuardConfig, Lease, LeaseLimits, Load, LoadShape, Model, Robot, Sample};
use divan::Bencher;
use nalgebra::{Isometry3, Point3, Vector3};

fn main() {
    divan::main();
}

/// Both arms and the torso follow a wave about a posture, `amplitude` rad wide, over a known table, with something in one hand.
fn step(bencher: Bencher, amplitude: f64) {
    let model = Model::shipped("armar3").unwrap();
    let (mut guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::default());
    let table = KnownBox {
        name: "table".into(),
        root_from_box: Isometry3::translation(0.25, 0.6, 0.94),
        size: Vector3::new(1.0, 0.7, 0.02),
    };
    robot.set_surroundings(vec![table]).unwrap();
    let shape = Some(LoadShape {
        tcp_from_box: Isometry3::translation(0.08, 0.0, 0.0),
        size: Vector3::new(0.04, 0.1, 0.07),
    });
    let load = Load { name: "sponge".into(), mass_kg: 0.15, center_in_tcp: Point3::origin(), shape };
    robot.set_load("right_hand", Some(load)).unwrap();
    let limbs = ["left_arm", "right_arm", "torso"];
    let leases: Vec<Lease> =
        limbs.iter().map(|limb| robot.lease(limb, "bench", LeaseLimits::default()).unwrap()).collect();
    let mut sample = Sample::resting(&model, model.ready("right_arm").to_vec());
    let mut now_ms = 0_u64;
    bencher.bench_local(|| {
        now_ms += 1;
        let speed = amplitude * libm::sin(now_ms as f64 * 2e-3);
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
