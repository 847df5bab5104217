//! How long the two seams take, against bare Zenoh in the same run: two sessions of one process, linked over TCP on this machine.
//!
//! `cargo bench -p armarium-robot --bench seams` prints the figures of `docs/wire-robot.md`. They depend on the machine and on what
//! else it does; the ratios less so.

#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs, reason = "a program that measures")]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use armarium_bus::{Key, Session, SessionConfig};
use armarium_robot::driver::{
    Driver, DriverClock, DriverError, DriverServer, GuardedDriver, RemoteDriver, TimedSample,
};
use armarium_robot::planning::KnownBox;
use armarium_robot::{
    Commander, Fault, Guard, GuardConfig, JointTargets, Lease, LeaseError, LeaseLimits, Load, Model,
    RemoteRobot, Robot, RobotError, RobotServer, Sensed, SensedWrench, ServoDriver, newest,
};
use parking_lot::Mutex;
use tokio::runtime::{Builder, Runtime};
use zenoh::Wait as _;

/// How often each way is gone. Before each there is a pause, as between the messages of a control loop: what follows at once finds threads
/// that are awake.
const TIMES: usize = 2000;
/// A cycle is late when the targets come so long after the period in which they were due.
const LATE: Duration = Duration::from_millis(2);
/// How long cycles are counted.
const COUNTED: Duration = Duration::from_secs(60);

#[expect(clippy::disallowed_methods, reason = "the wall's time is what is measured")]
fn now() -> Instant {
    Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "as a driver that has a rate")]
fn pause() {
    std::thread::sleep(Duration::from_micros(500));
}

/// When something came there.
type Came = mpsc::Receiver<Instant>;

struct Network {
    threads: Runtime,
    here: Session,
    there: Session,
}

impl Network {
    fn new() -> Self {
        let threads = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let there = threads.block_on(Session::open(&SessionConfig::default())).unwrap();
        let endpoints = threads.block_on(there.endpoints());
        let config = SessionConfig { listen: Vec::new(), ..SessionConfig::connected_to(&endpoints) };
        let here = threads.block_on(Session::open(&config)).unwrap();
        Self { threads, here, there }
    }
}

