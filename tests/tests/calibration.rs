//! Cameras that are mounted otherwise than believed are calibrated by a tool in the hand, without the marker on it.

use std::fs;
use std::sync::Arc;

use armarium_host::simulated::memory_of_run;
use armarium_host::{Console, RunConfig, Silent, run};
use armarium_simulator::World;
use armarium_values::Value;
use nalgebra::{Isometry3, Point3, Vector3};

const KNOWN: &str = "AgentInstances";

#[test]
fn a_tool_in_the_hand_tells_where_the_cameras_are() {
    let folder = tempfile::tempdir().unwrap();
    let charts = armarium_tests::repository::root().join("statecharts");
    for name in ["calibrate_by_tool.yaml", "approach_along.yaml"] {
        fs::copy(charts.join(name), folder.path().join(name)).unwrap();
    }
    // The tool is taken without a look at the marker.
    let grasp = fs::read_to_string(charts.join("grasp_object.yaml")).unwrap();
    let (before, rest) = grasp.split_once("  Calibrate:\n").unwrap();
    let (_, after) = rest.split_once("  Aside:\n").unwrap();
    let before = before.replace("success: Calibrate", "success: Aside");
    fs::write(folder.path().join("grasp_object.yaml"), format!("{before}  Aside:\n{after}")).unwrap();
    // Exact joints, so that the truth is the mounting alone.
    let world = fs::read_to_string(charts.join("calibrate_by_tool.world.yaml")).unwrap();
    let (shift, turn_deg) = ([0.008, -0.005, 0.004], [1.0, -1.5, 1.0]);
    let mounting = format!(
        "mounting_error: {{distance: 0, angle_deg: 0, position: {shift:?}, rotation_deg: {turn_deg:?}}}"
    );
    let world = format!("{world}\nphysics: ideal\ncamera: {{{mounting}}}\n");
    let world_file = folder.path().join("calibrate_by_tool.world.yaml");
    fs::write(&world_file, world).unwrap();
    let store = folder.path().join("memory.redb");
    let config = RunConfig {
        report: folder.path().join("report"),
        store: store.clone(),
        remember: vec![KNOWN.to_owned()],
        ..RunConfig::new(folder.path().join("calibrate_by_tool.yaml"))
    };
    let console: Arc<dyn Console> = Arc::new(Silent);
    let ended = run(&config, &console).unwrap();
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let memory = memory_of_run(&World::load(&world_file, 1).unwrap(), &store, &[KNOWN.to_owned()]).unwrap();
    let known = memory.memory().latest_now(&format!("{KNOWN}/local/hand_eye").parse().unwrap()).unwrap();
    let Some(Value::Pose(found)) = known.attribute("believed_from_left") else { panic!("{known:?}") };
    let turn = Vector3::from(turn_deg).map(f64::to_radians);
    let truth = Isometry3::new(Vector3::from(shift), turn);
    for place in [[-0.1, -0.1, 0.5], [0.1, -0.1, 0.5], [0.1, 0.1, 0.65], [-0.1, 0.1, 0.65]] {
        let place = Point3::from(place);
        let (before, after) = (place - truth * place, found.isometry() * place - truth * place);
        assert!(before.norm() > 0.01 && after.norm() < 0.004, "{before:?} {after:?}");
    }
}
