//! A guard in a process of its own: it owns the driver of a robot, and skills of other processes use the robot through leases.
//!
//! When the driver is lost it waits for the driver to come back; those who used the robot connect again.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use armarium_bus::Session;
use armarium_robot::driver::{DriverError, DryDriver, GuardedDriver, RemoteDriver};
use armarium_robot::{Guard, GuardConfig, GuardedRobot, Model, Robot, RobotServer};
use armarium_runtime::chart::{Outline, Registry};
use armarium_viewer::live::PageAddress;

use crate::address::Address;
use crate::console::Console;
use crate::error::HostError;
use crate::live::ServiceView;
use crate::recording::record_robot;

/// How often a driver that is not there is looked for.
const LOOKED_FOR: Duration = Duration::from_millis(500);

/// What a robot is served with.
#[derive(Clone, Debug)]
pub struct RobotService {
    /// Its driver.
    pub driver: Address,
    /// The name under which others use it.
    pub offered: Address,
    /// Its description.
    pub model: Arc<Model>,
    /// All commanded velocities are multiplied by this, until somebody sets another scale.
    pub speed_scale: f64,
    /// Whether no targets are sent: nothing moves.
    pub dry: bool,
    /// Where a live page shows it; `None` serves none.
    pub live: Option<PageAddress>,
}

/// Ends a guard's thread when whoever waits for it is dropped.
struct EndOnDrop(Arc<AtomicBool>);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl RobotService {
    /// Serves until this is dropped, in real time on a multi-threaded runtime. While there is no driver, leases are refused with the
    /// reason.
    ///
    /// # Errors
    /// [`HostError`] when the driver is of another robot, or the session has closed.
    pub async fn serve(&self, session: &Session, console: &Arc<dyn Console>) -> Result<(), HostError> {
        let Address { agent, name } = &self.offered;
        let mut speed_scale = self.speed_scale;
        let (mut guard, robot) = self.guarded(speed_scale)?;
        guard.end(&format!("its driver `{}/{}` has not been found yet", self.driver.agent, self.driver.name));
        let mut server = RobotServer::start(session, (agent, name), robot).await?;
        let view = match &self.live {
            Some(address) => Some(self.show(address, session, &**console).await?),
            None => None,
        };
        loop {
            let driver = self.find(session, &**console).await?;
            let (guard, robot) = self.guarded(speed_scale)?;
            drop(server);
            let shared: Arc<dyn Robot> = Arc::<GuardedRobot>::clone(&robot);
            if let Some(view) = &view {
                // It ends with the robot, which is another one after a loss.
                record_robot(&shared, Some(0), view.recorder.clone());
            }
            server = RobotServer::start(session, (agent, name), shared).await?;
            console.note(&format!(
                "{agent}/{name}: the robot `{}`, {} by {}",
                self.model.name(),
                if self.dry { "sensed and not driven" } else { "driven" },
                driver.name()
            ));
            let ends = Arc::new(AtomicBool::new(false));
            let (_end, heard) = (EndOnDrop(Arc::clone(&ends)), Arc::clone(console));
            let after = move |_, said: Vec<String>| {
                said.iter().for_each(|said| heard.note(&format!("the robot says: {said}")));
                !ends.load(Ordering::Relaxed)
            };
            let guarded = match self.dry {
                false => GuardedDriver::new(guard, driver),
                true => GuardedDriver::new(guard, DryDriver::new(driver)),
            };
            if let Err(error) = guarded.run(after).await {
                console.note(&format!("warning: {error}"));
            }
            server.last_state_sent().await;
            speed_scale = robot.speed_scale();
        }
    }

    /// Opens a page that shows how the robot moves.
    async fn show(
        &self,
        address: &PageAddress,
        session: &Session,
        console: &dyn Console,
    ) -> Result<ServiceView, HostError> {
        let nothing = Outline { states: Vec::new(), transitions: Vec::new() };
        let subtitle = format!(
            "the robot `{}`, driven by `{}/{}`",
            self.model.name(),
            self.driver.agent,
            self.driver.name
        );
        let title = (self.offered.agent.as_str(), subtitle);
        ServiceView::open(address, title, nothing, (&Registry::default(), &self.model), session, console)
            .await
    }

    /// A guard without a driver yet, and the robot above it.
    fn guarded(&self, speed_scale: f64) -> Result<(Guard, Arc<GuardedRobot>), HostError> {
        let (guard, robot) = Guard::new(Arc::clone(&self.model), GuardConfig::of(&self.model));
        robot.set_speed_scale(speed_scale)?;
        Ok((guard, robot))
    }

    /// The driver, as soon as it is there and free.
    async fn find(&self, session: &Session, console: &dyn Console) -> Result<RemoteDriver, HostError> {
        let (Address { agent, name }, mut said) = (&self.driver, None);
        loop {
            match RemoteDriver::connect(session, (agent, name), &self.model, &self.offered.agent).await {
                Ok(driver) => return Ok(driver),
                Err(
                    error @ (DriverError::Session { .. }
                    | DriverError::Refused { .. }
                    | DriverError::Restarted { .. }),
                ) => {
                    if said.as_ref() != Some(&error) {
                        console.note(&format!("waiting: {error}"));
                        said = Some(error);
                    }
                    tokio::time::sleep(LOOKED_FOR).await;
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
}
