//! The shipped charts do with the left arm what they do with the right one, in the mirrored kitchen.

use std::path::Path;
use std::time::Duration;

use armarium_host::{RunConfig, RunEnded};

use crate::ended::ended;

/// A run of a chart, with inputs.
fn with_inputs(chart: &Path, inputs: &[(&str, &str)]) -> RunEnded {
    ended(RunConfig {
        inputs: inputs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect(),
        longest: Some(Duration::from_secs(200)),
        ..RunConfig::new(chart)
    })
}

fn shipped(name: &str) -> std::path::PathBuf {
    armarium_tests::repository::root().join("statecharts").join(name)
}

#[test]
fn the_left_hand_grasps_what_lies_at_the_left() {
    let ended = with_inputs(&shipped("grasp_object.yaml"), &[("object", "sponge"), ("arm", "left_arm")]);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let error = ended.report["grasp"]["position_error_m"].as_f64().unwrap();
    assert!(error < 0.015, "{error} m");
    assert_eq!(ended.report["world"], "kitchen_mirrored");
}

/// Both arms move at the same time, each in a region of its own; the torso helps the one that took it first.
#[test]
fn both_arms_move_at_the_same_time() {
    const CHART: &str = "
statechart: Both
initial: Move
states:
  Move:
    parallel:
      Right:
        initial: A
        states:
          A: {skill: MoveJoints, with: {arm: right_arm, posture: wipe}, transitions: {success: Done}}
          Done: {final: success}
      Left:
        initial: A
        states:
          A: {skill: MoveJoints, with: {arm: left_arm, posture: wipe}, transitions: {success: Done}}
          Done: {final: success}
    transitions: {success: Done, failure: Failed}
  Done: {final: success}
  Failed: {final: failure}
";
    let folder = tempfile::tempdir().unwrap();
    let chart = folder.path().join("both.yaml");
    std::fs::write(&chart, CHART).unwrap();
    // Over the kitchen's table the left arm would meet it.
    std::fs::write(folder.path().join("both.world.yaml"), "world: low\ntable: {height: 0.5}\n").unwrap();
    let ended = with_inputs(&chart, &[]);
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
}
