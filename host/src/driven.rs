//! A robot that is not simulated here: its driver is in another process and its guard in this one, or both are elsewhere.

use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::WorkingMemory;
use armarium_robot::driver::{
    Driver, DriverClock, DriverError, DryDriver, GuardedDriver, RemoteDriver, TimedSample,
};
use armarium_robot::{
    Guard, GuardConfig, Joint, JointKind, JointTargets, Model, RemoteRobot, Robot, Sensed, newest,
};
use armarium_simulator::{Handle, Referee, RobotInWorld, World};
use armarium_visionx::{ImageError, ImageSource, PinholeCamera, StereoCalibration, StereoFrame};
use async_trait::async_trait;
use parking_lot::Mutex;

use crate::address::Address;
use crate::connection::Connection;
use crate::console::Console;
use crate::error::HostError;
use crate::recording::RunDigest;
use crate::simulated::{StagedRobot, equipment_of};
use crate::told_scene::{self, SceneTeller};

/// Where a run finds its robot, if not in the simulator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RobotAt {
    /// A driver; the guard is in the process of the run.
    Driver(Address),
    /// The same with everything but targets: nothing moves.
    DryDriver(Address),
    /// A robot behind a guard (`armarium robot serve`), which other processes may use, too.
    Guard(Address),
}

/// A robot that was found.
pub(crate) enum OutsideRobot {
    Driver(Box<RemoteDriver>),
    DryDriver(Box<DryDriver<RemoteDriver>>),
    Guard(RemoteRobot),
}

/// What brings the samples of such a robot.
pub(crate) enum Mover {
    Driver(Box<GuardedDriver>, Option<Wanted>),
    Guard(newest::NewestReceiver<Arc<Sensed>>),
}

/// How fast the joints of a robot would have been that must not move.
pub(crate) struct Wanted {
    model: Arc<Model>,
    fastest: Arc<Mutex<Vec<f64>>>,
}

/// A driver whose targets count in the run's digest, and that tells cameras what there is to see, if it knows it.
struct Witnessed<D> {
    driver: D,
    digest: RunDigest,
    stamp_ns: u64,
    teller: Option<SceneTeller>,
}

impl OutsideRobot {
    /// Connects to the world's robot, or claims its driver, as the agent `caller`.
    pub(crate) fn connect(
        at: &RobotAt,
        world: &World,
        caller: &str,
        connection: &Connection,
    ) -> Result<Self, HostError> {
        let (session, model) = (connection.session(), world.model()?);
        let threads = connection.runtime();
        match at {
            RobotAt::Driver(Address { agent, name }) | RobotAt::DryDriver(Address { agent, name }) => {
                let driver =
                    threads.block_on(RemoteDriver::connect(session, (agent, name), &model, caller))?;
                Ok(match at {
                    RobotAt::DryDriver(_) => Self::DryDriver(Box::new(DryDriver::new(driver))),
                    _ => Self::Driver(Box::new(driver)),
                })
            }
            RobotAt::Guard(Address { agent, name }) => Ok(Self::Guard(
                threads.block_on(RemoteRobot::connect(session, (agent, name), &model, caller))?,
            )),
        }
    }

    /// Whether its time can stand still.
    pub(crate) fn waits(&self) -> bool {
        let clock = match self {
            Self::Driver(driver) => driver.clock(),
            Self::DryDriver(driver) => driver.clock(),
            Self::Guard(_) => return false,
        };
        clock == DriverClock::Lockstep
    }

    /// The robot with what its skills need; it sees what its driver tells of the scene, or nothing until it is given cameras. Its commanded velocities are multiplied
    /// by `speed_scale`, if that is given. The targets of its joints are added to the digest, where the guard is here.
    pub(crate) fn stage(
        self,
        world: &World,
        seed: u64,
        memory: &Arc<WorkingMemory>,
        speed_scale: Option<f64>,
        (digest, console): (&RunDigest, &dyn Console),
    ) -> Result<(StagedRobot, Mover), HostError> {
        let bodies = match &self {
            Self::Driver(driver) => driver.bodies(),
            Self::DryDriver(driver) => driver.bodies(),
            Self::Guard(_) => Vec::new(),
        };
        let mut images: Arc<dyn ImageSource> = Arc::new(NoCameras::of(world));
        let mut teller = None;
        if !bodies.is_empty() {
            let (tells, cameras) = told_scene::cameras(world, seed, &bodies, console)?;
            (images, teller) = (Arc::new(cameras), Some(tells));
        }
        let (robot, mover): (Arc<dyn Robot>, Mover) = match self {
            Self::Driver(driver) => driven(world.model()?, *driver, (digest, teller), None),
            Self::DryDriver(driver) => {
                let model = world.model()?;
                let wanted = Wanted { model: Arc::clone(&model), fastest: driver.fastest() };
                driven(model, *driver, (digest, teller), Some(wanted))
            }
            Self::Guard(robot) => {
                let sensed = robot.sensed();
                (Arc::new(robot), Mover::Guard(sensed))
            }
        };
        if let Some(scale) = speed_scale {
            robot.set_speed_scale(scale)?;
        }
        let robot = RobotInWorld { name: world.robot.name.clone(), robot, images };
        let equipment = equipment_of(&robot, &world.robot, memory, seed);
        Ok((StagedRobot { referee: Referee::new(world), handle: Handle::default(), equipment }, mover))
    }
}

