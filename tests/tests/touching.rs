//! A hand that comes along a table sees what it touches, and grasps what it would have pushed away; and it sees that what it holds slips.

use armarium_host::{RunConfig, RunEnded};

use crate::ended::ended;

fn grasped(world: &str, inputs: &[(&str, &str)]) -> RunEnded {
    run("collision_grasp.yaml", world, 7, inputs)
}

fn run(chart: &str, world: &str, seed: u64, inputs: &[(&str, &str)]) -> RunEnded {
    let charts = armarium_tests::repository::root().join("statecharts");
    let inputs = inputs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    let world = Some(charts.join(world));
    ended(RunConfig { world, seed, inputs, ..RunConfig::new(charts.join(chart)) })
}

#[test]
fn a_box_of_which_the_place_is_told_wrong_is_grasped_by_sight_and_pushed_away_without() {
    for off in ["-0.04", "0.04"] {
        let seen = grasped("collision_grasp.world.yaml", &[("off", off)]);
        assert_eq!(seen.result.outcome, "success", "{:?} {:?}", seen.result.reason, seen.result.chain);
        let touch = &seen.report["touch"];
        assert!(touch["touches"].as_u64() >= Some(1) && touch["in_time"] == touch["touches"], "{touch}");
        assert!(
            touch["right_finger"] == 1.0 && touch["false_alarms"] == 0 && touch["grasped"] == 1,
            "{touch}"
        );
        let felt = grasped("collision_grasp.world.yaml", &[("off", off), ("look", "false")]);
        let touch = &felt.report["touch"];
        assert!(touch["missed"] == 1 && touch["grasped"] == 0, "{touch}");
    }
}

#[test]
fn a_hand_that_passes_is_no_touch() {
    let ended = grasped("passing_hand.world.yaml", &[("off", "0")]);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let touch = &ended.report["touch"];
    assert!(touch["touches"] == 0 && touch["false_alarms"] == 0 && touch["grasped"] == 1, "{touch}");
}

#[test]
fn what_slips_on_the_way_up_is_seen_to_stay_behind() {
    let ended = run("grasp_object.yaml", "slipping.world.yaml", 12, &[("object", "box")]);
    let reason = ended.result.reason.unwrap_or_default();
    assert!(reason.contains("slips: it stays behind, as is seen"), "{reason}");
    let slip = &ended.report["slip"];
    assert!(
        slip["delay_s"].as_f64() <= Some(0.25) && slip["missed"] == 0 && slip["false_alarms"] == 0,
        "{slip}"
    );
}
