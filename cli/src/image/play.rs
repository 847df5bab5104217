//! `armarium image play`: offers a recording or files as a provider.

use std::io::Write;

use armarium_visionx::providers::{Pace, offer};

use super::{ImageFailure, PlayArgs, argument, failed, source};
use crate::stopped::stopped;
use armarium_host::Connection;

/// Offers until the end, or Ctrl-C.
pub(super) async fn run(
    args: &PlayArgs,
    connection: &Connection,
    out: &mut dyn Write,
) -> Result<(), ImageFailure> {
    if !(args.speed.is_finite() && args.speed > 0.0 && args.rate.is_finite() && args.rate > 0.0) {
        return Err(argument("--speed and --rate are greater than 0"));
    }
    let pace = Pace { speed: Some(args.speed), repeat: args.repeat };
    let provider = source::file(&args.files, &args.provider, args.topic.as_deref(), args.rate, pace).await?;
    let described = provider.description();
    let mut offered = offer(connection.session(), &args.name, provider).await.map_err(failed)?;
    writeln!(out, "{}/{}: {}", args.name, described.name, described.about)?;
    for endpoint in connection.session().endpoints().await {
        writeln!(out, "  listens on {endpoint}")?;
    }
    writeln!(out, "  begins when somebody looks; Ctrl-C ends it")?;
    out.flush()?;
    tokio::select! {
        biased;
        () = stopped() => {}
        () = offered.ended() => {}
    }
    let counts = offered.statistics();
    writeln!(out, "{} frames sent, {} spoilt", counts.sent.get(), counts.spoilt.get())?;
    Ok(())
}
