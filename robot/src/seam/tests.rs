//! A robot in another session keeps every rule, and ends the leases of who is gone.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Session, SessionConfig};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};

use crate::driver::{DriverClock, DriverError, GuardedDriver};
use crate::{
    Fault, Guard, GuardConfig, LeaseError, LeaseLimits, Model, RemoteRobot, Robot, RobotServer, ServoDriver,
    conformance,
};

async fn linked(to: &Session) -> Session {
    let config = SessionConfig { listen: Vec::new(), ..SessionConfig::connected_to(&to.endpoints().await) };
    Session::open(&config).await.unwrap()
}

/// A robot whose time stays behind where the machine is busy.
struct Served {
    robot: Arc<dyn Robot>,
    session: Session,
    server: RobotServer,
    moving: JoinHandle<Result<(), DriverError>>,
}

async fn serve(model: &Arc<Model>) -> Served {
    let (guard, robot) = Guard::new(Arc::clone(model), GuardConfig::of(model));
    let joints = ServoDriver::new(model, model.start(), DriverClock::Lockstep);
    let moving = tokio::spawn(GuardedDriver::new(guard, joints).run(|_, _| true));
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let robot: Arc<dyn Robot> = robot;
    let server = RobotServer::start(&session, ("lab", "arm"), Arc::clone(&robot)).await.unwrap();
    Served { robot, session, server, moving }
}

async fn connect(session: &Session, model: &Arc<Model>) -> RemoteRobot {
    RemoteRobot::connect(session, ("lab", "arm"), model, "test").await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_robot_in_another_session_keeps_every_rule() {
    let model = Model::shipped("pillar7").unwrap();
    let served = serve(&model).await;
    let session = linked(&served.session).await;
    let robot: Arc<dyn Robot> = Arc::new(connect(&session, &model).await);
    conformance::check(&robot, &model.arms().next().unwrap().name).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_lease_ends_with_its_holders_session_and_the_limb_stands() {
    let model = Model::shipped("pillar7").unwrap();
    let served = serve(&model).await;
    let arm = model.arms().next().unwrap();
    let session = linked(&served.session).await;
    let robot = connect(&session, &model).await;
    let lease = robot.lease(&arm.name, "test", LeaseLimits::default()).unwrap();
    let mut sensed = robot.sensed();
    let began = Instant::now();
    while began.elapsed() < Duration::from_millis(300) {
        lease.command(&vec![0.3; arm.joints.len()]).unwrap();
        sensed.changed().await.unwrap();
    }
    let own = served.robot;
    let taken = own.lease(&arm.name, "another", LeaseLimits::default());
    assert!(matches!(taken, Err(LeaseError::Taken { .. })), "{taken:?}");
    // Nothing is given back: the process is gone.
    std::mem::forget((lease, robot));
    session.close().await.unwrap();
    let mut seen = own.sensed();
    let gone_ns = seen.borrow().stamp_ns;
    let standing = loop {
        seen.changed().await.unwrap();
        let now = seen.borrow_and_update();
        if arm.joints.iter().all(|&joint| now.velocity[joint].abs() < conformance::STANDING) {
            break now.stamp_ns - gone_ns;
        }
    };
    assert!(standing < conformance::STANDING_WITHIN_NS, "{standing} ns");
    let free = timeout(Duration::from_secs(2), async {
        while own.lease(&arm.name, "another", LeaseLimits::default()).is_err() {
            sleep(Duration::from_millis(5)).await;
        }
    });
    free.await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_robot_that_is_lost_is_so_with_a_reason() {
    let model = Model::shipped("pillar7").unwrap();
    let Served { session, server, moving, .. } = serve(&model).await;
    let other = linked(&session).await;
    let robot = connect(&other, &model).await;
    let mut sensed = robot.sensed();
    sensed.changed().await.unwrap();
    let lease = robot.lease(&model.arms().next().unwrap().name, "test", LeaseLimits::default()).unwrap();
    moving.abort();
    drop(server);
    while sensed.changed().await.is_ok() {}
    let Some(Fault::Stopped { reason }) = lease.fault() else { panic!("{:?}", lease.fault()) };
    assert_eq!(reason, "the robot `lab/arm` is lost: it has sent no state for 500 ms");
    assert!(robot.tare("any").is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn another_robot_of_the_name_is_refused() {
    let model = Model::shipped("pillar7").unwrap();
    let served = serve(&model).await;
    let session = linked(&served.session).await;
    let armar = Model::shipped("armar3").unwrap();
    let refused = RemoteRobot::connect(&session, ("lab", "arm"), &armar, "test").await;
    let error = refused.map(drop).unwrap_err().to_string();
    assert!(
        error.contains("it is not the robot `armar3` as this process knows it: it has another name"),
        "{error}"
    );
}