/// The robot above a driver, and what moves it.
fn driven(
    model: Arc<Model>,
    driver: impl Driver + 'static,
    (digest, teller): (&RunDigest, Option<SceneTeller>),
    wanted: Option<Wanted>,
) -> (Arc<dyn Robot>, Mover) {
    let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let driver = Witnessed { driver, digest: digest.clone(), stamp_ns: 0, teller };
    (robot, Mover::Driver(Box::new(GuardedDriver::new(guard, driver)), wanted))
}

impl<D> Witnessed<D> {
    fn witness(&mut self, timed: &TimedSample) {
        self.stamp_ns = timed.stamp_ns;
        self.teller.iter_mut().for_each(|teller| teller.tell(timed));
    }
}

impl<D: Driver> Driver for Witnessed<D> {
    fn clock(&self) -> DriverClock {
        self.driver.clock()
    }

    fn period(&self) -> Duration {
        self.driver.period()
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let timed = self.driver.sample()?;
        self.witness(&timed);
        Ok(timed)
    }

    fn call_on_arrival(&mut self, call: Box<dyn Fn() + Send + Sync>) -> bool {
        self.driver.call_on_arrival(call)
    }

    fn arrived(&mut self) -> Result<Option<TimedSample>, DriverError> {
        let timed = self.driver.arrived()?;
        timed.iter().for_each(|timed| self.witness(timed));
        Ok(timed)
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        self.digest.add(&(self.stamp_ns, &targets.position, &targets.velocity));
        self.driver.apply(targets)
    }

    fn brake(&mut self) {
        self.driver.brake();
    }
}

impl std::fmt::Display for Wanted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let fastest = self.fastest.lock();
        let moved = self.model.joints().iter().zip(fastest.iter()).filter(|(_, speed)| **speed > 0.0);
        let said = moved.map(|(Joint { name, kind, .. }, speed)| {
            let unit = if *kind == JointKind::Prismatic { "m/s" } else { "rad/s" };
            format!("{name} with up to {speed:.2} {unit}")
        });
        let said: Vec<String> = said.collect();
        let would = if said.is_empty() { "nothing".into() } else { said.join(", ") };
        write!(f, "dry run: nothing was commanded; what would have moved: {would}")
    }
}

impl Mover {
    /// Runs until `handle` ends it, or the robot is lost.
    pub(crate) async fn run(self, handle: Handle, console: Arc<dyn Console>) {
        match self {
            Self::Driver(driver, wanted) => {
                let heard = Arc::clone(&console);
                let after = move |stamp_ns: u64, said: Vec<String>| {
                    said.iter().for_each(|said| heard.happened(&format!("the robot says: {said}")));
                    handle.advance(stamp_ns)
                };
                if let Err(error) = driver.run(after).await {
                    console.note(&format!("warning: {error}"));
                }
                if let Some(wanted) = wanted {
                    console.note(&wanted.to_string());
                }
            }
            Self::Guard(mut sensed) => {
                while sensed.changed().await.is_ok() && handle.advance(sensed.borrow_and_update().stamp_ns) {}
            }
        }
    }
}

/// The cameras of a robot that has none: who waits for a picture is told so.
struct NoCameras(StereoCalibration);

impl NoCameras {
    fn of(world: &World) -> Self {
        let spec = &world.camera;
        let (width, height) = (spec.width, spec.height);
        let center = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        let camera = PinholeCamera { width, height, focal: spec.focal, center };
        Self(StereoCalibration { camera, baseline: spec.baseline })
    }
}

#[async_trait]
impl ImageSource for NoCameras {
    fn name(&self) -> &'static str {
        "none, as the run has no --cameras"
    }

    fn calibration(&self) -> StereoCalibration {
        self.0
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        Err(ImageError::Gone { provider: self.name().to_owned() })
    }
}
