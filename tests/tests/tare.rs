//! `Tare` makes the resting hand's force zero, and says why it does not.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_host::bench::{Bench, Benched};
use armarium_robot::planning::KnownBox;
use armarium_robot::{
    Commander, Fault, Lease, LeaseError, LeaseLimits, Load, Model, Robot, RobotError, Sensed, SensedWrench,
    newest,
};
use armarium_runtime::skill::Skill;
use armarium_simulator::World;
use armarium_states::Equipment;
use nalgebra::Vector3;

fn tare(equipment: &Equipment) -> Arc<dyn Skill> {
    armarium_states::skills(equipment).into_iter().find(|skill| skill.manifest().name == "Tare").unwrap()
}

fn reason(ended: &Benched) -> &str {
    assert_eq!(ended.outcome, "failure");
    ended.reason.as_deref().unwrap()
}

fn norm(force: &armarium_values::Value) -> f64 {
    Vector3::from(force.as_vector3().unwrap()).norm()
}

/// A world whose wrist sensor has an offset of some newtons.
fn biased(faults: &str) -> World {
    let text = format!("world: w\nrobot: {{noise: {{wrench_bias: 6 N}}}}\n{faults}\n");
    World::parse(std::path::Path::new("w.yaml"), &text).unwrap()
}

#[test]
fn what_the_resting_hand_feels_becomes_zero() {
    let ended = Bench::new(tare).world(biased("")).run().unwrap();
    assert_eq!(ended.outcome, "success", "{:?}", ended.reason);
    let left = ended.robot.sensed().borrow().wrenches[0].external.force.norm();
    let felt = norm(&ended.outputs["force"]);
    // Behind the low-pass, noise of 0.3 N (one deviation, each axis) is about 0.1 N.
    assert!(felt > 2.0 && left < 0.5, "{felt} N before, {left} N after");
}

#[test]
fn a_sensor_that_repeats_itself_is_said() {
    let ended = Bench::new(tare).world(biased("faults: {wrench: frozen}")).run().unwrap();
    assert!(reason(&ended).contains("check the sensor and its cable"), "{:?}", ended.reason);
}

/// A robot whose samples the test makes up.
struct Scripted {
    model: Arc<Model>,
    sensed: newest::Sender<Arc<Sensed>>,
}

#[derive(Debug)]
struct Nobody;

impl Commander for Nobody {
    fn command(&self, _: &[f64]) -> Result<(), Fault> {
        Ok(())
    }
    fn fault(&self) -> Option<Fault> {
        None
    }
}

impl Robot for Scripted {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }
    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>> {
        self.sensed.subscribe()
    }
    fn lease_together(&self, _: &[&str], _: &str, _: LeaseLimits, _: &[String]) -> Result<Lease, LeaseError> {
        Ok(Lease::new(Nobody))
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

/// `Tare` with a robot whose joints have `velocity(ms)` rad/s; it is silent from `until` ms on.
fn scripted(velocity: impl Fn(u64) -> f64 + Copy + Send + Sync + 'static, until: u64) -> Benched {
    let make = move |equipment: &Equipment| {
        let model = Arc::clone(equipment.robot.model());
        let position = model.start().to_vec();
        let sample = move |ms: u64| Sensed {
            stamp_ns: ms * 1_000_000,
            position: position.clone(),
            velocity: vec![velocity(ms); position.len()],
            wrenches: vec![SensedWrench::default(); 2],
        };
        let robot = Arc::new(Scripted { model, sensed: newest::Sender::new(Arc::new(sample(0))) });
        let samples = Arc::clone(&robot);
        tokio::spawn(async move {
            for ms in 1..until {
                tokio::time::sleep(Duration::from_millis(1)).await;
                samples.sensed.send(Arc::new(sample(ms)));
            }
            std::future::pending::<()>().await;
        });
        tare(&Equipment { robot, ..equipment.clone() })
    };
    Bench::new(make).at_most(Duration::from_secs(20)).run().unwrap()
}

#[test]
fn an_arm_that_moves_is_not_tared() {
    let ended = scripted(|_| 0.3, u64::MAX);
    assert!(reason(&ended).contains("the arm still moves after 2.0 s, a joint at 0.30 rad/s"));
    let ended = scripted(|ms| if ms > 180 { 0.1 } else { 0.0 }, u64::MAX);
    assert!(reason(&ended).contains("the arm moved while it was tared"), "{:?}", ended.reason);
    // It waits for an arm that still brakes.
    assert_eq!(scripted(|ms| if ms < 900 { 0.1 } else { 0.0 }, u64::MAX).outcome, "success");
}

#[test]
fn a_silent_robot_is_said() {
    let ended = scripted(|_| 0.0, 100);
    assert_eq!(reason(&ended), "the robot has sent no sample for 500 ms");
}
