//! Two hands on one thing: they carry it without crushing it, and what they lose is a failure that is named.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

mod ended;

use std::path::Path;

use armarium_host::{RunConfig, RunEnded};

use ended::ended;

/// A run of a shipped chart in the world beside it, changed by `edit`.
fn carried(chart: &str, seed: u64, edit: impl Fn(String) -> String) -> RunEnded {
    let folder = tempfile::tempdir().unwrap();
    let charts = armarium_tests::repository::root().join("statecharts");
    let world = folder.path().join("edited.world.yaml");
    let shipped = charts.join(Path::new(chart).with_extension("world.yaml"));
    std::fs::write(&world, edit(std::fs::read_to_string(shipped).unwrap())).unwrap();
    ended(RunConfig { world: Some(world), seed, ..RunConfig::new(charts.join(chart)) })
}

#[test]
fn a_box_is_carried_between_both_hands_and_put_down() {
    let ended = carried("carry_box.yaml", 1, |world| world);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["carrying"];
    let figure = |key: &str| own[key].as_f64().unwrap();
    assert!(figure("lifted_m") > 0.08 && figure("held") == 1.0, "{own}");
    assert!(figure("internal_least_n") > 5.0 && figure("internal_most_n") < 40.0, "{own}");
    assert!(figure("tilt_deg") < 5.0 && figure("slipped_m") < 0.005, "{own}");
    // What the hands feel is the box.
    let weight = ended.result.outputs["weight"].as_f64().unwrap();
    assert!((weight / (9.81 * figure("mass_kg")) - 1.0).abs() < 0.15, "{weight} {own}");
}

#[test]
fn a_box_that_is_too_smooth_is_lost_and_the_run_says_so() {
    let ended = carried("carry_box.yaml", 1, |world| world.replace("{from: 0.6, to: 0.9}", "0.05"));
    assert_eq!(ended.result.outcome, "failure", "{:?}", ended.report["carrying"]);
}
