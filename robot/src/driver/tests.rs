//! A driver in another session: the guard above it keeps every rule, and what the driver must not take it refuses.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use armarium_bus::{Payload as _, Session, SessionConfig};
use tokio::runtime::{Builder, Runtime};

use super::wire::{Keys, WireSample, WireTargets};
use super::{
    Driver, DriverClock, DriverError, DriverServer, DryDriver, GuardedDriver, RemoteDriver, TimedSample,
};
use crate::message::{read, written};
use crate::{
    Fault, Guard, GuardConfig, JointTargets, Lease, LeaseError, LeaseLimits, Model, Robot, ServoDriver,
    conformance,
};

/// Two sessions on threads of their own.
struct Network {
    threads: Runtime,
    driving: Session,
    guarding: Session,
}

impl Network {
    fn new() -> Self {
        let threads = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let driving = threads.block_on(Session::open(&SessionConfig::default())).unwrap();
        let endpoints = threads.block_on(driving.endpoints());
        let config = SessionConfig { listen: Vec::new(), ..SessionConfig::connected_to(&endpoints) };
        let guarding = threads.block_on(Session::open(&config)).unwrap();
        Self { threads, driving, guarding }
    }

    fn serve(&self, name: &str, model: &Arc<Model>, clock: DriverClock) -> DriverServer {
        let driver = ServoDriver::new(model, model.start(), clock);
        self.threads.block_on(DriverServer::start(&self.driving, ("sim", name), model, driver)).unwrap()
    }

    fn connect(&self, name: &str, model: &Model) -> Result<RemoteDriver, DriverError> {
        self.threads.block_on(RemoteDriver::connect(&self.guarding, ("sim", name), model, "test"))
    }
}

fn model(name: &str) -> Arc<Model> {
    Model::shipped(name).unwrap()
}

/// Everything under a paused clock, as a run in lockstep is.
fn in_virtual_time<T>(run: impl Future<Output = T>) -> T {
    Builder::new_current_thread().enable_all().start_paused(true).build().unwrap().block_on(run)
}

#[test]
fn a_robot_above_a_remote_driver_in_lockstep_keeps_every_rule() {
    let (network, model) = (Network::new(), model("pillar7"));
    let _server = network.serve("arm", &model, DriverClock::Lockstep);
    let driver = network.connect("arm", &model).unwrap();
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let robot: Arc<dyn Robot> = robot;
    let arm = model.arms().next().unwrap().name.clone();
    in_virtual_time(async {
        let ends = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ends);
        let guarded = GuardedDriver::new(guard, driver).run(move |_, _| !ended.load(Ordering::Relaxed));
        let task = tokio::spawn(guarded);
        conformance::check(&robot, &arm).await.unwrap();
        ends.store(true, Ordering::Relaxed);
        task.await.unwrap().unwrap();
        let mut sensed = robot.sensed();
        assert!(sensed.changed().await.is_err(), "who waits for samples is told that none will come");
    });
    // It was released, and somebody else may have it.
    drop(network.connect("arm", &model).unwrap());
}

/// A command is answered by the same motion, to the bit, however the threads of the network are scheduled.
#[test]
fn two_runs_in_lockstep_are_the_same() {
    let run = || {
        let (network, model) = (Network::new(), model("pillar7"));
        let _server = network.serve("arm", &model, DriverClock::Lockstep);
        let driver = network.connect("arm", &model).unwrap();
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        in_virtual_time(async move {
            let arm = model.arms().next().unwrap();
            let task =
                tokio::spawn(GuardedDriver::new(guard, driver).run(|stamp_ns, _| stamp_ns < 400_000_000));
            let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
            let mut sensed = robot.sensed();
            let mut seen = Vec::new();
            while sensed.changed().await.is_ok() {
                let now = sensed.borrow_and_update();
                let _ = lease.command(&vec![libm::sin(now.stamp_ns as f64 * 2e-8) * 0.3; arm.joints.len()]);
                seen.push((now.stamp_ns, now.position.clone()));
            }
            task.await.unwrap().unwrap();
            seen
        })
    };
    let first = run();
    assert!(first.len() >= 400, "{}", first.len());
    assert_eq!(first, run());
}

