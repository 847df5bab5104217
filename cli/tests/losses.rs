//! What happens when a part is lost: the process of a run, of the guard or of the driver is killed, stopped, or its line is cut,
//! while the arm moves at full speed and presses against a soft wall. It has to stand soon, the chart fails with the reason, and
//! only what has ended is started again.

#![allow(clippy::print_stdout, reason = "it says what it measured")]
#![cfg(unix)]
use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Read, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Session, SessionConfig};
use armarium_robot::driver::{Driver, DriverClock, DriverError, DriverServer, TimedSample};
use armarium_robot::{JointTargets, Kinematics, Model, ServoJoints};
use nalgebra::Vector3;
use parking_lot::{Condvar, Mutex};
use tokio::time::Instant;

const ROBOT: &str = "pillar7";
const NAME: &str = "lab/arm";
/// Names where the driver is to listen, in the process that is the driver.
const DRIVES_AT: &str = "ARMARIUM_TEST_DRIVES_AT";
const LONG: &str = "
statechart: Main
initial: There
states:
  There: {skill: MoveJoints, with: {posture: wipe}, transitions: {success: Back}}
  Back: {skill: MoveJoints, with: {posture: home}, transitions: {success: There}}
";
/// A busy machine may keep a command from a guard in another process for longer than the watchdog waits.
const SHORT: &str = "
statechart: Main
initial: There
states:
  There: {skill: MoveJoints, with: {posture: wipe}, retry: {times: 30, wait: 100ms}, transitions: {success: Done}}
  Done: {final: success}
";
/// A joint that is slower stands, rad/s.
const STANDING: f64 = 0.01;
/// What counts as full speed, rad/s, and as contact, N.
const MOVING: (f64, f64) = (0.6, 3.0);
/// Force of the wall on a hand that is where the chart moves it, N.
const PRESSES_N: f64 = 15.0;

#[expect(clippy::disallowed_methods, reason = "other processes and the driver's thread have the wall's time")]
fn pause(time: Duration) {
    std::thread::sleep(time);
}

#[expect(clippy::disallowed_methods, reason = "what processes say is read while the test goes on")]
fn aside(work: impl FnOnce() + Send + 'static) {
    std::thread::spawn(work);
}

/// Only one of these tests at a time: they measure times.
static ALONE: Mutex<()> = Mutex::new(());

/// Joints in real time, and a soft wall halfway between two postures.
struct Walled {
    joints: ServoJoints,
    targets: JointTargets,
    middle: Vector3<f64>,
    back: Vector3<f64>,
    tcp: armarium_robot::LinkId,
    steps: u64,
    due: Instant,
}

impl Walled {
    fn new(model: &Arc<Model>) -> Self {
        let arm = model.arms().next().unwrap();
        let tcp = arm.tcp.unwrap();
        let mut kinematics = Kinematics::new(model);
        let mut at = |posture: &str| {
            kinematics.update(model.posture(posture, &arm.name).unwrap());
            kinematics.pose(tcp).translation.vector
        };
        let (home, wipe) = (at("home"), at("wipe"));
        let joints = ServoJoints::new(model, model.start(), 0);
        let position = joints.sample().position.clone();
        let targets = JointTargets { velocity: vec![0.0; position.len()], position };
        Self {
            joints,
            targets,
            middle: (home + wipe) / 2.0,
            back: (home - wipe) / 2.0,
            tcp,
            steps: 0,
            due: Instant::now(),
        }
    }
}

impl Driver for Walled {
    fn clock(&self) -> DriverClock {
        DriverClock::Realtime
    }

    fn period(&self) -> Duration {
        Duration::from_millis(1)
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        self.due = (self.due + self.period()).max(Instant::now() - Duration::from_millis(20));
        pause(self.due.saturating_duration_since(Instant::now()));
        let tcp = self.joints.kinematics().pose(self.tcp).translation.vector;
        // 0 at the wall, 1 where the chart moves the hand.
        let depth = (self.middle - tcp).dot(&self.back) / self.back.norm_squared();
        let push = self.back.normalize() * PRESSES_N * depth.max(0.0);
        self.joints.step(&self.targets, &[push], 1e-3);
        self.steps += 1;
        let sample = self.joints.sample().clone();
        let fastest = sample.velocity.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let mut out = std::io::stdout().lock();
        // Nobody reads it any more: the test has ended.
        if writeln!(out, "at {} {fastest} {}", self.steps, push.norm()).and_then(|()| out.flush()).is_err() {
            std::process::exit(0);
        }
        Ok(TimedSample { stamp_ns: self.steps * 1_000_000, sample, braked: false, bodies: BTreeMap::new() })
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        self.targets.clone_from(targets);
        Ok(())
    }

