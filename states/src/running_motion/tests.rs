//! Owner, editors and memory: no edit is lost, from any source, and the last version in memory is the one that ran.

use std::f64::consts::TAU;

use armarium_memoryx::tokio_clock;
use armarium_motion::{CoachConfig, CoachInput, CoachedMotion, PeriodicDmpConfig, PhaseSample};
use nalgebra::Vector3;

use super::*;

/// A circle of 0.1 m in memory, and nothing that runs.
async fn memory_with_motion() -> (Arc<dyn Memory>, EntityId, RunningMotions) {
    let mut circle = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
    let sample = |k: u32| {
        let phase = TAU * f64::from(k) / 200.0;
        let (s, c) = (0.1 * libm::sin(phase), 0.1 * libm::cos(phase));
        PhaseSample { phase, y: vec![c, s, 0.7], dy: vec![-s, c, 0.0], ddy: vec![-c, -s, 0.0] }
    };
    circle.learn_batch(&(0..200).map(sample).collect::<Vec<_>>()).unwrap();
    let memory: Arc<dyn Memory> = Arc::new(armarium_knowledge::working_memory(tokio_clock()));
    let id = motions::address("bob", "wiping").unwrap();
    let motion = Motion::in_space("wiping", "root", 0.5, circle).unwrap();
    motions::store(&*memory, &id, &motion, 0).await.unwrap();
    (memory, id, RunningMotions::default())
}

async fn latest(memory: &Arc<dyn Memory>, id: &EntityId) -> Motion {
    motions::load(&**memory, id).await.unwrap().0
}

/// Another writer's change of the motion in memory: adds `difference` to the first weight.
async fn write_elsewhere(memory: &Arc<dyn Memory>, id: &EntityId, difference: f64) {
    let (motion, version) = motions::load(&**memory, id).await.unwrap();
    let mut primitive = motion.primitive().clone();
    let mut weights = primitive.weights().to_vec();
    weights[0] += difference;
    primitive.set_weights(&weights).unwrap();
    let next = motion.next_version(primitive, "elsewhere").unwrap();
    let commit = motions::commit(id, &next, 0, Some(version)).unwrap();
    memory.commit(vec![commit]).await.unwrap();
}

fn add(editor: &MotionEditor, weight: usize, difference: f64) {
    let added = editor.edit(|motion, _| {
        let mut weights = motion.weights().to_vec();
        weights[weight] += difference;
        motion.set_weights(&weights)
    });
    added.unwrap();
}

fn near(motion: &PeriodicDmp, weight: usize, before: &PeriodicDmp, difference: f64) {
    let changed = motion.weights()[weight] - before.weights()[weight];
    assert!((changed - difference).abs() < 1e-9, "weight {weight} changed by {changed}");
}