/// A driver that computes for longer than its period.
struct Slow(ServoDriver);

impl Driver for Slow {
    fn clock(&self) -> DriverClock {
        self.0.clock()
    }

    fn period(&self) -> Duration {
        self.0.period()
    }

    #[allow(clippy::disallowed_methods, reason = "it takes time of its thread, not of a clock")]
    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        std::thread::sleep(2 * self.period());
        self.0.sample()
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        self.0.apply(targets)
    }

    fn brake(&mut self) {
        self.0.brake();
    }
}

/// Skills, and those who send states to others, have each sample before the next one is waited for.
#[test]
fn a_slow_driver_in_lockstep_holds_up_nobody_who_waits_for_samples() {
    let model = model("pillar7");
    let driver = Slow(ServoDriver::new(&model, model.start(), DriverClock::Lockstep));
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let threads = Builder::new_current_thread().enable_all().build().unwrap();
    let seen = threads.block_on(async {
        let mut sensed = robot.sensed();
        tokio::spawn(GuardedDriver::new(guard, driver).run(|stamp_ns, _| stamp_ns < 300_000_000));
        let mut seen = 0;
        while sensed.changed().await.is_ok() {
            seen += 1;
            sensed.borrow_and_update();
        }
        seen
    });
    assert!(seen >= 300, "only {seen} of 300 samples were seen");
}

#[test]
fn a_driver_in_lockstep_that_ends_is_lost_with_a_reason() {
    let (network, model) = (Network::new(), model("pillar7"));
    let server = network.serve("arm", &model, DriverClock::Lockstep);
    let driver = network.connect("arm", &model).unwrap();
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let arm = model.arms().next().unwrap();
    let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
    let mut server = Some(server);
    let ended = in_virtual_time(GuardedDriver::new(guard, driver).run(move |stamp_ns, _| {
        if stamp_ns > 20_000_000 {
            server.take();
        }
        true
    }));
    assert!(matches!(ended, Err(DriverError::Silent { .. })), "{ended:?}");
    let fault = lease.fault().unwrap().to_string();
    assert!(fault.contains("the driver `sim/arm` has sent no sample"), "{fault}");
}

/// The guard is stepped by the threads that bring samples, and ends on its own.
#[test]
fn a_guard_in_real_time_ends_when_it_is_told_and_when_its_driver_is_lost() {
    let (network, model) = (Network::new(), model("pillar7"));
    let mut server = Some(network.serve("arm", &model, DriverClock::Realtime));
    for lost in [false, true] {
        let driver = network.connect("arm", &model).unwrap();
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let arm = model.arms().next().unwrap();
        let ends = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ends);
        let guarded = GuardedDriver::new(guard, driver).run(move |_, _| !ended.load(Ordering::Relaxed));
        let guarding = network.threads.spawn(guarded);
        let ended = network.threads.block_on(async {
            let mut sensed = robot.sensed();
            sensed.changed().await.unwrap();
            let begin = sensed.borrow_and_update().position[arm.joints[0]];
            let mut lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
            while sensed.borrow_and_update().position[arm.joints[0]] - begin < 0.02 {
                // On a busy machine a command may come too late.
                if lease.command(&vec![0.2; arm.joints.len()]).is_err() {
                    drop(lease);
                    lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
                }
                sensed.changed().await.unwrap();
            }
            if lost {
                server.take();
            } else {
                ends.store(true, Ordering::Relaxed);
            }
            let ended = guarding.await.unwrap();
            while sensed.changed().await.is_ok() {}
            assert!(lease.fault().is_some());
            ended
        });
        match ended {
            Err(DriverError::Silent { .. }) if lost => {}
            ended => assert_eq!((ended, lost), (Ok(()), false)),
        }
    }
}

