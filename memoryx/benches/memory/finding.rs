//! What is found by class or place among a million things, beside the same question without an index (a filter in other words).

use std::sync::Arc;

use armarium_memoryx::{Commit, Pattern, Query, SpatialRegion, WorkingMemory};
use armarium_values::{Frame, Value, Vector};

use super::{Meter, at_most, id, median, say};

const ENTITIES: u64 = 1_000_000;
const CLASSES: u64 = 10_000;
const TIMES: usize = 21;

/// Where a thing is: all over a hall of 100 m by 100 m by 4 m.
fn place(n: u64) -> [f64; 3] {
    let part = |prime: u64, most: u64| (n.wrapping_mul(prime) % (most * 1000)) as f64 * 1e-3;
    [part(7919, 100), part(104_729, 100), part(1_299_709, 4)]
}

pub(super) fn finding() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    for group in 0..ENTITIES / 1000 {
        let update = |n: u64| {
            let position = Value::Vector(Vector { frame: Frame::root(), components: place(n) });
            let class = Value::String(format!("class{}", n % CLASSES));
            Commit::new(id(n), n, [("class", class), ("position", position)])
        };
        memory.commit_now((group * 1000..(group + 1) * 1000).map(update).collect()).expect("it fits");
    }
    let frame = Frame::root;
    let inside = SpatialRegion::Box { frame: frame(), min: [9.0, 9.0, 0.0], max: [11.0, 10.0, 2.0] };
    let within = SpatialRegion::Within { frame: frame(), of: [50.0, 50.0, 1.0], radius: 1.0 };
    let nearest = SpatialRegion::Nearest { frame: frame(), to: [20.0, 70.0, 1.0], count: 10 };
    let all = || Query::latest(Pattern::any());
    let asked = [
        ("of one class in 10 000", all().filter("class == 'class77'")),
        ("in a box of 2 m by 1 m by 2 m", Query { region: Some(inside), ..all() }),
        ("within 1 m", Query { region: Some(within), ..all() }),
        ("the 10 nearest", Query { region: Some(nearest), ..all() }),
        ("of one class, without the index", all().filter("!(class != 'class77')")),
    ];
    for (what, query) in asked {
        let times = if what.contains("without") { 1 } else { TIMES };
        let mut found = 0;
        let one = |_| {
            let start = Meter::start();
            found = memory.query_now(&query).expect("an answer").len();
            start.elapsed()
        };
        let took = median((0..times).map(one).collect());
        let words = format!("{what}, of {ENTITIES} ({found} found)");
        match what.contains("without") {
            true => say(&words, took * 1e-3, "ms", ""),
            false => at_most(&words, took * 1e-3, "ms", 5.0),
        }
    }
}
