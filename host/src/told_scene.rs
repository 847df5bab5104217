//! Our cameras in another physics engine: a driver tells where its joints and bodies are, and the world's cameras draw that.
//!
//! A picture is drawn when somebody waits for it, in the driver's time: a run in lockstep stays one. The world has to be the one
//! that the driver simulates; what the driver does not tell is drawn as the world says.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_robot::driver::TimedSample;
use armarium_robot::newest;
use armarium_simulator::World;
use armarium_simulator::cameras::DistantCameras;
use armarium_visionx::{ImageError, ImageSource, StereoCalibration, StereoFrame};
use async_trait::async_trait;
use nalgebra::Isometry3;
use parking_lot::Mutex;

use crate::console::Console;
use crate::error::HostError;

/// What the driver has told last.
#[derive(Debug, Default)]
struct DriverScene {
    /// Number and time of the picture, ns.
    picture: (u64, u64),
    /// rad (m), in the model's order.
    position: Vec<f64>,
    /// Root frame.
    bodies: BTreeMap<String, Isometry3<f64>>,
}

/// Takes what a driver tells, at the cameras' rate.
pub(crate) struct SceneTeller {
    scenes: newest::Sender<Arc<DriverScene>>,
    rate_hz: f64,
    /// The number of the next picture.
    next: u64,
}

/// The cameras that draw it.
pub(crate) struct ToldCameras {
    scenes: newest::NewestReceiver<Arc<DriverScene>>,
    calibration: StereoCalibration,
    drawn: Arc<Mutex<Drawn>>,
}

struct Drawn {
    cameras: DistantCameras,
    /// The last picture and its number.
    last: Option<(u64, Arc<StereoFrame>)>,
}

/// The cameras of a world for a driver that tells where `bodies` are.
pub(crate) fn cameras(
    world: &World,
    seed: u64,
    bodies: &[String],
    console: &dyn Console,
) -> Result<(SceneTeller, ToldCameras), HostError> {
    let name = DistantCameras::name();
    let unusable = |why: String| HostError::Images { provider: name.to_owned(), why };
    let cameras = DistantCameras::new(world, seed).map_err(|error| unusable(error.to_string()))?;
    let known: Vec<&str> = cameras.bodies().collect();
    for strange in bodies.iter().filter(|body| !known.contains(&body.as_str())) {
        console.note(&format!(
            "warning: the driver tells where `{strange}` is, which the world does not have: no camera sees it"
        ));
    }
    let calibration = cameras.calibration();
    let scenes = newest::Sender::new(Arc::default());
    let told = scenes.subscribe();
    let teller = SceneTeller { scenes, rate_hz: world.camera.rate, next: 0 };
    let drawn = Arc::new(Mutex::new(Drawn { cameras, last: None }));
    Ok((teller, ToldCameras { scenes: told, calibration, drawn }))
}

impl SceneTeller {
    /// A sample of the driver: if a picture is due and the sample tells the scene, there may be one.
    pub(crate) fn tell(&mut self, timed: &TimedSample) {
        let number = (timed.stamp_ns as f64 * 1e-9 * self.rate_hz + 1e-6).floor() as u64;
        if timed.bodies.is_empty() || number < self.next {
            return;
        }
        self.next = number + 1;
        let (position, bodies) = (timed.sample.position.clone(), timed.bodies.clone());
        self.scenes.send(Arc::new(DriverScene { picture: (number, timed.stamp_ns), position, bodies }));
    }
}

impl ToldCameras {
    fn gone() -> ImageError {
        ImageError::Gone { provider: DistantCameras::name().to_owned() }
    }
}

#[async_trait]
impl ImageSource for ToldCameras {
    fn name(&self) -> &'static str {
        DistantCameras::name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let mut scenes = self.scenes.clone();
        scenes.borrow_and_update();
        scenes.changed().await.map_err(|_| Self::gone())?;
        let (scene, drawn) = (scenes.borrow_and_update(), Arc::clone(&self.drawn));
        // Not on the thread of the skills, who have to command meanwhile; a paused clock waits for it.
        let drawing = tokio::task::spawn_blocking(move || drawn.lock().picture(&scene));
        drawing.await.ok().flatten().ok_or_else(Self::gone)
    }
}

impl Drawn {
    /// The picture of a scene, unless it cannot be drawn.
    fn picture(&mut self, scene: &DriverScene) -> Option<Arc<StereoFrame>> {
        if let Some((number, frame)) = &self.last
            && *number == scene.picture.0
        {
            return Some(Arc::clone(frame));
        }
        let scenery = self.cameras.told(scene.picture, &scene.position, &scene.bodies);
        let drawn = self.cameras.draw(&scenery);
        let drawn =
            drawn.inspect_err(|error| tracing::warn!("what the driver tells cannot be drawn: {error}"));
        let frame = Arc::new(drawn.ok()?);
        self.last = Some((scene.picture.0, Arc::clone(&frame)));
        Some(frame)
    }
}