#[test]
fn a_driver_in_real_time_brakes_when_its_guard_is_silent() {
    let (network, model) = (Network::new(), model("pillar7"));
    let _server = network.serve("arm", &model, DriverClock::Realtime);
    let mut driver = network.connect("arm", &model).unwrap();
    let speed = 0.5;
    // On a busy machine it may brake in between.
    let silent_ns = loop {
        let timed = driver.sample().unwrap();
        if timed.sample.velocity[1] > 0.8 * speed {
            break timed.stamp_ns;
        }
        let mut velocity = vec![0.0; timed.sample.position.len()];
        velocity[1] = speed;
        driver.apply(&JointTargets { position: timed.sample.position, velocity }).unwrap();
    };
    let standing = loop {
        let timed = driver.sample().unwrap();
        if timed.sample.velocity.iter().all(|v| v.abs() < conformance::STANDING) {
            assert!(timed.braked, "and says so");
            break timed.stamp_ns - silent_ns;
        }
    };
    assert!(standing < 250_000_000, "{standing} ns");
}

/// Commands an arm for 100 samples; on a busy machine it takes some tries. Returns by how much its first joint was moved.
fn moved(guarded: &mut GuardedDriver, robot: &dyn Robot) -> (Lease, f64) {
    let arm = robot.model().arms().next().unwrap().clone();
    let at = || robot.sensed().borrow().position[arm.joints[0]];
    'again: loop {
        let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
        let begin = at();
        for _ in 0..100 {
            if lease.command(&vec![0.2; arm.joints.len()]).is_err() {
                continue 'again;
            }
            guarded.step().unwrap();
        }
        return (lease, at() - begin);
    }
}

#[test]
fn a_guard_begins_again_where_the_joints_have_braked() {
    let (network, model) = (Network::new(), model("pillar7"));
    let _server = network.serve("arm", &model, DriverClock::Realtime);
    let driver = network.connect("arm", &model).unwrap();
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let mut guarded = GuardedDriver::new(guard, driver);
    guarded.step().unwrap();
    let (lease, way) = moved(&mut guarded, &*robot);
    assert!(way > 0.005, "{way}");
    pause();
    guarded.step().unwrap();
    let fault = lease.fault();
    assert!(matches!(fault, Some(Fault::Braked | Fault::Watchdog { .. })), "{fault:?}");
    let standing = robot.sensed().borrow();
    assert!(standing.velocity.iter().all(|v| v.abs() < conformance::STANDING), "{standing:?}");
    drop(lease);
    let (_lease, way) = moved(&mut guarded, &*robot);
    assert!((0.005..0.1).contains(&way), "it goes on from there: {way}");
}

/// A driver whose first samples say that it is braked.
struct BrakedAtFirst(ServoDriver, u64);

impl Driver for BrakedAtFirst {
    fn clock(&self) -> DriverClock {
        self.0.clock()
    }
    fn period(&self) -> std::time::Duration {
        self.0.period()
    }
    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let timed = self.0.sample()?;
        Ok(TimedSample { braked: timed.stamp_ns <= self.1 * 1_000_000, ..timed })
    }
    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        self.0.apply(targets)
    }
    fn brake(&mut self) {
        self.0.brake();
    }
}

#[test]
fn skills_begin_when_a_driver_has_taken_its_first_targets() {
    let model = model("pillar7");
    for (braked_ms, begins_ms) in [(0, 1), (4, 5), (1000, 101)] {
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let joints = ServoDriver::new(&model, model.start(), DriverClock::Lockstep);
        let mut guarded = GuardedDriver::new(guard, BrakedAtFirst(joints, braked_ms));
        let begins = (1..200).find(|_| {
            guarded.step().unwrap();
            robot.sensed().borrow().stamp_ns > 0
        });
        assert_eq!(begins, Some(begins_ms));
        let arm = model.arms().next().unwrap();
        let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
        lease.command(&vec![0.1; arm.joints.len()]).unwrap();
        guarded.step().unwrap();
        assert_eq!(lease.fault().is_some(), braked_ms == 1000, "{:?}", lease.fault());
    }
}

