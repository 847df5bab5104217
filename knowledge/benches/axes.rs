//! The four axes by which Peller-Konrad et al. (arXiv 2206.02241) compare memories: transfer, compression,
//! reproduction, prediction. The scene has a standing cup and a cup on a circular path, both observed 30 times a
//! second for a minute, and a third cup that is left in one of three places each day: `cargo bench -p armarium-knowledge`.

#![allow(clippy::print_stdout, reason = "it prints figures")]

use std::sync::Arc;

use armarium_knowledge::UsualPlaces;
use armarium_knowledge::infer::{USUAL_PLACES, conclude_once};
use armarium_memoryx::{
    Commit, Consolidator, EntityId, LongTermMemory, Memory, MemoryLimits, Pattern, Policies, Policy, Query,
    Times, distance, place_of,
};
use armarium_values::{Frame, Value, Vector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[allow(dead_code, reason = "the benchmark of memory uses all of it")]
#[path = "../../memoryx/benches/memory/meter.rs"]
mod meter;

use meter::{Meter, say};

const HZ: u64 = 30;
const SECONDS: u64 = 60;
const DAY_NS: u64 = 86_400_000_000_000;
/// Where the cup is left, and on how many of ten days.
const PLACES: [([f64; 3], u32); 3] = [([1.0, 0.5, 1.2], 6), ([-1.0, 0.5, 0.9], 3), ([0.0, 2.0, 0.8], 1)];

fn cup(name: &str, at: [f64; 3], time_ns: u64) -> Commit {
    let id = EntityId::new("ObjectInstances", "vision", name).expect("a name");
    let position = Vector { frame: Frame::root(), components: at };
    Commit::new(id, time_ns, [("class", Value::from("cup")), ("position", position.into())])
}

/// A circle of 0.2 m radius, once in ten seconds: 0.126 m/s.
fn round(time_ns: u64) -> [f64; 3] {
    let angle = time_ns as f64 * 1e-9 * std::f64::consts::TAU / 10.0;
    [0.2 * libm::cos(angle), 0.6 + 0.2 * libm::sin(angle), 0.85]
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    for (name, policy) in [
        ("everything", Policy::Everything),
        ("on change", Policy::OnChange),
        ("at most 10 Hz", Policy::AtMost { hz: 10.0 }),
        ("at most 1 Hz", Policy::AtMost { hz: 1.0 }),
    ] {
        by_policy(name, policy);
    }
    prediction().await;
}

fn by_policy(name: &str, policy: Policy) {
    let folder = tempfile::tempdir().expect("a folder");
    let store = Arc::new(LongTermMemory::open(&folder.path().join("axes.redb")).expect("a file"));
    let kept = Consolidator::new(Arc::clone(&store), Policies::all(policy)).expect("it can be read");
    let memory = armarium_knowledge::working_memory(Arc::new(|| 0)).with_backing(Arc::new(kept));
    let (frames, step_ns) = (HZ * SECONDS, 1_000_000_000 / HZ);
    let start = Meter::start();
    for frame in 0..frames {
        let time_ns = frame * step_ns;
        let both = vec![cup("standing", [0.4, 0.6, 0.85], time_ns), cup("moving", round(time_ns), time_ns)];
        memory.commit_now(both).expect("it fits");
    }
    start.say(&format!("transfer, {name}: durable updates of two"), frames * 2);
    let stats = store.stats().expect("it can be read");
    say(&format!("compression, {name}: kept"), stats.snapshots as f64 * 100.0 / (frames * 2) as f64, "%", "");
    say(
        &format!("compression, {name}: a kept snapshot"),
        stats.bytes as f64 / stats.snapshots as f64,
        "bytes",
        "",
    );
    let (mut sum, mut most, asked) = (0.0, 0.0_f64, 997);
    let pattern = Pattern::segment("ObjectInstances").named("moving");
    for i in 1..=asked {
        let time_ns = i * (frames - 1) * step_ns / (asked + 1);
        let found =
            store.query(&Query::latest(pattern.clone()).times(Times::At(time_ns))).expect("it can be read");
        let place = found.first().and_then(|s| place_of(s)).expect("it was seen before").1;
        let error = distance(&place, &round(time_ns));
        (sum, most) = (sum + error, most.max(error));
    }
    say(
        &format!("reproduction, {name}: mean error of the moving one"),
        sum * 1000.0 / asked as f64,
        "mm",
        "",
    );
    say(&format!("reproduction, {name}: largest"), most * 1000.0, "mm", "");
}

/// Guesses the most probable place each day, before the cup is looked for.
async fn prediction() {
    let memory = armarium_knowledge::working_memory(Arc::new(|| 0))
        .with_limits(MemoryLimits { history: 10_000, ..MemoryLimits::default() });
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut guessed, mut surprise, mut days) = (0, 0.0, 0);
    for day in 1..=200_u64 {
        let mut left = random.random_range(0..10);
        let today = PLACES.iter().find(|(_, often)| {
            let is_here = left < *often;
            left = left.saturating_sub(*often);
            is_here
        });
        let today = today.map_or(PLACES[0].0, |(place, _)| *place);
        conclude_once(&memory, &UsualPlaces, day * DAY_NS).await.expect("it can be concluded");
        let known = memory.segment(USUAL_PLACES).await.expect("it can be read");
        let chance = |s: &armarium_memoryx::Snapshot| s.instance().map_or(0.0, |i| i.confidence);
        let is_there =
            |s: &armarium_memoryx::Snapshot| place_of(s).is_some_and(|(_, at)| distance(&at, &today) < 0.3);
        if day > 10 {
            days += 1;
            let best = known.iter().max_by(|a, b| chance(a).total_cmp(&chance(b)));
            guessed += u32::from(best.is_some_and(|s| is_there(s)));
            surprise -= libm::log2(known.iter().find(|s| is_there(s)).map_or(0.01, |s| chance(s)));
        }
        memory.commit_now(vec![cup("cup", today, day * DAY_NS + 1)]).expect("it fits");
    }
    say(
        "prediction: the cup was where it was likeliest",
        f64::from(guessed) * 100.0 / f64::from(days),
        "%",
        "best: 60",
    );
    let entropy: f64 = PLACES.iter().map(|(_, n)| f64::from(*n) / 10.0).map(|p| -p * libm::log2(p)).sum();
    say("prediction: surprise a day", surprise / f64::from(days), "bits", &format!("entropy: {entropy:.2}"));
}
