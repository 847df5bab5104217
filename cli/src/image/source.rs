//! Opens the provider that the command line names.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::SessionError;
use armarium_visionx::providers::{
    Delivery, FileProvider, ImageCoding, ImageProvider, Pace, ProviderDescription, RecordingProvider,
    RemoteError, RemoteProvider, StereoPair,
};

use super::{ImageFailure, SourceArgs, argument, failed};
use armarium_host::Connection;

const PROVIDER_TIMEOUT: Duration = Duration::from_secs(10);
/// Endings that mark a file.
const ENDINGS: [&str; 4] = ["mcap", "png", "jpg", "jpeg"];
/// Frames per second of image files.
const RATE_HZ: f64 = 30.0;

/// A provider, with its remote end if it is in another process.
pub(super) struct OpenedProvider {
    pub(super) provider: Arc<dyn ImageProvider>,
    pub(super) remote: Option<Arc<RemoteProvider>>,
}

/// Opens the provider that the arguments name. Files are played at `speed` times their own; with `None` as fast as
/// they are read.
pub(super) async fn open(
    args: &SourceArgs,
    connection: &Connection,
    coding: ImageCoding,
    speed: Option<f64>,
) -> Result<OpenedProvider, ImageFailure> {
    let delivery = Delivery::Newest;
    if Path::new(&args.source).exists() {
        let pace = Pace { speed, repeat: false };
        let provider =
            file(&[args.source.as_str().into()], "files", args.topic.as_deref(), RATE_HZ, pace).await?;
        return Ok(OpenedProvider { provider, remote: None });
    }
    let remote = Arc::new(remote(&args.source, connection, delivery, coding).await?);
    Ok(OpenedProvider { provider: Arc::clone(&remote) as Arc<dyn ImageProvider>, remote: Some(remote) })
}

/// As [`open`], for the newest frames of a stereo pair; returns its description and the pairs.
pub(super) async fn open_pair(
    args: &SourceArgs,
    connection: &Connection,
) -> Result<(OpenedProvider, ProviderDescription, StereoPair), ImageFailure> {
    let source = open(args, connection, ImageCoding::Raw, None).await?;
    let described = source.provider.description();
    let pair = StereoPair::of(&described);
    let pair = pair.map_err(|what| {
        let hint = if source.remote.is_some() {
            "`armarium image ls` lists what it gives"
        } else {
            "of files, a pair is `NAME_left.png` and `NAME_right.png` with a `calibration.yaml` (docs/vision.md); \
             `armarium vision` looks at single photographs"
        };
        argument(format!("`{}` gives no stereo pairs: {what}; {hint}", args.source))
    })?;
    Ok((source, described, pair))
}

/// The provider `AGENT/PROVIDER`.
pub(super) async fn remote(
    name: &str,
    connection: &Connection,
    delivery: Delivery,
    coding: ImageCoding,
) -> Result<RemoteProvider, ImageFailure> {
    let file = Path::new(name).extension().is_some_and(|e| ENDINGS.iter().any(|ending| e == *ending));
    let parts = name.split_once('/').filter(|(a, p)| !file && !a.is_empty() && !p.is_empty());
    let Some((agent, provider)) = parts else {
        return Err(argument(format!("there is no file `{name}`, and it is no AGENT/PROVIDER")));
    };
    let connected =
        RemoteProvider::connect(connection.session(), agent, provider, delivery, coding, PROVIDER_TIMEOUT)
            .await;
    connected.map_err(|error| match error {
        RemoteError::Session(SessionError::NoReply { .. }) => {
            failed(format!("{error}; `armarium image ls` lists the providers that can be reached"))
        }
        error => failed(error),
    })
}

/// A recording, a camera (`/dev/video0`), or image files.
pub(super) async fn file(
    files: &[std::path::PathBuf],
    name: &str,
    topic: Option<&str>,
    rate_hz: f64,
    pace: Pace,
) -> Result<Arc<dyn ImageProvider>, ImageFailure> {
    match (files.iter().find(|file| file.extension().is_some_and(|e| e == "mcap")), files) {
        (Some(recording), [_]) => {
            return Ok(Arc::new(RecordingProvider::open(recording, topic, pace).await.map_err(argument)?));
        }
        (Some(recording), _) => {
            let recording = recording.display();
            return Err(argument(format!(
                "{recording}: a recording cannot be mixed with other files; give it alone"
            )));
        }
        (None, _) => {}
    }
    if let [device] = files
        && device.starts_with("/dev")
    {
        return camera(device, name);
    }
    let provider = FileProvider::open(name, files, rate_hz, pace).await;
    Ok(Arc::new(provider.map_err(|(path, e)| argument(format!("{}: {e}", path.display())))?))
}

/// Requested size of camera images, px.
#[cfg(feature = "camera")]
const CAMERA: (u32, u32) = (640, 480);

#[cfg(feature = "camera")]
fn camera(device: &Path, name: &str) -> Result<Arc<dyn ImageProvider>, ImageFailure> {
    let camera = armarium_visionx::providers::CameraProvider::open(device, name, CAMERA);
    Ok(Arc::new(camera.map_err(|e| argument(format!("{}: {e}", device.display())))?))
}

#[cfg(not(feature = "camera"))]
fn camera(device: &Path, _: &str) -> Result<Arc<dyn ImageProvider>, ImageFailure> {
    let device = device.display();
    Err(argument(format!(
        "{device}: this program was built without cameras; build it with `--features camera`"
    )))
}