#[test]
fn a_guard_that_was_silent_for_too_long_learns_that_another_one_has_the_driver() {
    let (network, model) = (Network::new(), model("pillar7"));
    let _server = network.serve("arm", &model, DriverClock::Realtime);
    let mut first = network.connect("arm", &model).unwrap();
    first.sample().unwrap();
    pause();
    let second = loop {
        match network.connect("arm", &model) {
            Ok(driver) => break driver,
            Err(DriverError::Refused { .. }) => pause(),
            Err(error) => panic!("{error}"),
        }
    };
    let lost = loop {
        if let Err(error) = first.sample() {
            break error.to_string();
        }
    };
    assert!(lost.starts_with("the driver `sim/arm` refuses: somebody else has claimed it since"), "{lost}");
    // What the first one releases is not his.
    drop(first);
    drop(second);
}

#[test]
fn in_a_dry_run_everything_happens_but_targets() {
    let network = Network::new();
    let model = model("pillar7");
    for (name, clock) in [("still", DriverClock::Lockstep), ("alive", DriverClock::Realtime)] {
        let _server = network.serve(name, &model, clock);
        let driver = DryDriver::new(network.connect(name, &model).unwrap());
        let fastest = driver.fastest();
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let mut guarded = GuardedDriver::new(guard, driver);
        guarded.step().unwrap();
        let arm = model.arms().next().unwrap();
        let at = || robot.sensed().borrow().position.clone();
        let (lease, begin) = (robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap(), at());
        for _ in 0..100 {
            // On a busy machine samples may be so late that the guard misses a command.
            let commanded = lease.command(&vec![0.2; arm.joints.len()]);
            assert!(
                commanded.is_ok() || matches!(lease.fault(), Some(Fault::Watchdog { .. })),
                "{commanded:?}"
            );
            guarded.step().unwrap();
        }
        let moved = at().iter().zip(&begin).map(|(now, then)| (now - then).abs()).fold(0.0, f64::max);
        assert!(moved < 1e-9, "{name}: {moved}");
        let wanted = fastest.lock()[arm.joints[0]];
        assert!((0.05..0.25).contains(&wanted), "{name}: {wanted}");
    }
}

#[expect(clippy::disallowed_methods, reason = "it stands for a thread that hangs")]
fn pause() {
    std::thread::sleep(std::time::Duration::from_millis(200));
}

#[test]
fn a_driver_of_another_robot_is_refused_and_left_alone() {
    let network = Network::new();
    let (pillar, armar) = (model("pillar7"), model("armar3"));
    let _server = network.serve("arm", &pillar, DriverClock::Lockstep);
    let error = network.connect("arm", &armar).unwrap_err().to_string();
    assert!(error.contains("is not one of the robot `armar3`: the robot has no joint"), "{error}");
    let _first = network.connect("arm", &pillar).unwrap();
    let error = network.connect("arm", &pillar).unwrap_err().to_string();
    assert_eq!(error, "the driver `sim/arm` refuses: it is commanded by `test`");
    let error = network.connect("leg", &pillar).unwrap_err().to_string();
    assert!(error.contains("nobody answered `sim/drive/leg/description`"), "{error}");
}

/// What a stranger puts on the key of samples.
fn intrude(network: &Network, encoding: &str, payload: Vec<u8>) {
    let key = Keys::of("sim", "arm").unwrap().sample;
    network.threads.block_on(network.driving.put(&key, encoding, payload)).unwrap();
}

/// A sample of another start of the driver, as it is sent.
fn of_another_start(model: &Model) -> (String, Vec<u8>) {
    let (position, velocity) = (model.zero(), model.zero());
    let (epoch, number, stamp_ns) = (1, u64::MAX, u64::MAX);
    let wrenches = vec![[0.0; 6]; model.wrenches().len()];
    let (refused, bodies, claims) = (None, BTreeMap::new(), 0);
    written(&WireSample {
        epoch,
        number,
        stamp_ns,
        position,
        velocity,
        wrenches,
        braked: false,
        refused,
        bodies,
        claims,
    })
}

