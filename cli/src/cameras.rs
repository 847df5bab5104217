//! `armarium cameras --name NAME`: the simulated cameras in a process of their own. A run that is told `--cameras NAME` sends
//! what there is to see, and looks at the frames that come back; they are images of any provider then.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Interest, Key, Schema, Session, decode, encode, keys};
use armarium_simulator::World;
use armarium_simulator::cameras::{DistantCameras, Scenery, ScenerySink};
use armarium_visionx::ImageSource;
use armarium_visionx::providers::{
    Delivery, Description, ImageCoding, RemoteProvider, StereoView, channel, frame_of, offer,
};
use tokio::sync::watch;

use crate::agent::stopped;
use crate::connection::{Connection, ConnectionArgs};
use crate::render_findings::{Shown, render, summary};

/// What there is to see, on the network.
const SCENERY: Schema = Schema::new("simulator/scenery", 1);
/// The part of the provider's key on which it is told.
const TOLD_ON: &str = "scenery";
/// How long a run waits for its cameras.
const WAIT: Duration = Duration::from_secs(10);
/// The left camera's coordinate frame.
const FRAME_ID: &str = "camera_left";

/// What `cameras` takes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct CamerasArgs {
    /// The name by which a run asks for them.
    #[arg(long)]
    pub(crate) name: String,
    /// The simulated world, the same as the run's; the default kitchen if not given.
    #[arg(long, value_name = "FILE")]
    pub(crate) world: Option<PathBuf>,
    /// The run's seed.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

/// Draws what runs show, until Ctrl-C. Returns the exit status.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &CamerasArgs, out: &mut dyn Write) -> io::Result<u8> {
    let world = match args.world.as_deref().map(World::load).unwrap_or_else(|| Ok(World::default())) {
        Ok(world) => world,
        Err(errors) => {
            let findings: Vec<Shown> = errors.iter().map(Shown::from).collect();
            write!(out, "{}", render(&findings, false, 100))?;
            return writeln!(out, "{}", summary(&findings)).map(|()| 2);
        }
    };
    let connection = match Connection::for_images(&args.connection, None) {
        Ok(connection) => connection,
        Err(message) => return writeln!(out, "error: {message}").map(|()| 2),
    };
    match connection.runtime().block_on(serve(args, &world, &connection.session, out)) {
        Ok(()) => Ok(0),
        Err(message) => writeln!(out, "error: {message}").map(|()| 2),
    }
}

async fn serve(
    args: &CamerasArgs,
    world: &World,
    session: &Session,
    out: &mut dyn Write,
) -> Result<(), String> {
    let mut cameras = DistantCameras::new(world, args.seed).map_err(|e| e.to_string())?;
    let described = Description::of_stereo(DistantCameras::name(), FRAME_ID, &cameras.calibration());
    let about = format!("cameras of the simulated world `{}`, seed {}", world.name, args.seed);
    let (frames, provider) = channel(Description { about, ..described });
    let _offered = offer(session, &args.name, Arc::new(provider)).await.map_err(|e| e.to_string())?;
    let told = session.bulk_reader(told_on(&args.name)?, 1, true).await.map_err(|e| e.to_string())?;
    let mut say =
        |line: String| writeln!(out, "{line}").and_then(|()| out.flush()).map_err(|e| e.to_string());
    say(format!("{}/{}", args.name, DistantCameras::name()))?;
    for endpoint in session.endpoints().await {
        say(format!("  listens on {endpoint}"))?;
    }
    let name = &args.name;
    say(format!(
        "  blind until a run shows them its world: armarium run CHART --cameras {name} --connect ENDPOINT"
    ))?;
    let mut refused = None;
    let drawing = async {
        loop {
            let told = told.next().await;
            let drawn = SCENERY
                .check(&told.encoding)
                .and_then(|()| decode::<Scenery>(told.payload.as_ref()))
                .map_err(|e| e.to_string())
                .and_then(|scenery| cameras.draw(&scenery).map_err(|e| e.to_string()))
                .and_then(|stereo| frame_of(&Arc::new(stereo), 0, FRAME_ID).map_err(|e| e.to_string()));
            match drawn {
                Ok(frame) => frames.send(frame),
                // Once each: a run that shows another world does so at each frame.
                Err(error) if refused.as_ref() != Some(&error) => {
                    say(format!("warning: {error}"))?;
                    refused = Some(error);
                }
                Err(_) => {}
            }
        }
    };
    tokio::select! {
        biased;
        () = stopped() => Ok(()),
        failed = drawing => failed,
    }
}

fn told_on(name: &str) -> Result<Key, String> {
    keys::image_coded(name, DistantCameras::name(), TOLD_ON).map_err(|e| e.to_string())
}

/// Tells cameras in another process what there is to see; the newest, when they are slower than the world.
pub(crate) struct Told {
    newest: watch::Sender<Option<Scenery>>,
    wanted: Interest,
}

impl ScenerySink for Told {
    fn is_wanted(&self) -> bool {
        self.wanted.is_there()
    }

    fn show(&mut self, scenery: Scenery) {
        self.newest.send_replace(Some(scenery));
    }
}

/// The cameras `name`: where the world tells what there is to see, and the frames that come back.
///
/// # Errors
/// One sentence for people.
pub(crate) async fn connect(
    name: &str,
    connection: &Connection,
) -> Result<(Told, Arc<dyn ImageSource>), String> {
    let session = &connection.session;
    let key = told_on(name)?;
    let wanted = session.interest(&key.clone().into()).await.map_err(|e| e.to_string())?;
    let (camera, delivery) = (DistantCameras::name(), Delivery::Newest);
    let provider = RemoteProvider::connect(session, name, camera, delivery, ImageCoding::Raw, WAIT).await;
    let provider = provider.map_err(|e| format!("the cameras `{name}`: {e}"))?;
    let view = StereoView::new(Arc::new(provider)).map_err(|e| e.to_string())?;
    let (newest, mut told) = watch::channel(None::<Scenery>);
    let sending = session.clone();
    connection.runtime().spawn(async move {
        while told.changed().await.is_ok() {
            let Some(Ok(scenery)) = told.borrow_and_update().as_ref().map(encode) else { continue };
            if let Err(error) = sending.put(&key, &SCENERY.encoding(), scenery).await {
                tracing::warn!("the cameras were not told what there is to see: {error}");
            }
        }
    });
    Ok((Told { newest, wanted }, Arc::new(view)))
}
