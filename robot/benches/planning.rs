//! The duration of planning: `cargo bench -p armarium-robot --bench planning`.

#![allow(clippy::unwrap_used, missing_docs, reason = "a bench that cannot go on says where")]

use std::sync::Arc;

use armarium_robot::Model;
use armarium_robot::planning::{KnownBox, Planner};
use divan::Bencher;
use nalgebra::{Isometry3, Vector3};

fn main() {
    divan::main();
}

fn planner(model: &Arc<Model>, table_height: f64) -> Planner {
    let table = KnownBox {
        name: "table".into(),
        root_from_box: Isometry3::translation(0.25, 0.65, table_height - 0.02),
        size: Vector3::new(1.0, 0.7, 0.04),
    };
    Planner::new(model, &[table])
}

/// The bodies of a robot, and the pairs of them that have to stay apart.
#[divan::bench]
fn a_new_planner(bencher: Bencher) {
    let model = Model::shipped("armar3").unwrap();
    bencher.bench_local(|| planner(&model, 0.95));
}

/// Torso and arm from beside the table to over it.
#[divan::bench(args = [0.7, 0.95])]
fn home_to_ready(bencher: Bencher, table_height: f64) {
    let model = Model::shipped("armar3").unwrap();
    let mut planner = planner(&model, table_height);
    let arm = model.arms().next().unwrap();
    let joints = model.reaching_joints(&arm.name);
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 1;
        planner.plan(&joints, model.start(), model.ready(&arm.name), seed)
    });
}

/// A box that the start is shut up in: the whole budget is spent.
#[divan::bench]
fn no_way(bencher: Bencher) {
    let model = Model::shipped("armar3").unwrap();
    let side = |x: f64, y: f64, size: [f64; 3]| KnownBox {
        name: "cage".into(),
        root_from_box: Isometry3::translation(x, y, 1.2),
        size: size.into(),
    };
    let arm = model.arms().next().unwrap();
    let joints = model.reaching_joints(&arm.name);
    let hand = model.link_pose(model.start(), arm.tcp.unwrap()).translation.vector;
    let sides = [-0.25, 0.25].map(|off| side(hand.x, hand.y + off, [0.8, 0.02, 1.5]));
    let mut planner = Planner::new(&model, &sides);
    bencher.bench_local(|| planner.plan(&joints, model.start(), model.ready(&arm.name), 1));
}
