//! The charts that ship run with every robot that ships: each grasps; the one whose cameras stand in the room also wipes with a
//! motion that is recalled.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use armarium_host::simulated::memory_of_run;
use armarium_memoryx::{Commit, EntityId};
use armarium_motion::{Motion, PeriodicDmp, PeriodicDmpConfig, PhaseSample};
use armarium_robot::description::shipped_robots;
use armarium_simulator::World;
use armarium_values::Value;

/// Where the charts that ship are.
const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../statecharts");

/// Runs a chart that ships in an empty folder. Returns its report.
fn run(folder: &Path, chart: &str, args: &[&str]) -> serde_json::Value {
    let chart = Path::new(SHIPPED).join(chart);
    let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
    let output = program.current_dir(folder).arg("run").arg(chart).args(args).output().expect("it starts");
    let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert_eq!(output.status.code(), Some(0), "{args:?}: {said}");
    let text = std::fs::read_to_string(folder.join("report/report.json")).expect("there is a report");
    serde_json::from_str(&text).expect("it is JSON")
}

fn figure(report: &serde_json::Value, of: &str, name: &str) -> f64 {
    report[of][name].as_f64().expect("the report has the figure")
}

#[test]
fn every_robot_grasps() {
    for robot in shipped_robots() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let report = run(folder.path(), "grasp_object.yaml", &["--robot", robot, "--set", "object=sponge"]);
        let error = figure(&report, "grasp", "position_error_m");
        assert!(error < 0.01, "{robot}: {error}");
    }
}

/// Paths are planned beside the robot's control; neither that nor other work of the machine changes a run.
#[test]
fn a_run_is_the_same_while_the_machine_is_busy() {
    let trace = || {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let report = run(folder.path(), "grasp_object.yaml", &["--set", "object=sponge"]);
        report["trace_sha256"].as_str().expect("the report has it").to_owned()
    };
    let alone = trace();
    let done = AtomicBool::new(false);
    let busy = std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) + 1 {
            scope.spawn(|| {
                let mut sum = 0_u64;
                while !done.load(Ordering::Relaxed) {
                    sum = std::hint::black_box(sum.wrapping_mul(3).wrapping_add(1));
                }
            });
        }
        let busy = trace();
        done.store(true, Ordering::Relaxed);
        busy
    });
    assert_eq!(alone, busy);
}

/// From one metre before its place, turned by some degrees.
#[test]
fn a_robot_on_a_platform_drives_to_the_table_and_grasps() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let chart = "\
statechart: DriveAndGrasp
initial: Drive
states:
  Drive:
    skill: MovePlatform
    with: {to: [0.0, 0.0, 0.0]}
    transitions: {success: Grasp, failure: Failed}
  Grasp:
    statechart: GraspObject
    with: {object: sponge}
    transitions: {success: Done, failure: Failed}
  Done: {final: success}
  Failed: {final: failure}
";
    let file = folder.path().join("drive.yaml");
    std::fs::write(&file, chart).expect("it is written");
    let world = "world: far\nrobot: {model: rover2, at: [0.1, -1.0], yaw_deg: 15}\n";
    std::fs::write(folder.path().join("far.yaml"), world).expect("it is written");
    let args = ["--charts", SHIPPED, "--world", "far.yaml"];
    let report = run(folder.path(), &file.to_string_lossy(), &args);
    assert!(figure(&report, "grasp", "position_error_m") < 0.01, "{report}");
}

/// A helper stands where the arm reaches, and drives away when it is asked. Each robot runs its own chart.
#[test]
fn two_robots_of_a_world_run_two_charts_that_speak_to_each_other() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("it is written");
        folder.path().join(name).to_string_lossy().into_owned()
    };
    let ask = "\
statechart: AskAndGrasp
probes: [grasp]
events: {there_is_room: {}}
initial: Ask
states:
  Ask:
    enter: [{send: {event: make_room, to: helper}}]
    transitions: {there_is_room: Grasp}
    after: {60s: Failed}
  Grasp:
    statechart: GraspObject
    with: {object: sponge}
    transitions: {success: Done, failure: Failed}
  Done: {final: success}
  Failed: {final: failure}
";
    let make_room = "\
statechart: MakeRoom
inputs: {back: float}
events: {make_room: {}}
initial: Wait
states:
  Wait: {transitions: {make_room: Drive}}
  Drive:
    skill: MovePlatform
    with: {to: [\"${inputs.back}\", 0.0, 0.0]}
    transitions: {success: Tell, failure: Failed}
  Tell:
    enter: [{send: {event: there_is_room, to: local}}]
    always: Done
  Done: {final: success}
  Failed: {final: failure}
";
    let chart = write("ask.yaml", ask);
    write("make_room.yaml", make_room);
    let world = |back: &str| {
        format!(
            "world: two\nrobots:\n  - {{name: helper, model: rover2, at: [0.3, 1.6], yaw_deg: 180, \
             runs: make_room.yaml, inputs: {{back: {back}}}}}\n"
        )
    };
    write("two.yaml", &world("-0.6"));
    let report = run(folder.path(), &chart, &["--charts", SHIPPED, "--world", "two.yaml"]);
    assert!(figure(&report, "grasp", "position_error_m") < 0.01, "{report}");
    assert_eq!(report["robots"]["helper"]["outcome"], "success", "{report}");
}

/// Keeps a flat ellipse over the table of the default world in a store, as a run would that has learned it.
fn keep_ellipse(store: &Path) {
    let world = World::default();
    let samples: Vec<PhaseSample> = (0..200)
        .map(|k| {
            let phase = TAU * f64::from(k) / 200.0;
            let (sin, cos) = libm::sincos(phase);
            PhaseSample {
                phase,
                y: vec![0.28 + 0.05 * cos, 0.53 + 0.03 * sin, 1.05],
                dy: vec![-0.05 * sin, 0.03 * cos, 0.0],
                ddy: vec![-0.05 * cos, -0.03 * sin, 0.0],
            }
        })
        .collect();
    let config = PeriodicDmpConfig { dofs: 3, ..PeriodicDmpConfig::default() };
    let mut primitive = PeriodicDmp::new(config).expect("its constants are possible");
    primitive.learn_batch(&samples).expect("it is learned");
    let motion = Motion::in_space("ellipse", "root", 0.5, primitive).expect("it is a motion");
    let json = serde_json::to_value(&motion).expect("it is data");
    let attributes = BTreeMap::from([("motion".to_owned(), Value::from_json(&json))]);
    let id = EntityId::new("Motions", &world.robot.name, "ellipse").expect("an address");
    let memory = memory_of_run(&world, store, &[]).expect("a store");
    memory.memory().commit_now(vec![Commit::new(id, 1, attributes)]).expect("it is kept");
    memory.flush().expect("it is written");
}

#[test]
fn an_arm_with_cameras_in_the_room_wipes_with_a_recalled_motion() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = folder.path().join("motions.redb");
    keep_ellipse(&store);
    let store = store.to_string_lossy().into_owned();
    let args = ["--robot", "pillar7", "--set", "motion=ellipse", "--set", "patience=12s", "--store", &store];
    let report = run(folder.path(), "wiping.yaml", &args);
    assert!((figure(&report, "force", "mean_n") - 8.0).abs() < 0.5, "{report}");
    assert!(figure(&report, "force", "rms_error_n") < 0.5, "{report}");
    assert!(figure(&report, "force", "contact_lost_s") < 0.05, "{report}");
}
