//! A robot in another session keeps every rule, and ends the leases of who is gone.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{Key, Reply, Session, SessionConfig};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

use super::served::secret;
use super::wire::{Keys, LeaseQuestion, LeaseRefused, Leased, RobotCommand, RobotState};
use crate::message::{read, written};
use crate::planning::KnownBox;
use crate::{
    Fault, Guard, GuardConfig, GuardedRobot, LeaseError, LeaseLimits, Load, Model, RemoteRobot, Robot,
    RobotServer, ServoJoints, conformance,
};

async fn linked(to: &Session) -> Session {
    let config = SessionConfig { listen: Vec::new(), ..SessionConfig::connected_to(&to.endpoints().await) };
    Session::open(&config).await.unwrap()
}

async fn connect(session: &Session, model: &Arc<Model>) -> RemoteRobot {
    RemoteRobot::connect(session, ("lab", "arm"), model, "test").await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_robot_in_another_session_keeps_every_rule() {
    let mut far = Stepped::new().await;
    let remote = Arc::new(connect(&far.near, &far.model).await);
    let robot: Arc<dyn Robot> = Arc::<RemoteRobot>::clone(&remote);
    let arm = far.arm();
    let stepping = async {
        loop {
            far.seen_by(&remote).await;
        }
    };
    // In one task, and the rules first: what they command at a sample is on its way before the sample counts as seen.
    tokio::select! {
        biased;
        checked = conformance::check(&robot, &arm) => checked.unwrap(),
        () = stepping => {}
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_lease_ends_with_its_holders_session_and_the_limb_stands() {
    let mut far = Stepped::new().await;
    let robot = connect(&far.near, &far.model).await;
    let arm = far.model.arms().next().unwrap().clone();
    let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
    for _ in 0..300 {
        lease.command(&vec![0.3; arm.joints.len()]).unwrap();
        far.seen_by(&robot).await;
    }
    let taken = far.own.lease(&arm.name, "another", LeaseLimits::default());
    assert!(matches!(taken, Err(LeaseError::Taken { .. })), "{taken:?}");
    let moves = |far: &Stepped| {
        let velocity = &far.joints.sample().velocity;
        arm.joints.iter().any(|&joint| velocity[joint].abs() >= conformance::STANDING)
    };
    assert!(moves(&far));
    // Nothing is given back: the process is gone.
    std::mem::forget((lease, robot));
    far.near.close().await.unwrap();
    (0..conformance::STANDING_WITHIN_NS / 1_000_000).for_each(|_| far.step());
    assert!(!moves(&far), "{:?}", far.joints.sample().velocity);
    let freed = async {
        while far.own.lease(&arm.name, "another", LeaseLimits::default()).is_err() {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(Duration::from_secs(30), freed).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_robot_that_is_lost_is_so_with_a_reason() {
    let mut far = Stepped::new().await;
    let robot = connect(&far.near, &far.model).await;
    far.seen_by(&robot).await;
    let mut sensed = robot.sensed();
    let lease = robot.lease(&far.arm(), "test", LeaseLimits::default()).unwrap();
    drop(far.server);
    while sensed.changed().await.is_ok() {}
    assert_eq!(robot.lost().unwrap(), "the robot `lab/arm` is lost: it has sent no state for 700 ms");
    let Some(Fault::Stopped { reason }) = lease.fault() else { panic!("{:?}", lease.fault()) };
    assert_eq!(reason, "the robot `lab/arm` is lost: it has sent no state for 700 ms");
    assert!(robot.tare("any").is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn another_robot_of_the_name_is_refused() {
    let far = Stepped::new().await;
    let armar = Model::shipped("armar3").unwrap();
    let refused = RemoteRobot::connect(&far.near, ("lab", "arm"), &armar, "test").await;
    let error = refused.map(drop).unwrap_err().to_string();
    assert!(
        error.contains("it is not the robot `armar3` as this process knows it: it has another name"),
        "{error}"
    );
}

/// A robot in another session whose guard a test steps, in its own time: a machine that is busy delays nothing in it.
struct Stepped {
    model: Arc<Model>,
    guard: Guard,
    joints: ServoJoints,
    own: Arc<GuardedRobot>,
    server: RobotServer,
    session: Session,
    /// The session of the commander's side.
    near: Session,
    /// Sent from there after each sample, by the same way as commands and after them.
    barrier: ControlSender,
    passed: watch::Receiver<u64>,
    _reader: ControlReader,
    stamp_ns: u64,
}

impl Stepped {
    async fn new() -> Self {
        let model = Model::shipped("pillar7").unwrap();
        let (guard, own) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let session = Session::open(&SessionConfig::default()).await.unwrap();
        let shared: Arc<dyn Robot> = Arc::<GuardedRobot>::clone(&own);
        let server = RobotServer::start(&session, ("lab", "arm"), shared).await.unwrap();
        let joints = ServoJoints::new(&model, model.start(), 0);
        let near = linked(&session).await;
        let key = Key::parse("armarium/lab/test/barrier").unwrap();
        let barrier = near.control_sender(&key, "test").await.unwrap();
        let (pass, passed) = watch::channel(0);
        let reader = session.control_reader(key, move |message| {
            let stamp_ns = u64::from_le_bytes(message.payload.try_into().unwrap());
            pass.send_replace(stamp_ns);
        });
        let _reader = reader.await.unwrap();
        Self { model, guard, joints, own, server, session, near, barrier, passed, _reader, stamp_ns: 0 }
    }

    fn step(&mut self) {
        self.stamp_ns += 1_000_000;
        self.joints.step(self.guard.step(self.stamp_ns, self.joints.sample()), &[], 1e-3);
    }

    /// Steps until the robot over there has sensed the newest sample, and what was commanded until then has come.
    async fn seen_by(&mut self, robot: &RemoteRobot) {
        let mut sensed = robot.sensed();
        loop {
            self.step();
            let stamp_ns = self.stamp_ns;
            let seen = async {
                while sensed.borrow_and_update().stamp_ns != stamp_ns {
                    sensed.changed().await.unwrap();
                }
                // Whoever else waits for the sample commands first.
                tokio::task::yield_now().await;
                self.barrier.send(stamp_ns.to_le_bytes().into()).unwrap();
                self.passed.wait_for(|&passed_ns| passed_ns == stamp_ns).await.unwrap();
            };
            // Either message may be lost.
            if timeout(Duration::from_millis(100), seen).await.is_ok() {
                return;
            }
        }
    }

    fn arm(&self) -> String {
        self.model.arms().next().unwrap().name.clone()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn why_a_driver_was_lost_is_told_to_all_and_leases_are_refused_with_it() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let robot = connect(&session, &far.model).await;
    let lease = robot.lease(&far.arm(), "test", LeaseLimits::default()).unwrap();
    far.seen_by(&robot).await;
    far.guard.end("the driver was pulled out");
    far.server.last_state_sent().await;
    let mut sensed = robot.sensed();
    while sensed.changed().await.is_ok() {}
    assert_eq!(robot.lost().unwrap(), "the robot `lab/arm` is lost: the driver was pulled out");
    let stopped = Fault::Stopped { reason: "the driver was pulled out".into() };
    assert_eq!(lease.fault(), Some(stopped));
    // Who comes later is told, too; so is who asks by hand, and a reset brings no driver back.
    let late = RemoteRobot::connect(&session, ("lab", "arm"), &far.model, "test").await;
    assert_eq!(late.map(drop).unwrap_err().to_string(), "the robot `lab/arm`: the driver was pulled out");
    far.own.reset();
    let keys = Keys::of("lab", "arm").unwrap();
    let question = LeaseQuestion {
        limbs: vec![far.arm()],
        holder: "by hand".into(),
        force_n: None,
        speed_m_s: None,
        touches: Vec::new(),
        token: "by/alive/hand".into(),
    };
    let (encoding, payload) = written(&question);
    let asked = session.query_one(&keys.lease, "", Some((&encoding, payload))).await.unwrap();
    let Reply::Refusal { encoding, payload } = asked else { panic!("{asked:?}") };
    let LeaseRefused { why } = read(&encoding, &payload).unwrap();
    assert_eq!(why, LeaseError::Stopped { reason: "the driver was pulled out".into() });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn states_that_are_none_of_the_robot_are_passed_over_until_no_other_comes() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let key = Keys::of("lab", "arm").unwrap().state;
    let reasons = [
        "its guard was started again, or there are two of the name",
        "its clock went from",
        "a state is not of its joints and sensors, or not all of its numbers are finite",
        "a state is not of its joints and sensors, or not all of its numbers are finite",
        "the payload is version 9 of `robot/state`",
    ];
    for (case, reason) in reasons.into_iter().enumerate() {
        let robot = connect(&session, &far.model).await;
        far.seen_by(&robot).await;
        let number = 1 << 40;
        let mut strange =
            RobotState::of(&far.own.sensed().borrow(), (robot.epoch(), number), BTreeMap::new(), None);
        strange.stamp_ns += 1_000_000_000;
        match case {
            0 => strange.epoch += 1,
            1 => strange.stamp_ns = 5,
            2 => strange.velocity[0] = f64::NAN,
            3 => strange.wrenches.clear(),
            _ => {}
        }
        let (mut encoding, payload) = written(&strange);
        if case == 4 {
            encoding = encoding.replace(";v1", ";v9");
        }
        far.session.put(&key, &encoding, payload).await.unwrap();
        far.seen_by(&robot).await;
        assert_eq!(robot.lost(), None, "{reason}");
        // Then nothing else comes.
        let mut sensed = robot.sensed();
        let (encoding, payload) = (encoding, written(&strange).1);
        while timeout(Duration::from_millis(20), sensed.changed()).await.is_err() {
            far.session.put(&key, &encoding, payload.clone()).await.unwrap();
        }
        let lost = robot.lost().unwrap();
        assert!(lost.contains(reason), "{lost}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_lease_is_a_secret_that_nobody_else_sees_and_a_second_after_its_fault_its_limbs_are_free() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let robot = connect(&session, &far.model).await;
    let (model, arm) = (Arc::clone(&far.model), far.arm());
    let lease = robot.lease(&arm, "test", LeaseLimits::default()).unwrap();
    let secrets = [secret().unwrap(), secret().unwrap()];
    assert!(secrets.iter().all(|secret| secret.len() == 32) && secrets[0] != secrets[1]);
    far.seen_by(&robot).await;
    // The command has come when the joints move.
    while far.joints.sample().velocity.iter().all(|v| v.abs() < 0.05) {
        lease.command(&vec![0.1; model.limb(&arm).len()]).unwrap();
        far.seen_by(&robot).await;
    }
    (0..900).for_each(|_| far.step());
    far.seen_by(&robot).await;
    assert!(matches!(lease.fault(), Some(Fault::Watchdog { .. })), "{:?}", lease.fault());
    let taken = far.own.lease(&arm, "another", LeaseLimits::default());
    assert!(matches!(taken, Err(LeaseError::Taken { .. })), "{taken:?}");
    for _ in 0..6 {
        (0..200).for_each(|_| far.step());
        far.seen_by(&robot).await;
    }
    let _another = far.own.lease(&arm, "another", LeaseLimits::default()).unwrap();
    far.seen_by(&robot).await;
    let fault = lease.command(&vec![0.1; model.limb(&arm).len()]).unwrap_err();
    assert!(matches!(fault, Fault::Watchdog { .. }), "who held it is told still: {fault:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn names_without_end_and_lengths_that_nothing_has_are_refused() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let robot = connect(&session, &far.model).await;
    far.seen_by(&robot).await;
    let (arm, long) = (far.arm(), "x".repeat(101));
    let none = LeaseLimits::default();
    for refused in [
        robot.lease(&arm, &long, none),
        robot.lease_together(&[&arm], "test", none, std::slice::from_ref(&long)),
        robot.lease_together(&[&arm], "test", none, &vec!["x".into(); 101]),
    ] {
        assert!(matches!(refused, Err(LeaseError::Names { .. })), "{refused:?}");
    }
    let hand = far.model.hands().keys().next().unwrap().clone();
    let load = |name: &str, mass_kg, x| {
        let name = name.to_owned();
        Some(Load { name, mass_kg, center_in_tcp: nalgebra::Point3::new(x, 0.0, 0.0), shape: None })
    };
    assert!(robot.set_load(&hand, load("cup", 0.3, 0.1)).is_ok());
    for wrong in [load("cup", 1e300, 0.0), load("cup", 0.3, -1e300), load(&long, 0.3, 0.0)] {
        let error = robot.set_load(&hand, wrong).unwrap_err().to_string();
        assert!(error.contains("is not physical: a mass is 0 to 1000 kg"), "{error}");
    }
    let known = |name: &str, x, edge| {
        let root_from_box = nalgebra::Isometry3::translation(x, 0.0, 0.0);
        vec![KnownBox { name: name.into(), root_from_box, size: [edge; 3].into() }]
    };
    assert!(robot.set_surroundings(known("wall", 9.0, 1.0)).is_ok());
    for wrong in [known("wall", 1e300, 1.0), known("wall", 9.0, 1e300), known(&long, 9.0, 1.0)] {
        let error = robot.set_surroundings(wrong).unwrap_err().to_string();
        assert!(error.contains("or a name over 100 bytes"), "{error}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn somebody_else_changes_the_speed_while_an_arm_moves() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let robot = connect(&session, &far.model).await;
    let other = connect(&session, &far.model).await;
    far.seen_by(&robot).await;
    let (arm, n) = (far.arm(), far.model.limb(&far.arm()).len());
    let lease = robot.lease(&arm, "test", LeaseLimits::default()).unwrap();
    let joint = far.model.limb(&arm)[0];
    let mut speeds = Vec::new();
    for scale in [1.0, 0.05, 0.5] {
        other.set_speed_scale(scale).unwrap();
        for _ in 0..200 {
            lease.command(&vec![0.2; n]).unwrap();
            far.seen_by(&robot).await;
        }
        speeds.push(far.joints.sample().velocity[joint] / 0.2);
    }
    for (speed, scale) in speeds.iter().zip([1.0, 0.05, 0.5]) {
        assert!((speed - scale).abs() < 0.02, "{speeds:?}");
    }
    for wrong in [0.0, -0.1, 1.1, f64::NAN] {
        assert!(other.set_speed_scale(wrong).is_err());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn commands_that_are_old_foreign_or_not_understood_move_nothing() {
    let mut far = Stepped::new().await;
    let session = far.near.clone();
    let robot = connect(&session, &far.model).await;
    far.seen_by(&robot).await;
    let (arm, n) = (far.arm(), far.model.limb(&far.arm()).len());
    let keys = Keys::of("lab", "arm").unwrap();
    let question = LeaseQuestion {
        limbs: vec![arm.clone()],
        holder: "by hand".into(),
        force_n: None,
        speed_m_s: None,
        touches: Vec::new(),
        token: robot.token().into(),
    };
    let (encoding, payload) = written(&question);
    let asked = session.query_one(&keys.lease, "", Some((&encoding, payload))).await.unwrap();
    let Reply::Message(answer) = asked else { panic!("{asked:?}") };
    let Leased { lease, number } = read(&answer.encoding, &answer.payload).unwrap();
    let command = |lease: &str, number, speed| {
        written(&RobotCommand { lease: lease.to_owned(), number, velocity: vec![speed; n] })
    };
    let (version, moving) = command(&lease, 100, 0.1);
    let cases = [
        command("a guess", 100, 0.1),
        command(&number.to_string(), 100, 0.1),
        command(&lease, 7, 0.1),
        command(&lease, 6, 0.1),
        (version.replace(";v1", ";v2"), moving),
        (version.clone(), vec![0xff]),
    ];
    let put = async |(encoding, payload): (String, Vec<u8>)| {
        session.put(&keys.command, &encoding, payload).await.unwrap();
    };
    put(command(&lease, 7, 0.0)).await;
    for wrong in cases {
        put(wrong).await;
        for _ in 0..20 {
            far.seen_by(&robot).await;
        }
        let fastest = far.joints.sample().velocity.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        assert!(fastest < 1e-3, "{fastest}");
    }
    // What is nonsense takes the limb from him, and the reason is told with the states.
    put(command(&lease, 8, f64::NAN)).await;
    let fault = timeout(Duration::from_secs(5), async {
        loop {
            far.seen_by(&robot).await;
            if let Some(fault) = robot.faults().get(&number) {
                return fault.clone();
            }
        }
    });
    let fault = fault.await.unwrap();
    assert!(matches!(fault, Fault::NotFinite { .. }), "{fault:?}");
}