/// The time in the middle of all that were measured, and the one that 99 % do not exceed, microseconds.
fn spread(mut measured: Vec<Duration>) -> [f64; 2] {
    measured.sort_unstable();
    let at = |share: f64| measured[((measured.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e6;
    [at(0.5), at(0.99)]
}

fn compare(what: &str, ours: Vec<Duration>, bare: Vec<Duration>) {
    let ([ours, ours_99], [bare, bare_99]) = (spread(ours), spread(bare));
    println!(
        "{what}: {ours:.0} us (99 %: {ours_99:.0}), bare {bare:.0} us (99 %: {bare_99:.0}), ratio {:.2}",
        ours / bare
    );
}

/// A bare put of so many bytes from one session to the other.
struct BarePut {
    sender: armarium_bus::control::ControlSender,
    _reader: armarium_bus::control::ControlReader,
    came: Came,
    payload: Vec<u8>,
}

impl BarePut {
    fn new(threads: &Runtime, from: &Session, to: &Session, (key, bytes): (&str, usize)) -> Self {
        let key = Key::parse(key).unwrap();
        let (tell, came) = mpsc::channel();
        let reader = to.control_reader(key.clone(), move |_| {
            let _ = tell.send(now());
        });
        let reader = threads.block_on(reader).unwrap();
        let sender = threads.block_on(from.control_sender(&key, "application/cbor")).unwrap();
        let put = Self { sender, _reader: reader, came, payload: vec![0; bytes] };
        // The link has to know who listens.
        while put.came.recv_timeout(Duration::from_millis(50)).is_err() {
            put.sender.send(put.payload.clone()).unwrap();
        }
        pause();
        while put.came.try_recv().is_ok() {}
        put
    }

    /// Until it is there, on the thread of the link.
    fn measure(&self) -> Duration {
        let (began, came) = self.put();
        came - began
    }

    /// Until somebody has it who waits for it, as a skill does.
    fn measure_awaited(&self) -> Duration {
        let (began, _) = self.put();
        now() - began
    }

    /// When it was sent and when it came. One that a busy machine has dropped is sent again.
    fn put(&self) -> (Instant, Instant) {
        loop {
            let began = now();
            self.sender.send(self.payload.clone()).unwrap();
            if let Ok(came) = self.came.recv_timeout(Duration::from_secs(1)) {
                return (began, came);
            }
        }
    }
}

/// A robot that tells when it is commanded.
struct Target {
    model: Arc<Model>,
    sensed: newest::Sender<Arc<Sensed>>,
    commanded: mpsc::Sender<Instant>,
}

#[derive(Debug)]
struct Telling(mpsc::Sender<Instant>);

impl Commander for Telling {
    fn command(&self, _: &[f64]) -> Result<(), Fault> {
        let _ = self.0.send(now());
        Ok(())
    }

    fn fault(&self) -> Option<Fault> {
        None
    }
}

impl Robot for Target {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }
    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>> {
        self.sensed.subscribe()
    }
    fn lease_together(&self, _: &[&str], _: &str, _: LeaseLimits, _: &[String]) -> Result<Lease, LeaseError> {
        Ok(Lease::new(Telling(self.commanded.clone())))
    }
    fn tare(&self, _: &str) -> Result<(), RobotError> {
        Ok(())
    }
    fn set_load(&self, _: &str, _: Option<Load>) -> Result<(), RobotError> {
        Ok(())
    }
    fn loads(&self) -> BTreeMap<String, Load> {
        BTreeMap::new()
    }
    fn set_surroundings(&self, _: Vec<KnownBox>) -> Result<(), RobotError> {
        Ok(())
    }
    fn set_speed_scale(&self, _: f64) -> Result<(), RobotError> {
        Ok(())
    }
    fn stop(&self, _: &str) {}
    fn reset(&self) {}
    fn say(&self, _: &str) {}
}

/// Above the guard: lease, command, state.
fn above(network: &Network, model: &Arc<Model>) {
    let Network { threads, here, there } = network;
    let (commanded, came) = mpsc::channel();
    let sensed = |stamp_ns| {
        let wrenches = vec![SensedWrench::default(); model.wrenches().len()];
        Arc::new(Sensed { stamp_ns, position: model.zero(), velocity: model.zero(), wrenches })
    };
    let target =
        Arc::new(Target { model: Arc::clone(model), sensed: newest::Sender::new(sensed(0)), commanded });
    let shared: Arc<dyn Robot> = Arc::<Target>::clone(&target);
    let _server = threads.block_on(RobotServer::start(there, ("bench", "arm"), shared)).unwrap();
    let robot = threads.block_on(RemoteRobot::connect(here, ("bench", "arm"), model, "bench")).unwrap();
    let arm = model.arms().next().unwrap();
    let still = vec![0.0; arm.joints.len()];
    let put = BarePut::new(threads, here, there, ("bench/bare/command", 200));
    let asked = Key::parse("bench/bare/question").unwrap();
    let answering = there.zenoh().declare_queryable(asked.as_str().to_owned());
    let key = asked.as_str().to_owned();
    let answering = answering.callback(move |query| drop(query.reply(key.clone(), vec![0_u8; 60]).wait()));
    let _answering = answering.wait().unwrap();

    let mut stamp_ns = 0;
    let mut tick = || {
        stamp_ns += 1_000_000;
        target.sensed.send(sensed(stamp_ns));
    };
    let (mut leased, mut questions) = (Vec::new(), Vec::new());
    for _ in 0..TIMES {
        tick();
        pause();
        let began = now();
        let lease = robot.lease(&arm.name, "bench", LeaseLimits::default()).unwrap();
        lease.command(&still).unwrap();
        leased.push(came.recv().unwrap() - began);
        drop(lease);
        pause();
        let began = now();
        here.ask(&asked, ("", vec![0; 200]), Duration::from_secs(1)).unwrap();
        put.measure();
        questions.push(now() - began);
        pause();
    }
    compare("lease to first command, against a question and a put", leased, questions);

    let lease = robot.lease(&arm.name, "bench", LeaseLimits::default()).unwrap();
    let (mut commands, mut puts) = (Vec::new(), Vec::new());
    for _ in 0..TIMES {
        tick();
        pause();
        let began = now();
        lease.command(&still).unwrap();
        commands.push(came.recv().unwrap() - began);
        pause();
        puts.push(put.measure());
        pause();
    }
    compare("command to guard, against a put", commands, puts);

    let put = BarePut::new(threads, there, here, ("bench/bare/state", 600));
    let (mut states, mut puts) = (Vec::new(), Vec::new());
    let mut seen = robot.sensed();
    for _ in 0..TIMES {
        let began = now();
        tick();
        threads.block_on(seen.changed()).unwrap();
        states.push(now() - began);
        seen.borrow_and_update();
        pause();
        puts.push(put.measure_awaited());
        pause();
    }
    compare("state to skill, against a put", states, puts);
}

/// Joints that tell when they were sampled and when their targets came, and count the periods in which these were late.
struct Watched {
    joints: ServoDriver,
    told: Arc<Mutex<SampleTimes>>,
    applied: mpsc::Sender<Instant>,
}

#[derive(Default)]
struct SampleTimes {
    sampled: BTreeMap<u64, Instant>,
    last: Option<Instant>,
    periods: u64,
    late: u64,
}

impl Driver for Watched {
    fn clock(&self) -> DriverClock {
        self.joints.clock()
    }

    fn period(&self) -> Duration {
        self.joints.period()
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let timed = self.joints.sample()?;
        let mut told = self.told.lock();
        let (at, period) = (now(), self.joints.period());
        if let Some(last) = told.last {
            told.periods += 1;
            told.late += u64::from(at - last > period + LATE);
        }
        told.sampled.insert(timed.stamp_ns, at);
        Ok(timed)
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        let at = now();
        self.told.lock().last = Some(at);
        let _ = self.applied.send(at);
        self.joints.apply(targets)
    }

    fn brake(&mut self) {
        self.joints.brake();
    }
}

/// A driver that is offered there and connected to from here.
fn driven(
    Network { threads, here, there }: &Network,
    model: &Arc<Model>,
    clock: DriverClock,
) -> (DriverServer, RemoteDriver, Arc<Mutex<SampleTimes>>, Came) {
    let (applied, came) = mpsc::channel();
    let told = Arc::<Mutex<SampleTimes>>::default();
    let joints = ServoDriver::new(model, model.start(), clock);
    let watched = Watched { joints, told: Arc::clone(&told), applied };
    let name = ("bench", if clock == DriverClock::Lockstep { "still" } else { "alive" });
    let server = threads.block_on(DriverServer::start(there, name, model, watched)).unwrap();
    let driver = threads.block_on(RemoteDriver::connect(here, name, model, "bench")).unwrap();
    (server, driver, told, came)
}

/// Below the guard: targets, samples, and a minute at 1 kHz.
fn below(network: &Network, model: &Arc<Model>) {
    let Network { threads, here, there } = network;
    let put = BarePut::new(threads, here, there, ("bench/bare/targets", 400));
    let (server, mut driver, _, came) = driven(network, model, DriverClock::Lockstep);
    let (mut targets, mut puts) = (Vec::new(), Vec::new());
    for _ in 0..TIMES {
        let position = driver.sample().unwrap().sample.position;
        let wanted = JointTargets { velocity: vec![0.0; position.len()], position };
        let began = now();
        driver.apply(&wanted).unwrap();
        targets.push(came.recv().unwrap() - began);
        pause();
        puts.push(put.measure());
        pause();
    }
    compare("targets to driver, against a put", targets, puts);
    drop((driver, server));

    let put = BarePut::new(threads, there, here, ("bench/bare/sample", 500));
    let (_server, driver, told, _came) = driven(network, model, DriverClock::Realtime);
    let (guard, robot) = Guard::new(Arc::clone(model), GuardConfig::of(model));
    let ends = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&ends);
    let guarding =
        threads.spawn(GuardedDriver::new(guard, driver).run(move |_, _| !ended.load(Ordering::Relaxed)));
    let (mut samples, mut puts) = (Vec::new(), Vec::new());
    let mut seen = robot.sensed();
    while samples.len() < TIMES {
        threads.block_on(seen.changed()).unwrap();
        let at = now();
        let stamp_ns = seen.borrow_and_update().stamp_ns;
        let mut told = told.lock();
        if let Some(sampled) = told.sampled.remove(&stamp_ns) {
            samples.push(at - sampled);
        }
        told.sampled = told.sampled.split_off(&stamp_ns);
        drop(told);
        pause();
        puts.push(put.measure_awaited());
    }
    compare("sample to skill with the guard between, against a put", samples, puts);

    *told.lock() = SampleTimes::default();
    let began = now();
    while began.elapsed() < COUNTED {
        threads.block_on(seen.changed()).unwrap();
        told.lock().sampled.clear();
    }
    let (SampleTimes { periods, late, .. }, seconds) =
        (std::mem::take(&mut *told.lock()), began.elapsed().as_secs_f64());
    let share = 100.0 * late as f64 / periods as f64;
    println!(
        "1 kHz for {seconds:.0} s: {periods} periods, of which {late} had targets late by 2 ms ({share:.3} %)"
    );
    ends.store(true, Ordering::Relaxed);
    threads.block_on(guarding).unwrap().unwrap();
}

fn main() {
    let (network, model) = (Network::new(), Model::shipped("armar3").unwrap());
    above(&network, &model);
    below(&network, &model);
}
