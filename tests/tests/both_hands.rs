//! Two hands on one thing: they carry it without crushing it, and what they lose is a failure that is named.

use std::path::Path;
use std::sync::Arc;

use armarium_host::{Console, RunConfig, RunEnded, Silent, run};

use crate::ended::ended;

/// Two runs of the learning chart with the same memory: so many epochs each.
fn days(epochs: [&str; 2]) -> [RunEnded; 2] {
    let folder = tempfile::tempdir().unwrap();
    let chart = armarium_tests::repository::root().join("statecharts/learn_together.yaml");
    [("first", epochs[0]), ("second", epochs[1])].map(|(day, epochs)| {
        let config = RunConfig {
            report: folder.path().join(day),
            store: folder.path().join("memory.redb"),
            inputs: vec![("epochs".into(), epochs.into())],
            ..RunConfig::new(&chart)
        };
        let console: Arc<dyn Console> = Arc::new(Silent);
        run(&config, &console).expect("the run begins")
    })
}

#[test]
fn two_hands_learn_to_lift_and_shake_a_box_and_go_on_from_there_the_next_day() {
    let [first, second] = days(["6", "1"]);
    for day in [&first, &second] {
        assert_eq!(day.result.outcome, "success", "{:?} {:?}", day.result.reason, day.result.chain);
        assert!(day.report["learning_together"]["held"] == 1.0, "{}", day.report["learning_together"]);
    }
    let figure = |day: &RunEnded, key: &str| day.report["learning_together"][key].as_f64().unwrap();
    assert!(figure(&first, "distance_fell") > 10.0, "{}", first.report["learning_together"]);
    assert_eq!(figure(&second, "epochs_before"), 6.0);
    assert!(figure(&second, "first_rms_m") < 0.2 * figure(&first, "first_rms_m"));
}

/// Fingers come nearer to the table than the guard lets them come to what nobody works on.
#[test]
fn hands_come_beside_a_low_box() {
    let chart = armarium_tests::repository::root().join("statecharts/learn_together.yaml");
    let ended =
        ended(RunConfig { seed: 60, inputs: vec![("epochs".into(), "1".into())], ..RunConfig::new(&chart) });
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
}

/// A run of a shipped chart in the world beside it, changed by `edit`.
fn carried(chart: &str, seed: u64, edit: impl Fn(String) -> String) -> RunEnded {
    let folder = tempfile::tempdir().unwrap();
    let charts = armarium_tests::repository::root().join("statecharts");
    let world = folder.path().join("edited.world.yaml");
    let shipped = charts.join(Path::new(chart).with_extension("world.yaml"));
    std::fs::write(&world, edit(std::fs::read_to_string(shipped).unwrap())).unwrap();
    ended(RunConfig { world: Some(world), seed, ..RunConfig::new(charts.join(chart)) })
}

/// Asks what is asked of a box that is carried between both hands.
fn is_carried_well(ended: &RunEnded) {
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["carrying"];
    let figure = |key: &str| own[key].as_f64().unwrap();
    assert!(figure("lifted_m") > 0.05 && figure("held") == 1.0, "{own}");
    assert!(figure("internal_least_n") > 5.0 && figure("internal_most_n") < 45.0, "{own}");
    assert!(figure("tilt_deg") < 3.0 && figure("slipped_m") < 0.005, "{own}");
    // They press as its weight asks, and what they feel is the box.
    assert!(figure("squeeze_rms_n") < 3.0 && figure("mass_error").abs() < 0.05, "{own}");
    assert!(figure("put_down_n") < 15.0 && figure("put_down_moved_m") < 0.005, "{own}");
}

#[test]
fn a_box_is_carried_between_both_hands_and_put_down_though_it_and_an_arm_are_shoved() {
    let charts = armarium_tests::repository::root().join("statecharts");
    let world = Some(charts.join("carry_box_shoved.world.yaml"));
    is_carried_well(&ended(RunConfig { world, seed: 1, ..RunConfig::new(charts.join("carry_box.yaml")) }));
}

#[test]
fn a_box_is_driven_to_another_table_and_put_down_there() {
    let ended = carried("carry_far.yaml", 1, |world| world);
    is_carried_well(&ended);
    assert!(ended.report["carrying"]["way_m"].as_f64().unwrap() > 2.5, "{}", ended.report["carrying"]);
}

#[test]
fn a_tray_with_a_cup_is_driven_to_another_table_and_put_down_there_though_it_is_shoved() {
    let ended = carried("carry_tray_far.yaml", 2, |world| world);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["carrying"];
    let figure = |key: &str| own[key].as_f64().unwrap();
    assert!(figure("way_m") > 2.5 && figure("held") == 1.0 && figure("mass_error").abs() < 0.05, "{own}");
    assert!(
        figure("tilt_deg") < 3.0 && figure("sloshed_deg") < 12.0 && figure("upon_moved_m") < 0.01,
        "{own}"
    );
    assert!(figure("put_down_n") < 15.0 && figure("put_down_moved_m") < 0.005, "{own}");
}

#[test]
fn a_box_that_is_too_heavy_to_be_held_is_put_down_before_it_falls() {
    let ended = carried("carry_box.yaml", 1, |world| world.replace("{from: 1 kg, to: 3 kg}", "5.5 kg"));
    assert_eq!(ended.result.outcome, "put_down", "{:?}", ended.result.reason);
    let own = &ended.report["carrying"];
    let figure = |name: &str| own[name].as_f64().unwrap_or(f64::NAN);
    assert!(figure("internal_most_n") < 45.0, "{own}");
    assert!(
        figure("tilt_deg") < 3.0 && figure("slipped_m") < 0.005 && figure("put_down_moved_m") < 0.005,
        "{own}"
    );
}

#[test]
fn both_hands_come_to_the_handles_of_a_tray_with_cameras_that_are_elsewhere() {
    let ended = carried("lift_tray.yaml", 2, |world| world);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["reaching"];
    let figure = |key: &str| own[key].as_f64().unwrap();
    assert!(figure("error_m") < 0.005 && figure("angle_deg") < 3.0 && figure("apart_s") < 0.2, "{own}");
}

#[test]
fn a_box_that_is_too_smooth_is_lost_and_the_run_says_so() {
    let ended = carried("carry_box.yaml", 1, |world| world.replace("{from: 0.6, to: 0.9}", "0.05"));
    assert_eq!(ended.result.outcome, "failure", "{:?}", ended.report["carrying"]);
}

#[test]
fn a_tray_is_gripped_at_its_handles_carried_level_and_put_down() {
    // With contacts that do not turn with the load, this one would be jolted by its handles to 20 degrees.
    let ended = carried("carry_tray.yaml", 8, |world| world);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let own = &ended.report["carrying"];
    let figure = |key: &str| own[key].as_f64().unwrap();
    assert!(own["gripped"] == true && figure("lifted_m") > 0.05 && figure("held") == 1.0, "{own}");
    assert!(figure("tilt_deg") < 3.0 && figure("slipped_m") < 0.005, "{own}");
    assert!(figure("sloshed_deg") < 6.0 && figure("upon_moved_m") < 0.01, "{own}");
    assert!(figure("mass_error").abs() < 0.05, "{own}");
}