#[test]
fn what_strangers_send_on_its_key_does_not_end_a_driver() {
    let (network, model) = (Network::new(), model("pillar7"));
    let server = network.serve("arm", &model, DriverClock::Realtime);
    let mut driver = network.connect("arm", &model).unwrap();
    let (encoding, strange) = of_another_start(&model);
    let unknown = WireSample::SCHEMA.encoding().replace(";v1", ";v2");
    let huge = vec![0x81; 1 << 20];
    for _ in 0..20 {
        for (encoding, payload) in
            [(&encoding, &strange), (&unknown, &strange), (&encoding, &vec![0xff]), (&encoding, &huge)]
        {
            intrude(&network, encoding, payload.clone());
            assert!(driver.sample().unwrap().stamp_ns < u64::MAX);
        }
    }
    // When the driver is gone, what else came last is the reason: first what was on its way, and nothing else for a moment.
    drop(server);
    let restarted = DriverError::Restarted { driver: "sim/arm".into() };
    loop {
        intrude(&network, &encoding, strange.clone());
        match driver.sample() {
            Ok(_) | Err(DriverError::Silent { .. } | DriverError::Message { .. }) => {}
            Err(error) => break assert_eq!(error, restarted),
        }
    }
}

#[test]
fn targets_of_another_version_are_refused_with_the_reason() {
    let (network, model) = (Network::new(), model("pillar7"));
    let _server = network.serve("arm", &model, DriverClock::Realtime);
    let (tell, told) = std::sync::mpsc::channel();
    let Keys { sample, targets: key, .. } = Keys::of("sim", "arm").unwrap();
    let reader = network.guarding.control_reader(sample, move |message| {
        let sample: WireSample = read(&message.encoding, &message.payload).unwrap();
        sample.refused.into_iter().for_each(|refused| drop(tell.send(refused)));
    });
    let _reader = network.threads.block_on(reader).unwrap();
    let other = WireTargets::SCHEMA.encoding().replace(";v1", ";v2");
    let (commander, position, velocity) = ("a".to_owned(), vec![0.1, 0.2], vec![0.0, 0.0]);
    let targets = written(&WireTargets { commander, epoch: 7, number: 1, position, velocity }).1;
    let reason = loop {
        network.threads.block_on(network.guarding.put(&key, &other, targets.clone())).unwrap();
        // The link may not know the driver yet.
        if let Ok(reason) = told.recv_timeout(std::time::Duration::from_millis(100)) {
            break reason;
        }
    };
    assert!(reason.contains("the payload is version 2 of `drive/targets`"), "{reason}");
}

#[test]
fn a_clock_that_goes_back_ends_a_driver_with_the_reason() {
    struct Jumping(ServoDriver, u64);
    impl Driver for Jumping {
        fn clock(&self) -> DriverClock {
            self.0.clock()
        }
        fn period(&self) -> std::time::Duration {
            self.0.period()
        }
        fn sample(&mut self) -> Result<TimedSample, DriverError> {
            self.1 += 1;
            let timed = self.0.sample()?;
            let stamp_ns = if self.1 > 5 { 7 } else { timed.stamp_ns };
            Ok(TimedSample { stamp_ns, ..timed })
        }
        fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
            self.0.apply(targets)
        }
        fn brake(&mut self) {
            self.0.brake();
        }
    }
    let (network, model) = (Network::new(), model("pillar7"));
    let jumping = Jumping(ServoDriver::new(&model, model.start(), DriverClock::Lockstep), 0);
    let serving = DriverServer::start(&network.driving, ("sim", "arm"), &model, jumping);
    let _server = network.threads.block_on(serving).unwrap();
    let driver = network.connect("arm", &model).unwrap();
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let arm = model.arms().next().unwrap();
    let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
    let ended = in_virtual_time(GuardedDriver::new(guard, driver).run(|_, _| true));
    let clock = DriverError::Clock { driver: "sim/arm".into(), before_ns: 5_000_000, after_ns: 7 };
    assert_eq!(ended, Err(clock.clone()));
    assert_eq!(lease.fault(), Some(Fault::Stopped { reason: clock.to_string() }));
    drop(lease);
    robot.reset();
    let refused = robot.lease(&arm.name, "test", LeaseLimits::default()).map(drop);
    assert_eq!(
        refused,
        Err(LeaseError::Stopped { reason: clock.to_string() }),
        "a reset brings no driver back"
    );
}
