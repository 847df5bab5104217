//! The simulated cameras in a process of their own. A run sends the scene to it and receives the frames, like images
//! of any other provider.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Interest, Key, KeyError, Schema, Session, decode, encode, keys};
use armarium_simulator::World;
use armarium_simulator::cameras::{DistantCameras, Scenery, ScenerySink};
use armarium_visionx::ImageSource;
use armarium_visionx::providers::{
    Delivery, ImageCoding, ProviderDescription, RawFrame, RemoteProvider, StereoView, channel, frame_of,
    offer,
};
use tokio::sync::watch;

use crate::connection::Connection;
use crate::console::Console;
use crate::error::HostError;

/// The scene on the network.
const SCENERY: Schema = Schema::new("simulator/scenery", 2);
/// The part of the provider's key on which the scene is published.
const SCENERY_KEY: &str = "scenery";
/// How long a run waits for its cameras.
const CAMERA_TIMEOUT: Duration = Duration::from_secs(10);

/// The configuration of the cameras process.
#[derive(Clone, Debug, PartialEq)]
pub struct CamerasConfig {
    /// The name by which a run addresses them.
    pub name: String,
    /// The simulated world, the same as the run's; `None`: the default kitchen.
    pub world: Option<PathBuf>,
    /// The run's seed.
    pub seed: u64,
}

fn unusable(name: &str, why: impl ToString) -> HostError {
    HostError::Images { provider: name.to_owned(), why: why.to_string() }
}

/// Renders the scenes of runs; never returns without an error.
///
/// # Errors
/// [`HostError::Findings`], [`HostError::Images`] and [`HostError::Session`].
pub async fn serve_cameras(
    config: &CamerasConfig,
    session: &Session,
    console: &dyn Console,
) -> Result<(), HostError> {
    let world =
        config.world.as_deref().map_or_else(|| Ok(World::default()), |file| World::load(file, config.seed));
    let world = world.map_err(HostError::Findings)?;
    let name = &config.name;
    let mut cameras = DistantCameras::new(&world, config.seed).map_err(|error| unusable(name, error))?;
    let frame_id = cameras.frame().to_owned();
    let described = ProviderDescription::of_stereo(DistantCameras::name(), &frame_id, &cameras.calibration());
    let about = format!("cameras of the simulated world `{}`, seed {}", world.name, config.seed);
    let (frames, provider) = channel(ProviderDescription { about, ..described });
    let _offered = offer(session, name, Arc::new(provider)).await?;
    let scenery = session.bulk_reader(scenery_key(name)?, 1, true).await?;
    console.note(&format!("{name}/{}", DistantCameras::name()));
    for endpoint in session.endpoints().await {
        console.note(&format!("  listens on {endpoint}"));
    }
    console.note(&format!(
        "  blind until a run shows them its world: armarium run CHART --cameras {name} --connect ENDPOINT"
    ));
    let mut refused = false;
    loop {
        let message = scenery.next().await;
        let drawn = drawn(&mut cameras, &message.encoding, message.payload.as_ref(), &frame_id);
        // Said once until a scene is drawn again: a run with another world sends the wrong one with each frame.
        let was_refused = std::mem::replace(&mut refused, drawn.is_err());
        match drawn {
            Ok(frame) => frames.send(frame),
            Err(error) if !was_refused => console.note(&format!("warning: {error}")),
            Err(_) => {}
        }
    }
}

/// What the cameras see of a scene that was sent.
fn drawn(
    cameras: &mut DistantCameras,
    encoding: &str,
    payload: &[u8],
    frame_id: &str,
) -> Result<RawFrame, Box<dyn std::error::Error + Send + Sync>> {
    SCENERY.check(encoding)?;
    let stereo = cameras.draw(&decode::<Scenery>(payload)?)?;
    Ok(frame_of(&stereo, 0, frame_id)?)
}

fn scenery_key(name: &str) -> Result<Key, HostError> {
    let wrong = |error: KeyError| unusable(name, error);
    keys::image_coded(name, DistantCameras::name(), SCENERY_KEY).map_err(wrong)
}

/// Sends the scene to cameras in another process; if they are slower than the world, only the newest.
pub(crate) struct RemoteScenery {
    newest: watch::Sender<Option<Scenery>>,
    wanted: Interest,
}

impl ScenerySink for RemoteScenery {
    fn is_wanted(&self) -> bool {
        self.wanted.has_subscribers()
    }

    fn show(&mut self, scenery: Scenery) {
        self.newest.send_replace(Some(scenery));
    }
}

/// Connects to the cameras `name`: returns where the scene goes, and the frames.
///
/// # Errors
/// [`HostError::Images`] when they are absent or not a stereo pair.
pub(crate) async fn connect(
    name: &str,
    connection: &Connection,
) -> Result<(RemoteScenery, Arc<dyn ImageSource>), HostError> {
    let session = connection.session();
    let key = scenery_key(name)?;
    let wanted = session.interest(&key.clone().into()).await?;
    let (camera, delivery) = (DistantCameras::name(), Delivery::Newest);
    let provider =
        RemoteProvider::connect(session, name, camera, delivery, ImageCoding::Raw, CAMERA_TIMEOUT).await;
    let provider = provider.map_err(|error| unusable(name, error))?;
    let view = StereoView::new(Arc::new(provider)).map_err(|error| unusable(name, error))?;
    let (newest, mut scenery) = watch::channel(None::<Scenery>);
    let sending = session.clone();
    connection.runtime().spawn(async move {
        while scenery.changed().await.is_ok() {
            let Some(Ok(payload)) = scenery.borrow_and_update().as_ref().map(encode) else { continue };
            if let Err(error) = sending.put(&key, &SCENERY.encoding(), payload).await {
                tracing::warn!("the cameras were not shown what there is to see: {error}");
            }
        }
    });
    Ok((RemoteScenery { newest, wanted }, Arc::new(view)))
}
