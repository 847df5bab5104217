//! A person leads the hand: with little force, and the hand stands when it is shoved, left alone, or when its sensor fails.

use armarium_host::{RunConfig, RunEnded};

use crate::ended::ended;

/// A run of `guide.yaml` in a shipped world.
fn guided(world: &str, seed: u64) -> RunEnded {
    led("guide.yaml", world, seed)
}

/// A run of a shipped chart in a shipped world.
fn led(chart: &str, world: &str, seed: u64) -> RunEnded {
    let charts = armarium_tests::repository::root().join("statecharts");
    ended(RunConfig { world: Some(charts.join(world)), seed, ..RunConfig::new(charts.join(chart)) })
}

#[test]
fn a_hand_is_led_with_little_force_to_where_the_person_wants_it() {
    let ended = guided("guide.world.yaml", 3);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let led = &ended.report["guiding"]["leads"][0];
    let figure = |key: &str| led[key].as_f64().unwrap();
    assert!(figure("way_m") > 0.4, "{led}");
    assert!(figure("mean_n") < 10.0 && figure("peak_n") < 20.0 && figure("behind_m") < 0.04, "{led}");
    // Who is felt by the skill is the person.
    let way = ended.result.outputs["way"].as_f64().unwrap();
    assert!((way / figure("way_m") - 1.0).abs() < 0.1, "{way} {led}");
}

#[test]
fn a_shove_is_given_way_to_and_the_hand_can_be_led_after_it() {
    let ended = guided("guide_shove.world.yaml", 5);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let shove = &ended.report["guiding"]["pushes"][0];
    assert!(
        shove["gave_m"].as_f64().unwrap() < 0.05 && shove["stood_after_s"].as_f64().unwrap() < 0.2,
        "{shove}"
    );
    assert_eq!(ended.report["guiding"]["leads"].as_array().unwrap().len(), 1);
}

#[test]
fn a_frozen_sensor_ends_it_with_a_reason_and_the_arm_stands() {
    let ended = guided("guide_frozen.world.yaml", 2);
    assert_eq!(ended.result.outcome, "failure");
    let reason = ended.result.reason.unwrap_or_default();
    assert!(reason.contains("has not changed for 100 ms"), "{reason}");
    let stood = ended.report["guiding"]["frozen_stood_after_s"].as_f64();
    assert!(stood.is_some_and(|s| s < 0.25), "{stood:?}");
}

#[test]
fn what_was_led_is_kept_and_played_again() {
    for world in ["teach.world.yaml", "teach_rhythm.world.yaml"] {
        let ended = led("teach.yaml", world, 1);
        assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
        let off = ended.report["guiding"]["played_rms_m"].as_f64();
        assert!(off.is_some_and(|off| off < 0.01), "{world}: {off:?}");
    }
}

#[test]
fn both_hands_are_led_at_once() {
    let ended = led("guide_both.yaml", "guide_both.world.yaml", 1);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let leads = ended.report["guiding"]["leads"].as_array().unwrap();
    let arms: Vec<_> = leads.iter().map(|led| led["arm"].as_u64()).collect();
    assert_eq!(arms.len(), 2, "{leads:?}");
    assert_ne!(arms[0], arms[1]);
    for led in leads {
        assert!(led["mean_n"].as_f64().unwrap() < 10.0 && led["way_m"].as_f64().unwrap() > 0.1, "{led}");
    }
}

#[test]
fn a_platform_follows_a_hand_that_is_led_beyond_the_arms_reach() {
    let ended = led("guide.yaml", "guide_far.world.yaml", 1);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let led = &ended.report["guiding"]["leads"][0];
    let figure = |key: &str| led[key].as_f64().unwrap();
    assert!(figure("way_m") > 0.4 && figure("behind_m") < 0.04, "{led}");
    assert!(figure("mean_n") < 10.0 && figure("peak_n") < 20.0, "{led}");
}
