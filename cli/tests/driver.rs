//! A chart runs with a driver in another process and another language; who loses the driver says why.

use std::io::{BufRead as _, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::outside::not_run;
use armarium_robot::Model;

const ROBOT: &str = "pillar7";
const CHART: &str = "
statechart: Main
initial: Reach
states:
  Reach: {skill: MoveJoints, with: {posture: wipe}, transitions: {success: Tare}}
  Tare: {skill: Tare, transitions: {success: Back}}
  Back: {skill: MoveJoints, with: {posture: home}, transitions: {success: Done}}
  Done: {final: success}
";
/// A busy machine may keep a command from a guard in another process for longer than the watchdog waits.
const SHARED: &str = "
statechart: Main
initial: Reach
states:
  Reach: {skill: MoveJoints, with: {posture: wipe}, retry: {times: 9, wait: 100ms}, transitions: {success: Back}}
  Back: {skill: MoveJoints, with: {posture: home}, retry: {times: 9, wait: 100ms}, transitions: {success: Done}}
  Done: {final: success}
";
const LONG: &str = "
statechart: Main
initial: There
states:
  There: {skill: MoveJoints, with: {posture: wipe}, retry: {times: 99, wait: 100ms}, transitions: {success: Back}}
  Back: {skill: MoveJoints, with: {posture: home}, retry: {times: 99, wait: 100ms}, transitions: {success: There}}
";

/// A Python with the packages that the example needs, where there is one.
fn python() -> Option<std::ffi::OsString> {
    std::env::var_os("ARMARIUM_PYTHON").filter(|program| {
        let tried = Command::new(program).args(["-c", "import zenoh, cbor2"]).stderr(Stdio::null()).status();
        tried.is_ok_and(|status| status.success())
    })
}

/// The driver of the example, until its input is closed, and where it listens.
fn drive(python: &std::ffi::OsStr) -> (Child, String) {
    let model = Model::shipped(ROBOT).expect("the robot ships");
    let port =
        TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a port").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/python/drive_joints.py");
    let mut driver = Command::new(python)
        .args([script.as_os_str(), endpoint.as_ref()])
        .args(model.joints().iter().map(|joint| &joint.name))
        .arg("+")
        .args(model.wrenches().iter().map(|sensor| &sensor.name))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python can be started");
    let mut ready = String::new();
    let said = driver.stdout.take().expect("it is piped");
    BufReader::new(said).read_line(&mut ready).expect("it says that it is ready");
    assert_eq!(ready.trim(), "eve is ready");
    (driver, endpoint)
}

/// `armarium run` of a chart with that driver, or with the robot above it.
fn run(folder: &Path, chart: &str, with: &str, endpoint: &str) -> Command {
    std::fs::write(folder.join("main.yaml"), chart).expect("it can be written");
    let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
    program.current_dir(folder).args(["run", "main.yaml", "--robot", ROBOT, "--force", "--verbose"]);
    program.args([with, "eve/arm", "--connect", endpoint]).stderr(Stdio::piped());
    program
}

/// What a process says, line by line.
fn lines(said: impl std::io::Read) -> impl Iterator<Item = String> {
    BufReader::new(said).lines().map_while(Result::ok)
}

/// A guard of its own above the driver, and where it listens.
fn serve(endpoint: &str) -> (Child, String) {
    let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
    program.args(["robot", "serve", "--driver", "eve/arm", "--robot", ROBOT, "--connect", endpoint]);
    let mut guard = program.stdout(Stdio::piped()).spawn().expect("it starts");
    let mut said = lines(guard.stdout.take().expect("it is piped"));
    let own = said.find_map(|line| line.strip_prefix("listens on ").map(str::to_owned));
    assert!(said.any(|line| line == "eve/arm: the robot `pillar7`, driven by eve/arm"));
    (guard, own.expect("it says where it listens"))
}

#[test]
fn a_chart_runs_with_a_driver_in_python_and_each_time_in_the_same_way() {
    let Some(python) = python() else {
        return not_run("ARMARIUM_PYTHON names no Python with the packages eclipse-zenoh and cbor2");
    };
    let traces = [0, 1].map(|_| {
        let (mut driver, endpoint) = drive(&python);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let ended = run(folder.path(), CHART, "--driver", &endpoint).output().expect("it starts");
        let said = String::from_utf8_lossy(&[ended.stdout, ended.stderr].concat()).into_owned();
        assert_eq!(ended.status.code(), Some(0), "{said}");
        drop(driver.stdin.take());
        assert!(driver.wait().expect("it ends").success());
        let report = std::fs::read_to_string(folder.path().join("report/report.json")).expect("a report");
        let report: serde_json::Value = serde_json::from_str(&report).expect("it is JSON");
        (report["trace_sha256"].clone(), report["simulated_s"].clone())
    });
    assert_eq!(traces[0], traces[1], "the run depends on nothing but the driver");
}

#[test]
fn a_run_whose_driver_is_killed_fails_with_the_reason() {
    let Some(python) = python() else {
        return not_run("ARMARIUM_PYTHON names no Python with the packages eclipse-zenoh and cbor2");
    };
    let (mut driver, endpoint) = drive(&python);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut running = run(folder.path(), LONG, "--driver", &endpoint).spawn().expect("it starts");
    let mut said = lines(running.stderr.take().expect("it is piped"));
    assert!(said.any(|line| line.contains("MoveJoints begins")));
    driver.kill().expect("it runs");
    let rest: Vec<String> = said.collect();
    assert_eq!(running.wait().expect("it ends").code(), Some(1), "{rest:?}");
    let failed = rest.iter().any(|line| line.contains("the driver `eve/arm` has sent no sample"));
    assert!(failed, "{rest:?}");
    assert!(driver.wait().is_ok());
}

#[test]
fn only_what_has_died_of_run_and_guard_is_started_again() {
    let Some(python) = python() else {
        return not_run("ARMARIUM_PYTHON names no Python with the packages eclipse-zenoh and cbor2");
    };
    let (mut driver, endpoint) = drive(&python);
    let (mut guard, at) = serve(&endpoint);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let long = |at: &str| {
        let mut running = run(folder.path(), LONG, "--robot-at", at).spawn().expect("it starts");
        let mut said = lines(running.stderr.take().expect("it is piped"));
        assert!(said.any(|line| line.contains("MoveJoints begins")));
        (running, said)
    };
    // A run that is killed: its leases end with it, and the next run moves the same arm.
    let (mut running, _said) = long(&at);
    running.kill().expect("it runs");
    assert!(running.wait().is_ok());
    let ended = run(folder.path(), SHARED, "--robot-at", &at).output().expect("it starts");
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    // A guard that is killed: the run fails with the reason, and the driver takes another guard.
    let (mut running, said) = long(&at);
    guard.kill().expect("it runs");
    let rest: Vec<String> = said.collect();
    assert_eq!(running.wait().expect("it ends").code(), Some(1), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("the robot `eve/arm` is lost")), "{rest:?}");
    assert!(guard.wait().is_ok());
    let (mut guard, at) = serve(&endpoint);
    let ended = run(folder.path(), SHARED, "--robot-at", &at).output().expect("it starts");
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    guard.kill().expect("it runs");
    driver.kill().expect("it runs");
    assert!(guard.wait().is_ok() && driver.wait().is_ok());
}