    fn brake(&mut self) {
        self.targets.position.clone_from(&self.joints.sample().position);
        self.targets.velocity.fill(0.0);
    }
}

/// The process of the driver; a test of nothing where it is not started by one of those below.
#[test]
fn drives() {
    let Ok(endpoint) = std::env::var(DRIVES_AT) else { return };
    let threads = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    threads.block_on(async {
        let model = Model::shipped(ROBOT).unwrap();
        let config = SessionConfig { listen: vec![endpoint], ..SessionConfig::default() };
        let session = Session::open(&config).await.unwrap();
        let _server =
            DriverServer::start(&session, ("lab", "arm"), &model, Walled::new(&model)).await.unwrap();
        println!("ready");
        std::future::pending::<()>().await;
    });
}

/// How the joints move: the driver's time, ms, the fastest joint, rad/s, and the force on the hand, N.
#[derive(Clone, Copy, Debug, Default)]
struct Shown {
    at_ms: u64,
    fastest: f64,
    force: f64,
}

struct Arm {
    process: Child,
    shown: Arc<Mutex<Vec<Shown>>>,
}

impl Arm {
    fn start(port: u16) -> Self {
        let mut process = Command::new(std::env::current_exe().expect("this test has a file"))
            .args(["--exact", "losses::drives", "--nocapture"])
            .env(DRIVES_AT, format!("tcp/127.0.0.1:{port}"))
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let mut said = lines(process.stdout.take().expect("it is piped"));
        assert!(said.any(|line| line.ends_with("ready")));
        let shown = Arc::<Mutex<Vec<Shown>>>::default();
        let heard = Arc::clone(&shown);
        aside(move || {
            for line in said {
                let numbers: Vec<f64> =
                    line.split(' ').skip(1).filter_map(|text| text.parse().ok()).collect();
                if let [at_ms, fastest, force] = numbers[..] {
                    heard.lock().push(Shown { at_ms: at_ms as u64, fastest, force });
                }
            }
        });
        Self { process, shown }
    }

    fn now(&self) -> Shown {
        self.shown.lock().last().copied().unwrap_or_default()
    }

    /// Waits until all joints stand, and sees that they did so in time, and go on standing.
    fn stands(&self, since_ms: u64, within_ms: u64, what: &str) {
        while self.now().at_ms < since_ms + within_ms + 300 {
            pause(Duration::from_millis(5));
        }
        let shown = self.shown.lock();
        let last = shown.iter().rfind(|shown| shown.at_ms >= since_ms && shown.fastest >= STANDING);
        let after_ms = last.map_or(0, |last| last.at_ms + 1 - since_ms);
        println!("{what}: all joints stand after {after_ms} ms");
        assert!(after_ms <= within_ms, "{what}: {last:?} after {after_ms} ms");
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What a process says, line by line.
fn lines(said: impl Read) -> impl Iterator<Item = String> {
    BufReader::new(said).lines().map_while(Result::ok)
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a port").port()
}

/// A line between two processes that can be cut and joined again: meanwhile nothing gets through, and no end is closed.
#[derive(Clone)]
struct Line {
    port: u16,
    cut: Arc<(Mutex<bool>, Condvar)>,
}

impl Line {
    fn to(port: u16) -> Self {
        let socket = TcpListener::bind("127.0.0.1:0").expect("a port");
        let line = Self { port: socket.local_addr().expect("it has one").port(), cut: Arc::default() };
        let own = line.clone();
        aside(move || {
            for near in socket.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else { continue };
                for end in [&near, &far] {
                    end.set_nodelay(true).expect("a socket");
                }
                let (back, forth) = (near.try_clone().expect("a socket"), far.try_clone().expect("a socket"));
                let (one, other) = (own.clone(), own.clone());
                aside(move || one.carry(near, forth));
                aside(move || other.carry(far, back));
            }
        });
        line
    }

    fn carry(&self, mut from: TcpStream, mut to: TcpStream) {
        let mut buffer = vec![0; 65_536];
        while let Ok(n @ 1..) = from.read(&mut buffer) {
            let (cut, joined) = &*self.cut;
            joined.wait_while(&mut cut.lock(), |cut| *cut);
            if to.write_all(&buffer[..n]).is_err() {
                break;
            }
        }
        let _ = (from.shutdown(std::net::Shutdown::Both), to.shutdown(std::net::Shutdown::Both));
    }

    fn set_cut(&self, is: bool) {
        *self.cut.0.lock() = is;
        self.cut.1.notify_all();
    }

    fn endpoint(&self) -> String {
        format!("tcp/127.0.0.1:{}", self.port)
    }
}

/// The guard's process, and what it says.
struct Guard {
    process: Child,
    said: Box<dyn Iterator<Item = String>>,
}

impl Guard {
    fn start(driver: &Line, port: u16) -> Self {
        let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
        program.args(["robot", "serve", "--driver", NAME, "--robot", ROBOT, "--connect", &driver.endpoint()]);
        program.args(["--listen", &format!("tcp/127.0.0.1:{port}")]);
        let mut process = program.stdout(Stdio::piped()).spawn().expect("it starts");
        let said = lines(process.stdout.take().expect("it is piped"));
        let mut guard = Self { process, said: Box::new(said) };
        guard.drives();
        guard
    }

