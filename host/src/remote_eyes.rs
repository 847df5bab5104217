//! An agent that only watches: it receives images from another agent, and has no limbs.
//!
//! Its clock is the images' time, so that two agents of one simulated world share one time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::{Session, SessionError};
use armarium_robot::{Guard, GuardConfig, Model, Robot, Sample};
use armarium_simulator::World;
use armarium_simulator::world::AgentSpec;
use armarium_visionx::providers::{Delivery, ImageCoding, RemoteError, RemoteProvider, StereoView};
use armarium_visionx::{ImageError, ImageSource, StereoCalibration, StereoFrame};
use async_trait::async_trait;
use tokio::sync::watch;

use crate::address::Address;
use crate::error::HostError;

/// How long one search for the images takes before their absence is reported.
const SEARCH_TIMEOUT: Duration = Duration::from_secs(10);

/// The world file's entry for an agent.
pub(crate) fn agent_of<'w>(world: &'w World, name: &str) -> Result<&'w AgentSpec, HostError> {
    world.agents.iter().find(|agent| agent.name == name).ok_or_else(|| {
        let known: Vec<&str> = world.agents.iter().map(|agent| agent.name.as_str()).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        HostError::UnknownAgent { world: world.name.clone(), name: name.to_owned(), known }
    })
}

/// Waits until the images are offered; meanwhile calls `say` from time to time. They have to be a stereo pair.
pub(crate) async fn open(
    session: &Session,
    eyes: &Address,
    mut say: impl FnMut(&str),
) -> Result<Arc<StereoView>, HostError> {
    loop {
        let Address { agent, name } = eyes;
        let unusable = |why: String| HostError::Images { provider: format!("{agent}/{name}"), why };
        let connected =
            RemoteProvider::connect(session, agent, name, Delivery::Newest, ImageCoding::Raw, SEARCH_TIMEOUT);
        match connected.await {
            Ok(provider) => {
                let view = StereoView::new(Arc::new(provider));
                return view.map(Arc::new).map_err(|e| unusable(e.to_string()));
            }
            Err(RemoteError::Session(SessionError::NoReply { .. })) => {
                say(&format!("waiting for the images `{agent}/{name}`"))
            }
            Err(error) => return Err(unusable(error.to_string())),
        }
    }
}

/// The eyes of an agent whose robot does not move.
pub(crate) struct RemoteEyes {
    pub(crate) robot: Arc<dyn Robot>,
    pub(crate) images: Arc<dyn ImageSource>,
    guard: Guard,
    view: Arc<StereoView>,
    newest: watch::Sender<Option<Arc<StereoFrame>>>,
    now_ns: Arc<AtomicU64>,
}

impl RemoteEyes {
    /// Eyes with the images of `view`; `now_ns` gets the time of the newest image.
    pub(crate) fn new(model: Arc<Model>, view: Arc<StereoView>, now_ns: Arc<AtomicU64>) -> Self {
        let config = GuardConfig::of(&model);
        let (guard, robot) = Guard::new(model, config);
        let (newest, receiver) = watch::channel(None);
        let (name, calibration) = (view.name().to_owned(), view.calibration());
        let images = Arc::new(SharedImages { name, calibration, newest: receiver });
        Self { robot, images, guard, view, newest, now_ns }
    }

    /// Passes images on, and publishes a sensor sample with each, until the images end.
    pub(crate) async fn live(mut self) {
        let sample = Sample::resting(self.robot.model(), self.robot.model().start().to_vec());
        while let Ok(frame) = self.view.next().await {
            let stamp_ns = frame.stamp_ns;
            self.newest.send_replace(Some(frame));
            self.guard.step(stamp_ns, &sample);
            self.now_ns.store(stamp_ns, Ordering::Relaxed);
        }
    }
}

/// Shares the images among any number of readers.
struct SharedImages {
    name: String,
    calibration: StereoCalibration,
    newest: watch::Receiver<Option<Arc<StereoFrame>>>,
}

#[async_trait]
impl ImageSource for SharedImages {
    fn name(&self) -> &str {
        &self.name
    }

    fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let gone = || ImageError::Gone { provider: self.name.clone() };
        let mut newest = self.newest.clone();
        newest.mark_unchanged();
        newest.changed().await.map_err(|_| gone())?;
        let frame = newest.borrow_and_update().clone();
        frame.ok_or_else(gone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_agent_that_the_world_does_not_know_is_said_with_those_that_it_does() {
        let error = agent_of(&World::default(), "alice").unwrap_err().to_string();
        assert!(error.contains("no agent `alice` (it has none)"), "{error}");
    }
}