#[tokio::test(start_paused = true)]
async fn coaches_that_run_in_parallel_lose_nothing_and_memory_gets_it_all() {
    let (memory, id, running) = memory_with_motion().await;
    let before = latest(&memory, &id).await;
    let mut owner = running.own(&memory, &id).await.unwrap();
    let coach = |weight: usize| {
        let editor = running.edit(&id).unwrap();
        tokio::spawn(async move {
            for _ in 0..500 {
                add(&editor, weight, 1e-3);
                add(&editor, 5, 1e-3);
                tokio::time::sleep(Duration::from_micros(700)).await;
            }
        })
    };
    let coaches = [coach(1), coach(2)];
    for k in 0..700_u64 {
        owner.step(1e-3, 3.0, k * 1_000_000).unwrap();
        if k == 200 || k == 333 {
            write_elsewhere(&memory, &id, 0.25).await;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    for coach in coaches {
        coach.await.unwrap();
    }
    owner.step(1e-3, 3.0, 700_000_000).unwrap();
    for (weight, difference) in [(0, 0.5), (1, 0.5), (2, 0.5), (5, 1.0)] {
        near(&owner.dmp, weight, before.primitive(), difference);
    }
    let ran = owner.dmp.clone();
    owner.finish(None, None).await.unwrap();
    let kept = latest(&memory, &id).await;
    let same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
    assert!(kept.primitive().weights().iter().zip(ran.weights()).all(same));
    assert!(kept.version() > before.version() + 2);
}

#[tokio::test(start_paused = true)]
async fn an_edit_is_seen_at_once_and_is_executed_in_the_next_step() {
    let (memory, id, running) = memory_with_motion().await;
    let mut owner = running.own(&memory, &id).await.unwrap();
    owner.start_on_path(0.3).unwrap();
    let one = running.edit(&id).unwrap();
    let other = running.edit(&id).unwrap();
    owner.step(1e-3, 3.0, 0).unwrap();
    let mut coach = CoachedMotion::new(CoachConfig::default(), &one.view().unwrap()).unwrap();
    let push = CoachInput::Push { force: Vector3::new(9.0, 0.0, 0.0) };
    let report = one.edit(|motion, omega| coach.step(motion, 1e-3, omega, push)).unwrap();
    assert!(report.active && (report.phase - owner.state().phase).abs() < 1e-12);
    assert_eq!(other.view().unwrap().weights(), one.view().unwrap().weights());
    assert_ne!(owner.dmp.weights(), one.view().unwrap().weights());
    owner.step(1e-3, 3.0, 1).unwrap();
    assert_eq!(owner.dmp.weights(), one.view().unwrap().weights());
}

#[tokio::test(start_paused = true)]
async fn what_was_learned_of_the_surface_is_kept() {
    let (memory, id, running) = memory_with_motion().await;
    let mut owner = running.own(&memory, &id).await.unwrap();
    owner.set_height(0.75).unwrap();
    let surface = SurfaceCorrection::new(vec![0.001; 36], 90.0, [0.0, 0.0, 1.0]).unwrap();
    owner.finish(Some(&surface), Some("force adaptation")).await.unwrap();
    let kept = latest(&memory, &id).await;
    assert_eq!(kept.surface(), Some(&surface));
    assert_eq!((kept.version(), kept.learned_from()), (2, "force adaptation"));
    assert!((kept.primitive().centre()[2] - 0.75).abs() < 1e-12);
    // Nothing has changed: no new version.
    running.own(&memory, &id).await.unwrap().finish(None, None).await.unwrap();
    assert_eq!(latest(&memory, &id).await.version(), 2);
}

#[tokio::test(start_paused = true)]
async fn a_motion_has_one_owner_and_none_after_it_has_ended() {
    let (memory, id, running) = memory_with_motion().await;
    assert!(running.edit(&id).is_err());
    let owner = running.own(&memory, &id).await.unwrap();
    let second = running.own(&memory, &id).await.err().unwrap();
    assert!(second.reason.contains("already being executed"), "{}", second.reason);
    let editor = running.edit(&id).unwrap();
    owner.finish(None, None).await.unwrap();
    assert!(editor.edit(|_, _| Ok(())).is_err());
    // An owner that is dropped without `finish` releases the motion as well.
    drop(running.own(&memory, &id).await.unwrap());
    drop(running.own(&memory, &id).await.unwrap());
}

#[tokio::test(start_paused = true)]
async fn a_version_that_cannot_be_executed_ends_the_run() {
    let (memory, id, running) = memory_with_motion().await;
    let mut owner = running.own(&memory, &id).await.unwrap();
    let other =
        PeriodicDmp::new(PeriodicDmpConfig { kernels: 30, ..PeriodicDmpConfig::with_dofs(3) }).unwrap();
    let motion = Motion::in_space("wiping", "root", 0.5, other).unwrap();
    motions::store(&*memory, &id, &motion, 0).await.unwrap();
    tokio::time::sleep(Duration::from_millis(1)).await;
    let refused = owner.step(1e-3, 3.0, 0).err().unwrap();
    assert!(refused.reason.contains("weights"), "{}", refused.reason);
}
