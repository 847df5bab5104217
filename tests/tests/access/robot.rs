//! Who drives a robot, who commands it, who looks on, and who does nothing of that.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Access, Session, SessionConfig};
use armarium_robot::driver::{DriverClock, DriverServer, GuardedDriver, RemoteDriver};
use armarium_robot::{
    Guard, GuardConfig, LeaseError, LeaseLimits, Model, RemoteRobot, Robot, RobotServer, ServoDriver,
};
use tokio::time::{sleep, timeout};

use super::Authority;

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn certificates_say_who_drives_who_commands_and_who_looks_on() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::new(folder.path());
    let access = Access {
        own: "lab".into(),
        watchers: names(&["walt"]),
        commanders: names(&["carol"]),
        drivers: names(&["motors"]),
        ..Access::default()
    };
    let lab = SessionConfig {
        listen: vec!["tls/127.0.0.1:0".into()],
        tls: Some(authority.tls("lab")),
        access_control: Some(access.rules().unwrap()),
        ..SessionConfig::default()
    };
    let lab = Session::open(&lab).await.unwrap();
    let endpoints = lab.endpoints().await;
    let open = async |name: &str| {
        let config = SessionConfig {
            tls: Some(authority.tls(name)),
            listen: Vec::new(),
            ..SessionConfig::connected_to(&endpoints)
        };
        Session::open(&config).await.unwrap()
    };

    // Who is named as a driver is one; who is not is not found, whatever he calls himself.
    let model = Model::shipped("pillar7").unwrap();
    let servo = || ServoDriver::new(&model, model.start(), DriverClock::Lockstep);
    let (motors, mallory) = (open("motors").await, open("mallory").await);
    let _driver = DriverServer::start(&motors, ("motors", "arm"), &model, servo()).await.unwrap();
    let _others = DriverServer::start(&mallory, ("mallory", "arm"), &model, servo()).await.unwrap();
    let _forged = DriverServer::start(&mallory, ("motors", "leg"), &model, servo()).await.unwrap();
    for strange in [("mallory", "arm"), ("motors", "leg")] {
        let error =
            RemoteDriver::connect(&lab, strange, &model, "lab").await.map(drop).unwrap_err().to_string();
        assert!(error.contains("nobody answered"), "{error}");
    }
    let driver = RemoteDriver::connect(&lab, ("motors", "arm"), &model, "lab").await.unwrap();
    let (guard, _) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    GuardedDriver::new(guard, driver).run(|stamp_ns, _| stamp_ns < 20_000_000).await.unwrap();

    // Links over TLS on which much goes both ways may stall (docs/memory.md, "Security"): from here on the driver is this process's.
    let (guard, own) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    tokio::spawn(GuardedDriver::new(guard, servo()).run(|_, _| true));
    let shared: Arc<dyn Robot> = Arc::<armarium_robot::GuardedRobot>::clone(&own);
    let _server = RobotServer::start(&lab, ("lab", "arm"), shared).await.unwrap();

    let arm = model.arms().next().unwrap();
    let lease = |robot: &RemoteRobot| robot.lease(&arm.name, "test", LeaseLimits::default());
    let connect = async |session: &Session, name: &str| {
        RemoteRobot::connect(session, ("lab", "arm"), &model, name).await
    };
    // Who looks on sees how the joints move, and moves none.
    let walt = open("walt").await;
    let watching = connect(&walt, "walt").await.unwrap();
    let mut seen = watching.sensed();
    seen.changed().await.unwrap();
    let refused = lease(&watching).map(drop);
    assert!(matches!(refused, Err(LeaseError::Unreachable { .. })), "{refused:?}");
    assert!(watching.set_speed_scale(0.5).is_err());
    // Nor does he do so under another name.
    let masked = connect(&walt, "carol").await.unwrap();
    assert!(lease(&masked).is_err());

    // Who commands does.
    let carol = open("carol").await;
    let robot = connect(&carol, "carol").await.unwrap();
    let mut held = Some(lease(&robot).unwrap());
    timeout(Duration::from_secs(20), async {
        loop {
            seen.changed().await.unwrap();
            if seen.borrow_and_update().velocity[arm.joints[0]] > 0.05 {
                return;
            }
            // Often enough for the watchdog of 30 ms.
            sleep(Duration::from_millis(10)).await;
            // On a machine with much else to do, a command may come too late, and its lease is lost.
            let velocities = vec![0.2; arm.joints.len()];
            if held.as_ref().is_none_or(|held| held.command(&velocities).is_err()) {
                drop(held.take());
                held = lease(&robot).ok();
            }
        }
    })
    .await
    .unwrap();
    // His lease ends with his session.
    std::mem::forget((held, robot));
    carol.close().await.unwrap();
    let free = async {
        while own.lease(&arm.name, "another", LeaseLimits::default()).is_err() {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(Duration::from_secs(2), free).await.unwrap();

    // A stranger finds nothing.
    let error = connect(&mallory, "mallory").await.map(drop).unwrap_err().to_string();
    assert!(error.contains("nobody answered"), "{error}");
}