    /// Waits until it has its driver.
    fn drives(&mut self) {
        assert!(self.said.any(|line| line == "lab/arm: the robot `pillar7`, driven by lab/arm"));
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A driver, a guard, and the lines to them.
struct Lab {
    arm: Arm,
    arm_port: u16,
    guard: Guard,
    guard_port: u16,
    to_driver: Line,
    to_guard: Line,
    folder: tempfile::TempDir,
}

impl Lab {
    fn new() -> Self {
        let (arm_port, guard_port) = (free_port(), free_port());
        let (to_driver, to_guard) = (Line::to(arm_port), Line::to(guard_port));
        let arm = Arm::start(arm_port);
        let guard = Guard::start(&to_driver, guard_port);
        let folder = tempfile::tempdir().expect("a temporary folder");
        Self { arm, arm_port, guard, guard_port, to_driver, to_guard, folder }
    }

    /// A run whose arm moves at full speed, in contact.
    fn moving(&self) -> (Child, Box<dyn Iterator<Item = String>>) {
        let mut ended = Vec::new();
        // On a busy machine a command may be late, which ends a run; the arm stands where that was, and the next goes on from there.
        for attempt in 1..=60 {
            let mut program = run(self.folder.path(), LONG, &self.to_guard);
            let mut running = program.stdout(Stdio::null()).spawn().expect("it starts");
            let said = Box::new(lines(running.stderr.take().expect("it is piped")));
            while running.try_wait().expect("it can be asked").is_none() {
                let Shown { fastest, force, .. } = self.arm.now();
                if fastest > MOVING.0 && force > MOVING.1 {
                    println!("at speed in attempt {attempt}");
                    return (running, said);
                }
                pause(Duration::from_millis(1));
            }
            ended.extend(said);
        }
        panic!("the arm cannot be brought to speed: {:?} {ended:#?}", self.arm.now());
    }

    /// Somebody uses the robot as if nothing had been, as soon as the guard has found its driver again.
    fn goes_on(&self, what: &str) {
        let mut told = String::new();
        for _ in 0..20 {
            let ended = run(self.folder.path(), SHORT, &self.to_guard).output().expect("it starts");
            let said = String::from_utf8_lossy(&[ended.stdout, ended.stderr].concat()).into_owned();
            match ended.status.code() {
                Some(0) => return,
                Some(2) => {
                    told = said;
                    pause(Duration::from_millis(100));
                }
                code => panic!("after {what}: {code:?} {said}"),
            }
        }
        panic!("after {what} the robot cannot be used any more: {told}");
    }
}

/// `armarium run` of a chart.
fn run(folder: &Path, chart: &str, to_guard: &Line) -> Command {
    std::fs::write(folder.join("main.yaml"), chart).expect("it can be written");
    let mut program = Command::new(env!("CARGO_BIN_EXE_armarium"));
    // Without --force: a run that is stopped keeps its report.
    program.current_dir(folder).args(["run", "main.yaml", "--robot", ROBOT, "--verbose"]);
    program.args(["--robot-at", NAME, "--connect", &to_guard.endpoint()]).stderr(Stdio::piped());
    program
}

fn signal(process: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &process.id().to_string()]).status().expect("kill is there");
    assert!(sent.success());
}

fn kill(process: &mut Child) {
    process.kill().expect("it runs");
    process.wait().expect("it ends");
}

/// The run has failed, and says one of the reasons.
fn failed(mut running: Child, said: impl Iterator<Item = String>, reasons: &[&str]) {
    let said: Vec<String> = said.collect();
    assert_eq!(running.wait().expect("it ends").code(), Some(1), "{said:?}");
    let told = said.iter().any(|line| reasons.iter().any(|reason| line.contains(reason)));
    assert!(told, "{reasons:?} {said:?}");
}

const NO_STATES: &str = "the robot `lab/arm` is lost: it has sent no state for 700 ms";
const NO_COMMANDS: &str = "no command for";
const NO_SAMPLES: &str = "the driver `lab/arm` has sent no sample for 500 ms";

#[test]
fn when_a_run_is_lost_its_arm_stands_and_another_run_goes_on() {
    let _alone = ALONE.lock();
    let lab = Lab::new();

    let (mut running, _said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    kill(&mut running);
    lab.arm.stands(at_ms, 200, "a run was killed");
    lab.goes_on("a run was killed");

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    signal(&running, "-STOP");
    lab.arm.stands(at_ms, 200, "a run was stopped");
    lab.goes_on("a run was stopped, while it is");
    signal(&running, "-CONT");
    failed(running, said, &[NO_COMMANDS, NO_STATES]);

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    lab.to_guard.set_cut(true);
    lab.arm.stands(at_ms, 200, "the line of a run was cut");
    failed(running, said, &[NO_STATES]);
    lab.to_guard.set_cut(false);
    lab.goes_on("the line of a run was cut");
}

#[test]
fn when_the_guard_is_lost_the_arm_stands_and_runs_fail_with_the_reason() {
    let _alone = ALONE.lock();
    let mut lab = Lab::new();

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    kill(&mut lab.guard.process);
    lab.arm.stands(at_ms, 250, "the guard was killed");
    failed(running, said, &[NO_STATES]);
    lab.guard = Guard::start(&lab.to_driver, lab.guard_port);
    lab.goes_on("the guard was killed");

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    signal(&lab.guard.process, "-STOP");
    lab.arm.stands(at_ms, 250, "the guard was stopped");
    failed(running, said, &[NO_STATES]);
    signal(&lab.guard.process, "-CONT");
    lab.goes_on("the guard was stopped");

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    for line in [&lab.to_driver, &lab.to_guard] {
        line.set_cut(true);
    }
    lab.arm.stands(at_ms, 250, "the guard's lines were cut");
    failed(running, said, &[NO_STATES]);
    for line in [&lab.to_driver, &lab.to_guard] {
        line.set_cut(false);
    }
    lab.guard.drives();
    lab.goes_on("the guard's lines were cut");
}

#[test]
fn when_the_driver_is_lost_runs_fail_with_the_reason_and_the_guard_takes_it_again() {
    let _alone = ALONE.lock();
    let mut lab = Lab::new();

    let (running, said) = lab.moving();
    let at_ms = lab.arm.now().at_ms;
    lab.to_driver.set_cut(true);
    lab.arm.stands(at_ms, 250, "the driver's line was cut");
    failed(running, said, &[NO_SAMPLES]);
    lab.to_driver.set_cut(false);
    lab.guard.drives();
    lab.goes_on("the driver's line was cut");

    let (running, said) = lab.moving();
    signal(&lab.arm.process, "-STOP");
    failed(running, said, &[NO_SAMPLES]);
    let at_ms = lab.arm.now().at_ms;
    signal(&lab.arm.process, "-CONT");
    lab.arm.stands(at_ms, 200, "the driver was stopped and goes on");
    lab.guard.drives();
    lab.goes_on("the driver was stopped");

    let (running, said) = lab.moving();
    kill(&mut lab.arm.process);
    failed(running, said, &[NO_SAMPLES]);
    lab.arm = Arm::start(lab.arm_port);
    lab.guard.drives();
    lab.goes_on("the driver was killed");
}
