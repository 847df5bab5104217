//! `armarium memory top`: what each owner of provider segments takes and writes, and who follows whom.

use std::io::Write;
use std::time::Duration;

use armarium_memoryx::wire::Maintain;
use tokio::time::Instant;

use super::following::{lags_behind, lags_of};
use super::reach::OpenedMemory;
use super::show::Printer;
use super::{CommandFailure, MemoryArgs};
use crate::stopped::stopped;

/// How often it is shown.
const INTERVAL: Duration = Duration::from_secs(1);

/// Shows all that, again and again.
pub(super) async fn top(
    reached: &OpenedMemory,
    args: &MemoryArgs,
    once: bool,
    shown: &Printer,
    out: &mut dyn Write,
) -> Result<(), CommandFailure> {
    let (memory, session) = reached.agent()?;
    let mut before = (reached.maintain(Maintain::Usage).await?.counts, Instant::now());
    loop {
        tokio::select! {
            biased;
            () = stopped() => return Ok(()),
            () = tokio::time::sleep(INTERVAL) => {}
        }
        let now = (reached.maintain(Maintain::Usage).await?.counts, Instant::now());
        shown.owners(&before.0, &now.0, now.1 - before.1, out)?;
        shown.lags("follows", &lags_of(session, memory, &args.agent).await?, out)?;
        shown.lags("followed by", &lags_behind(session, memory, &args.agent).await?, out)?;
        out.flush()?;
        if once {
            return Ok(());
        }
        before = now;
    }
}
