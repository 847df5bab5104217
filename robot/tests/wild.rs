//! URDFs as they are in the wild: they are read, and inverse kinematics moves their arms. Optional: the variable
//! `ARMARIUM_URDFS` names a folder with URDFs, for instance that of the Python package `example-robot-data`
//! (`pip download --no-deps example-robot-data`, unpacked).

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may fail, and says what it did")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_robot::description;
use armarium_robot::planning::Planner;
use armarium_robot::{Limb, Model, PoseOptions, solve_pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Poses for each arm.
const POSES: usize = 100;

fn urdfs(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            urdfs(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "urdf") {
            found.push(path);
        }
    }
}

/// Random configurations of an arm that are looked at for one that is free of collision.
const TRIES: usize = 200;

/// The shares, each of 1, of random reachable poses, free of collision where such are found, that are found with 5 restarts, and
/// from the home posture alone.
fn reached(model: &Arc<Model>, arm: &Limb) -> (f64, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let tcp = arm.tcp.unwrap();
    let options = |restarts| PoseOptions {
        position_tolerance: 1e-3,
        orientation_tolerance: 0.5_f64.to_radians(),
        margin: 0.0,
        iterations: 300,
        restarts,
        ..PoseOptions::default()
    };
    let mut planner = Planner::new(model, &[]);
    let (mut all, mut from_home) = (0, 0);
    for _ in 0..POSES {
        let mut goal = model.start().to_vec();
        for _ in 0..TRIES {
            for &j in &arm.joints {
                let joint = &model.joints()[j];
                let (lower, upper) = (joint.lower.max(-3.1), joint.upper.min(3.1));
                goal[j] = rng.random_range(lower..=upper.max(lower));
            }
            if planner.nearest(&goal).is_none_or(|near| near.distance_m > 0.0) {
                break;
            }
        }
        let target = model.link_pose(&goal, tcp);
        let mut solve = |restarts| {
            solve_pose(model, tcp, &arm.joints, &target, model.start(), &options(restarts), &mut rng)
        };
        let (home, found) = (solve(0), solve(5));
        from_home += usize::from(home.is_ok());
        if let Ok(q) = found {
            all += 1;
            for (q, joint) in q.iter().zip(model.joints()) {
                assert!(*q >= joint.lower - 1e-9 && *q <= joint.upper + 1e-9, "{} at {q}", joint.name);
            }
        }
    }
    (all as f64 / POSES as f64, from_home as f64 / POSES as f64)
}

#[test]
fn robots_of_the_wild_are_read_and_reach() {
    let Some(folder) = std::env::var_os("ARMARIUM_URDFS") else {
        eprintln!("NOT RUN: ARMARIUM_URDFS names no folder with URDFs of the wild");
        return;
    };
    let mut files = Vec::new();
    urdfs(Path::new(&folder), &mut files);
    let (mut read, mut refused, mut arms, mut weak) = (0, Vec::new(), 0, Vec::new());
    for file in &files {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        match description::load(file, &[]) {
            Ok(found) => {
                read += 1;
                let meshes = found.warnings.iter().filter(|w| w.message.contains("meshes")).count();
                let model = found.model;
                eprintln!(
                    "{name}: {} links, {} joints, limbs {:?}, {} warnings, {meshes} about meshes",
                    model.links().len(),
                    model.joints().len(),
                    model.limbs().keys().collect::<Vec<_>>(),
                    found.warnings.len(),
                );
                for arm in model.arms().filter(|arm| arm.joints.len() >= 6) {
                    let (all, from_home) = reached(&model, arm);
                    arms += 1;
                    if all < 0.95 || from_home < 0.5 {
                        weak.push(format!("{name} {}: {all} of all, {from_home} from home", arm.name));
                    }
                }
            }
            Err(wrong) => refused.push(wrong.first().map_or_else(String::new, ToString::to_string)),
        }
    }
    eprintln!("{read} of {} read, {arms} arms; refused: {refused:#?}; weak: {weak:#?}", files.len());
    assert!(!files.is_empty(), "there is no URDF in {}", folder.display());
    assert!(refused.len() * 23 <= files.len(), "{refused:#?}");
    assert!(weak.is_empty(), "{weak:#?}");
}
